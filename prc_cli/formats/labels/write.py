"""Labels alone: one entry per input record, in record order, as ``.npy``, ``.csv`` or ``.parquet``."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import OutputError
from prc_cli.core.stream import LabelledBlock
from prc_cli.core.types import I64
from prc_cli.formats.writing.base import (
    CHUNK_RECORDS,
    Columns,
    ScatterWriter,
    close_quietly,
)
from prc_cli.formats.writing.columns import Values, asked_columns
from prc_cli.formats.writing.options import LabelOutput, OutputConfig
from prc_cli.formats.writing.record import RunRecord
from prc_cli.formats.writing.straight import StraightCodes, npy_header


class LabelFileWriter(ScatterWriter):
    """Writer of class codes by record; a missing shot has code 0.

    ``.npy`` holds (n_records,) uint8 codes; ``.csv`` and ``.parquet`` the columns ``record`` (int64), ``class``
    (uint8 code), ``name`` and, if asked for, ``segment`` (uint32), ``surface`` and ``dense_vegetation`` (uint8) and
    ``ground_height`` (float32, ``nan`` = unknown).
    """

    def __init__(
        self, path: Path, codes: ClassCodes, options: OutputConfig, n_records: int | None, *, is_part: bool = False
    ) -> None:
        self._kind = path.suffix.lower()
        asked = asked_columns(options)
        held = [column for column in asked if column.heading is not None and self._kind != ".npy"]
        super().__init__(path, codes, options, held, n_records, is_part=is_part)
        self._straight: StraightCodes | None = None
        """The output, as long as codes arrive in record order."""
        for column in asked:
            if column.heading is None:
                self._notice(f"label files hold no {column.what}s; [output] {column.option} needs .las or .laz")
            elif column not in held:
                needs = f"{column.what}s need .csv, .parquet, .las or .laz"
                self._notice(f"a .npy output holds class codes only; {needs}")

    def _begin(self) -> None:
        super()._begin()
        if self._kind == ".npy" and not self._is_part:
            self._straight = StraightCodes(self._temporary)
            self._stack.callback(close_quietly, self._straight)

    def _add(self, block: LabelledBlock) -> None:
        scan = block.block
        straight = self._straight
        if straight is not None and scan.record is None and not len(scan.extra):
            first = scan.first_line * scan.points_per_line
            if first == straight.n and first + block.labels.size <= self._limit:
                straight.append(self._encode(block.labels, scan.range_m).ravel())
                return
        self._leave_straight()
        super()._add(block)

    def _leave_straight(self) -> None:
        """Switch to a spool, because records arrive out of order or with gaps."""
        if self._straight is None:
            return
        first = 0
        for codes in self._straight.chunks(CHUNK_RECORDS):
            self._code_spool.put_run(first, codes)
            first += len(codes)
        self._straight.close()
        self._straight = None

    def _write(self, record: RunRecord) -> RunRecord:
        if self._straight is not None and self._straight.n == (self._n_records or record.n_records):
            self._straight.finish()
            self._counts += self._straight.counts
            return self._completed(record)
        self._leave_straight()
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
            handle.write(",".join(["record", "class", "name", *self._headings()]) + "\n")
            for record, item in _numbered(columns):
                numbers = record.tolist()
                ends: Any = [tails[code] for code in item.codes.tolist()]
                for column in self._optional:
                    texts = _texts(item.values[column.name])
                    ends = [f"{end},{text}" for end, text in zip(ends, texts, strict=True)]
                handle.writelines(f"{number},{end}\n" for number, end in zip(numbers, ends, strict=True))

    def _write_parquet(self, columns: Iterator[Columns]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        names = pa.array([self._name(code) for code in range(256)])
        fields = [("record", pa.int64()), ("class", pa.uint8()), ("name", pa.dictionary(pa.uint8(), pa.string()))]
        types = [pa.from_numpy_dtype(column.dtype) for column in self._optional]
        fields += zip(self._headings(), types, strict=True)
        schema = pa.schema(fields)
        try:
            # write to our own file object, so that a failed write shows the error of the system
            with self._temporary.open("wb") as handle, pq.ParquetWriter(handle, schema) as writer:
                for record, item in _numbered(columns):
                    codes = pa.array(item.codes)
                    table = [
                        pa.array(record),
                        codes,
                        pa.DictionaryArray.from_arrays(codes, names),
                    ]
                    table += [pa.array(item.values[column.name]) for column in self._optional]
                    writer.write_table(pa.Table.from_arrays(table, schema=schema))
        except pa.ArrowException as error:
            raise OutputError(str(self.path), f"cannot be written as Parquet ({error})", "try .csv or .npy") from error

    def _headings(self) -> list[str]:
        return [column.heading or column.name for column in self._optional]

    def _name(self, code: int) -> str:
        return self._names.get(code, f"class {code}")


def _numbered(columns: Iterator[Columns]) -> Iterator[tuple[I64, Columns]]:
    """Give every chunk the indices of its records."""
    first = 0
    for item in columns:
        yield np.arange(first, first + len(item.codes)) if item.record is None else item.record, item
        first += len(item.codes)


def _texts(values: Values) -> list[Any]:
    """Return values as text: whole numbers, or the shortest text that gives the same float32 again."""
    if values.dtype.kind != "f":
        return list(values.tolist())
    different, index = np.unique(values, return_inverse=True)  # all shots of a line share one height
    return list(different.astype(str).astype(object)[index].tolist())


def _cell(text: str) -> str:
    """Quote a CSV cell where it needs quotes."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([text])
    return line.getvalue()


def open_label_writer(output: LabelOutput) -> LabelFileWriter:
    """Return the writer of labels alone."""
    return LabelFileWriter(output.path, output.codes, output.options, output.n_records, is_part=output.is_part)
