"""Lines of streets made by code, by room and by car."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, F64, I32, U8
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


MISSING, DENSE, HORIZONTAL, VERTICAL, UNDECIDED = range(5)
SCANNER_M = 1.8


@dataclass(frozen=True)
class Piece:
    """A straight piece of a section.

    Horizontal distance and height over the road at both ends [m].
    """

    name: str
    from_m: tuple[float, float]
    to_m: tuple[float, float]
    seen: bool = True

    @property
    def code(self) -> int:
        return (
            VERTICAL
            if abs(self.to_m[1] - self.from_m[1]) > abs(self.to_m[0] - self.from_m[0])
            else HORIZONTAL
        )


def polyline(name: str, corners: list[tuple[float, float]], *, seen: bool = True) -> list[Piece]:
    return [Piece(name, a, b, seen) for a, b in pairwise(corners)]


def road(to_m: float = 200.0, slope: float = 0.0) -> list[Piece]:
    return polyline("road", [(0.5, 0.5 * slope), (to_m, to_m * slope)])


def curb(at_m: float, height_m: float = 0.15, depth_m: float = 20.0) -> list[Piece]:
    return [
        *polyline("curb", [(at_m, 0.0), (at_m, height_m)]),
        *polyline("pavement", [(at_m, height_m), (at_m + depth_m, height_m)]),
    ]


def wall(
    at_m: float,
    foot_m: float = 0.0,
    top_m: float = 8.0,
    *,
    windows: bool = False,
) -> list[Piece]:
    edges = [foot_m, 1.0, 2.2, 4.0, 5.2, top_m] if windows else [foot_m, top_m]
    parts = pairwise(edges)
    return [Piece("wall", (at_m, a), (at_m, b), i % 2 == 0) for i, (a, b) in enumerate(parts)]


def car(at_m: float, *, glass: bool = True, tyre: bool = False) -> list[Piece]:
    """The section across a car whose side stands at a distance.

    With a tyre, nothing is open below.
    """
    corner = np.array([at_m, 0.0])

    def part(corners: list[tuple[float, float]], *, seen: bool = True) -> list[Piece]:
        return polyline("car", [(at_m + h, z) for h, z in corners], seen=seen)

    arc = np.deg2rad(np.arange(270, 89, -10))
    wheel = corner + np.array([0.32, 0.32]) + 0.32 * np.stack([np.cos(arc), np.sin(arc)], axis=1)
    return [
        *part(
            [(0.06, 0.2), (0.0, 0.5), (0.05, 0.9)]
            if not tyre
            else [(0.3, 0.6), (0.05, 0.65), (0.05, 0.9)]
        ),
        *part([(0.05, 0.9), (0.3, 1.35)], seen=not glass),
        *part([(0.3, 1.35), (0.5, 1.45), (1.3, 1.45), (1.5, 1.35)]),
        *part([(1.5, 1.35), (1.75, 0.9)], seen=not glass),
        *part([(1.75, 0.9), (1.8, 0.5), (1.75, 0.2), (0.06, 0.2)]),
        *(polyline("car", [(float(h), float(z)) for h, z in wheel]) if tyre else []),
    ]


def bush(at_m: float, height_m: float = 2.5, depth_m: float = 1.0) -> list[Piece]:
    """Foliage: a front that :func:`see` scatters in depth; its label is T'."""
    return [Piece("bush", (at_m, 0.0), (at_m + depth_m * 1e-6, height_m))]


@dataclass(frozen=True)
class Seen:
    lines: VerticalLines
    surface: U8
    names: list[list[str]]
    """What every beam meets, "" where it meets nothing."""
    z_g: F32

    def where(self, name: str) -> I32:
        """Beams with a return of an object, in row 0."""
        return np.array(
            [k for k, piece in enumerate(self.names[0]) if piece == name and self.surface[0, k]],
            np.int32,
        )


def see(
    scenes: Iterable[list[Piece]],
    rng: Generator,
    *,
    step_deg: float = 0.115,
    low_deg: float = 30.0,
    high_deg: float = 120.0,
    scanner_m: float = SCANNER_M,
) -> Seen:
    """Look at one scene a row; angles from straight down."""
    beam = np.deg2rad(np.arange(low_deg, high_deg, step_deg))
    rows = [_row(pieces, beam, scanner_m, rng) for pieces in scenes]
    ranges = np.array([row[0] for row in rows], np.float32)
    return Seen(
        make_lines(ranges, beam),
        np.array([row[1] for row in rows], np.uint8),
        [row[2] for row in rows],
        np.full(len(rows), -scanner_m, np.float32),
    )


def make_lines(range_m: F32, beam_rad: F64) -> VerticalLines:
    h = range_m * np.sin(beam_rad)
    z = -range_m * np.cos(beam_rad)
    xyz = np.stack([h, 0 * h, z], axis=-1).astype(np.float32)
    n_beams = np.full(len(range_m), len(beam_rad), np.int32)
    return VerticalLines(
        range_m.astype(np.float32), xyz, np.hypot(xyz[..., 0], xyz[..., 1]), n_beams, beam_rad[None]
    )


def _row(
    pieces: list[Piece],
    beam: F64,
    scanner_m: float,
    rng: Generator,
) -> tuple[F64, list[int], list[str]]:
    direction = np.stack([np.sin(beam), -np.cos(beam)], axis=1)
    start = np.array([[p.from_m[0], p.from_m[1] - scanner_m] for p in pieces])
    along = np.array([p.to_m for p in pieces]) - np.array([p.from_m for p in pieces])
    cross = direction[:, None, 0] * along[:, 1] - direction[:, None, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        share = (start[:, 0] * direction[:, None, 1] - start[:, 1] * direction[:, None, 0]) / cross
    ranges = np.where((ranges > 0) & (share >= 0) & (share <= 1), ranges, np.inf)
    nearest = ranges.argmin(axis=1)
    hit_ranges = ranges[np.arange(len(beam)), nearest]
    hit = np.isfinite(hit_ranges)
    seen = hit & np.array([p.seen for p in pieces])[nearest]
    names = [pieces[i].name if is_hit else "" for i, is_hit in zip(nearest, hit, strict=True)]
    leaves = np.array(names) == "bush"
    hit_ranges = (
        hit_ranges + rng.normal(0, NOISE_M, len(beam)) + leaves * rng.exponential(0.3, len(beam))
    )
    codes = np.where(leaves, DENSE, np.array([p.code for p in pieces])[nearest])
    return (
        np.where(seen, hit_ranges, np.nan),
        [int(code) for code in np.where(seen, codes, MISSING)],
        names,
    )


def signed_angles(lines: VerticalLines, chord_m: float = 4 * NOISE_M) -> F32:
    """Signed angles with the least chord, point by point."""
    signed = np.full(lines.range_m.shape, np.nan, np.float32)
    for row in range(len(signed)):
        beams = np.flatnonzero(~np.isnan(lines.range_m[row]))
        points = lines.xyz_m[row, beams].astype(float)
        for j, k in enumerate(beams):
            distances = np.linalg.norm(points - points[j], axis=1)
            after = np.flatnonzero(distances[j:] >= chord_m)
            before = np.flatnonzero(distances[:j] >= chord_m)
            if len(after):
                chord = points[j + after[0]] - points[j]
                angle = np.degrees(np.arccos(chord[2] / np.linalg.norm(chord)))
                back = len(before) and chord @ (points[j] - points[before[-1]]) < 0
                signed[row, k] = -angle if back else angle
    return signed


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
