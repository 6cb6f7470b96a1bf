"""A beam that turns in a corridor on a platform that moves.

a registered cloud in closed form, with its true path.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyproj

from prc_cli.core.types import F64, I64
from tests.formats.builders import of_points, write_csv, write_las

LINES_HZ = 50.0
SHOTS_HZ = 12_000.0
DURATION_S = 4.0
HEIGHT_M = 2.1
LEFT_M = 4.0
RIGHT_M = -6.0
CEILING_M = 5.0
CORNER_M = (384_000.0, 6_672_000.0, 12.0)
"""Where the corridor begins, in EPSG:32635."""
EPSG = 32635


@dataclass(frozen=True, slots=True)
class Corridor:
    """Points with times, and the true path."""

    time_s: F64
    xyz_m: F64
    shot: I64
    """Numbers of the shots in the order of firing, from 0."""
    range_m: F64
    path_s: F64
    path_m: F64


def stations(time_s: F64) -> F64:
    """True positions of the scanner, (n, 3) [m]: its speed changes, and it sways."""
    along = 6.0 * time_s + 0.8 * np.sin(1.7 * time_s)
    return np.stack(
        [along, 0.3 * np.sin(0.9 * time_s), HEIGHT_M + 0.02 * np.sin(5.0 * time_s)], axis=1
    ) + np.array(CORNER_M)


def make_corridor(*, begin_s: float = 100.0, gap_s: float = 0.0) -> Corridor:
    """Cast the beam; a gap cuts the drive into two passes."""
    since = np.arange(round(DURATION_S * SHOTS_HZ)) / SHOTS_HZ
    station = stations(since)
    # no beam is level or upright
    angle = 2.0 * np.pi * LINES_HZ * since + 0.001
    # the scan plane leans back by 20 degrees and looks a little to the side
    lean = np.radians(20.0)
    aside = np.radians(3.0)
    axis = np.array([np.cos(lean) * np.cos(aside), np.cos(lean) * np.sin(aside), -np.sin(lean)])
    left = np.array([-np.sin(aside), np.cos(aside), 0.0])
    up = np.cross(axis, left)
    beam = np.cos(angle)[:, None] * left + np.sin(angle)[:, None] * up
    local = station - CORNER_M
    to_side = np.where(beam[:, 1] > 0, LEFT_M - local[:, 1], RIGHT_M - local[:, 1]) / beam[:, 1]
    to_level = np.where(beam[:, 2] > 0, CEILING_M - local[:, 2], -local[:, 2]) / beam[:, 2]
    range_m = np.minimum(to_side, to_level)
    xyz = station + range_m[:, None] * beam
    xyz += np.random.default_rng(3).normal(0.0, 0.002, xyz.shape)
    # a part of the ceiling is open
    seen = (np.sin(angle) < 0.95) | (beam[:, 2] < 0)
    later = np.where(since > 0.5 * DURATION_S, gap_s, 0.0)
    path_s = np.arange(-1.0, DURATION_S + 1.0, 0.005)
    return Corridor(
        (since + later + begin_s)[seen],
        xyz[seen],
        np.flatnonzero(seen),
        range_m[seen],
        path_s + begin_s,
        stations(path_s),
    )


def write_cloud(
    path: Path,
    cloud: Corridor,
    *,
    epsg: int | None = None,
    metres: float = 1.0,
) -> Path:
    """Write coordinates and times alone, in the order of x; in units of some metres."""
    order = np.argsort(cloud.xyz_m[:, 0], kind="stable")
    columns = of_points(cloud.xyz_m[order] / metres, time=cloud.time_s[order])
    return write_las(path, columns, None if epsg is None else pyproj.CRS.from_epsg(epsg))


def write_trajectory(
    path: Path,
    cloud: Corridor,
    *,
    clock_s: float = 0.0,
    moved_m: tuple[float, ...] = (0, 0, 0),
) -> Path:
    """Write the true path with another clock, elsewhere."""
    xyz_m = cloud.path_m + np.array(moved_m)
    return write_csv(path, {"time": cloud.path_s + clock_s, **of_points(xyz_m)})
