"""Tunes the filters of registered clouds on streets for tuning (seeds 9001, 9004 and 9006).

    python -m benchmarks.contest_tune

Prints the mean F1 over the streets for settings around those of the authors: of noise for noise
filters, of ground for ground filters, which run after the best noise filter. ``contest_chains.py``
has the best."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_judge import judge
from benchmarks.contest_peers import NOISE_FILTERS, run
from benchmarks.contest_runs import as_image, points_of

SPECS = tuple(
    replace(spec, length_m=30.0) for spec in data.TRAIN if spec.seed in (9001, 9004, 9006)
)
"""The first parts of three streets.

The choice does not depend on length, and radius filters are slow.
"""
GRIDS: dict[str, list[dict[str, Any]]] = {
    "statistical": [
        {"neighbours": n, "sigmas": s}
        for n, s in ((8, 2.0), (20, 0.25), (20, 0.5), (20, 1.0), (20, 2.0))
    ],
    "radius": [
        {"least": n, "radius_m": r} for n, r in ((4, 0.2), (4, 0.4), (8, 0.5), (4, 0.6), (8, 0.8))
    ],
    "csf": [
        {"resolution_m": c, "threshold_m": t, "rigidness": 3, "slope_smoothing": False}
        for c, t in product((0.5, 1.0), (0.15, 0.3))
    ],
    "smrf": [
        {"cell_m": c, "slope": 0.15, "window_m": 18.0, "threshold_m": t, "scaler": k}
        for c, t, k in (
            (0.5, 0.15, 0.0),
            (0.5, 0.15, 1.25),
            (0.5, 0.3, 0.0),
            (1.0, 0.15, 1.25),
            (1.0, 0.3, 0.0),
        )
    ],
    "patchwork": [
        {"piece_m": p, "distance_m": d, "upright": u, "reach_m": 80.0}
        for p, d, u in product((5.0, 10.0, 20.0), (0.125, 0.2), (0.5, 0.707))
    ],
}


def main() -> None:
    """Print every setting with its score, street by street."""
    streets = [(scan, points_of(scan)) for scan in map(data.simulated, SPECS)]
    before: list[Any] = [None] * len(streets)
    best = -1.0
    noisy: list[Any] = before
    for name, settings in GRIDS.items():
        judged = "noise" if name in NOISE_FILTERS else "ground"
        for setting in settings:
            codes = [
                run(points, [{"filter": name, **setting}], None if judged == "noise" else known)[0]
                for (_, points), known in zip(streets, before, strict=True)
            ]
            errors = [
                float(np.nan_to_num(judge(scan, *as_image(scan, scan_codes)).score(f"f1.{judged}")))
                for (scan, _), scan_codes in zip(streets, codes, strict=True)
            ]
            print(
                f"{np.mean(errors):.3f}  {' '.join(f'{f:.3f}' for f in errors)}  {name} {setting}",
                flush=True,
            )
            if judged == "noise" and np.mean(errors) > best:
                best = float(np.mean(errors))
                noisy = codes
        before = noisy


if __name__ == "__main__":
    main()
