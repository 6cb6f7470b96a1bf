"""Reader of SBET trajectories: geographic positions, projected to the coordinate system of the points."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64

if TYPE_CHECKING:
    import pyproj

SBET_BYTES = 136
"""Bytes of an SBET record: 17 little-endian doubles; time, latitude, longitude and altitude are the first."""
_BATCH = 100_000
"""Records read at a time."""


def read_sbet(path: Path, size: int) -> tuple[F64, F64]:
    """Read the positions of a file of ``size`` bytes."""
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


def project(path: Path, position: F64, target: str | None) -> F64:
    """Project longitude and latitude to the coordinate system of the points; heights stay ellipsoidal."""
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
        _refuse_heights(path, crs, shown)
        if not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
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
        f"coordinate system {shown!r} has heights of its own{heights}, expected a horizontal one: the altitudes of an "
        "SBET are above the ellipsoid and are not converted"
    )
    remedy = (
        f"set trajectory_crs = {alone} if the points' heights are above the ellipsoid too; if not, give the trajectory "
        "as CSV in the points' system"
    )
    raise ConfigError(str(path), problem, remedy)
