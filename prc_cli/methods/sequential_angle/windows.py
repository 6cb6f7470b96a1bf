"""Facades seen through their windows, which the test for vegetation takes for foliage; not in the paper.

Behind glass a shot returns from the pane, or from a curtain or wall some way behind it, and neighbours differ: the
signed angles alternate as in a crown. But in a vertical line the pane is one horizontal distance, and what is behind it
is another: two upright layers hold the points. Foliage is spread over its depth.
"""

from __future__ import annotations

import math

from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import U8
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import LayerThresholds, WallThresholds


class WindowsParams(Params):
    """When vegetation is a facade with windows (``[sequential_angle.coarse.windows]``)."""

    share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="a run of vegetation is vertical if two upright layers hold more than this share of its points; "
        "published: 1, never",
    )
    width_m: float = Field(0.03, ge=0, le=10, description="thickness of a layer at least [m]")
    width_sigmas: float = Field(
        6.0, ge=0, le=1000, description="thickness of a layer at least [standard deviations of the range noise]"
    )
    most_m: float = Field(0.06, ge=0, le=10, description="thickness of a layer at most, however noisy the ranges [m]")
    min_points: int = Field(8, ge=1, le=100_000, description="shorter runs stay vegetation [points]")
    wall_extent_m: float = Field(
        0.3,
        ge=0,
        le=1e3,
        description="runs of vertical points of this height that are straight and upright are walls: vegetation in "
        "their plane is vertical, and so is what is seen behind a wall below its lower end; published: 0, none is [m]",
    )
    wall_m: float = Field(
        0.03, ge=0, le=10, description="vegetation this near to a wall's distance is in its plane [m]"
    )
    straight_m: float = Field(
        0.01, ge=0, le=10, description="straight is what lies this near to a straight line, rms [m], ..."
    )
    straight_sigmas: float = Field(2.0, ge=0, le=1000, description="... or as many times the range noise")
    lean_deg: float = Field(
        2.0, ge=0, le=45, description="upright is what leans less than this from the vertical [deg]"
    )

    def thresholds(self, range_noise_m: float) -> LayerThresholds:
        """Return the thresholds of the kernel, for a standard deviation of the range [m]."""
        return LayerThresholds(
            width_m=min(max(self.width_m, self.width_sigmas * range_noise_m), self.most_m),
            share=self.share,
            min_points=self.min_points,
        )

    def walls(self, range_noise_m: float) -> WallThresholds:
        """Return the thresholds of the kernel for walls, for a standard deviation of the range [m]."""
        return WallThresholds(
            extent_m=self.wall_extent_m,
            break_m=_BREAK_M,
            residual_m=max(self.straight_m, self.straight_sigmas * range_noise_m),
            slope=math.tan(math.radians(self.lean_deg)),
            width_m=self.wall_m,
            front_m=_FRONT_M,
        )


_BREAK_M = 0.1
"""A wall ends where the distance changes by more [m]."""
_FRONT_M = 0.1
"""What is behind a wall may be this much before it: its face has reliefs [m]."""


def without_windows(surface: U8, lines: VerticalLines, params: WindowsParams, *, range_noise_m: float) -> U8:
    """Make vegetation vertical that lies in two upright layers, in the plane of a wall, or behind a wall above it.

    ``surface`` (R, n) uint8; returns (R, n) uint8.

    Panes and a wall behind them, then leaves:

    >>> import numpy as np
    >>> found = []
    >>> for distance in (np.tile([9.0, 9.4], 5), np.linspace(9.0, 9.4, 10)):
    ...     x, z = distance, np.linspace(1.0, 2.0, 10)
    ...     xyz = np.stack([x, 0 * x, z], axis=-1)[None].astype(np.float32)
    ...     beams = np.arctan2(x, -z)[None]
    ...     n_beams, ranges = np.array([10], np.int32), np.linalg.norm(xyz, axis=-1)
    ...     lines = VerticalLines(ranges, xyz, xyz[..., 0].copy(), n_beams, beams)
    ...     leaves = np.ones((1, 10), np.uint8)
    ...     found.append(without_windows(leaves, lines, WindowsParams(), range_noise_m=0.005))
    >>> found
    [array([[3, 3, 3, 3, 3, 3, 3, 3, 3, 3]], dtype=uint8), array([[1, 1, 1, 1, 1, 1, 1, 1, 1, 1]], dtype=uint8)]
    """
    if params.share < 1.0:
        layers = params.thresholds(range_noise_m)
        surface = kernels.upright_layers(surface, lines.horizontal_m, lines.n_beams, layers)
    if params.wall_extent_m > 0.0:
        walls = params.walls(range_noise_m)
        surface = kernels.behind_walls(surface, lines.xyz_m, lines.horizontal_m, lines.n_beams, walls)
    return surface
