"""``prc info --draft``: a layout or configuration that reads a file, to begin with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import ValidationError

from prc_cli.config import LoadedConfig
from prc_cli.core.errors import InputError
from prc_cli.core.files import atomic_output, prepare_outputs
from prc_cli.formats import check_input, open_source
from prc_cli.formats.clouds.source import CloudSource
from prc_cli.formats.guessing import MOST_HEADER_BYTES, guess_names, guess_records, range_scale
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import STANDARD_NAMES
from prc_cli.formats.registry import is_dump
from prc_cli.formats.text.read import TextSource
from prc_cli.jobs.info import Inspection, inspect

_ROWS = 1 << 16
_KEPT = ("lines", "columns", "range")
_KEYS = {"scale", "missing"}


def draft(
    path: Path,
    output: Path,
    loaded: LoadedConfig,
    *,
    overwrite: bool = False,
) -> str:
    """Write a configuration with what a file says of itself, and what its numbers show."""
    prepare_outputs(output, overwrite=overwrite, inputs=(path, *loaded.files))
    lines, layout = _layout_lines(path, loaded)
    told = loaded if layout is None else _with_layout(loaded, layout)
    inspection = inspect(path, told)
    header = None if layout is None else _empty_header(path, layout, inspection)
    if layout is not None and header is not None:
        lines = [
            line.replace(f"header_bytes = {layout.header_bytes}", f"header_bytes = {header}")
            for line in lines
        ]
        inspection = inspect(
            path, _with_layout(loaded, layout.model_copy(update={"header_bytes": header}))
        )
    text = "\n".join(
        [f"# drafted from {path.name} by prc info --draft: look at it before you rely on it", ""]
    )
    text += "\n".join([*_input_lines(inspection), *lines, ""])
    with atomic_output(output, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return text


def _empty_header(path: Path, layout: Layout, found: Inspection) -> int | None:
    """Return the bytes of a header of zeros, which look like missing shots.

    As many as are too many for whole lines.
    """
    m = None if found.period is None else found.period.points_per_line
    each = sum(np.dtype(field.type).itemsize for field in layout.fields)
    if not is_dump(path) or not m or not each:
        return None
    surplus = (path.stat().st_size - layout.header_bytes) // each % m
    header = layout.header_bytes + surplus * each
    if not surplus or header > MOST_HEADER_BYTES:
        return None
    with path.open("rb") as handle:
        return None if any(handle.read(header)) else header


def _with_layout(loaded: LoadedConfig, layout: Layout) -> LoadedConfig:
    config = loaded.config.model_copy(update={"layout": layout})
    return LoadedConfig(config, sources=loaded.sources, files=loaded.files, notes=loaded.notes)


def _input_lines(found: Inspection) -> list[str]:
    """Return the table ``[input]``: what was taken, what was measured, and what is missing."""
    lines = ["[input]"]
    taken = [
        (item.key.removeprefix("input."), item.value, item.why)
        for item in found.assumptions
        if not found.missing
    ]
    lines += [
        f"{key} = {_quoted(value)}  # {why}"
        for key, value, why in taken
        if key in _KEPT and _is_valid(key, value)
    ]
    for option in found.missing:
        flag, _, value = option.partition(" ")
        if flag == "--set":
            key, _, value = value.removeprefix("input.").partition("=")
            lines.append(f"{key} = {value}  # measured from the times")
        elif value.endswith("FILE"):
            lines.append(
                f"# {flag.removeprefix('--')} = {_quoted(value)}  # the positions of the scanner over time"
            )
        else:
            lines.append(f"{flag.removeprefix('--')} = {_quoted(value)}  # measured from the times")
    period = found.period
    if (
        found.points_per_line is None
        and not found.missing
        and period is not None
        and period.points_per_line
    ):
        lines.append(f"points_per_line = {period.points_per_line}  # {period.reason}")
    elif found.problem and not found.missing:
        lines += [f"# {found.problem}", f"# {found.hint}"]
    return [line.replace("\n", " ") for line in lines]


def _is_valid(key: str, value: str) -> bool:
    try:
        InputConfig.model_validate({key: value})
    except ValidationError:
        return False
    return True


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(one if one.isprintable() else "?" for one in escaped) + '"'


def _layout_lines(path: Path, loaded: LoadedConfig) -> tuple[list[str], Layout | None]:
    """Return the table ``[layout]`` of a dump, a text file or a cloud; none for other files."""
    if loaded.config.layout is not None and loaded.config.layout.fields:
        return [], None
    check_input(path)
    # before it is opened: the usual dump is one of float32
    if is_dump(path) and not path.name.startswith("pulse-"):
        return _dump_lines(path)
    source = open_source(path, loaded.config.layout)
    if isinstance(source, TextSource):
        return _text_lines(source)
    if isinstance(source, CloudSource):
        rows = [
            _field_line(
                {"name": name, "source": one.name}
                | one.item.model_dump(include={"unit", "offset"}, exclude_defaults=True)
            )
            for name, one in source.columns.items()
            if name in (*STANDARD_NAMES, "ring")
        ]
        return ["", "[layout]", "fields = [", *rows, "]"], None
    return [], None


def _dump_lines(path: Path) -> tuple[list[str], Layout | None]:
    found = guess_records(path)
    if found is None:
        problem = "nothing repeats in its bytes, expected records of one size"
        raise InputError(
            str(path), problem, "write the layout by hand: docs, Input formats, Raw binary"
        )
    rows = [
        _field_line(
            {"name": field.name, "type": field.type}
            | field.model_dump(include=_KEYS, exclude_defaults=True)
        )
        for field in found.fields
    ]
    header = [
        "",
        "[layout]",
        f"header_bytes = {found.header_bytes}",
        f'endian = "{found.endian}"',
        "fields = [",
    ]
    return [*header, *rows, "]"], found


def _field_line(values: dict[str, object]) -> str:
    shown = (
        f"{key} = {_quoted(value) if isinstance(value, str) else repr(value)}"
        for key, value in values.items()
    )
    return f"    {{ {', '.join(shown)} }},"


def _text_lines(source: TextSource) -> tuple[list[str], Layout | None]:
    """Return the columns that are known by name, and those that show what they are."""
    told = source.describe()
    first = next(iter(source.chunks(source.dimensions)), None)
    columns = (
        {}
        if first is None
        else {name: np.asarray(values[:_ROWS]) for name, values in first.values.items()}
    )
    known = [
        (name, int(one.key), one.item.unit)
        for name, one in source.columns.items()
        if name in STANDARD_NAMES
    ]
    taken = {name for name, *_ in known}
    shown = {name: values for name, values in columns.items() if name not in taken}
    fields: list[dict[str, object]] = [
        {"name": name, "source": at, **({"unit": unit} if unit else {})} for name, at, unit in known
    ]
    for column, name in guess_names(shown).items():
        if name in taken:
            continue
        guessed: dict[str, object] = {"name": name, "source": int(source.columns[column].key)}
        if name == "range":
            stored = shown[column][
                np.isfinite(shown[column])
            ]  # what is no number is missing by itself
            scale, missing = range_scale(
                stored.astype(np.int64) if np.all(stored % 1 == 0) else stored
            )
            guessed |= ({"scale": scale} if scale != 1 else {}) | (
                {} if missing is None else {"missing": missing}
            )
        fields.append(guessed)
    has_header = told["header_line"] is not None and any(told["columns"])
    values = {
        "delimiter": told["delimiter"],
        "decimal": told["decimal"],
        "header": has_header,
        "fields": tuple(fields),
    }
    delimiter = '"\\t"' if told["delimiter"] == "\t" else _quoted(str(told["delimiter"]))
    lines = ["", "[layout]", f"delimiter = {delimiter}", f'decimal = "{told["decimal"]}"']
    lines += [
        f"header = {str(has_header).lower()}",
        "fields = [",
        *(_field_line(one) for one in fields),
        "]",
    ]
    return lines, Layout.model_validate(values) if fields else None
