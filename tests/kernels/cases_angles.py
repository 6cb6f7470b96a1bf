"""Random arguments for the angles, HMM-CUSUM and surface kernels, aimed at ties and edges."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.random import Generator

CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {}

TOLERANCES: dict[str, float] = {}
"""Kernels whose floats may differ from the twin's by this much, absolute; all others are equal bit for bit."""
