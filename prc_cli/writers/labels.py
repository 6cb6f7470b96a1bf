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
from prc_cli.writers.base import Columns, ScatterWriter
from prc_cli.writers.options import OutputConfig
from prc_cli.writers.record import RunRecord


class LabelFileWriter(ScatterWriter):
    """Writer of class codes by record; a missing shot has code 0.

    ``.npy`` holds (n_records,) uint8 codes; ``.csv`` and ``.parquet`` the columns ``record`` (int64), ``class``
    (uint8 code), ``name`` and, if asked for, ``segment`` (uint32).
    """

    def __init__(self, path: Path, codes: ClassCodes, options: OutputConfig, n_records: int | None) -> None:
        super().__init__(path, codes, options, n_records)
        self._kind = path.suffix.lower()
        if self._kind == ".npy" and options.segment_ids:
            self._with_segments = False
            self._notice("a .npy output holds class codes only; segment ids need .csv, .parquet, .las or .laz")
        if options.range:
            self._notice("label files hold no ranges; [output] range needs .las or .laz")

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
            header = {"descr": "|u1", "fortran_order": False, "shape": (total,)}
            np.lib.format.write_array_header_1_0(handle, header)
            for item in columns:
                handle.write(item.codes.data)

    def _write_csv(self, columns: Iterator[Columns]) -> None:
        # text of everything but the record number, by code: the loop only joins
        tails = [f"{code},{_cell(self._name(code))}" for code in range(256)]
        with self._temporary.open("w", encoding="utf-8", newline="") as handle:
            handle.write("record,class,name" + (",segment\n" if self._segment_spool is not None else "\n"))
            for first, item in _numbered(columns):
                numbers = range(first, first + len(item.codes))
                ends: Any = [tails[code] for code in item.codes.tolist()]
                if item.segments is not None:
                    ends = (f"{end},{segment}" for end, segment in zip(ends, item.segments.tolist(), strict=True))
                handle.writelines(f"{number},{end}\n" for number, end in zip(numbers, ends, strict=True))

    def _write_parquet(self, columns: Iterator[Columns]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        names = pa.array([self._name(code) for code in range(256)])
        fields = [("record", pa.int64()), ("class", pa.uint8()), ("name", pa.dictionary(pa.uint8(), pa.string()))]
        if self._segment_spool is not None:
            fields.append(("segment", pa.uint32()))
        schema = pa.schema(fields)
        try:
            # the file stays ours, so that a failed write shows the system's own error
            with self._temporary.open("wb") as handle, pq.ParquetWriter(handle, schema) as writer:
                for first, item in _numbered(columns):
                    codes = pa.array(item.codes)
                    table = [
                        pa.array(np.arange(first, first + len(item.codes))),
                        codes,
                        pa.DictionaryArray.from_arrays(codes, names),
                    ]
                    if item.segments is not None:
                        table.append(pa.array(item.segments))
                    writer.write_table(pa.Table.from_arrays(table, schema=schema))
        except pa.ArrowException as error:
            raise OutputError(str(self.path), f"cannot be written as Parquet ({error})", "try .csv or .npy") from error

    def _name(self, code: int) -> str:
        return self._names.get(code, f"class {code}")


def _numbered(columns: Iterator[Columns]) -> Iterator[tuple[int, Columns]]:
    """Give every chunk the index of its first record."""
    first = 0
    for item in columns:
        yield first, item
        first += len(item.codes)


def _cell(text: str) -> str:
    """Quote a CSV cell where it needs quotes."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([text])
    return line.getvalue()
