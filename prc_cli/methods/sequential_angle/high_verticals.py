"""High vertical surfaces, behind which no cars are accepted (Stamos et al. 2012, sec. 7.4)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import F32, U8
from prc_cli.methods.sequential_angle.lines import VerticalLines


class HighVerticalsParams(Params):
    """What is too high for a car (``[sequential_angle.car.high_verticals]``)."""

    enabled: bool = Field(True, description="look for them at all; false = cars may lie behind walls")
    height_m: float = Field(
        2.5,
        gt=0,
        le=1e3,
        description="vertical surfaces that reach this far above the ground hide all cars behind [m] (published)",
    )


def high_verticals(lines: VerticalLines, surface: U8, z_g: F32, params: HighVerticalsParams) -> F32:
    """Find the horizontal distance beyond which there is no car.

    This is the distance of the last point of the first sequence of vertical points that ends higher above the ground
    than the limit. A missing shot ends a sequence, so that a tower seen over a wall does not extend the wall.

    ``surface`` (R, n) uint8; ``z_g`` (R,) float32, metres; returns (R,) float32.
    """
    if not params.enabled:
        return np.full(len(z_g), np.inf, np.float32)
    found, beam = kernels.first_high_verticals(surface, lines.xyz_m, lines.n_beams, z_g, params.height_m)
    distance = np.full(len(beam), np.inf, np.float32)
    distance[found] = lines.horizontal_m[found, beam[found]]
    return distance
