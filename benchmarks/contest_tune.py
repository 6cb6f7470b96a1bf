"""Choose the parameters of the filters of registered clouds on the streets for tuning (seeds 9001-9099).

    python -m benchmarks.contest_tune [CACHE]

Prints the mean F1 over the streets for every setting of a small grid around what the authors recommend. What is best
stands in ``contest_chains.py``. Ground filters come behind the noise filter that was chosen there.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_chains import NOISE_BEST
from benchmarks.contest_runs import DataSet, Store

SPECS = tuple(replace(spec, length_m=30.0) for spec in data.TRAIN if spec.seed in (9001, 9004, 9006))
"""The beginnings of three of them: what is chosen does not hang on their length, and radius filters are slow."""
STATISTICAL = ((8, 2.0), (20, 0.5), (20, 1.0), (20, 2.0))
PATCHWORK = ((5.0, 0.125, 0.707), (10.0, 0.125, 0.707), (20.0, 0.125, 0.707), (10.0, 0.2, 0.707), (10.0, 0.125, 0.5))


def grids() -> dict[str, list[dict[str, Any]]]:
    """Return the settings of every filter."""
    return {
        "statistical": [{"filter": "statistical", "neighbours": n, "sigmas": s} for n, s in STATISTICAL],
        "radius": [
            {"filter": "radius", "least": n, "radius_m": r}
            for n, r in ((4, 0.2), (4, 0.4), (8, 0.5), (4, 0.6), (8, 1.0))
        ],
        "csf": [
            {"filter": "csf", "resolution_m": c, "threshold_m": t, "rigidness": 3, "slope_smoothing": s}
            for c, t, s in product((0.5, 1.0), (0.15, 0.3), (False,))
        ],
        "smrf": [
            {"filter": "smrf", "cell_m": c, "slope": s, "window_m": 18.0, "threshold_m": t, "scaler": k}
            for c, s, t, k in product((0.5, 1.0), (0.15,), (0.15, 0.3), (0.0, 1.25))
        ],
        "patchwork": [
            {"filter": "patchwork", "piece_m": p, "distance_m": d, "upright": u, "reach_m": 80.0}
            for p, d, u in PATCHWORK
        ],
    }


def main() -> None:
    """Print a table for every filter, best first."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.gettempdir()) / "prc_contest"
    store = Store(folder, lambda text: print(text, file=sys.stderr, flush=True))
    items = [DataSet(spec.name, "", partial(data.simulated, spec), repr(spec)) for spec in SPECS]
    chains: dict[str, list[dict[str, Any]]] = {}
    kind: dict[str, str] = {}
    for name, settings in grids().items():
        for setting in settings:
            title = ", ".join(f"{key} {value}" for key, value in setting.items() if key != "filter")
            chains[f"{name}: {title}"] = [setting] if name in ("statistical", "radius") else [NOISE_BEST, setting]
            kind[f"{name}: {title}"] = name
    scores: dict[str, list[float]] = {name: [] for name in chains}
    for item in items:
        for name, run in store.peer_runs(item, chains).items():
            judged = "noise" if kind[name] in ("statistical", "radius") else "ground"
            scores[name].append(run.verdict.score(f"f1.{judged}"))
    for name in sorted(scores, key=lambda n: (kind[n], -float(np.mean(scores[n] or [0.0])))):
        if scores[name]:
            print(f"{np.mean(scores[name]):.3f}  {' '.join(f'{s:.3f}' for s in scores[name])}  {name}")


if __name__ == "__main__":
    main()
