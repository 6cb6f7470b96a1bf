"""The frame of a spinning scanner, from its rings."""

from __future__ import annotations

import numpy as np

from prc_cli.core.frame import SensorFrame, turning
from prc_cli.core.types import F32, I64
from tests.methods.rings.test_rings import scene


def shots(n_lines: int = 1800) -> tuple[F32, I64]:
    ranges, xyz, _ = scene()
    there = np.isfinite(ranges[:n_lines])
    return xyz[:n_lines][there], np.nonzero(there)[1]


def moved(xyz: F32, turn_deg: tuple[float, float], apex_m: tuple[float, float, float]) -> F32:
    """Return coordinates in a frame in which a scanner is turned and stands elsewhere."""
    turn = turning(np.deg2rad([*turn_deg, 0.0]))
    elsewhere: F32 = (xyz.astype(np.float64) @ turn + np.array(apex_m)).astype(np.float32)
    return elsewhere


def test_frames_are_shown() -> None:
    assert SensorFrame(apex_m=(1.0, 0.0, 0.5)).shown() == "the scanner is at 1.00, 0.00, 0.50"
