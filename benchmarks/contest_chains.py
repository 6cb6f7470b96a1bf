"""Filters of registered clouds that are run: as their authors recommend, and as chosen on the streets for tuning."""

from __future__ import annotations

from typing import Any

NOISE_BEST: dict[str, Any] = {"filter": "radius", "least": 4, "radius_m": 0.5}

CHAINS: dict[str, list[dict[str, Any]]] = {}
