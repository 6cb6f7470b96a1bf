"""Small files of records: columns in, a file out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np

Columns = Mapping[str, np.ndarray[Any, Any]]


def write_las(path: Path, columns: Columns, crs: Any = None) -> Path:
    """Write LAS or LAZ of point format 6: x, y, z, time, and all others as extra bytes.

    Every record is the only return of its shot.
    """
    n = len(next(iter(columns.values())))
    xyz = [np.asarray(columns.get(axis, np.zeros(n))) for axis in "xyz"]
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = [0.001] * 3
    header.offsets = [np.floor(place.min()) for place in xyz]
    if crs is not None:
        header.add_crs(crs)
    others = [name for name in columns if name not in ("x", "y", "z", "time")]
    for name in others:
        kind = "f4" if columns[name].dtype.kind == "f" else "u4"
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz
    las.return_number = las.number_of_returns = np.ones(n, np.uint8)
    if "time" in columns:
        las.gps_time = columns["time"]
    for name in others:
        las[name] = columns[name]
    las.write(path)
    return path


def write_csv(path: Path, columns: Columns) -> Path:
    """Write a row a record below the names."""
    formats = ["%.9f" if values.dtype.kind == "f" else "%d" for values in columns.values()]
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, formats, ",", header=",".join(columns), comments="")
    return path


def of_points(xyz: np.ndarray[Any, Any], **columns: np.ndarray[Any, Any]) -> Columns:
    """Return columns of coordinates (n, 3) and others."""
    return dict(zip("xyz", xyz.T, strict=True)) | columns
