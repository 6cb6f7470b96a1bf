"""Chains of filters of registered clouds.

With parameters of their authors, and tuned on the streets for tuning.
"""

from __future__ import annotations

from typing import Any

_OUTLIERS: dict[str, Any] = {"filter": "statistical", "neighbours": 20, "sigmas": 2.0}
_CSF: dict[str, Any] = {
    "filter": "csf",
    "resolution_m": 0.5,
    "threshold_m": 0.5,
    "rigidness": 3,
    "slope_smoothing": False,
}
_SMRF: dict[str, Any] = {
    "filter": "smrf",
    "cell_m": 1.0,
    "slope": 0.15,
    "window_m": 18.0,
    "threshold_m": 0.5,
    "scaler": 1.25,
}
_PATCHWORK: dict[str, Any] = {
    "filter": "patchwork",
    "piece_m": 20.0,
    "distance_m": 0.125,
    "upright": 0.707,
    "reach_m": 80.0,
}

# chosen by ``python -m benchmarks.contest_tune``
_BEST_OUTLIERS = {**_OUTLIERS, "sigmas": 0.5}
_BEST_RADIUS: dict[str, Any] = {"filter": "radius", "least": 4, "radius_m": 0.6}
_BEST_CSF = {**_CSF, "threshold_m": 0.3}
_BEST_PATCHWORK = {**_PATCHWORK, "piece_m": 5.0, "distance_m": 0.2}

CHAINS: dict[str, list[dict[str, Any]]] = {
    "statistical outliers, recommended": [_OUTLIERS],
    "statistical outliers, tuned": [_BEST_OUTLIERS],
    "radius outliers, tuned": [_BEST_RADIUS],
    "CSF, recommended": [_CSF],
    "statistical, tuned + CSF, recommended": [_BEST_OUTLIERS, _CSF],
    "statistical, tuned + CSF, tuned": [_BEST_OUTLIERS, _BEST_CSF],
    "Patchwork++, recommended": [_PATCHWORK],
    "statistical, tuned + Patchwork++, recommended": [_BEST_OUTLIERS, _PATCHWORK],
    "statistical, tuned + Patchwork++, tuned": [_BEST_OUTLIERS, _BEST_PATCHWORK],
    "statistical, tuned + SMRF, recommended": [_BEST_OUTLIERS, _SMRF],
}
"""Chains by their name in the table; chains with the same first step share its run."""
