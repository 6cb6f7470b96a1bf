"""Lines of streets made by code, and thresholds with changes."""

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from prc_cli.core.stream import ScanBlock
from prc_cli.methods.sequential_angle.lines import VerticalLines

Segment = tuple[float, float, float, float]
"""x, z to x, z [m]."""
ROAD_Z = -1.8
NOISE_M = 0.005
"""Range noise [m]."""


def street(curb_m: float = 0.15, *, car: bool = False) -> list[Segment]:
    """Road, curb at 6 m, pavement, wall at 10 m; a car with a gap of 0.25 m under it at 3 m."""
    pavement_z = ROAD_Z + curb_m
    parts = [
        (0.0, ROAD_Z, 6.0, ROAD_Z),
        (6.0, ROAD_Z, 6.0, pavement_z),
        (6.0, pavement_z, 10.0, pavement_z),
        (10.0, pavement_z, 10.0, 6.0),
    ]
    if car:
        parts += [
            (3.0, ROAD_Z + 0.25, 3.0, -1.0),
            (3.0, -1.0, 3.6, -0.95),
            (3.6, -0.95, 3.9, -0.5),
            (3.9, -0.5, 4.9, -0.5),
        ]
    return parts


def scan(profiles: Sequence[list[Segment]], n: int = 800) -> ScanBlock:
    """Scan one cross section a line; beams from 2 to 150 degrees from straight down."""
    angle = np.deg2rad(np.linspace(2.0, 150.0, n))
    east = np.sin(angle)
    down = -np.cos(angle)
    ranges = np.full((len(profiles), n), np.inf)
    for row, profile in enumerate(profiles):
        for x0, z0, x1, z1 in profile:
            across = east * (z1 - z0) - down * (x1 - x0)
            with np.errstate(all="ignore"):
                r = (x0 * (z1 - z0) - z0 * (x1 - x0)) / across
                u = (x0 * down - z0 * east) / across
            hit = (r > 0.1) & (u >= 0) & (u < 1) & (r < ranges[row])
            ranges[row, hit] = r[hit]
    ranges[np.isinf(ranges)] = np.nan
    ranges += np.random.default_rng(1).normal(0, NOISE_M, ranges.shape)
    xyz = np.stack([ranges * east, 0 * ranges, ranges * down], axis=-1).astype(np.float32)
    return ScanBlock(0, ranges.astype(np.float32), xyz_m=xyz, beam_rad=angle, is_last=True)


def lines_through(points: Any) -> VerticalLines:
    """A line through given points, (n, 2): horizontal distance and height [m]; NaN = missing."""
    xz = np.asarray(points, np.float64)[None]
    xyz = np.stack([xz[..., 0], 0 * xz[..., 0], xz[..., 1]], axis=-1).astype(np.float32)
    ranges = np.linalg.norm(xyz, axis=-1).astype(np.float32)
    n = len(points)
    return VerticalLines(
        ranges, xyz, xyz[..., 0].copy(), np.full(1, n, np.int32), np.linspace(0.1, 3, n)[None]
    )


TupleT = TypeVar("TupleT", bound=tuple[Any, ...])


def made(kind: type[TupleT], **values: float) -> TupleT:
    """Return thresholds with some values changed, of the type that the default has."""
    defaults: Any = kind()
    changed = {name: type(getattr(defaults, name))(value) for name, value in values.items()}
    thresholds: TupleT = defaults._replace(**changed)
    return thresholds
