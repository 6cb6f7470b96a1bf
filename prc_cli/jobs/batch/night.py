"""The report of a night: a page with the scores of a run, and of the nights before."""

from __future__ import annotations

import base64
import contextlib
import json
from importlib import resources
from pathlib import Path
from typing import Any

from prc_cli.core.errors import PrcError
from prc_cli.core.own_file import read_own, write_own
from prc_cli.core.pages import render_page
from prc_cli.evaluation.html import Curve, class_colour, line_chart
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.reports import percent
from prc_cli.evaluation.scores import scores
from prc_cli.formats.writing.record import read_record
from prc_cli.jobs.batch.engine import Compared
from prc_cli.jobs.batch.references import BatchEvaluation
from prc_cli.jobs.batch.report import BatchSummary
from prc_cli.jobs.batch.types import OWN_FOLDER, own_name
from prc_cli.jobs.drive import output_name
from prc_cli.jobs.evaluate.pictures import class_pictures

MOST_NIGHTS = 60
"""Nights in the report."""
WORST = 3
"""Files with pictures: the files with the lowest accuracy."""
LISTED = 500
"""Files in the table, the worst first; ``summary.json`` has all of them."""
_LARGEST = 1 << 22
"""Largest file of earlier nights that is read [bytes]."""


def write_night(summary: BatchSummary, to: str) -> Path | None:
    """Write ``report.html``, and save the scores for the next nights.

    Return None if no output was compared.
    """
    evaluation = summary.evaluation
    if evaluation is None:
        return None
    files = [(file, scores(file.matrix)) for file in evaluation.files if file.matrix is not None]
    if not files:
        return None
    history = summary.out / OWN_FOLDER / own_name("nights", summary.shard, ".json")
    nights = [*_earlier(history), _night(summary, evaluation)][-MOST_NIGHTS:]
    write_own(history, json.dumps(nights, indent=1, allow_nan=False) + "\n")
    files.sort(key=lambda file: file[1].accuracy)
    pooled = scores(evaluation.matrix)
    names = [row.name for row in pooled.classes if row.name in pooled.scored and row.n_reference]
    values = {
        "style": (resources.files("prc_cli.evaluation") / "page.css").read_text(encoding="utf-8"),
        "summary": summary,
        "evaluation": evaluation,
        "pooled": pooled,
        "names": names,
        "trend": _trend(nights, names),
        "files": files[:LISTED],
        "n_more": max(len(files) - LISTED, 0),
        "pictures": [
            (file.name, _pictures(file, summary, to, evaluation)) for file, _ in files[:WORST]
        ],
    }
    page = render_page(
        "prc_cli.jobs.batch", "night.html", values, {"percent": percent, "colour": class_colour}
    )
    path = summary.out / own_name("report", summary.shard, ".html")
    write_own(path, page)
    return path


def _earlier(path: Path) -> list[dict[str, Any]]:
    # none if the file is missing or damaged
    with contextlib.suppress(OSError, ValueError, PrcError, RecursionError):
        nights = json.loads(read_own(path, _LARGEST))
        return [
            night
            for night in nights
            if isinstance(night, dict) and {"finished", "f1", "records"} <= night.keys()
        ]
    return []


def _night(summary: BatchSummary, evaluation: BatchEvaluation) -> dict[str, Any]:
    pooled = scores(evaluation.matrix)
    # without undefined scores, which are NaN
    f1 = {row.name: float(row.f1) for row in pooled.classes if row.f1 == row.f1}
    return {
        "finished": summary.finished,
        "records": pooled.n_scored,
        "accuracy": float(pooled.accuracy),
        "f1": f1,
    }


def _trend(nights: list[dict[str, Any]], names: list[str]) -> str:
    # F1 of every class by night; empty for a first night
    if len(nights) < 2:
        return ""
    dates = [str(night["finished"])[:10] for night in nights]
    curves = [
        Curve(name, tuple(float(night["f1"].get(name, float("nan"))) for night in nights), colour)
        for colour, name in enumerate(names)
    ]
    ticks = [date if i in (0, len(dates) - 1) else "" for i, date in enumerate(dates)]
    return line_chart(
        "F1 by night", "night", dates, [int(night["records"]) for night in nights], curves, ticks
    )


def _pictures(
    file: Compared,
    summary: BatchSummary,
    to: str,
    evaluation: BatchEvaluation,
) -> list[tuple[str, str]]:
    """Draw the classes of a file and its reference: captions and PNGs in base64.

    Empty if the scan lines of the file are not known.
    """
    settings = evaluation.settings
    if file.reference is None or settings.mapping_name is None:
        return []
    predicted = summary.out / output_name(file.name, to)
    mapping = load_mapping(settings.mapping_name)
    with contextlib.suppress(PrcError, OSError, ValueError, KeyError, TypeError):
        record = read_record(predicted)
        drawn = class_pictures(
            predicted,
            settings.tree / file.reference,
            mapping,
            record["stream"]["points_per_line"],
            points=(summary.archive / file.name, None),
        )
        return [(caption, base64.b64encode(png).decode()) for caption, png in drawn]
    return []
