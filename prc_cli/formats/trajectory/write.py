"""Writes the path of a scanner: CSV with uncertainties, or SBET without."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prc_cli.core.errors import OutputError
from prc_cli.core.types import F64, I64
from prc_cli.formats.trajectory import SBET_SUFFIXES, convergence, unproject

CSV_SUFFIXES = (".csv", ".txt")
HEAD = "time,x,y,z,sigma_x,sigma_y,sigma_z,axis_x,axis_y,axis_z,pass"
BATCH_ROWS = 1 << 14
COURSE_S = 0.5
"""The course of an SBET is that over this time [s]."""
SLOW_M_S = 0.2
"""Slower platforms keep their course [m/s]."""


@dataclass(frozen=True, slots=True)
class PathTable:
    """Positions of a scanner over time."""

    time_s: F64
    """(k,) float64, rising [s]."""
    xyz: F64
    """(k, 3) float64, in the units of the cloud's coordinate system."""
    sigma: F64
    """(k, 3) float64, standard deviations, in the same units."""
    axis: F64
    """(k, 3) float64, unit vectors along the axis of the turn."""
    number: I64
    """(k,) int64, number of the pass."""


def check_path_suffix(path: Path) -> None:
    """Raise an error if the suffix is of no trajectory format."""
    if path.suffix.lower() not in (*CSV_SUFFIXES, *SBET_SUFFIXES):
        known = ", ".join((*CSV_SUFFIXES, *SBET_SUFFIXES))
        raise OutputError(
            str(path), f"ends in {path.suffix or 'nothing'!r}, expected one of {known}", "rename it"
        )


def write_path(
    path: Path,
    name: Path,
    table: PathTable,
    crs: str | None,
) -> None:
    """Write a path in the format that its name asks for.

    Parameters
    ----------
    path
        File to write.
    name
        Name that it will have.
    table
        The path.
    crs
        Coordinate system of the path, for SBET.
    """
    if name.suffix.lower() in SBET_SUFFIXES:
        path.write_bytes(sbet_records(name, table, crs).tobytes())
        return
    with path.open("w", encoding="utf-8", newline="\n") as handle:
        handle.writelines(_rows(table))


def _rows(table: PathTable) -> Iterator[str]:
    yield HEAD + "\n"
    for first in range(0, len(table.time_s), BATCH_ROWS):
        part = slice(first, first + BATCH_ROWS)
        columns = (table.xyz[part], table.sigma[part], table.axis[part])
        values = np.concatenate(columns, axis=1).tolist()
        for time_s, row, number in zip(
            table.time_s[part].tolist(), values, table.number[part].tolist(), strict=True
        ):
            # times are exact: a rounded one may lie outside of the points
            position = ",".join(f"{value:.5f}" for value in row[:6])
            axis = ",".join(f"{value:.7f}" for value in row[6:])
            yield f"{time_s!r},{position},{axis},{number}\n"


def sbet_records(name: Path, table: PathTable, crs: str | None) -> F64:
    """Return a path as records of 17 doubles, (k, 17) float64.

    The velocity is that of the path, the heading its course; roll, pitch, accelerations and rates
    are not known and are 0. The wander angle is 0: velocities are north, east and down.
    """
    place = unproject(name, table.xyz, crs)
    speed, heading = _course(table)
    true_heading = heading + np.radians(convergence(place[:, [1, 0]], crs))
    level = np.hypot(speed[:, 0], speed[:, 1])
    grid = np.arctan2(speed[:, 0], speed[:, 1]) + (true_heading - heading)
    records = np.zeros((len(table.time_s), 17))
    records[:, 0] = table.time_s
    records[:, 1:4] = place[:, [1, 0, 2]]
    records[:, 4:7] = np.stack([level * np.cos(grid), level * np.sin(grid), -speed[:, 2]], axis=1)
    records[:, 9] = np.remainder(true_heading, 2.0 * math.pi)
    return records.astype("<f8")


def _course(table: PathTable) -> tuple[F64, F64]:
    """Return the velocity (k, 3) and the heading from grid north to the right (k,) [rad]."""
    n = len(table.time_s)
    step = float(np.median(np.diff(table.time_s)))
    half = max(round(0.5 * COURSE_S / step), 1)
    place = np.arange(n)
    before = np.maximum(place - half, 0)
    after = np.minimum(place + half, n - 1)
    # not across passes
    before = np.maximum(before, np.searchsorted(table.number, table.number))
    after = np.minimum(after, np.searchsorted(table.number, table.number, side="right") - 1)
    after_s = np.maximum(table.time_s[after] - table.time_s[before], 1e-9)
    speed = (table.xyz[after] - table.xyz[before]) / after_s[:, None]
    heading = np.arctan2(speed[:, 0], speed[:, 1])
    moves = np.hypot(speed[:, 0], speed[:, 1]) > SLOW_M_S
    last = np.maximum.accumulate(np.where(moves, place, -1))
    first = int(np.argmax(moves)) if moves.any() else 0
    return speed, heading[np.where(last >= 0, last, first)]
