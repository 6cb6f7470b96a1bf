"""Trajectories as files, CSV or SBET, so that registration can be tested with what users have.

The position is that of the scanner's centre, without lever arm. World coordinates become those of a map by adding the
origin of a :class:`Frame`; points of the same run must be shifted by the same.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output
from prc_cli.core.types import F64
from prc_cli.formats.trajectory import SBET_SUFFIXES
from prc_cli.simulation.trajectory import Platform, Pose

if TYPE_CHECKING:
    import pyproj

_BATCH = 50_000
"""Rows worked out at a time."""
_COLUMNS = ("time", "x", "y", "z", "roll_deg", "pitch_deg", "yaw_deg")


@dataclass(frozen=True, slots=True)
class Frame:
    """A coordinate system in metres, x to the east and y to the north, and where the simulated world lies in it.

    The default is UTM zone 35 north on WGS 84, near the test sites of Lehtola et al. (2019, III).
    """

    crs: str = "EPSG:32635"
    """Anything that pyproj takes; projected, in metres."""
    easting_m: float = 363_000.0
    northing_m: float = 6_671_000.0
    height_m: float = 40.0
    """Above the ellipsoid."""

    def origin(self) -> F64:
        """Return what is added to world coordinates, (3,) float64 [m]."""
        return np.array([self.easting_m, self.northing_m, self.height_m])


WORLD = Frame("", 0.0, 0.0, 0.0)
"""Coordinates of the simulated world as they are; no place on earth, so for CSV alone."""


def write_trajectory(
    path: Path,
    platform: Platform,
    duration_s: float,
    *,
    hz: float = 200.0,
    start_s: float = 0.0,
    frame: Frame = WORLD,
    into: Path | None = None,
) -> None:
    """Write where a scanner is from time 0 on, batch by batch.

    A file ending in ``.sbet`` or ``.out`` becomes SBET: 17 little-endian doubles a record, angles in radians, heights
    above the ellipsoid, heading from true north, velocities to the north, east and down; accelerations and rates are
    left at 0. Any other becomes CSV with a header, angles in degrees as in
    :mod:`prc_cli.simulation.trajectory`.
    """
    is_sbet = path.suffix.lower() in SBET_SUFFIXES
    earth = _earth(path, frame) if is_sbet else None
    target = atomic_output(path) if into is None else contextlib.nullcontext(into)
    with target as temporary, temporary.open("wb") as handle:
        if earth is None:
            handle.write((",".join(_COLUMNS) + "\n").encode())
        for time_s, pose, velocity in _positions(platform, duration_s, hz):
            xyz_m = pose.position + frame.origin()
            if earth is None:
                angles = np.degrees(np.stack([pose.roll, pose.pitch, pose.yaw], axis=1))
                rows = np.column_stack([time_s + start_s, xyz_m, angles])
                np.savetxt(handle, rows, "%.6f,%.4f,%.4f,%.4f,%.5f,%.5f,%.5f")
            else:
                handle.write(_records(earth, time_s + start_s, xyz_m, pose, velocity).tobytes())


def _positions(platform: Platform, duration_s: float, hz: float) -> Iterator[tuple[F64, Pose, F64]]:
    """Yield times, poses and velocities, the last time at the duration or just after it."""
    n = int(np.ceil(duration_s * hz)) + 1
    for first in range(0, n, _BATCH):
        time_s = np.arange(first, min(first + _BATCH, n)) / hz
        pose = platform.pose(time_s)
        yield time_s, pose, (platform.pose(time_s + 0.5 / hz).position - pose.position) * (2.0 * hz)


def check_frame(path: Path, frame: Frame) -> None:
    """Refuse a coordinate system that coordinates in metres cannot have, as far as pyproj is there to know it."""
    if frame.crs and find_spec("pyproj") is not None:
        _earth(path, frame)


def _earth(path: Path, frame: Frame) -> pyproj.Proj:
    """Return what brings the frame's coordinates to longitude and latitude."""
    if not frame.crs:
        problem = "an SBET trajectory is in latitude and longitude, and the simulated world lies nowhere on earth"
        raise ConfigError(str(path), problem, "give a coordinate system, for example EPSG:32635, or write CSV")
    try:
        import pyproj
        import pyproj.exceptions
    except ImportError:
        problem = "an SBET trajectory needs pyproj, which is not installed"
        raise ConfigError(str(path), problem, "pip install prc-cli[crs]") from None
    try:
        crs = pyproj.CRS.from_user_input(frame.crs)
        if not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
            problem = f"coordinate system {frame.crs[:40]!r} is not a projected one in metres"
            raise ConfigError(str(path), problem, "give one, for example EPSG:32635")
        return pyproj.Proj(crs)
    except pyproj.exceptions.ProjError as error:
        problem = f"coordinate system {frame.crs[:40]!r} cannot be used ({str(error).splitlines()[0]})"
        raise ConfigError(str(path), problem, "give another, for example EPSG:32635") from None


def _records(earth: pyproj.Proj, time_s: F64, xyz_m: F64, pose: Pose, velocity: F64) -> F64:
    """Return SBET records, (n, 17) little-endian float64."""
    longitude, latitude = earth(xyz_m[:, 0], xyz_m[:, 1], inverse=True)
    convergence = np.radians(earth.get_factors(longitude, latitude).meridian_convergence)
    records = np.zeros((len(time_s), 17), dtype="<f8")
    records[:, 0] = time_s
    records[:, 1], records[:, 2], records[:, 3] = np.radians(latitude), np.radians(longitude), xyz_m[:, 2]
    east, north = velocity[:, 0], velocity[:, 1]
    records[:, 4] = north * np.cos(convergence) - east * np.sin(convergence)
    records[:, 5] = east * np.cos(convergence) + north * np.sin(convergence)
    records[:, 6] = -velocity[:, 2]
    # there the body has x forward, y right, z down: pitch changes its sign, roll does not
    records[:, 7], records[:, 8] = pose.roll, -pose.pitch
    records[:, 9] = (np.pi / 2.0 - pose.yaw + convergence) % (2.0 * np.pi)
    return records
