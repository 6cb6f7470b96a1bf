"""Heights above the ground, for those who ask for them: nothing here runs otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32
from prc_cli.methods.base import Part, Turn

UNKNOWN_M = 1e6
"""Heights beyond are those of places where no ground was seen [m]."""
_LEAST_SHARE = 0.5
"""Beams nearer to level than 60 degrees tell nothing of the tilt of the plane."""
_ValueT = TypeVar("_ValueT")
_ResultT = TypeVar("_ResultT")


class Overhearing(Turn):
    """A turn that also keeps the results of its steps.

    Attributes
    ----------
    results : dict
        Result of every step so far, by the name of its part.
    """

    def __init__(self, turn: Turn) -> None:
        self._turn = turn
        self.results: dict[str, Any] = {}

    def hand_on(self, part: Part[_ValueT], step: Callable[[_ValueT], tuple[_ResultT, _ValueT]]) -> _ResultT:
        """Run a step; see :class:`~prc_cli.methods.base.Turn`."""
        result = self._turn.hand_on(part, step)
        self.results[part.name] = result
        return result


def true_heights(above_m: F32, block: ScanBlock) -> F32:
    """Return heights in metres from heights in the scan plane.

    ``above_m`` (lines, M) float32; returns (lines, M) float32.
    """
    known = np.where(above_m < np.float32(UNKNOWN_M), above_m, np.float32(np.nan))
    heights: F32 = (known * np.float32(_cosine_of_tilt(block))).astype(np.float32, copy=False)
    return heights


def _cosine_of_tilt(block: ScanBlock) -> float:
    """Return height per metre in the scan plane: 1 where the plane is upright, or its lean is not known."""
    if block.xyz_m is None or block.beam_rad is None:
        return 1.0
    down = np.cos(block.beam_rad)
    steep = np.abs(down) > _LEAST_SHARE
    in_plane = block.range_m[:, steep].astype(np.float64) * down[steep]
    ratio = -block.xyz_m[:, steep, 2] / in_plane
    ratio = ratio[np.isfinite(ratio)]
    return min(float(np.median(ratio)), 1.0) if len(ratio) else 1.0
