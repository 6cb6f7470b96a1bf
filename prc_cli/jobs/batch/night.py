"""The night's report: a page of a run whose outputs were compared with references, beside the nights before."""

from __future__ import annotations

import base64
import contextlib
import json
from importlib import resources
from pathlib import Path
from typing import Any

from prc_cli.core.errors import PrcError
from prc_cli.core.files import atomic_output, read_own, remove_stale
from prc_cli.core.pages import render_page
from prc_cli.evaluation.html import Curve, class_colour, line_chart
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.reports import percent
from prc_cli.evaluation.scores import scores
from prc_cli.formats.writing.record import read_record
from prc_cli.jobs.batch.report import BatchEvaluation, BatchSummary
from prc_cli.jobs.batch.types import OWN_FOLDER, Compared, own_name
from prc_cli.jobs.drive import output_name
from prc_cli.jobs.evaluate.pictures import class_pictures

MOST_NIGHTS = 60
"""Nights that are kept and drawn."""
WORST = 3
"""Files with pictures: those of the lowest accuracy."""
LISTED = 500
"""Files in the table, the worst first; all of them are in ``summary.json``."""
_LARGEST = 1 << 22
"""Largest file of earlier nights that is read [bytes]."""


def write_night(summary: BatchSummary, to: str) -> Path | None:
    """Write ``report.html`` and keep the scores for the next nights.

    None where nothing was compared.
    """
    found = summary.evaluation
    if found is None or not any(one.matrix is not None for one in found.files):
        return None
    kept = summary.out / OWN_FOLDER / own_name("nights", summary.shard, ".json")
    nights = [*_earlier(kept), _night(summary, found)][-MOST_NIGHTS:]
    _write(kept, json.dumps(nights, indent=1, allow_nan=False) + "\n")
    compared = [one for one in found.files if one.matrix is not None]
    worst = sorted(
        compared, key=lambda one: 0.0 if one.matrix is None else scores(one.matrix).accuracy
    )
    pooled = scores(found.matrix)
    names = [
        item.name for item in pooled.classes if item.name in pooled.scored and item.n_reference
    ]
    values = {
        "style": (resources.files("prc_cli.evaluation") / "page.css").read_text(encoding="utf-8"),
        "summary": summary,
        "found": found,
        "pooled": pooled,
        "names": names,
        "trend": _trend(nights, names),
        "files": [(one, scores(one.matrix)) for one in worst[:LISTED] if one.matrix is not None],
        "n_more": max(len(worst) - LISTED, 0),
        "pictures": [(one.name, _pictures(one, summary, to, found)) for one in worst[:WORST]],
    }
    page = render_page(
        "prc_cli.jobs.batch", "night.html", values, {"percent": percent, "colour": class_colour}
    )
    path = summary.out / own_name("report", summary.shard, ".html")
    _write(path, page)
    return path


def _write(path: Path, text: str) -> None:
    remove_stale(path)  # of a run that was killed just here
    with atomic_output(path, overwrite=True) as temporary:
        temporary.write_text(
            text, encoding="utf-8", errors="backslashreplace", newline="\n"
        )  # names may be any bytes


def _earlier(path: Path) -> list[dict[str, Any]]:
    """Return the nights before; none where there are none, or their file was damaged."""
    with contextlib.suppress(OSError, ValueError, PrcError, RecursionError):
        nights = json.loads(read_own(path, _LARGEST))
        return [
            night
            for night in nights
            if isinstance(night, dict) and {"finished", "f1", "records"} <= night.keys()
        ]
    return []


def _night(summary: BatchSummary, found: BatchEvaluation) -> dict[str, Any]:
    pooled = scores(found.matrix)
    f1 = {
        item.name: float(item.f1) for item in pooled.classes if item.f1 == item.f1
    }  # NaN where it is undefined
    return {
        "finished": summary.finished,
        "records": pooled.n_scored,
        "accuracy": float(pooled.accuracy),
        "f1": f1,
    }


def _trend(nights: list[dict[str, Any]], names: list[str]) -> str:
    """Draw the F1 of every class over the nights; empty for a first night."""
    if len(nights) < 2:
        return ""
    dates = [str(night["finished"])[:10] for night in nights]
    curves = [
        Curve(name, tuple(float(night["f1"].get(name, float("nan"))) for night in nights), place)
        for place, name in enumerate(names)
    ]
    ticks = [date if i in (0, len(dates) - 1) else "" for i, date in enumerate(dates)]
    return line_chart(
        "F1 by night", "night", dates, [int(night["records"]) for night in nights], curves, ticks
    )


def _pictures(
    one: Compared,
    summary: BatchSummary,
    to: str,
    found: BatchEvaluation,
) -> list[tuple[str, str]]:
    """Draw a file's classes beside those of its reference; none where its lines are not known."""
    if one.reference is None or found.settings.mapping_name is None:
        return []
    predicted = summary.out / output_name(one.name, to)
    mapping = load_mapping(found.settings.mapping_name)
    with contextlib.suppress(PrcError, OSError, ValueError, KeyError, TypeError):
        record = read_record(predicted)
        drawn = class_pictures(
            predicted,
            found.settings.tree / one.reference,
            mapping,
            record["stream"]["points_per_line"],
            points=(summary.archive / one.name, None),
        )
        return [(caption, base64.b64encode(png).decode()) for caption, png in drawn]
    return []
