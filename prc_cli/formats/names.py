"""Usual names of what a scanner measures: one table for text, clouds, LAS extra bytes, columns and arrays."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from prc_cli.core.facts import KnownRule
from prc_cli.formats.options import FACTORS, UNITS
from prc_cli.formats.records import STANDARD_NAMES

NAMES: dict[str, tuple[str, ...]] = {
    "range": ("range", "distance", "r"),
    "scan_line": ("scan_line", "scanline", "line"),
    "column": ("column", "col"),
    "angle": ("angle", "scan_angle", "theta", "zenith", "azimuth"),
    "time": ("gps_time", "gpstime", "time", "timestamp", "t", "offset_ns"),
    "intensity": ("intensity", "amplitude"),
    "return_number": ("return_number", "num_echo"),
    "number_of_returns": ("number_of_returns", "num_returns", "nb_of_echo"),
    "ring": ("ring", "laser_id", "laser_number"),
}
"""Names of the standard dimensions, the first one present is used: in any case, with or without ``scalar_`` before and
a unit behind (``range_m``, ``angle_gon``, ``time [us]``)."""
_BESIDE_RANGE = ("theta", "zenith", "azimuth")
"""Directions of a shot where its range is there; else of anything."""
_UNIT = re.compile(r"(?P<name>.+?) ?(?:_|\(|\[| ) ?(?P<unit>mm|cm|m|ft|s|ms|us|ns|rad|deg|gon) ?[)\]]?")
"""A name with a unit behind it: ``range_mm``, ``angle [gon]``, ``x (ft)``; runs of blanks are one blank by then, as
many of them would take hours."""
ZENITH = "zenith"
"""Angles from straight up: straight down is 180 degrees."""


@dataclass(frozen=True, slots=True)
class Usual:
    """A dimension by a usual name."""

    name: str
    """As it is called in the file."""
    index: int
    """Its number among the names given."""
    unit: str
    """Empty where it is the usual one."""


def split_unit(name: str) -> tuple[str, str]:
    """Return a name in lower case without the unit behind it, and the unit.

    >>> split_unit("Range [mm]"), split_unit("scalar_angle_gon"), split_unit("scan_line")
    (('range', 'mm'), ('angle', 'gon'), ('scan_line', ''))
    """
    plain = " ".join(name.lower().split()).removeprefix("scalar_")
    found = _UNIT.fullmatch(plain)
    return (plain, "") if found is None else (found["name"], found["unit"])


def unit_of(standard: str, name: str) -> str:
    """Return the unit that a name tells of a standard dimension; empty for the usual one.

    >>> unit_of("range", "range_mm"), unit_of("angle", "angle_deg"), unit_of("angle", "theta")
    ('mm', '', 'rad')
    """
    plain, unit = split_unit(name)
    if standard == "angle" and plain == "theta" and not unit:
        return "rad"
    if unit not in UNITS.get(standard, ()):
        return ""
    is_usual = (FACTORS.get(unit) == 1.0 and standard != "angle") or unit == "deg"
    return "" if is_usual else unit


def usual_names(names: Sequence[str]) -> dict[str, Usual]:
    """Map standard dimensions to names, as far as these are usual ones; the first of equal names is used.

    >>> found = usual_names(["theta", "Range [mm]", "line"])
    >>> [(standard, one.name, one.unit) for standard, one in found.items()]
    [('range', 'Range [mm]', 'mm'), ('scan_line', 'line', ''), ('angle', 'theta', 'rad')]
    """
    lowered = [name.strip().lower().removeprefix("scalar_") for name in names]
    plain = [split_unit(name)[0] for name in names]
    found: dict[str, Usual] = {}
    for standard in (*STANDARD_NAMES, "ring"):
        for alias in NAMES.get(standard, (standard,)):
            if (alias in _BESIDE_RANGE and "range" not in found) or (alias == "r" and {"g", "b"} <= set(lowered)):
                continue
            known = lowered if alias in lowered or standard not in UNITS else plain
            if alias in known:
                index = known.index(alias)
                found[standard] = Usual(names[index], index, unit_of(standard, names[index]))
                break
    return found


def angle_rules(name: str | None) -> tuple[KnownRule, ...]:
    """Return what the name of the angles says of straight down."""
    if name is None or split_unit(name)[0] != ZENITH:
        return ()
    return (KnownRule("nadir", "180", f"{name!r} counts from straight up"),)
