"""Where the sensor was at any time: trajectories from CSV and SBET files."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64

SBET_BYTES = 136
"""Bytes of an SBET record: 17 little-endian doubles; time, latitude, longitude and altitude are the first."""
_NAMES = {
    "time": ("time", "gps_time", "gpstime", "t"),
    "x": ("x", "easting", "e"),
    "y": ("y", "northing", "n"),
    "z": ("z", "height", "altitude", "alt", "h"),
}
_BATCH = 100_000
"""Rows or records read at a time."""
_MAX_ROW = 65_536
_WEEK_S = 604_800.0
_ADJUSTED_S = 1e9
"""Adjusted standard GPS time is GPS time less this (LAS 1.4, global encoding bit 0)."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Positions of the sensor over time, linear in between.

    Held in memory whole: 32 bytes a position, so a day at 200 Hz takes 550 MB and an hour 23 MB.
    """

    path: str
    """File name, for messages."""
    time_s: F64
    """(n,) float64, strictly increasing [s], the offset already added."""
    xyz_m: F64
    """(n, 3) float64, in the coordinate system of the points [m]."""

    def positions(self, time_s: F64) -> F64:
        """Interpolate.

        Parameters
        ----------
        time_s : (n,) float64
            Times [s].

        Returns
        -------
        (n, 3) float64
            Positions [m], finite.

        Raises
        ------
        InputError
            When a time is not finite or lies outside the trajectory.

        Examples
        --------
        >>> track = Trajectory("drive.csv", np.array([0.0, 2.0]), np.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0]]))
        >>> track.positions(np.array([0.5]))
        array([[1., 0., 1.]])
        """
        if len(time_s) == 0:
            return np.empty((0, 3))
        # a comparison with NaN is false, so NaN counts as outside
        inside = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        if not inside.all():
            raise self._outside(time_s, inside)
        columns = [np.interp(time_s, self.time_s, self.xyz_m[:, axis]) for axis in range(3)]
        return np.stack(columns, axis=1)

    def _outside(self, time_s: F64, inside: np.ndarray) -> InputError:
        finite = time_s[np.isfinite(time_s)]
        n_outside = int(np.count_nonzero(~inside))
        if not len(finite):
            problem = f"all {len(time_s)} point times are NaN or infinite, expected times within the trajectory"
            return InputError(self.path, problem, "look at gps_time with prc info")
        span = f"{self.time_s[0]:.2f} to {self.time_s[-1]:.2f} s"
        problem = (
            f"{n_outside} of {len(time_s)} point times are outside the trajectory: points from {finite.min():.2f} to "
            f"{finite.max():.2f} s, trajectory from {span}"
        )
        if len(finite) < len(time_s):
            problem += f" ({len(time_s) - len(finite)} times are NaN or infinite)"
        return InputError(self.path, problem, self._offset_hint(float(finite.min()), float(finite.max())))

    def _offset_hint(self, first: float, last: float) -> str:
        """Suggest the offset if the clocks differ by whole GPS weeks, by 1e9 s, or by both."""
        start, end = float(self.time_s[0]), float(self.time_s[-1])
        middle = (first + last - start - end) / 2
        slack = max((end - start - (last - first)) / 2, 0.0) + 1.0
        for base in (0.0, -_ADJUSTED_S, _ADJUSTED_S):
            weeks = round((middle - base) / _WEEK_S)
            offset = base + weeks * _WEEK_S
            if offset and abs(middle - offset) <= slack:
                known = ((f"{weeks:+d} GPS weeks", weeks), (f"{base:+.0e} s", base))
                what = " and ".join(text for text, there in known if there)
                return f"the clocks seem to differ by {what}: try trajectory_time_offset = {offset:.0f}"
        return "give the trajectory of this drive, or set trajectory_time_offset to what its times lack"


def load_trajectory(path: Path, *, crs: str | None, source_crs_wkt: str | None, time_offset: float) -> Trajectory:
    """Read a trajectory; ``.sbet`` and ``.out`` are SBET, anything else is text with a header row.

    Parameters
    ----------
    path : Path
        Text: columns time (time, gps_time, t), x (x, easting, e), y (y, northing, n) and z (z, height, altitude,
        alt, h) in the coordinate system of the points, any delimiter. SBET: projected to that system.
    crs : str or None
        Coordinate system of the points (``trajectory_crs``), for SBET.
    source_crs_wkt : str or None
        The same as the points' file says it; used where ``crs`` is None.
    time_offset : float
        Added to the trajectory's times [s].

    Raises
    ------
    InputError
        When the file cannot be read as a trajectory; the message names the row or record.
    ConfigError
        When an SBET file has no coordinate system to go to, or pyproj is missing.
    """
    try:
        size = path.stat().st_size
        if size == 0:
            raise InputError(str(path), "empty file, expected a trajectory", "give a CSV or SBET file with positions")
        if path.suffix.lower() in (".sbet", ".out"):
            time_s, position = _read_sbet(path, size)
            target = crs or source_crs_wkt
            xyz_m = _project(path, position, target)
        else:
            time_s, xyz_m = _read_text(path)
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check the trajectory's name and permissions") from None
    _check(path, time_s, xyz_m)
    return Trajectory(str(path), time_s + time_offset, xyz_m)


def _check(path: Path, time_s: F64, xyz_m: F64) -> None:
    """Refuse times that do not increase; finite numbers were checked while reading."""
    if len(time_s) < 2:
        problem = f"{len(time_s)} positions, expected at least 2 to interpolate between"
        raise InputError(str(path), problem, "give the whole trajectory")
    stuck = np.flatnonzero(np.diff(time_s) <= 0)
    if len(stuck):
        i = int(stuck[0]) + 1
        problem = (
            f"position {i + 1} (counted from 1) has time {time_s[i]:.6f} s after {time_s[i - 1]:.6f} s, expected times "
            f"that increase ({len(stuck)} such steps)"
        )
        raise InputError(str(path), problem, "sort the trajectory by time and drop repeated rows")


def _read_sbet(path: Path, size: int) -> tuple[F64, F64]:
    """Return time (n,) [s] and (n, 3) longitude [rad], latitude [rad], altitude [m]."""
    if size % SBET_BYTES:
        problem = f"{size} bytes, expected a multiple of {SBET_BYTES} (17 doubles a record)"
        raise InputError(str(path), problem, "the SBET is cut short, or it is no SBET: give a text file another suffix")
    parts = []
    with path.open("rb") as handle:
        while raw := handle.read(_BATCH * SBET_BYTES):
            whole = raw[: len(raw) // SBET_BYTES * SBET_BYTES]
            parts.append(np.frombuffer(whole, "<f8").reshape(-1, 17)[:, :4].astype(np.float64))
    values = np.concatenate(parts)
    sane = np.isfinite(values).all(axis=1) & (np.abs(values[:, 1]) <= math.pi / 2) & (np.abs(values[:, 2]) <= math.tau)
    if not sane.all():
        i = int(np.argmin(sane))
        found = ", ".join(f"{value:g}" for value in values[i])
        problem = f"time, latitude, longitude, altitude are {found}, expected finite numbers, angles in radians"
        position = f"{path}: record {i} (byte {i * SBET_BYTES})"
        raise InputError(position, problem, "check that this is an SBET file")
    return values[:, 0].copy(), values[:, [2, 1, 3]]


def _project(path: Path, position: F64, target: str | None) -> F64:
    """Bring longitude and latitude to the points' system; altitudes are taken as they are."""
    if target is None:
        problem = "an SBET trajectory is in latitude and longitude, and the points' coordinate system is not known"
        raise ConfigError(str(path), problem, "set trajectory_crs, for example EPSG:32635")
    try:
        import pyproj
        import pyproj.exceptions
    except ImportError:
        problem = "an SBET trajectory needs pyproj, which is not installed"
        raise ConfigError(str(path), problem, "pip install prc-cli[crs]") from None
    shown = target if len(target) <= 40 else f"{target[:40]}..."
    remedy = "set trajectory_crs to that of the points, for example EPSG:32635"
    try:
        crs = pyproj.CRS.from_user_input(target)
        if crs.is_compound:
            crs = crs.sub_crs_list[0]
        if not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info[:2]):
            problem = f"coordinate system {shown!r} is not a projected one in metres"
            raise ConfigError(str(path), problem, remedy)
        transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        x, y = transformer.transform(np.degrees(position[:, 0]), np.degrees(position[:, 1]))
    except pyproj.exceptions.ProjError as error:
        problem = f"coordinate system {shown!r} cannot be used ({str(error).splitlines()[0]})"
        raise ConfigError(str(path), problem, remedy) from None
    xyz_m: F64 = np.stack([x, y, position[:, 2]], axis=1)
    finite = np.isfinite(xyz_m).all(axis=1)
    if not finite.all():
        problem = f"position {int(np.argmin(finite))} lies outside of what {shown!r} can show"
        raise InputError(str(path), problem, "check trajectory_crs")
    return xyz_m


def _read_text(path: Path) -> tuple[F64, F64]:
    """Return time (n,) [s] and position (n, 3) [m]."""
    with path.open("r", encoding="utf-8-sig", errors="replace", newline=None) as handle:
        rows = _rows(str(path), handle)
        number, first = next(rows, (1, ""))
        delimiter = next((mark for mark in ",;\t" if mark in first), None)
        columns = _find_columns(f"{path}: line {number}", _cells(first.lstrip("#"), delimiter))
        parts = []
        while batch := list(islice(rows, _BATCH)):
            parts.append(_parse(str(path), batch, delimiter, columns))
    values = np.concatenate(parts) if parts else np.empty((0, 4))
    return values[:, 0].copy(), values[:, 1:].copy()


def _rows(where: str, handle: TextIO) -> Iterator[tuple[int, str]]:
    """Yield line number and text of every row that holds something; the first may begin with #."""
    number = 0
    first = True
    while row := handle.readline(_MAX_ROW + 1):
        number += 1
        if len(row) > _MAX_ROW:
            problem = f"row of more than {_MAX_ROW} characters, expected time and position"
            position = f"{where}: line {number}"
            raise InputError(position, problem, "give a CSV file, or an SBET file ending in .sbet or .out")
        text = row.strip()
        if text and (first or not text.startswith("#")):
            first = False
            yield number, text


def _cells(row: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in row.split(delimiter)]


def _find_columns(where: str, cells: list[str]) -> list[int]:
    """Return the columns of time, x, y and z."""
    # units in brackets are decoration: "x [m]", "time(s)"
    names = [cell.lower().partition("[")[0].partition("(")[0].strip() for cell in cells]
    columns = []
    for wanted, known in _NAMES.items():
        found = [names.index(name) for name in known if name in names]
        if not found:
            problem = f"no column for {wanted} (one of {', '.join(known)}), found {', '.join(cells)[:200]!r}"
            raise InputError(where, problem, "name the columns in the first row, for example time,x,y,z")
        columns.append(found[0])
    return columns


def _parse(where: str, batch: list[tuple[int, str]], delimiter: str | None, columns: list[int]) -> F64:
    """Return (n, 4) time and position, all finite."""
    try:
        cells = [row.split(delimiter) for _, row in batch]
        values = np.array([[float(row[column]) for column in columns] for row in cells], dtype=np.float64)
    except (ValueError, IndexError):
        values = np.empty((0, 4))
    if len(values) and np.isfinite(values).all():
        return values
    # something is wrong in this batch, or quoted: look at it row by row
    return np.array([_parse_row(f"{where}: line {number}", _cells(row, delimiter), columns) for number, row in batch])


def _parse_row(where: str, cells: list[str], columns: list[int]) -> list[float]:
    if len(cells) <= max(columns):
        problem = f"{len(cells)} cells, expected at least {max(columns) + 1}"
        raise InputError(where, problem, "every row needs time, x, y and z")
    values = []
    for column in columns:
        try:
            value = float(cells[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            problem = f"cell {column + 1} is {cells[column][:40]!r}, expected a finite number"
            raise InputError(where, problem, "correct or drop the row")
        values.append(value)
    return values
