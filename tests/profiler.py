"""The real profiler sample (README of the data: jakteristics test data) and parameters recovered
from it by fitting."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np

from prc_cli.config import LoadedConfig
from prc_cli.core.types import F64, I64
from prc_cli.jobs.classify import open_stream

JAKARTO_M = 5099
JAKARTO_PERIOD_S = 5.0161e-3
SHOT_S = 0.98374e-6


def jakarto(real_data: Path) -> tuple[Path, dict[str, np.ndarray]]:
    folder = real_data / "profiler"
    with np.load(folder / "jakarto_0.02s_recovered.npz") as recovered:
        return folder / "jakarto_0.02s.las", {name: recovered[name] for name in recovered.files}


def scanner_positions(las: laspy.LasData, recovered: dict[str, np.ndarray]) -> F64:
    """Scanner centre of every line from coordinates and recovered ranges (linear least squares).

    Time, x, y, z.
    """
    xyz = np.column_stack([las.x, las.y, las.z])
    middle = xyz.mean(axis=0)
    rows = []
    for line in range(4):
        chosen = recovered["line"] == line
        points = xyz[chosen] - middle
        ranges = recovered["range_m"][chosen].astype(np.float64)
        # |p - c|² = r² becomes linear in c and |c|². In a plane, the part across it comes from
        # the normal of the coordinates.
        squares = (points**2).sum(axis=1) - ranges**2
        normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
        offset = float(normal @ points.mean(axis=0))
        system = np.column_stack([2 * points, -np.ones(len(points))])
        system = np.vstack([system, [*(1e6 * normal), 0.0]])
        solution = np.linalg.lstsq(system, np.append(squares, 1e6 * offset), rcond=None)[0]
        rows.append([float(las.gps_time[chosen].mean()), *(solution[:3] + middle)])
    return np.array(rows)


def write_trajectory(path: Path, positions: F64) -> None:
    """Extend the positions straight on at both ends, so that every shot lies inside."""
    first = positions[0] - 2 * (positions[1] - positions[0])
    last = positions[-1] + 2 * (positions[-1] - positions[-2])
    rows = np.vstack([first, positions, last])
    np.savetxt(path, rows, delimiter=",", header="time,x,y,z", comments="", fmt="%.9f")


def jakarto_input(trajectory: Path) -> dict[str, Any]:
    """Return the ``[input]`` table for the sample.

    Lines and columns by time, ranges by trajectory.
    """
    return {
        "lines": f"time:{1 / JAKARTO_PERIOD_S!r}",
        "columns": f"time:{1 / SHOT_S!r}",
        "range": f"trajectory:{trajectory}",
        "points_per_line": JAKARTO_M,
    }


def placed(source: Path, loaded: LoadedConfig, n_records: int) -> tuple[I64, I64, F64, int]:
    """Return line, column and range [m] of every record of a file as the reader places them, and
    the cells read."""
    line = np.full(n_records, -1, np.int64)
    column = np.full(n_records, -1, np.int64)
    range_m = np.full(n_records, np.nan)
    n_cells = 0
    for block in open_stream(source, loaded).blocks():
        records = block.records()
        where = np.argwhere(records >= 0)
        record = records[records >= 0]
        line[record] = where[:, 0] + block.first_line
        column[record] = where[:, 1]
        range_m[record] = block.range_m[records >= 0]
        n_cells += block.range_m.size
    return line, column, range_m, n_cells


def steps_apart(line: I64, column: I64, recovered: dict[str, np.ndarray]) -> I64:
    """Return how many shots each record lies beside its recovered cell.

    The phase of the mirror is taken out.
    """
    steps = (line - recovered["line"]) * JAKARTO_M + column - recovered["column"]
    return np.abs(steps - int(np.median(steps)))
