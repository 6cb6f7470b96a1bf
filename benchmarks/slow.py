"""The fused method on slow and stop-and-go drives, beside the same streets driven normally.

    python -m benchmarks.slow            # seeds 1 to 5, for tuning
    python -m benchmarks.slow report     # seeds 1311 to 1316, which decided nothing

Leaves of the simulator have no size: every shot meets others, however slow the drive. Here they
have one: a slow drive is a normal one with lines in between, in which every shot is that of the
line before or of the line after, one after the other; surfaces go on evenly between them. Every
line has its own range noise and background light."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from unittest import mock

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan, Simulated
from benchmarks.contest_judge import judge
from benchmarks.contest_methods import label
from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.stream import ExtraReturns
from prc_cli.core.types import F64
from prc_cli.methods.fused import pipeline
from prc_cli.methods.fused.thresholds import STREET, Limits

NAMES = ("noise", "ground", "building", "vegetation")
SCENES = ("residential", "terraces", "suburb", "boulevard", "mixed")
LENGTH_M = 30.0
EVEN_M = 0.3
"""Surfaces are even between lines that differ by less in range [m]."""
EDGE_COLUMNS = 64
LEAVES = int(ClassCodes().lookup()[Label.VEGETATION])
NOISE = int(ClassCodes().lookup()[Label.NOISE])
NOISE_M = 0.002
"""Fresh range noise of the lines in between [m]."""
STRAY_SHARE = 0.03
"""Share of shots that become background light; every line has its own."""


def slowed(scan: Scan, places: F64, seed: int) -> Scan:
    """Return a scan with lines at other places along the way, in lines of the scan."""
    rng = np.random.default_rng(seed)
    before = np.floor(places).astype(np.int64)
    last = len(scan.range_m) - 1
    turn = rng.random(scan.range_m.shape, np.float32)
    # edges of things come together, leaves one by one
    groups = np.arange(scan.range_m.shape[1]) // EDGE_COLUMNS
    turn = np.where(scan.codes == LEAVES, turn, rng.random((len(turn), groups[-1] + 1))[:, groups])
    ranges = []
    codes = []
    for place, line in zip(places, before, strict=True):
        takes_next = turn[line] < place - line
        next_line = min(line + 1, last)
        line_ranges = scan.range_m[line]
        two = scan.range_m[next_line]
        rows = np.where(takes_next, two, line_ranges)
        # surfaces go on evenly
        is_even = (
            (abs(two - line_ranges) < EVEN_M)
            & (scan.codes[line] == scan.codes[next_line])
            & (scan.codes[line] != LEAVES)
        )
        rows = np.where(is_even, line_ranges + np.float32(place - line) * (two - line_ranges), rows)
        rows = rows + rng.normal(0, NOISE_M, rows.shape).astype(np.float32)
        line_codes = np.where(takes_next, scan.codes[next_line], scan.codes[line])
        is_stray = rng.random(rows.shape) < STRAY_SHARE
        is_around = rng.random(rows.shape) < data.STRAY_SHARE
        around = rows + rng.normal(0, data.STRAY_M, rows.shape)
        strays = np.where(
            is_around & (around > 0), around, rng.random(rows.shape) * data.FARTHEST_M
        )
        ranges.append(np.where(is_stray, strays, rows))
        codes.append(np.where(is_stray, NOISE, line_codes))
    return replace(
        scan,
        range_m=np.maximum(np.stack(ranges), np.float32(0.1)).astype(np.float32),
        codes=np.stack(codes),
        extra=ExtraReturns.none(),
        extra_codes=np.empty(0, np.int64),
        time_s=None,
        intensity=None,
        world_m=None,
        scanner_m=None,
    )


def every(part: float) -> Callable[[int], F64]:
    """Return the places of lines that lie closer by a factor."""
    return lambda n: np.arange(0.0, n - 1.0, part)


def stop_and_go(n: int) -> F64:
    """Return the places of a drive that brakes, stands for 400 lines and speeds up again, half
    way."""
    usual = np.ones(max((n - 80) // 2, 0))
    steps = np.concatenate(
        [usual, np.linspace(1, 0.02, 80), np.zeros(400), np.linspace(0.02, 1, 80), usual]
    )
    places = np.concatenate([[0.0], np.cumsum(steps)])
    kept: F64 = places[places < n - 1.0]
    return kept


DRIVES: dict[str, Callable[[int], F64]] = {
    "normal": every(1.0),
    "1/2 of the speed": every(0.5),
    "1/4": every(0.25),
    "1/8": every(0.125),
    "1/16": every(0.0625),
    "stop and go": stop_and_go,
}
SETTINGS = {"": STREET, "without": STREET._replace(spaced=None)}


def streets(seeds: Sequence[int]) -> list[Scan]:
    """Simulate streets of all scenes."""
    specs = [
        Simulated("", seed, LENGTH_M, scene=SCENES[i % 5], noise=0) for i, seed in enumerate(seeds)
    ]
    return [data.simulated(spec) for spec in specs]


def f1_of(scan: Scan, limits: Limits) -> list[float]:
    """Return the F1 of the four classes; NaN = too rare."""
    with mock.patch.object(pipeline, "STREET", limits):
        run = label(scan, load_config(preset="fused"))
    scores = judge(scan, run.codes, run.extra_codes).f1()
    return [scores.get(name, np.nan) for name in NAMES]


def cells(f1: F64, normal: F64) -> str:
    """Return the mean over streets, the lowest, and the most that is lost on one street beside its
    normal drive."""
    loss = np.nanmax(normal - f1, axis=0)
    pairs = zip(f1.T, loss, strict=True)
    return " | ".join(
        f"{np.nanmean(scores):.3f} ({np.nanmin(scores):.2f}, {-lost:+.3f})"
        for scores, lost in pairs
    )


def main() -> None:
    """Print the table."""
    seeds = range(1311, 1317) if "report" in sys.argv[1:] else range(1, 6)
    scans = streets(seeds)
    print(
        f"F1 on streets of seeds {seeds[0]} to {seeds[-1]}; lowest street, and most lost "
        "beside the normal drive\n"
    )
    print(f"| drive | {' | '.join(NAMES)} |\n|---|{'---:|' * 4}")
    normal = None
    for name, where in DRIVES.items():
        drives = [
            slowed(scan, where(len(scan.range_m)), seed)
            for scan, seed in zip(scans, seeds, strict=True)
        ]
        for suffix, limits in SETTINGS.items():
            rows = np.array([f1_of(drive, limits) for drive in drives])
            normal = rows if normal is None else normal
            print(f"| {name} {suffix} | {cells(rows, normal)} |")


if __name__ == "__main__":
    main()
