"""Gain of the later steps of the fused method, on the streets for tuning and on twelve held-out streets.

    python -m benchmarks.contest_share

Streets have the scanners, mounts and noise of the contest, but other seeds: 9021 to 9092 for tuning, 9121 to 9132 held
out. Reads ../shared/data or $PRC_DATA for the first Oakland strip, to which background is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan, Simulated
from benchmarks.contest_judge import judge
from benchmarks.contest_methods import label, preset_with
from prc_cli.core.types import F64

SHORTER = {80.0: 60.0, 160.0: 120.0, 30.0: 20.0}
"""Lengths of streets of the contest, and of those for tuning [m]."""
SCENES = (
    "suburb", "terraces", "boulevard", "mixed", "residential", "terraces",
    "mixed", "boulevard", "mixed", "residential", "suburb", "terraces",
)  # fmt: skip
"""Other scenes for the same drives: those of seeds 9041 to 9052."""
NAMES = ("noise", "ground", "building", "vegetation")
WITHOUT = (
    ("fused.noise.held=false",),
    ("fused.noise.ghosts=false",),
    ("fused.strips.level_smooth=3",),
    ("fused.walls.behind_m=2.5",),
    ("fused.sensor.again=false",),
    ("fused.smoothness.noise_sigmas=2.5", "fused.votes.near_m=2.0", "fused.walls.before_m=1.6",
     "fused.noise.leaf_slots=5"),
)  # fmt: skip
"""Settings that undo each step."""


def streets(first_seed: int, *, other_scenes: bool = False, whole: bool = False) -> list[Simulated]:
    """Return streets like those of the contest."""
    return [
        replace(
            spec,
            seed=first_seed + i,
            scene=SCENES[i] if other_scenes else spec.scene,
            length_m=spec.length_m if whole else SHORTER[spec.length_m],
        )
        for i, spec in enumerate(data.TEST_STREETS)
    ]


def simulate(specs: Sequence[Simulated]) -> list[Scan]:
    """Simulate streets, without unneeded fields."""
    return [replace(data.simulated(spec), world_m=None, scanner_m=None, time_s=None) for spec in specs]


def mean_f1(scans: Sequence[Scan], assignments: Sequence[str]) -> F64:
    """Return the mean F1 of the four classes over the scans that have them."""
    config = preset_with("fused", assignments)
    rows = []
    for scan in scans:
        found = label(scan, config)
        scores = judge(scan, found.codes, found.extra_codes).f1()
        rows.append([scores.get(name, np.nan) for name in NAMES])
    means: F64 = np.nanmean(rows, axis=0)
    return means


def cells(values: F64) -> str:
    """Return scores as cells of a table."""
    return " | ".join(f"{value:.3f}" for value in values)


def main() -> None:
    """Print both tables."""
    tuned = simulate([
        *streets(9021), *streets(9041, other_scenes=True), *streets(9061), *streets(9081),
    ])  # fmt: skip
    strip = [data.oakland_noisy(1)]
    all_back = [assignment for step in WITHOUT for assignment in step]
    print("<!-- written by python -m benchmarks.contest_share; do not edit -->\n")
    print(f"| F1 | {' | '.join(NAMES)} | strip 1 with background: {' | '.join(NAMES)} |\n|---|{'---:|' * 8}")
    base, base_strip = mean_f1(tuned, []), mean_f1(strip, [])
    print(f"| {len(tuned)} streets for tuning | {cells(base)} | {cells(base_strip)} |")
    for step in (*WITHOUT, tuple(all_back)):
        lost, lost_strip = base - mean_f1(tuned, step), base_strip - mean_f1(strip, step)
        name = "all of these" if len(step) == len(all_back) else ", ".join(f"`{part}`" for part in step)
        print(f"| lost with {name} | {cells(lost)} | {cells(lost_strip)} |")
    held_out = simulate(streets(9121, whole=True))
    print("\n| F1 of twelve streets that decided nothing | " + " | ".join(NAMES) + f" |\n|---|{'---:|' * 4}")
    print(f"| with all steps | {cells(mean_f1(held_out, []))} |")
    print(f"| without them | {cells(mean_f1(held_out, all_back))} |")


if __name__ == "__main__":
    main()
