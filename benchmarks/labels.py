"""F1 by scan and class of what ``prc classify IN OUT`` finds when nothing is told but the file.

    python -m benchmarks.labels                                  # the seeds below, and Oakland
    python -m benchmarks.labels --seeds 8901-8906 --only push-broom
    # another checkout too: after, and the difference
    python -m benchmarks.labels --against OTHER/bin/python

The first seeds chose nothing and were run once for the page of figures; limits were chosen on
:data:`SPENT`. The scene of a street goes with its seed. A class counts in a scan with at least 200
shots of it."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import contest_data as data
from benchmarks import contest_files, contest_judge
from benchmarks.contest_data import Scan, Simulated
from benchmarks.pages import parser_of

SEEDS = "8801-8806"
SPENT = "9301-9342, 9401-9442"
SCENES = ("residential", "terraces", "suburb", "boulevard", "mixed", "varied")
WOODS = ("mixed", "pine-heath", "dense-spruce")
MAPPINGS = {"forest": str(contest_judge.MAPPINGS["forest"]), "oakland": "street_oakland"}
"""Where the mapping of a scan does not score every class."""
NAMES = {"horizontal": "ground", "vertical": "building"}
"""Of the reference of a tripod.

Trunks, poles and curbs are vertical there, roofs horizontal; noise is not judged.
"""
LEAST_SHOTS = 200
WHOLE_TURN = {"azimuth_step_deg": 0.46}
STREETS: dict[str, Simulated] = {
    "profiler": Simulated("", 0, 60),
    "profiler, noise": Simulated("", 0, 60, noise=0.05),
    "push-broom": Simulated("", 0, 120, scanner="sick-push-broom"),
    "push-broom, noise": Simulated("", 0, 120, scanner="sick-push-broom", noise=0.05),
    "two returns": Simulated("", 0, 12, scanner="profiler-1mhz", mount={"max_returns": 2}),
    "tripod": Simulated("", 0, 783, scanner="scanstation2", kind="street-scan", mount=WHOLE_TURN),
    "tripod, noise": Simulated(
        "", 0, 783, scanner="scanstation2", kind="street-scan", mount=WHOLE_TURN, noise=0.05
    ),
}
"""Drives of so many metres, and tripods of so many lines.

Without noise, only mixed ranges at edges remain.
"""
Making = Callable[[], Scan]


def scans(seeds: list[int], only: str) -> Iterator[tuple[str, str, Making]]:
    """Yield the group, the name and the making of every scan whose group begins with ``only``."""
    groups: dict[str, list[tuple[str, Making]]] = {}
    for seed in seeds:
        scene = SCENES[seed % len(SCENES)]
        wood = WOODS[seed % len(WOODS)]
        for group, spec in STREETS.items():
            settings = replace(spec, seed=seed, scene=scene, noise=spec.noise or 0.0)
            groups.setdefault(group, []).append(
                (f"{scene} {seed}", partial(data.simulated, settings))
            )
        forest = Simulated("", seed, 15, wood, "focus3d-120", kind="forest")
        groups.setdefault("forest", []).append((f"{wood} {seed}", partial(data.simulated, forest)))
    groups["Oakland"] = [(f"strip {strip}", partial(data.oakland, strip)) for strip in (1, 2, 3)]
    yield from (
        (group, *scan)
        for group, every in groups.items()
        if group.startswith(only)
        for scan in every
    )


def written(scan: Scan, folder: Path) -> tuple[contest_files.ScanFile, Path]:
    """Write a scan as ``prc classify`` takes it, and its reference class of every record.

    Return both.
    """
    file = contest_files.write(scan, folder)
    reference = folder / "reference.npy"
    if file.record is None:
        np.save(reference, scan.codes.ravel().astype(np.int32))
    else:
        codes = np.zeros(
            int(max(file.record.max(), file.extra_record.max(initial=-1))) + 1, np.int32
        )
        codes[file.record[file.record >= 0]] = scan.codes[file.record >= 0]
        codes[file.extra_record] = scan.extra_codes
        np.save(reference, codes)
    return file, reference


def f1_of(python: str, scan: Scan, folder: Path) -> dict[str, float]:
    """Classify a scan and evaluate it as a user does, by the package of a Python.

    Return the F1 of every class.
    """
    file, reference = written(scan, folder)
    labels = folder / "labels.npy"
    labels.unlink(missing_ok=True)
    run = [*shlex.split(python), "-m", "prc_cli"]
    classify = [*run, "classify", str(file.path), str(labels), *file.options, "--overwrite", "-q"]
    done = subprocess.run(classify, cwd=folder, capture_output=True, text=True, check=False)
    if not labels.exists():
        print(f"refused: {done.stderr.strip()}", file=sys.stderr)
        return {}  # what is refused has no labels
    mapping = MAPPINGS.get(scan.mapping, scan.mapping)
    evaluate = [*run, "evaluate", str(labels), str(reference), "--mapping", mapping, "--json"]
    process = subprocess.run(evaluate, cwd=folder, capture_output=True, text=True, check=True)
    classes = json.loads(process.stdout)["classes"]
    return {
        NAMES.get(name, name): scores["f1"] or 0.0
        for name, scores in classes.items()
        if scores["n_reference"] >= LEAST_SHOTS and name != "other"
    }


def numbers(text: str) -> list[int]:
    """Return the seeds of a text, ``3-5, 9``."""
    spans = [part.partition("-") for part in text.replace(" ", "").split(",") if part]
    return [seed for first, _, last in spans for seed in range(int(first), int(last or first) + 1)]


CLASSES = ("noise", "ground", "curb", "building", "vegetation", "car", "pole", "stem")


def row(name: str, after: dict[str, float], before: dict[str, float] | None) -> str:
    """Return a row of the table, with the difference to another checkout, if there is one."""
    cells = []
    for key in CLASSES:
        change = "" if before is None else f" ({after.get(key, 0.0) - before.get(key, 0.0):+.3f})"
        cells.append(f"{after[key]:.3f}{change}" if key in after else "")
    return f"| {name} | {' | '.join(cells)} |"


def mean(all_scores: list[dict[str, float]]) -> dict[str, float]:
    """Return the mean F1 of every class over the scans that have it."""
    by_class = {key: [scores[key] for scores in all_scores if key in scores] for key in CLASSES}
    return {key: float(np.mean(every)) for key, every in by_class.items() if every}


def main() -> None:
    """Print a row for every scan, and the mean of every group."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", default=SEEDS, help="of simulated scans, e.g. 8801-8806,8901")
    parser.add_argument("--only", default="", metavar="GROUP", help="the groups that begin so")
    parser.add_argument(
        "--against", metavar="PYTHON", help="command of a Python with another checkout"
    )
    chosen = parser.parse_args()
    pythons = [sys.executable, *([chosen.against] if chosen.against else [])]
    print(f"| scan | {' | '.join(CLASSES)} |\n|---|{'---:|' * len(CLASSES)}")
    groups: dict[str, list[list[dict[str, float]]]] = {}
    for group, name, make in scans(numbers(chosen.seeds), chosen.only):
        with tempfile.TemporaryDirectory() as folder:
            scan = make()
            f1 = [f1_of(python, scan, Path(folder)) for python in pythons]
        groups.setdefault(group, []).append(f1)
        print(row(f"{group}: {name}", f1[0], f1[1] if len(f1) > 1 else None), flush=True)
    for group, every in groups.items():
        means = [mean([row[k] for row in every]) for k in range(len(pythons))]
        print(row(f"**{group}, mean**", means[0], means[1] if len(means) > 1 else None))


if __name__ == "__main__":
    main()
