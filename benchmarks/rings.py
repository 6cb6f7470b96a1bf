"""The fused method on frames of spinning scanners: the KITTI frame and the labelled range views.

    python -m benchmarks.rings            # even-numbered views, which the parameters of rings were chosen on
    python -m benchmarks.rings report     # odd-numbered views

Reads ../shared/data or $PRC_DATA. The views are images of rings by azimuth, one point a cell. In the nuScenes views
verges are called vegetation.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan
from benchmarks.contest_judge import judge
from benchmarks.contest_methods import label, preset_with
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.types import I64, U8

CLASSES = {
    "kitti": {Label.GROUND: (9, 10, 11, 12, 17), Label.BUILDING: (13, 14), Label.VEGETATION: (15, 16)},
    "nuscenes": {Label.GROUND: (0, 1), Label.BUILDING: (2,), Label.VEGETATION: (4,)},
}
"""Reference codes of the views; others are not judged."""
NAMES = ("ground", "building", "vegetation")
CARS = {"frame": (10, 13, 16, 18, 20, 252, 257, 258, 259), "kitti": (1, 4, 5), "nuscenes": (7, 8, 9)}
"""Reference codes of cars, lorries and buses; unlabelled shots are not judged."""
UNLABELLED = {"frame": 0, "kitti": 0, "nuscenes": 10}
SETTINGS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("fused", ()),
    ("as for profilers", ("fused.rings.enabled=false",)),
    ("memory of the ground", ("fused.rings.memory_lines=60",)),
    ("steps of the ground", ("fused.rings.step_m=0.14", "fused.rings.gap_slope=0.08")),
    ("tolerance", ("fused.rings.noise_sigmas=2.25", "fused.rings.per_step=0.1")),
    ("walls", ("fused.rings.wall_m=1.5",)),
    ("flanks of vehicles", ("fused.rings.flanks=true",)),
    ("cars", ("fused.rings.cars=false",)),
    ("leaves", ("fused.rings.leaf_share=0.4", "fused.rings.leaf_share_before_walls=0.2")),
)
"""Settings that give single parameters the value for profilers."""


def f1_of(scan: Scan, labels: U8, classes: dict[Label, tuple[int, ...]]) -> list[float]:
    """Return the F1 of the three classes, among what is judged."""
    judged = np.isfinite(scan.range_m) & np.isin(scan.codes, [code for codes in classes.values() for code in codes])
    lookup, scores = ClassCodes().lookup(), []
    for one, codes in classes.items():
        reference, predicted = np.isin(scan.codes, codes) & judged, (labels == lookup[one]) & judged
        scores.append(2 * (reference & predicted).sum() / max(reference.sum() + predicted.sum(), 1))
    return scores


def cars_of(kind: str, scan: Scan, labels: U8) -> I64:
    """Return how many shots are rightly cars, are predicted as cars, and are cars of the reference."""
    judged = np.isfinite(scan.range_m) & (scan.codes != UNLABELLED[kind])
    predicted = (labels == ClassCodes().lookup()[Label.CAR]) & judged
    reference = np.isin(scan.codes, CARS[kind]) & judged
    return np.array([(predicted & reference).sum(), predicted.sum(), reference.sum()])


def print_cars(scans: dict[str, list[Scan]]) -> None:
    """Print precision, recall and F1 of cars, over all scans of a kind together."""
    print("\nCars: precision, recall, F1\n")
    print(f"| | {' | '.join(scans)} |\n|---|{'---:|' * len(scans)}")
    for title, assignments in (("fused", ()), ("as for profilers", ("fused.rings.enabled=false",))):
        config, cells = preset_with("fused", assignments), []
        for kind, items in scans.items():
            right, predicted, reference = sum(
                cars_of(kind, scan, label(scan, config).codes) for scan in items
            )  # fmt: skip
            f1 = 2 * right / max(predicted + reference, 1)
            cells.append(f"{right / max(predicted, 1):.2f}, {right / max(reference, 1):.2f}, {f1:.2f}")
        print(f"| {title} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the tables."""
    parity = int("report" in sys.argv[1:])
    frame = data.kitti()
    scans = {kind: list(data.views(kind, parity)) for kind in CLASSES}
    print(f"F1, {'odd' if parity else 'even'}-numbered views, means\n")
    print(f"| | {' | '.join(f'{scan} {name}' for scan in ('frame', *CLASSES) for name in NAMES)} |")
    print(f"|---|{'---:|' * 9}")
    for title, assignments in SETTINGS:
        config = preset_with("fused", assignments)
        found = label(frame, config)
        scores = judge(frame, found.codes, found.extra_codes).f1()
        cells = [scores[name] for name in NAMES]
        for kind, classes in CLASSES.items():
            cells += np.mean([f1_of(scan, label(scan, config).codes, classes) for scan in scans[kind]], axis=0).tolist()
        print(f"| {title} | {' | '.join(f'{cell:.3f}' for cell in cells)} |", flush=True)
    print_cars({"frame": [frame], **scans})


if __name__ == "__main__":
    main()
