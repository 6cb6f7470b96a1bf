"""Lines of streets made by code, by room and by car."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from prc_cli.core.types import F32, I32, U8
from prc_cli.methods.sequential_angle.lines import VerticalLines

H = 2
V = 3
T = 1
Segment = tuple[float, float, float, float, int]
"""x, z to x, z [m], and the surface."""
ROAD_Z = -1.8


NOISE_M = 0.005
"""Range noise of the scenes unless they say otherwise [m]."""


@dataclass(frozen=True)
class Scene:
    lines: VerticalLines
    surface: U8
    signed: F32
    phihat: F32
    ahead: I32

    def rows(self, first: int, end: int) -> Scene:
        rows = slice(first, end)
        lines = VerticalLines(
            self.lines.range_m[rows],
            self.lines.xyz_m[rows],
            self.lines.horizontal_m[rows],
            self.lines.n_beams[rows],
            self.lines.beam_rad,
        )
        return Scene(
            lines, self.surface[rows], self.signed[rows], self.phihat[rows], self.ahead[rows]
        )


def street(
    curb_m: float = 0.15,
    slope_deg: float = 0.0,
    car: bool = False,
    wall: bool = True,
) -> list[Segment]:
    """Road, curb at 6 m, pavement, wall at 10 m; a car with a gap of 0.25 m under it at 3 m."""
    rise = float(np.tan(np.deg2rad(slope_deg)))

    def z(x: float) -> float:
        return ROAD_Z + rise * x

    parts: list[Segment] = [
        (0.0, z(0), 6.0, z(6), H),
        (6.0, z(6) + curb_m, 10.0, z(10) + curb_m, H),
    ]
    if curb_m:
        parts.append((6.0, z(6), 6.0, z(6) + curb_m, V))
    if wall:
        parts.append((10.0, z(10) + curb_m, 10.0, 6.0, V))
    if car:
        parts += [
            (3.0, z(3) + 0.25, 3.0, -1.0, V),
            (3.0, -1.0, 3.6, -0.95, H),
            (3.6, -0.95, 3.9, -0.5, V),
            (3.9, -0.5, 4.9, -0.5, H),
        ]
    return parts


def scan(
    profiles: Sequence[list[Segment]],
    n: int = 1000,
    n_sides: int = 1,
    noise_m: float = NOISE_M,
    missing: float = 0.0,
    seed: int = 1,
) -> Scene:
    """Scan one cross section a line; beams from 2 to 150 degrees from straight down."""
    rng = np.random.default_rng(seed)
    angle = np.deg2rad(np.linspace(2.0, 150.0, n))
    east = np.sin(angle)
    down = -np.cos(angle)
    n_rows = len(profiles) * n_sides
    ranges = np.full((n_rows, n), np.inf)
    surface = np.zeros((n_rows, n), np.uint8)
    for row in range(n_rows):
        for x0, z0, x1, z1, kind in profiles[row // n_sides]:
            dx = x1 - x0
            dz = z1 - z0
            across = east * dz - down * dx
            with np.errstate(all="ignore"):
                r = (x0 * dz - z0 * dx) / across
                u = (x0 * down - z0 * east) / across
            hit = (r > 0.1) & (u >= 0) & (u < 1) & (r < ranges[row])
            ranges[row, hit] = r[hit]
            surface[row, hit] = kind
    surface[rng.random(surface.shape) < missing] = 0
    ranges[surface == 0] = np.nan
    ranges += rng.normal(0, noise_m, ranges.shape)
    side = np.where(np.arange(n_rows) % n_sides == 0, 1.0, -1.0)[:, None]
    xyz = np.stack([ranges * east * side, 0 * ranges, ranges * down], axis=-1).astype(np.float32)
    beam_rad = np.tile(angle, (n_sides, 1))
    n_beams = np.full(n_rows, n, np.int32)
    lines = VerticalLines(
        ranges.astype(np.float32), xyz, np.hypot(xyz[..., 0], xyz[..., 1]), n_beams, beam_rad
    )
    signed, phihat, ahead = angles(lines, surface)
    return Scene(lines, surface, signed, phihat, ahead)


def angles(lines: VerticalLines, surface: U8, chord_m: float = 0.02) -> tuple[F32, F32, I32]:
    """Angle to the vertical, angle to the shot plus that of the beam, and the beam that both are
    measured to."""
    signed = np.full(surface.shape, np.nan, np.float32)
    phihat = np.full(surface.shape, np.nan, np.float32)
    ahead = np.full(surface.shape, -1, np.int32)
    for row in range(len(surface)):
        valid = np.flatnonzero(surface[row])
        xyz = lines.xyz_m[row].astype(float)
        for i, k in enumerate(valid):
            after = valid[i + 1 : i + 60]
            chords = xyz[after] - xyz[k]
            length = np.linalg.norm(chords, axis=1)
            far = np.flatnonzero(length >= chord_m)
            if not len(far):
                continue
            chord = chords[far[0]] / length[far[0]]
            ahead[row, k] = after[far[0]]
            signed[row, k] = np.rad2deg(np.arccos(np.clip(chord[2], -1, 1)))
            shot = xyz[k] / np.linalg.norm(xyz[k])
            if surface[row, k] == H:
                beam = lines.beam_rad[row % lines.n_sides, k]
                phihat[row, k] = np.rad2deg(np.arccos(np.clip(chord @ shot, -1, 1)) + beam)
    return signed, phihat, ahead


def lines_through(points: Any) -> VerticalLines:
    """Lines through given points, (R, n, 2): horizontal distance and height [m]; NaN = missing."""
    xz = np.asarray(points, np.float64)
    xz = xz[None] if xz.ndim == 2 else xz
    xyz = np.stack([xz[..., 0], 0 * xz[..., 0], xz[..., 1]], axis=-1).astype(np.float32)
    n_rows, n = xz.shape[:2]
    ranges = np.linalg.norm(xyz, axis=-1).astype(np.float32)
    return VerticalLines(
        ranges, xyz, xyz[..., 0].copy(), np.full(n_rows, n, np.int32), np.linspace(0.1, 3, n)[None]
    )


TupleT = TypeVar("TupleT", bound=tuple[Any, ...])


def made(kind: type[TupleT], **values: Any) -> TupleT:
    defaults: Any = kind()
    thresholds: TupleT = defaults._replace(
        **{name: _like(getattr(defaults, name), values[name]) for name in values}
    )
    return thresholds


def _like(default: Any, value: Any) -> Any:
    if hasattr(default, "_fields"):
        return value
    if isinstance(default, tuple):
        return tuple(
            _like(default_part, value_part)
            for default_part, value_part in zip(default, value, strict=True)
        )
    return type(default)(value)
