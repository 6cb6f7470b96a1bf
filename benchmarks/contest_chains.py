"""Filters of registered clouds that are run: as their authors recommend, and as chosen on the streets for tuning."""

from __future__ import annotations

from typing import Any

NOISE_BEST: dict[str, Any] = {"filter": "radius", "least": 4, "radius_m": 0.5}

_CSF: dict[str, Any] = {
    "filter": "csf", "resolution_m": 0.5, "threshold_m": 0.5, "rigidness": 3, "slope_smoothing": False,
}  # fmt: skip
_SMRF: dict[str, Any] = {
    "filter": "smrf", "cell_m": 1.0, "slope": 0.15, "window_m": 18.0, "threshold_m": 0.5, "scaler": 1.25,
}  # fmt: skip
_PATCHWORK: dict[str, Any] = {
    "filter": "patchwork", "piece_m": 20.0, "distance_m": 0.125, "upright": 0.707, "reach_m": 80.0,
}  # fmt: skip

CHAINS: dict[str, list[dict[str, Any]]] = {}
