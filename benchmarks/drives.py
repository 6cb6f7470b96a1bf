"""Inputs of the benchmarks: a simulated street of any length as raw dump, text, LAS or LAZ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import numpy as np

from prc_cli.core.types import F32
from prc_cli.simulation.settings import load_settings, open_simulation

POINTS_PER_LINE = 2154
_LINES_AT_ONCE = 200
_ANGLE_STEP_DEG = {True: 0.006, False: 1.0}


def ranges_of(kind: str, n_lines: int, **options: Any) -> F32:
    """Return the ranges of a simulation, (lines, M) [m]."""
    settings = load_settings(kind, options={"lines": n_lines, **options})  # type: ignore[arg-type]
    scan = open_simulation(kind, settings).scan  # type: ignore[arg-type]
    return np.concatenate([block.range_m for block in scan.blocks()])


def write_raw(path: Path, n_lines: int) -> None:
    """Write a street of any length by repeating a simulated one."""
    tile = ranges_of("street", min(n_lines, 600), scanner={"points_per_line": POINTS_PER_LINE})
    with path.open("wb") as handle:
        for first in range(0, n_lines, len(tile)):
            tile[: n_lines - first].tofile(handle)


def write_csv(path: Path, raw: Path) -> None:
    """Write the ranges of a raw dump as text, one per row; a missing shot is nan."""
    ranges = np.memmap(raw, "<f4", "r")
    with path.open("w", encoding="ascii") as handle:
        handle.write("range\n")
        for first in range(0, len(ranges), 1 << 20):
            values = ranges[first : first + (1 << 20)].tolist()
            handle.writelines(f"{value:.3f}\n" if value > 0 else "nan\n" for value in values)


def write_drive(path: Path, ranges: Path, point_format: int) -> None:
    """Write the returns of a raw dump as LAS or LAZ, by suffix."""
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales = np.full(3, 0.001)
    header.offsets = np.array([650_000.0, 6_860_000.0, 0.0])
    for name, kind in (("range", "f4"), ("scan_line", "u4"), ("column", "u4")):
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    rng = np.random.default_rng(0)
    image = np.memmap(ranges, "<f4", "r").reshape(-1, POINTS_PER_LINE)
    with laspy.open(path, "w", header=header) as writer:
        for first in range(0, len(image), _LINES_AT_ONCE):
            writer.write_points(
                drive_points(image[first : first + _LINES_AT_ONCE], first, header, rng)
            )


def drive_points(
    image: np.ndarray,
    first: int,
    header: laspy.LasHeader,
    rng: np.random.Generator,
) -> laspy.ScaleAwarePointRecord:
    """Records of some scan lines at 100 lines per second and 5 cm between lines."""
    line, column = np.indices(image.shape).reshape(2, -1)
    is_return = np.isfinite(image.ravel()) & (image.ravel() > 0)
    line = line[is_return] + first
    column = column[is_return]
    range_m = image.ravel()[is_return]
    turn = 2 * np.pi * column / POINTS_PER_LINE
    points = laspy.ScaleAwarePointRecord.zeros(len(range_m), header=header)
    across = range_m * np.cos(turn) * np.sqrt(0.5)
    points.x = 650_100 + across + 0.05 * line
    points.y = 6_860_100 + across
    points.z = 2 + range_m * np.sin(turn)
    points.intensity = rng.normal(2000, 150, len(range_m)).astype("u2")
    points.return_number = points.number_of_returns = np.ones(len(range_m), "u1")
    points.gps_time = 3e8 + line / 100 + column / (100 * POINTS_PER_LINE)
    name = "scan_angle" if header.point_format.id >= 6 else "scan_angle_rank"
    step_deg = _ANGLE_STEP_DEG[header.point_format.id >= 6]
    points[name] = np.rint(np.rad2deg(turn - np.pi) / 2 / step_deg).astype(
        "i2" if step_deg < 1 else "i1"
    )
    points["range"] = range_m
    points["scan_line"] = line
    points["column"] = column
    return points
