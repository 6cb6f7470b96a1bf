"""Trajectories as files: text of times and positions, poses (TUM text, messages of bags), and SBET.

Positions in SBET are geographic; they are projected to the coordinate system of the points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64
from prc_cli.formats.bags.messages import Cursor, ShortMessageError

if TYPE_CHECKING:
    import pyproj

    from prc_cli.formats.bags.containers import Message


SBET_SUFFIXES = (".sbet", ".out")
_NAMES = {
    "time": ("time", "gps_time", "gpstime", "t"),
    "x": ("x", "easting", "e"),
    "y": ("y", "northing", "n"),
    "z": ("z", "height", "altitude", "alt", "h"),
}
_TURNS = {"roll": ("roll", "roll_deg"), "pitch": ("pitch", "pitch_deg")}
_YAW = ("yaw", "yaw_deg")
_HEADING = ("heading", "heading_deg")
_BATCH = 100_000
"""Rows or records read at a time."""
_MAX_ROW = 65_536


def read_text(path: Path) -> tuple[F64, F64]:
    """Read time and position from columns of these names, or from four columns without names."""
    values = _columns(path, _NAMES)
    return values[:, 0].copy(), values[:, 1:].copy()


def _columns(path: Path, names: dict[str, tuple[str, ...]]) -> F64:
    rows = _rows(path, with_head=True)
    with closing(rows):
        number, first = next(rows, (1, ""))
        delimiter = next((mark for mark in ";\t," if mark in first), None)
        cells = _cells(first.lstrip("#"), delimiter)
        left: Iterator[tuple[int, str]] = rows
        if delimiter != ",":
            start = list(islice(rows, _LOOKED_AT))
            left = chain(start, rows)
            if _has_decimal_commas([first, *(text for _, text in start)], delimiter):
                left = ((place, text.replace(",", ".")) for place, text in left)
                first = first.replace(",", ".")
                cells = [cell.replace(",", ".") for cell in cells]
        is_bare = (
            names is _NAMES
            and len(cells) == len(names)
            and all(_number(cell) is not None for cell in cells)
        )
        if first.startswith("#") or not is_bare:
            columns = _find_columns(f"{path}: line {number}", cells, names)
        else:
            columns = list(range(len(names)))
            left = chain([(number, first)], left)
        parts = []
        while batch := list(islice(left, _BATCH)):
            parts.append(_parse(path, batch, delimiter, columns))
    return np.concatenate(parts) if parts else np.empty((0, len(names)))


def read_turns(path: Path, target: str | None) -> F64:
    """Read the orientations of a text file or an SBET, (n, 4) quaternions (x, y, z, w).

    They turn the axes of the vehicle to those of the points. The axes of the vehicle are forward,
    left, up. Text has ``roll``, ``pitch`` and ``yaw`` (from x to the left, pitch positive with the
    nose down) or ``heading`` (from grid north to the right, pitch positive with the nose up), in
    degrees. The true heading of an SBET is its platform heading less the wander angle.
    """
    from scipy.spatial.transform import Rotation

    if path.suffix.lower() in SBET_SUFFIXES:
        values = _sbet_records(path, path.stat().st_size)
        roll = np.degrees(values[:, 7])
        pitch = -np.degrees(values[:, 8])
        heading = np.degrees(values[:, 9] - values[:, 10]) - convergence(values[:, 1:3], target)
        yaw = 90.0 - heading
    else:
        head = next(_rows(path, with_head=True), (1, ""))[1].lower()
        by_heading = "heading" in head
        roll, pitch, yaw = _columns(path, {**_TURNS, "yaw": _HEADING if by_heading else _YAW}).T
        if by_heading:
            pitch = -pitch
            yaw = 90.0 - yaw
    quaternion: F64 = Rotation.from_euler(
        "ZYX", np.stack([yaw, pitch, roll], axis=1), degrees=True
    ).as_quat()
    return quaternion


def convergence(place: F64, target: str | None) -> F64:
    """Return the angle from true north to grid north, (n,) [deg].

    ``place`` is latitude and longitude, (n, 2) [rad].
    """
    import pyproj

    earth = pyproj.Proj(pyproj.CRS.from_user_input(target))
    latitude, longitude = np.degrees(place).T
    return np.asarray(earth.get_factors(longitude, latitude).meridian_convergence, np.float64)


def _rows(path: Path, *, with_head: bool) -> Generator[tuple[int, str], None, None]:
    """Yield number and text of every row but blank ones and comments; a header may start with #."""
    with path.open("r", encoding="utf-8-sig", errors="replace", newline=None) as handle:
        number = 0
        while row := handle.readline(_MAX_ROW + 1):
            number += 1
            if len(row) > _MAX_ROW:
                problem = f"row of more than {_MAX_ROW} characters, expected time and position"
                hint = "give a CSV or TUM file, or an SBET file ending in .sbet or .out"
                raise InputError(f"{path}: line {number}", problem, hint)
            text = row.strip()
            if text and (with_head or not text.startswith("#")):
                with_head = False
                yield number, text


def _cells(row: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in row.split(delimiter)]


_LOOKED_AT = 20
"""Rows that are tested for decimal commas."""


def _has_decimal_commas(rows: list[str], delimiter: str | None) -> bool:
    cells = [cell for row in rows for cell in _cells(row, delimiter)]
    has_comma = any("," in cell and _number(cell.replace(",", ".")) is not None for cell in cells)
    return has_comma and not any("." in cell and _number(cell) is not None for cell in cells)


def _number(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _find_columns(
    where: str, cells: list[str], wanted_names: dict[str, tuple[str, ...]]
) -> list[int]:
    # ignore units in brackets: "x [m]", "time(s)"
    names = [cell.lower().partition("[")[0].partition("(")[0].strip() for cell in cells]
    columns = []
    for wanted, known in wanted_names.items():
        places = [names.index(name) for name in known if name in names]
        if not places:
            expected = f"{wanted} (one of {', '.join(known)})"
            problem = f"no column for {expected}, found {', '.join(cells)[:200]!r}"
            example = "time,x,y,z" if wanted in _NAMES else "time,x,y,z,roll,pitch,yaw"
            raise InputError(
                where, problem, f"name the columns in the first row, for example {example}"
            )
        columns.append(places[0])
    return columns


def _parse(
    path: Path,
    batch: list[tuple[int, str]],
    delimiter: str | None,
    columns: list[int],
) -> F64:
    """Return (n, 4) time and position, all finite."""
    try:
        cells = [row.split(delimiter) for _, row in batch]
        values = np.array(
            [[float(row[column]) for column in columns] for row in cells], dtype=np.float64
        )
    except (ValueError, IndexError):
        values = np.empty((0, 4))
    if len(values) and np.isfinite(values).all():
        return values
    # something in this batch is wrong or quoted: parse row by row
    return np.array(
        [
            _parse_row(f"{path}: line {number}", _cells(row, delimiter), columns)
            for number, row in batch
        ]
    )


def _parse_row(where: str, cells: list[str], columns: list[int]) -> list[float]:
    if len(cells) <= max(columns):
        problem = f"{len(cells)} cells, expected at least {max(columns) + 1}"
        raise InputError(where, problem, "every row needs time, x, y and z")
    values = []
    for column in columns:
        value = _number(cells[column])
        if value is None:
            problem = f"cell {column + 1} is {cells[column][:40]!r}, expected a finite number"
            raise InputError(where, problem, "correct or drop the row")
        values.append(value)
    return values


ODOMETRY = "nav_msgs/Odometry"
KINDS = (ODOMETRY, "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped")
"""Types of messages with a pose behind their header, and in odometry a name of a frame."""
_N_CELLS = 8
_LENGTH = 0.01
"""Tolerance for the length of a quaternion."""


def is_tum(path: Path) -> bool:
    """Whether the first row of a text file, comments left out, is 8 numbers."""
    for _, text in _rows(path, with_head=False):
        cells = text.split()
        return len(cells) == _N_CELLS and all(_number(cell) is not None for cell in cells)
    return False


def read_tum(path: Path) -> tuple[F64, F64, F64]:
    """Read rows of time, position and quaternion, separated by blanks."""
    rows: list[list[float]] = []
    for number, text in _rows(path, with_head=False):
        cells = text.split()
        values = [_number(cell) for cell in cells]
        numbers = [value for value in values if value is not None]
        if len(cells) != _N_CELLS or len(numbers) != _N_CELLS:
            problem = f"found {' '.join(cells)[:80]!r}, expected 8 numbers: time x y z qx qy qz qw"
            raise InputError(f"{path}: line {number}", problem, "correct or drop the row")
        _check_length(f"{path}: line {number}", numbers[4:])
        rows.append(numbers)
    return _split(rows)


def _split(rows: list[list[float]]) -> tuple[F64, F64, F64]:
    table = np.array(rows, np.float64).reshape(-1, _N_CELLS)
    quaternion = table[:, 4:] / np.sqrt((table[:, 4:] ** 2).sum(axis=1, keepdims=True))
    return table[:, 0].copy(), table[:, 1:4].copy(), quaternion


def _check_length(where: str, quaternion: list[float]) -> None:
    with np.errstate(over="ignore"):
        length = float(np.sqrt((np.array(quaternion) ** 2).sum()))
    if not abs(length - 1.0) <= _LENGTH:
        problem = f"the quaternion has length {length:g}, expected 1"
        raise InputError(where, problem, "check the columns: time x y z qx qy qz qw")


def read_poses(path: Path, topic: str | None) -> tuple[F64, F64, F64]:
    """Read the poses of a bag; see :func:`read_tum` for what is returned."""
    from prc_cli.formats.bags.containers import Bag

    bag = Bag(path)
    pose_topics = [candidate for candidate in bag.counts if candidate.kind in KINDS]
    if topic is None:
        chosen = [candidate for candidate in pose_topics if bag.counts[candidate]]
    else:
        chosen = [candidate for candidate in pose_topics if candidate.name == topic]
    if len(chosen) > 1 or (topic is not None and not chosen):
        shown = ", ".join(candidate.name for candidate in pose_topics[:20]) or "none"
        reason = "several topics with poses" if topic is None else f"no poses on {topic!r}"
        problem = f"{reason} in {path.name}, it has: {shown}"
        raise ConfigError("input.trajectory_topic", problem, "name one of them")
    rows: list[list[float]] = []
    for message in bag.messages(chosen):
        rows.append(_pose(path, message, len(rows)))
    if not rows:
        problem = f"no poses, expected messages of {', '.join(KINDS)}"
        raise InputError(str(path), problem, "give another file as trajectory")
    return _split(rows)


def _pose(path: Path, message: Message, number: int) -> list[float]:
    where = f"{path}: {message.topic.name}: message {number}"
    try:
        cursor = Cursor(message.data, is_cdr=message.topic.is_cdr)
        stamp_s, _ = cursor.header()
        if message.topic.kind == ODOMETRY:
            cursor.text()
        values = list(cursor.numbers("d", 7))
    except ShortMessageError as error:
        raise InputError(where, f"the message {error}", "copy the bag again") from None
    if not np.isfinite(values).all():
        raise InputError(
            where, "found a pose that is not finite, expected numbers", "record it again"
        )
    _check_length(where, values[3:])
    return [stamp_s, *values]


def turned(quaternion: F64, arm_m: F64) -> F64:
    """Return a vector of the vehicle in the coordinates of the positions.

    A quarter turn to the left:

    >>> half = np.sqrt(0.5)
    >>> turned(np.array([[0.0, 0.0, half, half]]), np.array([1.0, 1.0, 2.0])).round(9)
    array([[-1.,  1.,  2.]])
    """
    axis = quaternion[:, :3]
    w = quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, arm_m)
    result: F64 = arm_m + w * twice + np.cross(axis, twice)
    return result


SBET_BYTES = 136
"""Bytes of an SBET record: 17 little-endian doubles.

Time, latitude, longitude and altitude are the first.
"""


def read_sbet(path: Path, size: int) -> tuple[F64, F64]:
    """Read the positions of a file of ``size`` bytes."""
    values = _sbet_records(path, size)[:, :4]
    sane = (
        np.isfinite(values).all(axis=1)
        & (np.abs(values[:, 1]) <= math.pi / 2)
        & (np.abs(values[:, 2]) <= math.tau)
    )
    if not sane.all():
        i = int(np.argmin(sane))
        shown = ", ".join(f"{value:g}" for value in values[i])
        what = f"time, latitude, longitude, altitude are {shown}"
        problem = f"{what}, expected finite numbers, angles in radians"
        position = f"{path}: record {i} (byte {i * SBET_BYTES})"
        raise InputError(position, problem, "check that this is an SBET file")
    return values[:, 0].copy(), values[:, [2, 1, 3]]


def _sbet_records(path: Path, size: int) -> F64:
    """Return time, position, attitude and the wander angle of every record, (n, 11)."""
    if size % SBET_BYTES:
        problem = f"{size} bytes, expected a multiple of {SBET_BYTES} (17 doubles a record)"
        raise InputError(
            str(path),
            problem,
            "copy the SBET again; if it is text, give it another suffix",
        )
    parts = []
    with path.open("rb") as handle:
        while raw := handle.read(_BATCH * SBET_BYTES):
            complete = raw[: len(raw) // SBET_BYTES * SBET_BYTES]
            records = np.frombuffer(complete, "<f8").reshape(-1, 17)
            parts.append(records[:, :11].astype(np.float64))
    return np.concatenate(parts)


def project(path: Path, position: F64, target: str | None) -> F64:
    """Project longitude and latitude to the coordinate system of the points.

    Heights stay ellipsoidal.
    """
    system = _projected_system(path, target)
    x, y = system.forward(np.degrees(position[:, 0]), np.degrees(position[:, 1]))
    xyz_m: F64 = np.stack([x, y, position[:, 2]], axis=1)
    finite = np.isfinite(xyz_m).all(axis=1)
    if not finite.all():
        problem = (
            f"position {int(np.argmin(finite))} lies outside of what {system.shown!r} can show"
        )
        raise InputError(str(path), problem, "check trajectory_crs")
    return xyz_m


def unproject(path: Path, xyz_m: F64, target: str | None) -> F64:
    """Return longitude, latitude [rad] and height [m] (n, 3), the inverse of :func:`project`."""
    system = _projected_system(path, target)
    longitude, latitude = system.backward(xyz_m[:, 0], xyz_m[:, 1])
    place: F64 = np.stack([np.radians(longitude), np.radians(latitude), xyz_m[:, 2]], axis=1)
    finite = np.isfinite(place).all(axis=1)
    if not finite.all():
        problem = (
            f"position {int(np.argmin(finite))} lies outside of what {system.shown!r} can show"
        )
        raise InputError(str(path), problem, "check trajectory_crs")
    return place


@dataclass(frozen=True, slots=True)
class _System:
    """A projected coordinate system in metres."""

    shown: str
    forward: Callable[[F64, F64], tuple[F64, F64]]
    """Longitude and latitude in degrees to x and y."""
    backward: Callable[[F64, F64], tuple[F64, F64]]


def _projected_system(path: Path, target: str | None) -> _System:
    if target is None:
        problem = (
            "an SBET has latitude and longitude, but the points' coordinate system is not known"
        )
        raise ConfigError(str(path), problem, "set trajectory_crs, for example EPSG:32635")
    try:
        import pyproj
        import pyproj.exceptions
    except ImportError:
        problem = "an SBET trajectory needs pyproj, which is not installed"
        raise ConfigError(str(path), problem, 'pip install ".[crs]"') from None
    shown = target if len(target) <= 40 else f"{target[:40]}..."
    remedy = "set trajectory_crs to that of the points, for example EPSG:32635"
    try:
        crs = pyproj.CRS.from_user_input(target)
        _refuse_heights(path, crs, shown)
        if not crs.is_projected or any(
            axis.unit_conversion_factor != 1.0 for axis in crs.axis_info
        ):
            problem = f"coordinate system {shown!r} is not a projected one in metres"
            raise ConfigError(str(path), problem, remedy)
        forward = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        backward = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except pyproj.exceptions.ProjError as error:
        problem = f"coordinate system {shown!r} cannot be used ({str(error).splitlines()[0]})"
        raise ConfigError(str(path), problem, remedy) from None
    return _System(shown, forward.transform, backward.transform)


def _refuse_heights(path: Path, crs: pyproj.CRS, shown: str) -> None:
    """Refuse a system with a vertical datum: heights in SBET are ellipsoidal."""
    inner = crs.source_crs if crs.is_bound and crs.source_crs is not None else crs
    if not inner.is_compound:
        return
    names = [part.name for part in inner.sub_crs_list]
    # lower confidences name systems of other countries
    code = inner.sub_crs_list[0].to_authority(min_confidence=100) if names else None
    alone = ":".join(code) if code is not None else "its horizontal part"
    heights = f" ({names[-1][:40]!r})" if names else ""
    problem = (
        f"{shown!r} has heights of its own{heights}, but heights of an SBET are above the ellipsoid"
    )
    hint = (
        f"set trajectory_crs = {alone} if the points' heights are above the ellipsoid too; "
        "if not, give the trajectory as CSV"
    )
    raise ConfigError(str(path), problem, hint)
