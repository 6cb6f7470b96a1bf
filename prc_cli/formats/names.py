"""Usual names of what a scanner measures.

One table for text, clouds, LAS extra bytes, columns and arrays.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from prc_cli.core.errors import InputError
from prc_cli.core.facts import KnownRule
from prc_cli.formats.options import FACTORS, UNITS, Layout, LayoutField, check_fields
from prc_cli.formats.records import STANDARD_NAMES, Column, listed

NAMES: dict[str, tuple[str, ...]] = {
    "range": ("range", "distance", "r", "slant_range", "slantrange", "slope_distance"),
    "scan_line": ("scan_line", "scanline", "line"),
    "column": ("column", "col"),
    "angle": (
        "angle",
        "scan_angle",
        "scanangle",
        "scan_angle_rank",
        "scananglerank",
        "theta",
        "zenith",
        "azimuth",
    ),
    "time": ("gps_time", "gpstime", "time", "timestamp", "t", "offset_ns"),
    "intensity": ("intensity", "amplitude"),
    "return_number": ("return_number", "num_echo"),
    "number_of_returns": ("number_of_returns", "num_returns", "nb_of_echo"),
    "ring": ("ring", "laser_id", "laser_number"),
    # VeloView
    **{
        axis: (axis, f"points:{number}", f"points_m_xyz:{number}")
        for number, axis in enumerate("xyz")
    },
}
"""Names of the standard dimensions; the first one present is used.

In any case, with or without ``scalar_`` before and a unit behind (``range_m``, ``time [us]``).
"""
_BESIDE_RANGE = ("theta", "zenith", "azimuth")
"""Names of scan angles only if there are ranges too."""
UNIT_WORDS = {
    **{unit: unit for unit in ("mm", "cm", "m", "ft", "s", "ms", "us", "ns", "rad", "deg", "gon")},
    "metre": "m",
    "metres": "m",
    "meter": "m",
    "meters": "m",
    "millimetres": "mm",
    "millimeters": "mm",
    "feet": "ft",
    "foot": "ft",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "radian": "rad",
    "radians": "rad",
    "grad": "gon",
    "second": "s",
    "seconds": "s",
    "sec": "s",
    "µs": "us",
    "μs": "us",
}
"""Units by the words that other programs write."""
_UNIT = re.compile(
    rf"(?P<name>.+?) ?(?:_|/|\(|\[| in | ) ?(?P<unit>{'|'.join(UNIT_WORDS)}) ?[)\]]?"
)
"""A name with a unit behind it: ``range_mm``, ``angle [gon]``, ``x (ft)``, ``range/m``.

Runs of blanks must be one blank: many of them would take hours.
"""
ZENITH = "zenith"
"""Angles from straight up: straight down is 180 degrees."""
_FROM_UP = (ZENITH, "zenith_angle", "polar", "polar_angle", "colatitude")
"""Vertical angles from straight up."""
_FROM_LEVEL = ("elevation", "elevation_angle", "altitude", "inclination")
"""Vertical angles from level, upwards: straight down is -90 degrees."""
_VERTICAL = ("vertical_angle", "vertical", "v")
"""Vertical angles from up or from level: the ranges decide."""
_HORIZONTAL = ("azimuth", "horizontal_angle", "horizontal", "hz", "phi", "az")


@dataclass(frozen=True, slots=True)
class Usual:
    """A column with a usual name of a standard dimension."""

    name: str
    """Name in the file."""
    index: int
    """Index among the names of the file."""
    unit: str
    """Unit; empty for the usual one."""


def split_unit(name: str) -> tuple[str, str]:
    """Return a name in lower case without the unit behind it, and the unit.

    >>> split_unit("Range [mm]"), split_unit("scalar_angle_gon"), split_unit("scan_line")
    (('range', 'mm'), ('angle', 'gon'), ('scan_line', ''))
    >>> split_unit("Range/m"), split_unit("angle in degrees"), split_unit("Line[-]")
    (('range', 'm'), ('angle', 'deg'), ('line', ''))
    """
    plain = _lowered(name)
    match = _UNIT.fullmatch(plain)
    return (plain, "") if match is None else (match["name"], UNIT_WORDS[match["unit"]])


def _lowered(name: str) -> str:
    """Return a name in lower case, without empty brackets of a missing unit."""
    plain = " ".join(name.lower().split()).removeprefix("scalar_")
    return re.sub(r" ?(?:\[-*\]|\(-*\))$", "", plain)


def unit_of(standard: str, name: str) -> str:
    """Return the unit in the name of a standard dimension; empty for the usual one.

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
    """Map standard dimensions to columns with usual names; the first of equal names is used.

    >>> usual = usual_names(["theta", "Range [mm]", "line"])
    >>> [(standard, column.name, column.unit) for standard, column in usual.items()]
    [('range', 'Range [mm]', 'mm'), ('scan_line', 'line', ''), ('angle', 'theta', 'rad')]
    """
    lowered = [_lowered(name) for name in names]
    plain = [split_unit(name)[0] for name in names]
    usual: dict[str, Usual] = {}
    for standard in (*STANDARD_NAMES, "ring"):
        aliases = NAMES.get(standard, (standard,))
        if standard == "angle" and "range" in usual:
            # of two directions the vertical one turns within a line
            aliases = (*aliases[:5], *_vertical_names(plain), *aliases[5:])
        for alias in aliases:
            if (alias in _BESIDE_RANGE and "range" not in usual) or (
                alias == "r" and {"g", "b"} <= set(lowered)
            ):
                continue
            known = lowered if alias in lowered or standard not in UNITS else plain
            if alias in known:
                index = known.index(alias)
                usual[standard] = Usual(names[index], index, unit_of(standard, names[index]))
                break
    return usual


def is_horizontal(name: str) -> bool:
    """Return whether a column has the usual name of a horizontal angle.

    >>> is_horizontal("Azimuth"), is_horizontal("angle")
    (True, False)
    """
    return split_unit(name)[0] in _HORIZONTAL


def _vertical_names(plain: Sequence[str]) -> tuple[str, ...]:
    """Return the names of vertical angles beside a horizontal one; alone they may be heights."""
    by_word = {name.replace(" ", "_"): name for name in plain}
    if not by_word.keys() & set(_HORIZONTAL):
        return ()
    return tuple(by_word[word] for word in (*_FROM_UP, *_FROM_LEVEL, *_VERTICAL) if word in by_word)


def find_columns(
    where: str,
    names: Sequence[str],
    layout: Layout | None,
    keys: Sequence[str] = (),
    hint: str = "",
) -> dict[str, Column]:
    """Return the columns of a file by dimension.

    The fields of a layout name the dimensions. Without fields, usual names become standard
    dimensions. All other columns keep their name, or their number if they have none.

    Parameters
    ----------
    where
        File and line, for messages.
    names
        Names of the columns; empty strings without names.
    layout
        If no column has a name, fields without a source are the columns in order.
    keys
        Names of the columns in the body, by default ``names``.
    hint
        End of the hint of errors.

    Raises
    ------
    InputError
        If a field has no column, or several.
    """
    keys = keys or names
    columns: dict[str, Column] = {}
    if layout is not None and layout.fields:
        check_fields(layout)
        for position, item in enumerate(layout.fields):
            index = _find_source(where, names, item, position, hint)
            unit = "" if item.unit or item.scale != 1.0 else unit_of(item.name, names[index])
            with_unit = item.model_copy(update={"unit": unit}) if unit else item
            columns[item.name] = Column(keys[index], names[index], with_unit)
    else:
        for standard, usual in usual_names(names).items():
            _check_once(where, names, usual.name)
            item = LayoutField.model_validate({"name": standard, "unit": usual.unit})
            columns[standard] = Column(keys[usual.index], usual.name, item)
    used_keys = {column.key for column in columns.values()}
    for index, name in enumerate(names):
        dimension = name or str(index)
        if keys[index] not in used_keys and dimension not in columns:
            columns[dimension] = Column(keys[index], name, LayoutField(name=dimension))
    return columns


def _find_source(
    where: str,
    names: Sequence[str],
    item: LayoutField,
    position: int,
    hint: str,
) -> int:
    source = item.source
    if not any(names):
        if isinstance(source, str) and not source.isdecimal():
            problem = f"no header row, so no column {source!r} for field {item.name!r}"
            raise InputError(where, problem, "give the column's number from 0 as source")
        source = position if source is None else int(source)
    if isinstance(source, int):
        if not 0 <= source < len(names):
            problem = f"no column {source} for field {item.name!r}, expected 0 to {len(names) - 1}"
            raise InputError(where, problem, f"the file has {len(names)} columns{hint}")
        return source
    name = item.name if source is None else source
    plain = [column.lower().removeprefix("scalar_") for column in names]
    usual = usual_names(names).get(item.name) if source is None else None
    if name in names:
        index = list(names).index(name)
    elif name.lower() in plain:
        index = plain.index(name.lower())
    elif usual is not None:
        index = usual.index
    else:
        problem = f"no column {name!r} for field {item.name!r}, it has: {listed(names)}"
        raise InputError(
            where, problem, f"name the column as its source in [[layout.fields]]{hint}"
        )
    _check_once(where, names, names[index])
    return index


def _check_once(where: str, names: Sequence[str], name: str) -> None:
    places = [index for index, column in enumerate(names) if column == name]
    if len(places) > 1:
        problem = f"the name {name!r} is in columns {places[0]} and {places[1]}, expected once"
        hint = "rename one, or give the column's number from 0 as source in [[layout.fields]]"
        raise InputError(where, problem, hint)


def ring_rules() -> tuple[KnownRule, ...]:
    """Return the rules of points of a spinning scanner: a ring beside x, y, z."""
    return (
        KnownRule("lines", "rings", "the points have a ring, and x, y, z from the scanner"),
        KnownRule("range", "sensor-xyz", "rings turn around the origin of x, y, z"),
    )


def angle_rules(name: str | None) -> tuple[KnownRule, ...]:
    """Return the rule for straight down that the name of the angles implies.

    >>> angle_rules("zenith")[0].value, angle_rules("Elevation [deg]")[0].value
    ('180', '-90')
    >>> angle_rules("scan_angle")
    ()
    """
    word = "" if name is None else split_unit(name)[0].replace(" ", "_")
    if word in _FROM_UP:
        return (KnownRule("nadir", "180", f"{name!r} counts from straight up"),)
    if word in _FROM_LEVEL:
        return (KnownRule("nadir", "-90", f"{name!r} counts from level"),)
    return ()
