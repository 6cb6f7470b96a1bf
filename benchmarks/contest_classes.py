"""Every class of the fused method in streets, cars, curbs and poles included, and what each step is worth.

    python -m benchmarks.contest_classes tuning
    python -m benchmarks.contest_classes held-out
    python -m benchmarks.contest_classes oakland

Seeds 1 to 5 are for tuning, as were 21 to 50, 61 to 100 and 1001 to 1030 later; 901 to 920, 1101 to 1110 and 1201 to
1210 are spent. 1401 to 1410 decided nothing and were looked at once; ``--seed`` takes other ones. A curb is right if a
shot of the other side's curbs is within 10 cm; in all else curbs are ground. Reads ../shared/data or $PRC_DATA for the
strips.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan, Simulated
from benchmarks.contest_judge import curbs
from benchmarks.contest_methods import label, preset_with
from prc_cli.core.types import F64, I64, Mask
from prc_cli.evaluation.mapping import load_mapping

NAMES = ("noise", "ground", "building", "vegetation", "car", "pole")
CURB = 66
SCENES = ("mixed", "residential", "boulevard", "terraces", "suburb")
TUNING = (
    *(Simulated(f"{scene}, photon-80", seed + 1, 60, scene) for seed, scene in enumerate(SCENES)),
    Simulated("residential, sick-push-broom", 2, 120, "residential", "sick-push-broom", noise=0.02),
    Simulated("mixed, profiler-1mhz", 1, 20, "mixed", "profiler-1mhz", noise=0.02),
    Simulated("suburb, profiler-1mhz, slant 45°", 3, 20, "suburb", "profiler-1mhz", mount={"slant_deg": 45.0},
              noise=0.05),
    Simulated("mixed, photon-80, gap of 50° down, slant 20°", 4, 60, "mixed", mount=data.GAP_DOWN),
    Simulated("boulevard, sick-push-broom", 5, 120, "boulevard", "sick-push-broom", noise=0.05),
)  # fmt: skip
HELD_OUT = (
    *(Simulated(f"{scene}, photon-80", seed + 1401, 100, scene) for seed, scene in enumerate(SCENES)),
    Simulated("mixed, photon-80, gap of 50° down, slant 20°", 1406, 80, "mixed", mount=data.GAP_DOWN),
    Simulated("residential, sick-push-broom", 1407, 160, "residential", "sick-push-broom", noise=0.02),
    Simulated("boulevard, sick-push-broom", 1408, 160, "boulevard", "sick-push-broom", noise=0.05),
    Simulated("mixed, profiler-1mhz", 1409, 30, "mixed", "profiler-1mhz", noise=0.02),
    Simulated("suburb, profiler-1mhz, slant 45°", 1410, 30, "suburb", "profiler-1mhz", mount={"slant_deg": 45.0},
              noise=0.05),
)  # fmt: skip
STEPS: tuple[tuple[str, ...], ...] = (
    ("fused.flanks.enabled=false",),
    ("fused.cars.level_bins=3",),
    ("fused.cars.roofs=false",),
    ("fused.poles.across=false",),
    ("fused.poles.beside_cars=false",),
    ("fused.poles.shots=1",),
    ("fused.poles.trunks=false",),
    ("fused.poles.arms=false",),
    ("fused.poles.boxes=false",),
    ("fused.flanks.lorries=false",),
    ("fused.walls.lines=0",),
    ("fused.walls.roofs=false",),
    ("fused.walls.storey_m=0",),
    ("fused.leaves.at_depth=false",),
    ("fused.noise.pits=false",),
    ("fused.interlace.enabled=false",),
    ("fused.noise.panes=false",),
    ("fused.noise.lone_leaves=false",),
    ("fused.noise.mirrors=false",),
    ("fused.noise.sparse=false",),
    ("fused.noise.alone=false",),
    ("fused.noise.spike_m=0",),
    ("fused.curbs.steep=0",),
)
"""Settings that undo each step."""
FORMER = (
    *(setting for step in STEPS for setting in step),
    "fused.cars.named=false",
    "fused.poles.named=false",
    "fused.curbs.enabled=false",
)
"""Settings that give the labels of before."""


def counts_of(scan: Scan, codes: I64) -> F64:
    """Return, for every class and for curbs, shots that agree, that are predicted, and of the reference, (n + 1, 3)."""
    mapping = load_mapping("street_oakland" if scan.mapping == "oakland" else "street")
    there: Mask = ~np.isnan(scan.range_m)
    if scan.mapping == "oakland":
        there &= (scan.codes != 0) & ~((scan.codes >= 1001) & (scan.codes <= 1003))
    predicted, reference = np.maximum(codes[there], 1), scan.codes[there]
    rows = _classes(mapping.names("reference"), mapping.class_indices(reference, "reference"))
    columns = _classes(mapping.names("predicted"), mapping.class_indices(predicted, "predicted"))
    table = [[((rows == k) & (columns == k)).sum(), (columns == k).sum(), (rows == k).sum()] for k in range(len(NAMES))]
    table.append([0, 0, 0])
    if scan.world_m is not None and scan.mapping == "street":
        place = scan.world_m[there]
        table[-1] = curbs(place[predicted == CURB], place[reference == CURB])
    return np.array(table, np.float64)


def _classes(names: tuple[str, ...], index: I64) -> I64:
    """Return the place of every shot's class in :data:`NAMES`; curbs are ground, -1 = none of them."""
    names = tuple("ground" if name == "curb" else name for name in names)
    places = np.array([NAMES.index(name) if name in NAMES else -1 for name in (*names, "")])
    found: I64 = places[index]
    return found


def scores(counts: F64) -> F64:
    """Return precision, recall and F1 of every class, (n + 1, 3); NaN where the reference has none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        precision, recall = counts[:, 0] / counts[:, 1], counts[:, 0] / counts[:, 2]
        found = np.stack([precision, recall, 2 * counts[:, 0] / (counts[:, 1] + counts[:, 2])], axis=1)
    found[counts[:, 2] == 0] = np.nan
    return found


def run(scans: Sequence[Scan], assignments: Sequence[str]) -> list[F64]:
    """Return the scores of every scan, and their mean over the scans that have the class."""
    config = preset_with("fused", assignments)
    each = [scores(counts_of(scan, label(scan, config).codes.astype(np.int64))) for scan in scans]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # classes that no scan has
        return [*each, np.nanmean(each, axis=0)]


def row(name: str, found: F64) -> str:
    """Return F1, precision and recall of every class as a row of a table."""
    cells = ("" if np.isnan(f1) else f"{f1:.3f} ({precision:.2f}, {recall:.2f})" for precision, recall, f1 in found)
    return f"| {name} | {' | '.join(cells)} |"


def scans_of(which: str, first_seed: int = HELD_OUT[0].seed) -> list[Scan]:
    """Return the scans for tuning, those that decided nothing, or the real strips."""
    if which == "oakland":
        return [data.oakland(strip) for strip in (1, 2, 3)]
    held_out = (replace(spec, seed=first_seed + i) for i, spec in enumerate(HELD_OUT))
    return [data.simulated(spec) for spec in (TUNING if which == "tuning" else held_out)]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("which", choices=("tuning", "held-out", "oakland"))
    parser.add_argument("--seed", type=int, default=HELD_OUT[0].seed, help="first seed of the streets held out")
    arguments = parser.parse_args()
    scans = scans_of(arguments.which, arguments.seed)
    print("<!-- written by python -m benchmarks.contest_classes; do not edit -->\n")
    print(f"| F1 (precision, recall) | {' | '.join((*NAMES, 'curb, 10 cm'))} |\n|---|{'---:|' * (len(NAMES) + 1)}")
    base = run(scans, [])
    for scan, found in zip(scans, base, strict=False):
        print(row(scan.name, found), flush=True)
    print(row("mean", base[-1]), flush=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        print(row("worst", np.nanmin(base[:-1], axis=0)), flush=True)
    for step in STEPS:
        print(row(f"mean, `{step[0]}`", run(scans, step)[-1]), flush=True)
    print(row("mean, as before", run(scans, FORMER)[-1]))


if __name__ == "__main__":
    main()
