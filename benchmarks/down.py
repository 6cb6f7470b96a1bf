"""Guess straight down from starting points all along simulated drives, walks and the Oakland
strips.

    python -m benchmarks.down [SEED]                    # first seed, default 8201

Limits were chosen on seeds 9501 to 9531 and 7701 to 7731. A guess is right within 15 degrees; it is
refused where another direction comes near. The windows are 64 lines spread over 640, as for a file,
and 64 in a row, as for a short one."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator

import numpy as np

from benchmarks.contest_data import Scan, Simulated, oakland, simulated
from prc_cli.core.types import F32, F64
from prc_cli.streams.down import MOST_LINES, guess_down, spread_rows

RIGHT_RAD = math.radians(15.0)
SPREAD_LINES = 640
EVERY = 64
"""Lines that a guess is spread over, and lines between two starting points."""
SCENES = ("residential", "terraces", "suburb", "boulevard", "mixed")
MOUNTS: tuple[tuple[str, str, dict[str, float]], ...] = (
    (
        "gap of 50° down, slant 20°",
        "photon-80",
        {"centre_deg": 180.0, "field_deg": 310.0, "slant_deg": 20.0},
    ),
    (
        "gap of 60° down, slant 30°",
        "photon-80",
        {"centre_deg": 180.0, "field_deg": 300.0, "slant_deg": 30.0},
    ),
    (
        "gap of 70° down, slant 45°",
        "photon-80",
        {"centre_deg": 180.0, "field_deg": 290.0, "slant_deg": 45.0},
    ),
    (
        "gap down and 30° aside",
        "photon-80",
        {"centre_deg": 180.0, "field_deg": 310.0, "slant_deg": 45.0, "roll_deg": 30.0},
    ),
    ("gap up, slant 25°", "photon-80", {"slant_deg": 25.0}),
    ("push-broom", "sick-push-broom", {}),
    ("whole turn, slant 45°", "profiler-1mhz", {"slant_deg": 45.0}),
)
LENGTHS_M = {"photon-80": 170.0, "sick-push-broom": 250.0, "profiler-1mhz": 50.0}
FORESTS = ("mixed", "pine-heath", "dense-spruce")


def scans(seed: int) -> Iterator[tuple[str, Scan]]:
    """Yield scans with the name of their kind."""
    for title, scanner, mount in MOUNTS:
        for scene in SCENES:
            seed += 1
            yield (
                title,
                simulated(
                    Simulated(scene, seed, LENGTHS_M[scanner], scene, scanner, mount=dict(mount))
                ),
            )
    for scene in FORESTS:
        seed += 1
        yield (
            "forest, gap down",
            simulated(Simulated(scene, seed, 18.0, scene, "focus3d-120", kind="forest")),
        )
    for strip in (1, 2, 3):
        yield "Oakland", oakland(strip)


def judge(angle_rad: F64, range_m: F32) -> tuple[int, int, int, float]:
    """Return whether a guess is right, wrong or refused, and how far it is off [deg]."""
    guess = guess_down(angle_rad, range_m[spread_rows(len(range_m), MOST_LINES)])
    if guess is None or not guess.is_sure:
        return 0, 0, 1, 0.0
    off = abs(math.remainder(guess.down_rad, 2 * math.pi))
    return int(off <= RIGHT_RAD), int(off > RIGHT_RAD), 0, math.degrees(off)


def main() -> None:
    """Print a table."""
    verdicts: dict[tuple[str, int], list[tuple[int, int, int, float]]] = {}
    for title, scan in scans(int(sys.argv[1]) if len(sys.argv) > 1 else 8201):
        lines = scan.range_m[np.isfinite(scan.range_m).any(axis=1)]
        for n in (SPREAD_LINES, MOST_LINES):
            starts = range(0, max(len(lines) - MOST_LINES, 1), EVERY)
            verdicts.setdefault((title, n), []).extend(
                judge(scan.angle_rad, lines[start : start + n]) for start in starts
            )
    print("| scans | lines | windows | right | wrong | refused | off in the middle | at most |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for (title, n), rows in verdicts.items():
        table = np.array(rows)
        right = table[table[:, 0] > 0, 3]
        counts = " | ".join(str(int(count)) for count in table[:, :3].sum(axis=0))
        off = f"{np.median(right):.1f}° | {right.max():.1f}°" if len(right) else "|"
        print(f"| {title} | {n} | {len(rows)} | {counts} | {off} |")


if __name__ == "__main__":
    main()
