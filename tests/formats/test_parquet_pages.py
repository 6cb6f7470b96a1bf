"""The headers of Parquet pages: what any writer makes is let through, what cannot be is refused before room is made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.parquet_pages import MOST_HEADER_BYTES, check_pages
from prc_cli.formats.tables.read import open_table

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


def write(path: Path, n: int = 5000, **options: Any) -> Path:
    rng = np.random.default_rng(1)
    table = pa.table(
        {
            "class": rng.integers(0, 9, n).astype(np.uint8),
            "range": rng.normal(size=n),
            "gap": pa.array(rng.normal(size=n), mask=rng.random(n) < 0.3),
            "name": pa.array(["some text"] * n),
        }
    )
    pq.write_table(table, path, **options)
    return path


def check(path: Path, columns: tuple[str, ...] = ("class", "range", "gap")) -> None:
    with pq.ParquetFile(path) as file:
        check_pages(path, file.metadata, columns)


@pytest.mark.parametrize("compression", ["NONE", "snappy", "zstd"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("dictionary", [True, False])
def test_what_writers_make_is_let_through(tmp_path: Path, compression: str, version: str, dictionary: bool) -> None:
    path = write(
        tmp_path / "a.parquet", compression=compression, data_page_version=version, use_dictionary=dictionary,
        row_group_size=1700, data_page_size=1000, write_page_checksum=True, write_page_index=True,
    )  # fmt: skip
    check(path)
    table = open_table(path)
    assert table is not None
    assert sum(chunk.n for chunk in table.chunks(("class", "range"))) == 5000


def test_no_rows(tmp_path: Path) -> None:
    check(write(tmp_path / "a.parquet", n=0))


def first_page(path: Path, column: int = 1) -> int:
    with pq.ParquetFile(path) as file:
        return int(file.metadata.row_group(0).column(column).data_page_offset)


def test_a_page_that_says_two_gigabytes_is_refused_and_its_neighbours_are_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.parquet", use_dictionary=False, compression="snappy")
    data = bytearray(path.read_bytes())
    at = first_page(path) + 3
    assert data[at - 1] == 0x15, "the second field, a whole number"
    data[at : at + 3] = b"\xfe\xff\xff"  # a longer number than was there, of the same bytes
    path.write_bytes(data)
    with pytest.raises(ValueError, match="'range'.* says it holds"):
        check(path)
    table = open_table(path)
    assert table is not None
    with pytest.raises(InputError, match="no whole Parquet file .column 'range'"):
        list(table.chunks(("class", "range")))
    assert sum(chunk.n for chunk in table.chunks(("class",))) == 5000


@pytest.mark.parametrize("content", [b"\x1c" * MOST_HEADER_BYTES, b"\xff" * MOST_HEADER_BYTES, b"\x19\xff" * 2000])
def test_a_header_without_an_end_is_refused(tmp_path: Path, content: bytes) -> None:
    path = write(tmp_path / "a.parquet", use_dictionary=False, compression="NONE")
    data = bytearray(path.read_bytes())
    at = first_page(path)
    data[at : at + len(content)] = content
    path.write_bytes(data)
    with pytest.raises(ValueError, match="has no end"):
        check(path)
