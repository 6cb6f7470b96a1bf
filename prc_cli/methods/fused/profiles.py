"""Cars by the profile of single lines, where shots are far apart: push-brooms and fans of rings."""

from __future__ import annotations

import math

import numpy as np

from prc_cli import kernels
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.classes import CarParams
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import FanThresholds

LINES, BINS = 12, 200
"""As in :mod:`fans_loops`."""


def no_profiles() -> U8:
    """Return the marks before the first line."""
    return np.zeros((LINES, 2 * BINS), np.uint8)


def are_wanted(plane: ScanPlane, params: CarParams) -> bool:
    """Return whether cars are looked for in the profiles of a scanner's lines."""
    return params.enabled and params.roofs and float(plane.step_rad) >= math.radians(params.roof_step_deg)


@stage("profiles")
def find_cars(
    seen: tuple[U8, F32, F32, F32], n_lines: int, plane: ScanPlane, before: U8, thresholds: FanThresholds
) -> tuple[U8, U8]:
    """Label cars by lines across their roofs; see :func:`fans_loops.fan_cars`.

    ``seen`` tuple of (lines + ahead, M) arrays; ``before`` (LINES, 2 BINS) uint8.
    """
    found: tuple[U8, U8] = kernels.fan_cars(*seen, plane.sine, (plane.left, plane.right), before, n_lines, thresholds)
    return found
