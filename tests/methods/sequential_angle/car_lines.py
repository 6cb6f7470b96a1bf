"""Single vertical lines over road, cars and walls, seen by a noisy scanner, with their true labels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, F64, I32, U8
from prc_cli.methods.sequential_angle.lines import VerticalLines

MISSING, DENSE, H, V, UNDECIDED = range(5)
SCANNER_M = 1.8
NOISE_M = 0.005


@dataclass(frozen=True)
class Piece:
    """A straight piece of a section: horizontal distance and height over the road at both ends [m]."""

    name: str
    from_m: tuple[float, float]
    to_m: tuple[float, float]
    seen: bool = True

    @property
    def code(self) -> int:
        return V if abs(self.to_m[1] - self.from_m[1]) > abs(self.to_m[0] - self.from_m[0]) else H


def polyline(name: str, corners: list[tuple[float, float]], *, seen: bool = True) -> list[Piece]:
    return [Piece(name, a, b, seen) for a, b in pairwise(corners)]


def road(to_m: float = 200.0, slope: float = 0.0) -> list[Piece]:
    return polyline("road", [(0.5, 0.5 * slope), (to_m, to_m * slope)])


def curb(at_m: float, height_m: float = 0.15, depth_m: float = 20.0) -> list[Piece]:
    return [
        *polyline("curb", [(at_m, 0.0), (at_m, height_m)]),
        *polyline("pavement", [(at_m, height_m), (at_m + depth_m, height_m)]),
    ]


def wall(at_m: float, foot_m: float = 0.0, top_m: float = 8.0, *, windows: bool = False) -> list[Piece]:
    edges = [foot_m, 1.0, 2.2, 4.0, 5.2, top_m] if windows else [foot_m, top_m]
    parts = pairwise(edges)
    return [Piece("wall", (at_m, a), (at_m, b), i % 2 == 0) for i, (a, b) in enumerate(parts)]


def car(at_m: float, *, glass: bool = True, tyre: bool = False) -> list[Piece]:
    """The section across a car whose side stands at a distance; with a tyre, nothing is open below."""
    at = np.array([at_m, 0.0])

    def part(corners: list[tuple[float, float]], *, seen: bool = True) -> list[Piece]:
        return polyline("car", [(at_m + h, z) for h, z in corners], seen=seen)

    arc = np.deg2rad(np.arange(270, 89, -10))
    wheel = at + np.array([0.32, 0.32]) + 0.32 * np.stack([np.cos(arc), np.sin(arc)], axis=1)
    return [
        *part([(0.06, 0.2), (0.0, 0.5), (0.05, 0.9)] if not tyre else [(0.3, 0.6), (0.05, 0.65), (0.05, 0.9)]),
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
        return np.array([k for k, found in enumerate(self.names[0]) if found == name and self.surface[0, k]], np.int32)


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
    h, z = range_m * np.sin(beam_rad), -range_m * np.cos(beam_rad)
    xyz = np.stack([h, 0 * h, z], axis=-1).astype(np.float32)
    n_beams = np.full(len(range_m), len(beam_rad), np.int32)
    return VerticalLines(range_m.astype(np.float32), xyz, np.hypot(xyz[..., 0], xyz[..., 1]), n_beams, beam_rad[None])


def _row(pieces: list[Piece], beam: F64, scanner_m: float, rng: Generator) -> tuple[F64, list[int], list[str]]:
    direction = np.stack([np.sin(beam), -np.cos(beam)], axis=1)
    start = np.array([[p.from_m[0], p.from_m[1] - scanner_m] for p in pieces])
    along = np.array([p.to_m for p in pieces]) - np.array([p.from_m for p in pieces])
    cross = direction[:, None, 0] * along[:, 1] - direction[:, None, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        share = (start[:, 0] * direction[:, None, 1] - start[:, 1] * direction[:, None, 0]) / cross
    ranges = np.where((ranges > 0) & (share >= 0) & (share <= 1), ranges, np.inf)
    nearest = ranges.argmin(axis=1)
    found = ranges[np.arange(len(beam)), nearest]
    hit = np.isfinite(found)
    seen = hit & np.array([p.seen for p in pieces])[nearest]
    names = [pieces[i].name if one else "" for i, one in zip(nearest, hit, strict=True)]
    leaves = np.array(names) == "bush"
    found = found + rng.normal(0, NOISE_M, len(beam)) + leaves * rng.exponential(0.3, len(beam))
    codes = np.where(leaves, DENSE, np.array([p.code for p in pieces])[nearest])
    return np.where(seen, found, np.nan), [int(code) for code in np.where(seen, codes, MISSING)], names


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
