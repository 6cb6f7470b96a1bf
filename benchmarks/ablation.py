"""What every step of the fused method is worth: F1 without it, one step after the other.

    python -m benchmarks.ablation > figures/ablation.md

The scans are those that chose limits and steps; ``benchmarks.labels`` judges on others.
A step that costs less than .003 of the mean F1 in every group and .01 in no class does not stay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any, TypeVar
from unittest import mock

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan
from benchmarks.contest_judge import judge, judge_things
from benchmarks.contest_methods import label
from benchmarks.pages import duration, heading, table
from prc_cli.config import load_config
from prc_cli.methods.forest.thresholds import FOREST, Forest
from prc_cli.methods.fused import pipeline
from prc_cli.methods.fused.thresholds import NEVER, NO_BINS, STREET, Limits

LEAST_THINGS = 200
"""Fewest cars, poles or curbs of the reference, in shots, to score them."""
Tables = dict[str, Any]
"""Limits by table and name; a value that is no dict takes the place of the table, None = the step
is left out."""
LimitsT = TypeVar("LimitsT", Limits, Forest)


def changed(limits: LimitsT, **tables: Any) -> LimitsT:
    """Return limits with changes in some tables, ``walls={"height_m": 9.0}``.

    A name instead of a number is another limit of the same table. A table that is left out already
    stays so."""
    result: Tables = {}
    for name, values in tables.items():
        before = getattr(limits, name)
        if isinstance(values, dict) and before is not None:
            changes = {
                key: getattr(before, value) if isinstance(value, str) else value
                for key, value in values.items()
            }
            result[name] = before._replace(
                **{key: type(getattr(before, key))(value) for key, value in changes.items()}
            )
        elif before is not None:
            result[name] = values
    return limits._replace(**result)


STREET_STEPS: dict[str, Tables] = {
    "interlaced columns in step": {"interlace_rad": math.inf},
    "neighbours farther away where lines are close": {"spaced": None},
    "trunks and posts along lines": {"columns": {"lines": -1}},
    "walls": {"walls": {"height_m": NEVER}},
    "roofs above walls": {"decision": {"roof_m": -NEVER}},
    "foliage rougher close to walls": {"decision": {"leaf_share_before_wall": "leaf_share"}},
    "flanks of vehicles": {"flanks": None},
    "bodies of lorries": {"flanks": {"high_m": -1}},
    "texture at its depth": {"foliage": {"at_depth": False}},
    "spikes": {"decision": {"spike_share": NEVER}},
    "sides of pits": {"decision": {"pit_near": NEVER}},
    "lone leaves": {"decision": {"leaf_slots": NEVER}},
    "ghosts behind walls": {"decision": {"ghost_near": 0}},
    "cars by level surfaces": {"decision": {"car_bins": NO_BINS, "car_bins_rough": NO_BINS}},
    "cars by roofs": {"roof_step_rad": math.inf},
    "cars not in rooms": {"room_m": 0.0},
    "poles": {"decision": {"pole_m": 0, "box_m": 0}},
    "trunks": {"decision": {"thick_m": NEVER}},
    "arms of lamps": {"decision": {"arm_m": NEVER}},
    "bins and cabinets": {"decision": {"box_m": 0}},
    "curbs": {"curbs": None},
    "votes": {"votes": None},
}
FOREST_STEPS: dict[str, Tables] = {
    "runs behind leaves": {"runs": {"gap_steep": -math.inf}},
    "opaque stems": {"runs": {"behind_m": math.inf}},
    "joined runs": {"stems": {"near_m": -1, "near_share": 0, "runs": 1}},
    "ground in flat places": {"classes": {"cover_m": 0}},
    "shots beside stems": {"classes": {"beside_m": -1}},
    "isolated shots": {"classes": {"near_m": -1}},
}


def scans() -> Iterator[tuple[str, Scan]]:
    """Yield scans with the name of their group."""
    for spec in data.TRAIN:
        yield "streets", data.simulated(spec)
    for spec in data.TRAIN_FOREST:
        yield "forests", data.simulated(spec)
    yield "Oakland", data.oakland(1)


def f1_of(scan: Scan) -> dict[str, float]:
    """Return the F1 of every class, cars, poles and curbs too, of the method as it is now."""
    run = label(scan, load_config(preset="fused-forest" if scan.mapping == "forest" else "fused"))
    scores = judge(scan, run.codes, run.extra_codes).f1()
    for name, (right, predicted, reference) in judge_things(scan, run.codes).items():
        if reference >= LEAST_THINGS:
            scores[f"{name}s"] = 2 * right / max(predicted + reference, 1.0)
    return scores


def main() -> None:
    """Print the table."""
    rows: dict[str, dict[str, list[dict[str, float]]]] = {}
    for group, scan in scans():
        steps = FOREST_STEPS if group == "forests" else STREET_STEPS
        for name in ("all steps", *steps):
            with ExitStack() as patches:
                if name in steps:
                    kind, limits = ("FOREST", FOREST) if group == "forests" else ("STREET", STREET)
                    without = changed(limits, **steps[name])
                    patches.enter_context(mock.patch.object(pipeline, kind, without))
                rows.setdefault(name, {}).setdefault(group, []).append(f1_of(scan))
    print(heading("Steps of fused: figures", "ablation"))
    print_steps(rows, rows["all steps"])
    print(duration())


def print_steps(
    rows: dict[str, dict[str, list[dict[str, float]]]], whole: dict[str, list[dict[str, float]]]
) -> None:
    """Print what is lost without every step."""
    table_rows = []
    for name, scores_by_group in rows.items():
        cells = []
        lost = []
        for group, before in whole.items():
            if group not in scores_by_group:
                cells.append("")
                continue
            now, then = (
                np.mean([np.mean(list(scores.values())) for scores in group_scores])
                for group_scores in (scores_by_group[group], before)
            )
            cells.append(f"{then:.3f}" if name == "all steps" else f"{now - then:+.4f}")
            for class_name in sorted({key for scores in before for key in scores}):
                pairs = zip(scores_by_group[group], before, strict=True)
                off = [
                    scores.get(class_name, 0.0) - first[class_name]
                    for scores, first in pairs
                    if class_name in first
                ]
                lost.append((float(np.mean(off)), f"{class_name}, {group}"))
        most = "" if name == "all steps" else f"{min(lost)[0]:+.3f} {min(lost)[1]}"
        table_rows.append((name, *cells, most))
    table(("without", *whole, "most lost by a class"), table_rows)


if __name__ == "__main__":
    main()
