"""Maps columns of a text file to dimensions, by the fields of the layout or the names in the header."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.formats.layout import FACTORS, UNITS
from prc_cli.formats.options import Layout, LayoutField
from prc_cli.formats.records import STANDARD_NAMES, standard_first
from prc_cli.formats.text.dialect import TextFormat, shorten

_XYZ = ("x", "y", "z")
ALIASES: dict[str, tuple[str, ...]] = {
    "range": ("range", "range_m", "distance", "r"),
    "scan_line": ("scan_line", "scanline", "line"),
    "column": ("column", "col"),
    "angle": ("angle", "angle_deg", "angle_rad"),
    "time": ("time", "time_s", "gps_time", "t"),
}
"""Header names of the standard dimensions, in any case; the first one present is used."""
CLOUD_SUFFIXES = (".xyz", ".asc", ".pts")
"""Files whose first columns are x, y, z where they have no names."""
_UNIT = re.compile(r"(?P<name>.+?) ?(?:_|\(|\[| ) ?(?P<unit>mm|cm|m|ft|s|ms|us|ns|rad|deg|gon) ?[)\]]?")
"""A name with a unit behind it: ``range_mm``, ``angle [gon]``, ``x (ft)``; runs of blanks are one blank by then, as
many of them would take hours."""


@dataclass(frozen=True, slots=True)
class TextColumn:
    """Column of a dimension and the decoding of its cells."""

    index: int
    """Column number from 0."""
    label: str
    """Name of the column in messages."""
    item: LayoutField
    """Scale, offset, missing value and unit."""


def find_columns(path: Path, text: TextFormat, layout: Layout | None) -> dict[str, TextColumn]:
    """Return the dimensions of a text file, standard names first.

    Fields of the layout decide; without fields, known names in the header become standard names. All other columns keep
    their name, or their number if they have none. A single column without a name is the range.

    Raises
    ------
    InputError
        When the column of a field is not in the file, or its name is in the header twice.
    """
    fields = () if layout is None else layout.fields
    found: dict[str, TextColumn] = {}
    for position, item in enumerate(fields):
        index, name = _find_source(path, text, item, position)
        found[item.name] = TextColumn(index, _label(text, index), _with_unit(item, name))
    if not fields:
        found.update(_by_alias(path, text))
    if not fields and not any(text.names) and path.suffix.lower() in CLOUD_SUFFIXES and text.n_columns >= len(_XYZ):
        known = (*_XYZ, *(("intensity",) if path.suffix.lower() == ".pts" and text.n_columns > len(_XYZ) else ()))
        found.update({name: TextColumn(at, _label(text, at), LayoutField(name=name)) for at, name in enumerate(known)})
    if not fields and text.header_line is None and text.n_columns == 1:
        found["range"] = TextColumn(0, "range", LayoutField(name="range"))
    taken = {column.index for column in found.values()}
    for index, name in enumerate(text.names):
        own = name or str(index)
        if index not in taken and own not in found:
            found[own] = TextColumn(index, _label(text, index), LayoutField(name=own))
    return {name: found[name] for name in standard_first(found)}


def _with_unit(item: LayoutField, name: str) -> LayoutField:
    """Return a field with the unit from the name of its column, if the layout gives none."""
    found = _UNIT.fullmatch(" ".join(name.lower().split()))
    unit = None if found is None else found["unit"]
    if item.unit or item.scale != 1.0 or unit is None or unit not in UNITS.get(item.name, ()):
        return item
    # the usual units need not be named
    return (
        item
        if (FACTORS[unit] == 1.0 and item.name != "angle") or unit == "deg"
        else item.model_copy(update={"unit": unit})
    )


def _plain_name(name: str) -> str:
    """Return a name in lower case without the unit behind it.

    >>> _plain_name("Range [mm]"), _plain_name("angle_gon"), _plain_name("scan_line")
    ('range', 'angle', 'scan_line')
    """
    found = _UNIT.fullmatch(" ".join(name.lower().split()))
    return name.strip().lower() if found is None else found["name"]


def _by_alias(path: Path, text: TextFormat) -> dict[str, TextColumn]:
    lowered = [name.lower() for name in text.names]
    plain = [_plain_name(name) for name in text.names]
    found = {}
    for standard in STANDARD_NAMES:
        known = standard in UNITS
        for alias in ALIASES.get(standard, (standard,)):
            names = lowered if alias in lowered or not known else plain
            if alias in names and not (alias == "r" and {"g", "b"} <= set(lowered)):
                index = names.index(alias)
                _check_once(path, text, text.names[index])
                item = _with_unit(LayoutField(name=standard), text.names[index])
                found[standard] = TextColumn(index, _label(text, index), item)
                break
    return found


def _find_source(path: Path, text: TextFormat, item: LayoutField, position: int) -> tuple[int, str]:
    """Return number and name of the column that a field is read from."""
    source = item.source
    if not any(text.names):
        if isinstance(source, str) and not source.isdecimal():
            problem = f"no header row, so no column {source!r} for field {item.name!r}"
            hint = "give the column's number from 0 as source"
            raise InputError(str(path), problem, hint)
        # without names, fields are columns in order
        source = position if source is None else int(source)
    if isinstance(source, int):
        if not 0 <= source < text.n_columns:
            problem = f"no column {source} for field {item.name!r}, expected 0 to {text.n_columns - 1}"
            raise InputError(str(path), problem, f"line {text.first_row} has {text.n_columns} cells{_other(text)}")
        return source, text.names[source]
    wanted = (source,) if source is not None else ALIASES.get(item.name, (item.name,))
    lowered = [name.lower() for name in text.names]
    for name in wanted:
        if name in text.names or name.lower() in lowered:
            index = text.names.index(name) if name in text.names else lowered.index(name.lower())
            _check_once(path, text, text.names[index])
            return index, text.names[index]
    shown = ", ".join(shorten(name) for name in text.names[:20]) + (" ..." if text.n_columns > 20 else "")
    problem = f"no column {wanted[0]!r} for field {item.name!r}, the header in line {text.header_line} has: {shown}"
    raise InputError(str(path), problem, f"name the column as its source in [[layout.fields]]{_other(text)}")


def _other(text: TextFormat) -> str:
    """Return a hint about the delimiter where rows have a single cell."""
    return f"; is {text.delimiter!r} the delimiter?" if text.n_columns == 1 else ""


def _check_once(path: Path, text: TextFormat, name: str) -> None:
    if text.names.count(name) > 1:
        places = [index for index, other in enumerate(text.names) if other == name]
        problem = f"the name {name!r} stands in columns {places[0]} and {places[1]}, expected once"
        hint = "rename one, or give the column's number from 0 as source in [[layout.fields]]"
        raise InputError(f"{path}: line {text.header_line}", problem, hint)


def _label(text: TextFormat, index: int) -> str:
    return repr(shorten(text.names[index])) if text.names[index] else f"{index} (from 0)"
