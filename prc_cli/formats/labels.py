"""Class codes in record order: read from any file with codes, and written as label files."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import ASPRS_NAMES, NO_CODE, ClassCodes
from prc_cli.core.errors import ConfigError, InputError, OutputError
from prc_cli.core.files import open_to_read, suffix_of
from prc_cli.formats.records import CodeSource, nearest_first
from prc_cli.formats.registry import Format, by_suffix
from prc_cli.formats.writing.base import Columns, ScatterWriter
from prc_cli.formats.writing.columns import LabelOutput, Values, asked_columns
from prc_cli.formats.writing.disk import npy_header
from prc_cli.formats.writing.record import RunRecord

KITTI_SUFFIX = ".label"
FORMATS = (
    Format(
        name="SemanticKITTI labels",
        codes=(KITTI_SUFFIX,),
        open_codes="prc_cli.formats.labels:open_semantic_codes",
    ),
)


NAMES = ("class", "label", "classification", "class_code")
"""Usual names of class codes, in any case; the first one present is used."""
CODES_AT_ONCE = 1 << 20
"""Codes read at a time."""

_BY_HAND = re.compile(rb"# labels by hand: .*?(?:, (\d+) records)?\s*$")
_HEAD_BYTES = 4096
LABEL_BYTES = 4
"""Bytes of a SemanticKITTI label."""
SEMANTIC_BITS = 0xFFFF
"""Its bits that hold the class."""


def open_codes(path: Path, dimension: str | None = None) -> CodeSource:
    """Open the class codes of a file."""
    suffix = suffix_of(path)
    known = by_suffix("codes")
    if suffix not in known:
        problem = f"unknown suffix {suffix!r}" if suffix else "no suffix"
        raise InputError(
            str(path),
            f"{problem}, expected one of: {' '.join(known)}",
            "rename the file or convert it",
        )
    if not path.is_file():
        raise InputError(str(path), "no such file, expected class codes", "check the name")
    return known[suffix].code_source(path, dimension)


def labelled_records(path: Path) -> int | None:
    """Return the number of records of the file that labels by hand are about, by their first line.

    It is ``# labels by hand: drive.laz, 1000 records``. 0 = not known, None = no labels by hand.
    """
    if suffix_of(path) != ".csv":
        return None
    with open_to_read(path) as handle:
        head = handle.readline(_HEAD_BYTES)
    known = _BY_HAND.match(head)
    return int(known[1] or 0) if known else None


def code_suffix_of(path: Path) -> str:
    """Return the suffix of a file of class codes, compression included; empty for other files.

    >>> code_suffix_of(Path("drive.1.csv.gz"))
    '.csv.gz'
    >>> code_suffix_of(Path("labels.npy.prc.json"))
    ''
    """
    suffix = suffix_of(path)
    return suffix if suffix in by_suffix("codes") else ""


def dimension_of_codes(path: Path, names: list[str], dimension: str | None) -> str:
    """Return the dimension of class codes: the given one, a usual one, or the only one."""
    shown = ", ".join(names[:40])
    if dimension is not None:
        if dimension not in names:
            shown = ", ".join(nearest_first(names, dimension)[:40])
            raise ConfigError(
                str(path), f"no dimension {dimension!r} in the file", f"it has: {shown}"
            )
        return dimension
    lowered = {name.lower(): name for name in reversed(names)}
    for name in NAMES:
        if name in lowered:
            return lowered[name]
    if len(names) == 1:
        return names[0]
    problem = f"none of {', '.join(NAMES)} in the file, which has: {shown or 'nothing'}"
    raise InputError(str(path), problem, "name the dimension that holds the class codes")


CODES_BY_NAME = {
    name: code for names in (ASPRS_NAMES, ClassCodes().names()) for code, name in names.items()
}
"""Names of this program, else of ASPRS."""
_NUMBERED = "class "
"""Prefix of the names that this program writes for other codes."""


def code_of_name(where: str, name: str) -> int:
    """Return the class code of a name or number in a cell; -1 where it is empty.

    >>> [code_of_name("a.csv", name) for name in ("Ground", "low vegetation", "class 40")]
    [2, 3, 40]
    """
    text = name.strip(' \t"').lower().replace("_", " ")
    number = text.removeprefix(_NUMBERED)
    if not text:
        return NO_CODE
    if number.isdecimal():
        return int(number)
    if text not in CODES_BY_NAME:
        known = ", ".join(CODES_BY_NAME)
        problem = f"found the class name {name.strip()!r}, expected a class code or one of: {known}"
        raise InputError(where, problem, "write one of these names, or class codes and a --mapping")
    return CODES_BY_NAME[text]


def open_record_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open a dimension of a file of records: a text, a cloud."""
    source = by_suffix("scans")[suffix_of(path)].open_records(path, None)
    name = dimension_of_codes(path, list(source.dimensions), dimension)
    # label files of this program have record numbers
    numbered = {"record", "class", "name"} <= set(source.dimensions)

    def read() -> Iterator[NDArray[Any]]:
        for chunk in source.chunks((name, "record") if numbered else (name,)):
            if numbered:
                # rows are matched by their order: moved or missing ones are refused
                expected = chunk.first_record + np.arange(chunk.n)
                record = np.asarray(chunk.values["record"], np.float64)
                if (record != expected).any():
                    row = int(np.argmax(record != expected))
                    problem = (
                        f"row {expected[row]} is record {record[row]:g}, expected {expected[row]}"
                    )
                    raise InputError(str(path), problem, "sort the rows by record, all of them")
            yield chunk.values[name]

    return CodeSource(path, source.n_records, read, missing=True, name=name)


def open_las_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open a dimension of a LAS or LAZ file, ``classification`` by default."""
    return open_record_codes(path, dimension or "classification")


def open_semantic_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open the labels of SemanticKITTI.

    Little-endian uint32, class in the low 16 bits, instance in the high ones.
    """
    if dimension is not None:
        raise ConfigError(str(path), f"no dimension {dimension!r} in a .label file", "leave it out")
    with open_to_read(path) as handle:
        size = handle.seek(0, 2)
    if not size or size % LABEL_BYTES:
        problem = f"found {size} bytes, expected {LABEL_BYTES} a record"
        raise InputError(str(path), problem, "copy it from the archive again")

    def read() -> Iterator[NDArray[Any]]:
        with open_to_read(path) as handle:
            left = size // LABEL_BYTES
            while left:
                labels = np.fromfile(handle, "<u4", min(left, CODES_AT_ONCE))
                if not len(labels):
                    problem = f"the file ends {left} records early"
                    raise InputError(str(path), problem, "it was cut while being read; run again")
                left -= len(labels)
                yield (labels & SEMANTIC_BITS).astype(np.uint16)

    return CodeSource(path, size // LABEL_BYTES, read)


class LabelFileWriter(ScatterWriter):
    """Writer of class codes by record; a missing shot has code 0.

    ``.npy`` holds (n_records,) uint8 codes; ``.csv`` and ``.parquet`` the columns ``record``
    (int64), ``class`` (uint8 code), ``name`` and, if asked for, ``segment`` (uint32), ``surface``
    and ``dense_vegetation`` (uint8) and ``ground_height`` (float32, ``nan`` = unknown).
    """

    def __init__(self, labels: LabelOutput) -> None:
        self._kind = labels.path.suffix.lower()
        asked = asked_columns(labels.options)
        written = [
            column for column in asked if column.heading is not None and self._kind != ".npy"
        ]
        super().__init__(labels, written, labels.n_records)
        for column in asked:
            if column.heading is None:
                self._notice(
                    f"label files hold no {column.what}s; "
                    f"[output] {column.option} needs .las or .laz"
                )
            elif column not in written:
                needs = f"{column.what}s need .csv, .parquet, .las or .laz"
                self._notice(f"a .npy output holds class codes only; {needs}")

    def _write(self, record: RunRecord) -> RunRecord:
        total = self._total(record)
        columns = self._counted(total)
        if self._kind == ".npy":
            self._write_npy(columns, total)
        elif self._kind == ".csv":
            self._write_csv(columns)
        else:
            self._write_parquet(columns)
        return self._completed(record)

    def _counted(self, total: int) -> Iterator[Columns]:
        for item in self._columns(total):
            self._count(item.codes)
            yield item

    def _write_npy(self, columns: Iterator[Columns], total: int) -> None:
        with self._temporary.open("wb") as handle:
            handle.write(npy_header("|u1", (total,)))
            for item in columns:
                handle.write(item.codes.data)

    def _write_csv(self, columns: Iterator[Columns]) -> None:
        # text after the record number, by code, so that the loop only joins strings
        tails = [f"{code},{_cell(self._name(code))}" for code in range(256)]
        with self._temporary.open("w", encoding="utf-8", newline="") as handle:
            headings = [column.heading or column.name for column in self._optional]
            handle.write(",".join(["record", "class", "name", *headings]) + "\n")
            for item in columns:
                numbers = item.record.tolist()
                ends: Any = [tails[code] for code in item.codes.tolist()]
                for column in self._optional:
                    texts = _texts(item.values[column.name])
                    ends = [f"{end},{text}" for end, text in zip(ends, texts, strict=True)]
                handle.writelines(
                    f"{number},{end}\n" for number, end in zip(numbers, ends, strict=True)
                )

    def _write_parquet(self, columns: Iterator[Columns]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        names = pa.array([self._name(code) for code in range(256)])
        fields = [
            ("record", pa.int64()),
            ("class", pa.uint8()),
            ("name", pa.dictionary(pa.uint8(), pa.string())),
        ]
        fields += [
            (column.heading or column.name, pa.from_numpy_dtype(column.dtype))
            for column in self._optional
        ]
        schema = pa.schema(fields)
        try:
            # write to our own file object, so that a failed write shows the error of the system
            with self._temporary.open("wb") as handle, pq.ParquetWriter(handle, schema) as writer:
                for item in columns:
                    codes = pa.array(item.codes)
                    table = [
                        pa.array(item.record),
                        codes,
                        pa.DictionaryArray.from_arrays(codes, names),
                    ]
                    table += [pa.array(item.values[column.name]) for column in self._optional]
                    writer.write_table(pa.Table.from_arrays(table, schema=schema))
        except pa.ArrowException as error:
            raise OutputError(
                str(self.path), f"cannot be written as Parquet ({error})", "try .csv or .npy"
            ) from error

    def _name(self, code: int) -> str:
        return self._names.get(code, f"class {code}")


def _texts(values: Values) -> list[Any]:
    """Return whole numbers, or the shortest text that gives the same float32 again."""
    if values.dtype.kind != "f":
        return list(values.tolist())
    different, index = np.unique(
        values, return_inverse=True
    )  # all shots of a line share one height
    return list(different.astype(str).astype(object)[index].tolist())


def _cell(text: str) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([text])
    return line.getvalue()
