"""Maps columns of a text file to dimensions, by the fields of the layout or the names in the header."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.formats.names import unit_of, usual_names
from prc_cli.formats.options import Layout, LayoutField
from prc_cli.formats.records import STANDARD_NAMES, standard_first
from prc_cli.formats.text.dialect import TextFormat, shorten

_XYZ = ("x", "y", "z")
CLOUD_SUFFIXES = (".xyz", ".asc", ".pts")
"""Files whose first columns are x, y, z where they have no names."""


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
    """
    fields = () if layout is None else layout.fields
    found: dict[str, TextColumn] = {}
    for position, item in enumerate(fields):
        index, name = _find_source(path, text, item, position)
        found[item.name] = TextColumn(index, _label(text, index), _with_unit(item, name))
    if not fields:
        found.update(_by_usual_name(path, text))
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
    unit = "" if item.unit or item.scale != 1.0 else unit_of(item.name, name)
    return item.model_copy(update={"unit": unit}) if unit else item


def _by_usual_name(path: Path, text: TextFormat) -> dict[str, TextColumn]:
    found = {}
    for standard, usual in usual_names(text.names).items():
        if standard in STANDARD_NAMES:
            _check_once(path, text, usual.name)
            item = _with_unit(LayoutField(name=standard), usual.name)
            found[standard] = TextColumn(usual.index, _label(text, usual.index), item)
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
    name = item.name if source is None else source
    lowered = [one.lower() for one in text.names]
    usual = usual_names(text.names).get(item.name) if source is None else None
    index = None if usual is None else usual.index
    if name in text.names or name.lower() in lowered:
        index = text.names.index(name) if name in text.names else lowered.index(name.lower())
    if index is not None:
        _check_once(path, text, text.names[index])
        return index, text.names[index]
    shown = ", ".join(shorten(name) for name in text.names[:20]) + (" ..." if text.n_columns > 20 else "")
    problem = f"no column {name!r} for field {item.name!r}, the header in line {text.header_line} has: {shown}"
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
