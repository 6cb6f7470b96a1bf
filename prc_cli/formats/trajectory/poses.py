"""Poses, positions with an orientation: TUM text files, and ``nav_msgs/Odometry`` and the like in bags."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64
from prc_cli.formats.bags.cursor import Cursor, ShortMessageError

if TYPE_CHECKING:
    from prc_cli.formats.bags.containers import Message

ODOMETRY = "nav_msgs/Odometry"
KINDS = (ODOMETRY, "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped")
"""Types of messages with a pose behind their header; Odometry has the name of a frame in between."""
_MAX_ROW = 65_536
_N_CELLS = 8
_LENGTH = 0.01
"""Tolerance for the length of a quaternion."""


def is_tum(path: Path) -> bool:
    """Whether the first row of a text file, comments left out, is 8 numbers."""
    for _, cells in _rows(path):
        return len(cells) == _N_CELLS and all(_number(cell) is not None for cell in cells)
    return False


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of every row that is neither blank nor a comment."""
    with path.open("r", encoding="utf-8-sig", errors="replace", newline=None) as handle:
        number = 0
        while row := handle.readline(_MAX_ROW + 1):
            number += 1
            if len(row) > _MAX_ROW:
                where = f"{path}: line {number}"
                problem = f"row of more than {_MAX_ROW} characters, expected a time and a position"
                raise InputError(where, problem, "give a CSV or TUM file, or an SBET file ending in .sbet or .out")
            text = row.strip()
            if text and not text.startswith("#"):
                yield number, text.split()


def _number(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def read_tum(path: Path) -> tuple[F64, F64, F64]:
    """Read rows of time, position and quaternion, separated by blanks."""
    rows: list[list[float]] = []
    for number, cells in _rows(path):
        values = [_number(cell) for cell in cells]
        found = [value for value in values if value is not None]
        if len(cells) != _N_CELLS or len(found) != _N_CELLS:
            problem = f"found {' '.join(cells)[:80]!r}, expected 8 numbers: time x y z qx qy qz qw"
            raise InputError(f"{path}: line {number}", problem, "correct or drop the row")
        _check_length(f"{path}: line {number}", found[4:])
        rows.append(found)
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
    every = [one for one in bag.counts if one.kind in KINDS]
    chosen = [one for one in every if (bag.counts[one] if topic is None else one.name == topic)]
    shown = ", ".join(one.name for one in every[:20]) or "none"
    if len(chosen) > 1 or (topic is not None and not chosen):
        found = "several topics with poses" if topic is None else f"no poses on {topic!r}"
        raise ConfigError("input.trajectory_topic", f"{found} in {path.name}, it has: {shown}", "name one of them")
    rows: list[list[float]] = []
    for message in bag.messages(chosen):
        rows.append(_pose(path, message, len(rows)))
    if not rows:
        problem = f"no poses, expected messages of {', '.join(KINDS)}"
        raise InputError(str(path), problem, "give another file as trajectory")
    return _split(rows)


def _pose(path: Path, message: Message, number: int) -> list[float]:
    """Return time, position and quaternion of a message."""
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
        raise InputError(where, "found a pose that is not finite, expected numbers", "record it again")
    _check_length(where, values[3:])
    return [stamp_s, *values]


def turned(quaternion: F64, arm_m: F64) -> F64:
    """Return a vector of the vehicle in the coordinates of the positions.

    A quarter turn to the left:

    >>> half = np.sqrt(0.5)
    >>> turned(np.array([[0.0, 0.0, half, half]]), np.array([1.0, 1.0, 2.0])).round(9)
    array([[-1.,  1.,  2.]])
    """
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, arm_m)
    result: F64 = arm_m + w * twice + np.cross(axis, twice)
    return result
