"""The fused method in forests with 0 to 3 cm of range noise, with the noise measured and without.

python -m benchmarks.forest_noise            # seeds 1 to 5, for tuning
python -m benchmarks.forest_noise report     # seeds 911 to 915, which decided nothing
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan, Simulated
from benchmarks.contest_judge import judge
from benchmarks.contest_methods import label, preset_with

NAMES = ("noise", "ground", "stem", "vegetation")
SCENES = ("mixed", "pine-heath", "dense-spruce")
LENGTH_M = 6.0
NOISES_M = (None, 0.01, 0.02, 0.03)
"""Range noise close by [m]; None = that of the scanner."""
SETTINGS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("measured", ()),
    ("not for stems", ("fused.forest.stems.noise_sigmas=0",)),
    ("not for ground", ("fused.forest.soil_sigmas=0", "fused.forest.flat.noise_sigmas=0")),
    ("not measured", ("fused.sensor.range_noise_m=0",)),
)


def walk(seed: int, noise_m: float | None) -> Scan:
    """Simulate a short walk."""
    mount = {} if noise_m is None else {"noise_m": noise_m}
    scene = SCENES[(seed - 1) % 3]
    return data.simulated(Simulated("", seed, LENGTH_M, scene=scene, scanner="focus3d-120", kind="forest", mount=mount))


def f1_of(scan: Scan, assignments: Sequence[str]) -> list[float]:
    """Return the F1 of the four classes."""
    found = label(scan, preset_with("fused-forest", assignments))
    scores = judge(scan, found.codes, found.extra_codes).f1()
    return [scores.get(name, np.nan) for name in NAMES]


def main() -> None:
    """Print the table."""
    seeds = range(911, 916) if "report" in sys.argv[1:] else range(1, 6)
    print(f"F1 on forests of seeds {seeds[0]} to {seeds[-1]}, lowest forest in brackets\n")
    print(f"| range noise | | {' | '.join(NAMES)} |\n|---|---|{'---:|' * 4}")
    for noise_m in NOISES_M:
        scans = [walk(seed, noise_m) for seed in seeds]
        for name, assignments in SETTINGS:
            rows = np.array([f1_of(scan, assignments) for scan in scans])
            cells = [f"{np.nanmean(one):.3f} ({np.nanmin(one):.2f})" for one in rows.T]
            print(f"| {'scanner' if noise_m is None else noise_m} | {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
