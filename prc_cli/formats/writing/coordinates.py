"""Where returns lie in a new point cloud: coordinates of the input, else its scan planes one behind the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F64

SPACING_M = 0.1
"""Distance of lines where nothing tells it [m]."""
Placement: TypeAlias = Callable[[ScanBlock], tuple[F64, F64]]
"""Returns coordinates of the cells, (lines, M, 3), and of the further returns of a block, (n, 3) float64 [m]."""


@dataclass(frozen=True, slots=True)
class LinesApart:
    """Scan planes one behind the other, for inputs without coordinates.

    A line of two shots, straight down and to the side:

    >>> place = LinesApart({0: np.array([0.0, np.pi / 2])})
    >>> place(ScanBlock(3, np.array([[2.0, 5.0]], np.float32)))[0].round(3).tolist()
    [[[0.3, 0.0, -2.0], [0.3, 5.0, -0.0]]]
    """

    beams: Mapping[int, F64] = field(default_factory=dict)
    """Angle of every column's beam from straight down by scanner [rad], where it is known."""
    apart_m: float = SPACING_M
    how: str = "assumed"
    """How the distance of lines is known."""

    def __call__(self, block: ScanBlock) -> tuple[F64, F64]:
        """Return the coordinates of a block."""
        extra, line = block.extra, np.arange(block.n_lines)[:, None]
        angle, is_upright = self._angles(block)
        own = behind(self._along(block, line), angle[None, :], block.range_m, is_upright=is_upright)
        other = behind(self._along(block, extra.line), angle[extra.column], extra.range_m, is_upright=is_upright)
        return own, other

    def notice(self, block: ScanBlock) -> str:
        """Return how the coordinates were made, for the user."""
        if self._angles(block)[1]:
            plane = "scan planes stand upright"
        elif block.angle_rad is not None:
            plane = "straight down is not known: scan planes lie flat, x = r cos(angle), y = r sin(angle)"
        else:
            m = block.points_per_line
            plane = f"nor angles: scan planes lie flat, with {m} columns spread evenly over a full turn"
        told = f"{self.apart_m:.2g} m apart ({self.how})"
        return f"the input has no coordinates; {plane}, one line behind the other, {told}"

    def _along(self, block: ScanBlock, line: NDArray[Any]) -> F64:
        return (block.first_line + line.astype(np.float64)) * self.apart_m

    def _angles(self, block: ScanBlock) -> tuple[F64, bool]:
        """Return the angle of every column, and whether it is that from straight down."""
        beam = block.beam_rad if block.beam_rad is not None else self.beams.get(block.scanner)
        if beam is not None:
            return beam, True
        if block.angle_rad is not None:
            return block.angle_rad, False
        return 2.0 * np.pi * np.arange(block.points_per_line) / block.points_per_line, False


def behind(along_m: NDArray[Any], angle: NDArray[Any], range_m: NDArray[Any], *, is_upright: bool = True) -> F64:
    """Return shots of planes behind each other, upright ones along x, others one above the other, (..., 3) [m]."""
    r = np.asarray(range_m, np.float64)
    along = np.broadcast_to(along_m, r.shape)
    down, side = r * np.cos(angle), r * np.sin(angle)
    xyz: F64 = np.stack([along, side, -down] if is_upright else [down, side, along], axis=-1)
    xyz[np.isnan(r)] = np.nan
    return xyz


def coordinates(block: ScanBlock, place: Placement | None) -> tuple[tuple[F64, F64], str]:
    """Return the coordinates of a block by a placement, else relative to the scanner, and a notice if made up."""
    if place is None and block.xyz_m is None:
        place = LinesApart()
    if place is not None:
        return place(block), place.notice(block) if isinstance(place, LinesApart) else ""
    assert block.xyz_m is not None
    extra = block.extra
    own = block.xyz_m.astype(np.float64)
    # all returns of a shot lie on the same beam
    ranges = block.range_m[extra.line, extra.column].astype(np.float64)
    ratio = extra.range_m / np.where(np.isnan(ranges), 1.0, ranges)
    return (own, own[extra.line, extra.column] * ratio[:, None]), ""
