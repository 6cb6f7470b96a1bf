"""``prc info --draft``: a first layout or configuration that reads a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import ValidationError

from prc_cli.config import LoadedConfig
from prc_cli.core.errors import InputError
from prc_cli.core.files import atomic_output, prepare_outputs
from prc_cli.formats.clouds.source import CloudSource
from prc_cli.formats.guessing import MOST_HEADER_BYTES, guess_names, guess_records, range_scale
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import STANDARD_NAMES
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
    """Write a configuration from the header of a file, and from its numbers.

    Returns
    -------
    str
        The text of the configuration.
    """
    prepare_outputs(output, overwrite=overwrite, inputs=(path, *loaded.files))
    scan = Input.of(path, loaded.config.layout)
    lines, layout = _layout_lines(scan, loaded)
    described = loaded if layout is None else _with_layout(loaded, layout)
    inspection = inspect(path, described)
    header = None if layout is None else _empty_header(scan, layout, inspection)
    if layout is not None and header is not None:
        lines = [
            line.replace(f"header_bytes = {layout.header_bytes}", f"header_bytes = {header}")
            for line in lines
        ]
        inspection = inspect(
            path, _with_layout(loaded, layout.model_copy(update={"header_bytes": header}))
        )
    text = "\n".join(
        [f"# draft from {path.name} by prc info --draft: check it before you use it", ""]
    )
    text += "\n".join([*_input_lines(inspection), *lines, ""])
    with atomic_output(output, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return text


def _empty_header(scan: Input, layout: Layout, inspection: Inspection) -> int | None:
    """Return the length of a header of zeros [bytes]: the surplus over whole lines."""
    m = None if inspection.period is None else inspection.period.points_per_line
    record_bytes = sum(np.dtype(field.type).itemsize for field in layout.fields)
    if not scan.is_dump or not m or not record_bytes:
        return None
    surplus = (scan.path.stat().st_size - layout.header_bytes) // record_bytes % m
    header = layout.header_bytes + surplus * record_bytes
    if not surplus or header > MOST_HEADER_BYTES:
        return None
    with scan.path.open("rb") as handle:
        return None if any(handle.read(header)) else header


def _with_layout(loaded: LoadedConfig, layout: Layout) -> LoadedConfig:
    config = loaded.config.model_copy(update={"layout": layout})
    return LoadedConfig(config, sources=loaded.sources, files=loaded.files, notes=loaded.notes)


def _input_lines(inspection: Inspection) -> list[str]:
    """Return the table ``[input]``: assumptions, measured values, and what is missing."""
    lines = ["[input]"]
    for assumption in inspection.assumptions if not inspection.missing else ():
        key = assumption.key.removeprefix("input.")
        if key in _KEPT and _is_valid(key, assumption.value):
            lines.append(f"{key} = {_quoted(assumption.value)}  # {assumption.why}")
    for option in inspection.missing:
        flag, _, value = option.partition(" ")
        if flag == "--set":
            key, _, value = value.removeprefix("input.").partition("=")
            lines.append(f"{key} = {value}  # measured from the times")
        elif value.endswith("FILE"):
            lines.append(
                f"# {flag.removeprefix('--')} = {_quoted(value)}  # the positions of the scanner "
                "over time"
            )
        else:
            lines.append(f"{flag.removeprefix('--')} = {_quoted(value)}  # measured from the times")
    period = inspection.period
    if (
        inspection.points_per_line is None
        and not inspection.missing
        and period is not None
        and period.points_per_line
    ):
        lines.append(f"points_per_line = {period.points_per_line}  # {period.reason}")
    elif inspection.problem and not inspection.missing:
        lines += [f"# {inspection.problem}", f"# {inspection.hint}"]
    return [line.replace("\n", " ") for line in lines]


def _is_valid(key: str, value: str) -> bool:
    try:
        InputConfig.model_validate({key: value})
    except ValidationError:
        return False
    return True


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return (
        '"' + "".join(character if character.isprintable() else "?" for character in escaped) + '"'
    )


def _layout_lines(scan: Input, loaded: LoadedConfig) -> tuple[list[str], Layout | None]:
    """Return the table ``[layout]`` of a dump, a text file or a cloud; empty for other files."""
    if loaded.config.layout is not None and loaded.config.layout.fields:
        return [], None
    scan.check()
    # without a layout a dump would be read as float32
    if scan.is_dump and not scan.name.startswith("pulse-"):
        return _dump_lines(scan.path)
    source = scan.records()
    if isinstance(source, TextSource):
        return _text_lines(source)
    if isinstance(source, CloudSource):
        rows = []
        for name, column in source.columns.items():
            if name in (*STANDARD_NAMES, "ring"):
                unit = column.item.model_dump(include={"unit", "offset"}, exclude_defaults=True)
                rows.append(_field_line({"name": name, "source": column.name} | unit))
        return ["", "[layout]", "fields = [", *rows, "]"], None
    return [], None


def _dump_lines(path: Path) -> tuple[list[str], Layout | None]:
    layout = guess_records(path)
    if layout is None:
        problem = "found no records of one size in its bytes"
        raise InputError(str(path), problem, "write a layout: see docs, Input formats, Raw binary")
    rows = []
    for field in layout.fields:
        values = field.model_dump(include=_KEYS, exclude_defaults=True)
        rows.append(_field_line({"name": field.name, "type": field.type} | values))
    header = [
        "",
        "[layout]",
        f"header_bytes = {layout.header_bytes}",
        f'endian = "{layout.endian}"',
        "fields = [",
    ]
    return [*header, *rows, "]"], layout


def _field_line(values: dict[str, object]) -> str:
    shown = (
        f"{key} = {_quoted(value) if isinstance(value, str) else repr(value)}"
        for key, value in values.items()
    )
    return f"    {{ {', '.join(shown)} }},"


def _text_lines(source: TextSource) -> tuple[list[str], Layout | None]:
    """Return the columns with known names, and columns whose numbers show what they are."""
    description = source.facts.header
    first = next(iter(source.chunks(source.dimensions)), None)
    columns = (
        {}
        if first is None
        else {name: np.asarray(values[:_ROWS]) for name, values in first.values.items()}
    )
    known = [
        (name, int(column.key), column.item.unit)
        for name, column in source.columns.items()
        if name in STANDARD_NAMES
    ]
    taken = {name for name, *_ in known}
    shown = {name: values for name, values in columns.items() if name not in taken}
    fields: list[dict[str, object]] = [
        {"name": name, "source": position, **({"unit": unit} if unit else {})}
        for name, position, unit in known
    ]
    for column, name in guess_names(shown).items():
        if name in taken:
            continue
        guessed: dict[str, object] = {"name": name, "source": int(source.columns[column].key)}
        if name == "range":
            # NaN needs no missing code
            stored = shown[column][np.isfinite(shown[column])]
            scale, missing = range_scale(
                stored.astype(np.int64) if np.all(stored % 1 == 0) else stored
            )
            guessed |= ({"scale": scale} if scale != 1 else {}) | (
                {} if missing is None else {"missing": missing}
            )
        fields.append(guessed)
    has_header = description["header_line"] is not None and any(description["columns"])
    values = {
        "delimiter": description["delimiter"],
        "decimal": description["decimal"],
        "header": has_header,
        "fields": tuple(fields),
    }
    delimiter = (
        '"\\t"' if description["delimiter"] == "\t" else _quoted(str(description["delimiter"]))
    )
    lines = ["", "[layout]", f"delimiter = {delimiter}", f'decimal = "{description["decimal"]}"']
    lines += [
        f"header = {str(has_header).lower()}",
        "fields = [",
        *(_field_line(field) for field in fields),
        "]",
    ]
    return lines, Layout.model_validate(values) if fields else None
