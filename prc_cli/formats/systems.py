"""Units of coordinate systems, and sources whose coordinates are converted to metres."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import F64
from prc_cli.formats.records import AXES, RecordChunk, Source, filtered

REPROJECT = (
    "reproject it to metres, for example: pdal translate IN.las OUT.las reprojection "
    "--filters.reprojection.out_srs=EPSG:CODE"
)
LONGEST_DEG = 0.1
"""Largest extent of the first points of a drive [deg]: 11 km."""
UPRIGHT = 50.0
"""Points whose heights spread this many times more than x and y are not in metres on all axes."""
LEAST_POINTS = 100
"""Fewer points are not tested."""
_UNIT = re.compile(r'\b(?:LENGTH)?UNIT\s*\[\s*"([^"]*)"\s*,\s*([0-9.eE+-]+)')
_VERTICAL = re.compile(r"\bVERT(?:_CS|CRS|ICALCRS)\s*\[")
_PROJECTED = re.compile(
    r"\b(?:PROJCS|PROJCRS|PROJECTEDCRS|LOCAL_CS|ENGCRS|ENGINEERINGCRS|GEOCCS)\s*\["
)
_GEOGRAPHIC = re.compile(r"\b(?:GEOGCS|GEOGCRS|GEOGRAPHICCRS|GEODCRS)\s*\[")


@dataclass(frozen=True, slots=True)
class SystemUnits:
    """Units of the axes of a coordinate system."""

    name: str
    """Name of the system."""
    unit: str
    """Name of the unit of x and y."""
    xy_m: float
    """Metres in one unit of x and y; NaN for degrees."""
    z_m: float
    """Metres in one unit of z."""

    @property
    def is_geographic(self) -> bool:
        """Whether x and y are degrees."""
        return bool(np.isnan(self.xy_m))

    @property
    def is_metric(self) -> bool:
        """Whether all axes are metres."""
        return self.xy_m == 1.0 and self.z_m == 1.0


@lru_cache(maxsize=8)
def units_of_system(crs: str | None) -> SystemUnits | None:
    """Return the units of a coordinate system, WKT or ``EPSG:CODE``; None if it is not known.

    >>> degrees = 'GEOGCS["g",UNIT["degree",0.0174532925199433]]'
    >>> wkt = f'PROJCS["NY",{degrees},UNIT["US survey foot",0.304800609601219]]'
    >>> units_of_system(wkt).unit, units_of_system(wkt).z_m
    ('US survey foot', 0.304800609601219)
    >>> units_of_system('GEOGCS["WGS 84",UNIT["degree",0.0174532925199433]]').is_geographic
    True
    """
    if not crs:
        return None
    wkt = crs if "[" in crs else _wkt_of(crs)
    shown = crs
    if "[" in crs:
        quoted = re.search(r'"([^"]*)"', crs)
        shown = "its coordinate system" if quoted is None else quoted[1]
    wkt = re.split(r"\bTARGETCRS\s*\[", wkt)[0]
    horizontal, *vertical = _VERTICAL.split(wkt, maxsplit=1)
    if not _PROJECTED.search(horizontal):
        return SystemUnits(shown, "degree", np.nan, 1.0) if _GEOGRAPHIC.search(horizontal) else None
    units = _UNIT.findall(horizontal)
    if not units:
        return None
    name = units[-1][0]
    metres = float(units[-1][1])
    heights = _UNIT.findall(vertical[0]) if vertical else []
    z_m = float(heights[-1][1]) if heights else metres
    return SystemUnits(shown, name, metres, z_m) if metres > 0 and z_m > 0 else None


def _wkt_of(crs: str) -> str:
    try:
        import pyproj
    except ImportError:
        return ""
    try:
        return pyproj.CRS.from_user_input(crs).to_wkt()
    except pyproj.exceptions.CRSError:
        return ""


def looks_geographic(xyz: F64) -> bool:
    """Whether x and y of points, (n, 3) float64, must be degrees, with z in metres.

    >>> line = np.linspace(0, 1, 500)
    >>> looks_geographic(np.stack([25 + line * 1e-4, 60 + line * 1e-4, 9 * line], axis=1))
    True
    >>> looks_geographic(np.stack([25 + line, 60 + line, 9 * line], axis=1))
    False
    """
    known = xyz[np.isfinite(xyz).all(axis=1)]
    if len(known) < LEAST_POINTS:
        return False
    spread = np.ptp(known, axis=0)
    middle = np.abs(np.median(known, axis=0))
    on_earth = middle[0] <= 180.0 and middle[1] <= 90.0 and middle[:2].max() > LONGEST_DEG
    across = float(spread[:2].max())
    return bool(on_earth and 0.0 < across < LONGEST_DEG and spread[2] > UPRIGHT * across)


def refuse_degrees(source: Source) -> None:
    """Raise an error if the coordinates are degrees, because ranges are computed from metres."""
    if not set(AXES) <= set(source.dimensions):
        return
    units = units_of_system(source.facts.crs_wkt)
    if units is not None and units.is_geographic:
        problem = f"x and y are degrees ({units.name}), ranges are computed from metres"
        raise InputError(source.path, problem, REPROJECT)
    if units is None and first_look_geographic(source):
        problem = "x and y are degrees by their size, ranges are computed from metres"
        raise InputError(source.path, problem, REPROJECT)


def first_look_geographic(source: Source) -> bool:
    """Whether the first points of a source are in degrees by their size."""
    first = next(iter(source.chunks(AXES)), None)
    return first is not None and looks_geographic(points_of(first.values))


def points_of(values: dict[str, NDArray[Any]]) -> F64:
    """Return x, y, z as one array, (n, 3) float64."""
    return np.stack([np.asarray(values[axis], np.float64) for axis in AXES], axis=1)


def in_metres(source: Source) -> Source:
    """Return a source with x, y, z in metres, by the unit of its coordinate system."""
    units = units_of_system(source.facts.crs_wkt)
    if (
        units is None
        or units.is_geographic
        or units.is_metric
        or not set(AXES) <= set(source.dimensions)
    ):
        return source
    scales = dict(zip(AXES, (units.xy_m, units.xy_m, units.z_m), strict=True))
    heights = "" if units.z_m == units.xy_m else f", heights of {units.z_m:g} m"
    unit = f"{units.unit} of {units.xy_m:.6g} m{heights} ({units.name})"
    note = f"x, y, z are in {unit}: converted to metres"

    def chunks(names: tuple[str, ...], stored: Source) -> Iterator[RecordChunk]:
        for chunk in stored.chunks(names):
            scaled = {name: chunk.values[name] * scales[name] for name in AXES if name in names}
            yield replace(chunk, values={**chunk.values, **scaled})

    def facts_of(facts: SourceFacts) -> SourceFacts:
        return replace(facts, notes=(*facts.notes, note))

    return filtered(source, chunks, facts_of=facts_of)
