"""Points, and LAS and LAZ files of them, for tests of several folders."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np

from prc_cli.core.types import F64


def seen(length: Any, azimuth: Any, elevation: Any) -> F64:
    """Coordinates from lengths [m] and angles [rad], (..., 3) [m]; azimuths turn to the left."""
    flat = length * np.cos(elevation)
    xyz = flat * np.cos(azimuth), flat * np.sin(azimuth), length * np.sin(elevation)
    return np.stack(np.broadcast_arrays(*xyz), axis=-1)


def write_las(
    path: Path, xyz: F64, codes: Any, *, extra: dict[str, Any] | None = None, **columns: Any
) -> Path:
    """Write points with a class code each, in steps of 1 mm.

    ``columns`` are dimensions of LAS, ``extra`` are extra bytes.
    """
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, 0.001)
    header.offsets = np.floor(np.asarray(xyz).min(axis=0))
    for name, values in (extra or {}).items():
        header.add_extra_dim(laspy.ExtraBytesParams(name, values.dtype))
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    las.classification = np.asarray(codes, np.uint8)
    for name, values in {**columns, **(extra or {})}.items():
        las[name] = values
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)
    return path
