"""Organised scans (rows by columns): shared parts of PTX and E57."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import Assumption, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.formats.options import InputConfig, origin_of

CHUNK_SHOTS = 1 << 18
"""Shots of a block at most (at least a line)."""
MAX_POINTS_PER_LINE = 10_000_000
"""Longest line, as for ``input.points_per_line``."""
MAX_LINES = 10_000_000
"""Most columns of a scan: counts per column are held in memory."""
MAX_SCANS = 1 << 16
"""Most scans in a file: point_source_id in LAS has as many values."""
INTENSITY_STEPS = 65535.0
"""Full scale of intensities in LAS."""
_ROTATION_TOLERANCE = 1e-3
"""Tolerance for unit length and right angles of the axes of a pose.

Some are written with four digits.
"""


@dataclass(frozen=True, slots=True)
class Pose:
    """Transformation from the file to the frame of the sensor: ``xyz @ rotation + offset_m``."""

    rotation: F64
    """(3, 3) float64, rows are the axes of the file in a frame with z up."""
    offset_m: F64
    """(3,) float64, origin of the file relative to the scanner, in the rotated frame [m].

    Usually zero.
    """

    station_m: F64 = field(default_factory=lambda: np.zeros(3))
    """(3,) float64, position of the scanner among all scans [m]."""

    @classmethod
    def none(cls) -> Pose:
        """Identity: points are in the frame of the sensor already, z up."""
        return cls(np.eye(3), np.zeros(3))

    def apply(self, xyz: F64) -> F64:
        """Return sensor-centred coordinates with z up."""
        placed = np.empty_like(xyz)
        # no matrix product: its rounding depends on the number of points per call
        with np.errstate(over="ignore", invalid="ignore"):
            for axis in range(3):
                a, b, c = self.rotation[:, axis]
                placed[:, axis] = (
                    xyz[:, 0] * a + xyz[:, 1] * b + xyz[:, 2] * c + self.offset_m[axis]
                )
        return placed


@dataclass(frozen=True, slots=True)
class ScanShape:
    """One scan of a file."""

    scanner: int
    """Index of the scan in the file."""
    n_lines: int
    points_per_line: int
    n_records: int
    first_record: int

    @property
    def n_cells(self) -> int:
        """Shots, missing ones included."""
        return self.n_lines * self.points_per_line


def is_rotation(matrix: F64) -> bool:
    """Whether a 3 x 3 matrix is a rotation, without scale or reflection.

    >>> is_rotation(np.eye(3)), is_rotation(2 * np.eye(3)), is_rotation(np.diag([1.0, 1.0, -1.0]))
    (True, False, False)
    """
    with np.errstate(over="ignore", invalid="ignore"):
        product = matrix @ matrix.T
        close = np.abs(product - np.eye(3)).max() <= _ROTATION_TOLERANCE
        return bool(close and np.linalg.det(matrix) > 0)


def lengths(xyz: F64) -> F64:
    """Return the slant range of every point, (n,) float64 [m]; infinite on overflow."""
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        length: F64 = np.sqrt(xyz[:, 0] ** 2 + xyz[:, 1] ** 2 + xyz[:, 2] ** 2)
    return length


def to_float32(values: F64) -> F32:
    """Return float32; NaN where a value is not finite."""
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        rounded: F32 = values.astype(np.float32)
    rounded[~np.isfinite(rounded)] = np.nan
    return rounded


def filled(values: F32, n: int) -> F32:
    """Return values padded with missing ones to n."""
    if len(values) == n:
        return values
    return np.concatenate(
        [values, np.full((n - len(values), *values.shape[1:]), np.nan, np.float32)]
    )


def lines_per_block(points_per_line: int) -> int:
    """Return the lines of a block.

    >>> lines_per_block(1 << 10), lines_per_block(1 << 20)
    (256, 1)
    """
    return max(1, CHUNK_SHOTS // points_per_line)


def refuse_rules(path: Path, config: InputConfig, what: str, **allowed: tuple[str, ...]) -> None:
    """Refuse rules that a file has itself."""
    for key, values in allowed.items():
        value = getattr(config, key)
        if value not in values:
            problem = f"found {value!r}, expected {' or '.join(values)}: {path.name} {what}"
            raise ConfigError(f"input.{key}", problem, "leave the key out")


RULED_OUT = frozenset(
    (
        "lines",
        "columns",
        "range",
        "trajectory",
        "origin",
        "scanner",
        "order",
        "angle_start",
        "angle_step",
        "points_per_line",
        "layout",
        "azimuth_step",
        "partial_line",
        "time_origin",
    )
)
"""Keys that scans refuse or ignore: they have their own lines, columns and angles."""


def check_rules(
    path: Path,
    config: InputConfig,
    what: str = "organised scans",
    *,
    may_have_origin: bool = False,
) -> None:
    """Refuse options that do not apply to an organised scan, which has its own lines and ranges.

    ``may_have_origin``: ``range = origin:X,Y,Z`` is checked by the caller, who knows the scans.
    """
    if may_have_origin and origin_of(config) is not None:
        config = config.model_copy(update={"range": "auto"})
    refuse_rules(
        path,
        config,
        f"holds {what}",
        lines=("auto",),
        columns=("auto",),
        range=("auto", "sensor-xyz"),
        scanner=("none",),
        order=("require", "trust"),
    )
    for key in ("angle_start", "angle_step"):
        if getattr(config, key) is not None:
            problem = f"given, but {path.name} holds {what}, whose angles follow from xyz"
            raise ConfigError(f"input.{key}", problem, "leave the key out")


def check_width(where: Path | str, points_per_line: int, config: InputConfig) -> None:
    """Refuse a file whose line length is not ``input.points_per_line``."""
    wanted = config.points_per_line
    if wanted is not None and wanted != points_per_line:
        problem = f"found {points_per_line} points per line, input.points_per_line is {wanted}"
        raise InputError(str(where), problem, "leave input.points_per_line out")


def check_shapes(path: Path, shapes: list[ScanShape], config: InputConfig) -> None:
    """Refuse a file without shots, or with another line length than ``input.points_per_line``."""
    if not any(shape.n_cells for shape in shapes):
        scans_text = "no scans" if not shapes else f"{_scans(len(shapes))} without points"
        raise InputError(str(path), f"found {scans_text}, expected scan data", "export it again")
    for shape in shapes:
        if shape.n_cells:
            check_width(f"{path}: scan {shape.scanner}", shape.points_per_line, config)


def describe(
    path: Path,
    form: str,
    shapes: list[ScanShape],
    assumptions: list[Assumption],
    notes: list[str],
    poses: Sequence[Pose] = (),
    *,
    takes_origin: bool = False,
) -> StreamInfo:
    """Return the metadata known before reading.

    ``takes_origin``: the scan has no pose; ``--range origin:X,Y,Z`` says where the scanner is.
    """
    remedy = "export the scan again, in metres, with the scanner at its origin"
    if takes_origin:
        remedy += ", or give the place of the scanner: --range origin:X,Y,Z"
    full = [shape for shape in shapes if shape.n_cells]
    sizes = ", ".join(f"{shape.n_lines} x {shape.points_per_line}" for shape in full[:5])
    more = ", ..." if len(full) > 5 else ""
    empty = [shape.scanner for shape in shapes if not shape.n_cells]
    if empty:
        notes = [*notes, f"{_scans(len(empty))} without points left out: {listed(empty)}"]
    assumed = [
        Assumption(
            "input.lines",
            "columns of the scan",
            f"{_scans(len(full))} of lines x beams {sizes}{more}",
        ),
        Assumption("input.scanner", "one a scan", "every scan of the file has its own lines"),
        *assumptions,
    ]
    return StreamInfo(
        path=str(path),
        format=form,
        points_per_line=max(shape.points_per_line for shape in full),
        n_records=sum(shape.n_records for shape in shapes),
        n_lines=sum(shape.n_lines for shape in full),
        assumptions=tuple(assumed),
        facts=SourceFacts(
            has_scans=True,
            stations=_stations(shapes, poses),
            notes=tuple(notes),
            refuses=(RULED_OUT - {"origin"} if takes_origin else RULED_OUT) | {"range_scale"},
            remedy=remedy,
        ),
    )


def _stations(
    shapes: list[ScanShape], poses: Sequence[Pose]
) -> dict[int, tuple[float, float, float]]:
    """Return the position of the scanner of every scan; empty where all are at the origin."""
    placed = {
        shape.scanner: tuple(pose.station_m.tolist())
        for shape, pose in zip(shapes, poses, strict=False)
    }
    return placed if any(map(any, placed.values())) else {}


def spans(n_lines: int, lines: int) -> Iterator[tuple[int, int]]:
    """Yield first and last line + 1 of every block.

    >>> list(spans(5, 2))
    [(0, 2), (2, 4), (4, 5)]
    """
    for first in range(0, n_lines, lines):
        yield first, min(first + lines, n_lines)


def in_turn(
    parts: Iterator[NDArray[Any]], sizes: Iterable[int], missing: InputError
) -> Iterator[NDArray[Any]]:
    """Cut parts that come one after the other into pieces of such sizes.

    An error where they end too early.
    """
    waiting: list[NDArray[Any]] = []
    n_waiting = 0
    for wanted in sizes:
        while n_waiting < wanted or not waiting:
            part = next(parts, None)
            if part is None:
                raise missing
            waiting.append(part)
            n_waiting += len(part)
        joined = waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
        waiting = [joined[wanted:]]
        n_waiting = n_waiting - wanted
        yield joined[:wanted]
    # whoever reads the parts checks that there are no more
    for _ in parts:
        pass


def listed(numbers: list[int]) -> str:
    """Return the first numbers of scans, for messages."""
    return ", ".join(map(str, numbers[:10])) + (", ..." if len(numbers) > 10 else "")


def _scans(n: int) -> str:
    return f"{n} scan" + ("s" if n != 1 else "")
