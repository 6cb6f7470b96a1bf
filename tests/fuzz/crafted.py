"""Files that are made to end a process, or to keep it for ever."""

from __future__ import annotations

import io
import sqlite3
import struct
from importlib.metadata import version
from pathlib import Path

import lazrs
import pytest

from tests.fuzz.seeds import seed

_LEAST = 1 << 24
_SYMBOLS = 5
_SWITCH = 2
"""The times go on with another sequence; any number of these may follow each other."""
_GPS_TIME = 8
"""Index of the layer of times."""
_N_LAYERS = 9


class _Coder:
    """Laszip's adaptive arithmetic coder of one model."""

    def __init__(self) -> None:
        self.out = bytearray()
        self._base = 0
        self._length = 0xFFFFFFFF
        self._counts = [1] * _SYMBOLS
        self._total = 0
        self._cycle = _SYMBOLS
        self._update()
        self._until = self._cycle = (_SYMBOLS + 6) >> 1

    def encode(self, symbol: int) -> None:
        self._length >>= 15
        low = self._shares[symbol] * self._length
        self._add(low)
        self._length = self._shares[symbol + 1] * self._length - low
        self._shift()
        self._counts[symbol] += 1
        self._until -= 1
        if not self._until:
            self._update()

    def end(self) -> bytes:
        self._add(_LEAST)
        self._length = _LEAST >> 1
        self._shift()
        return bytes(self.out) + bytes(4)

    def _update(self) -> None:
        self._total += self._cycle
        if self._total > 1 << 15:
            self._counts = [(count + 1) >> 1 for count in self._counts]
            self._total = sum(self._counts)
        scale = 0x80000000 // self._total
        below = 0
        self._shares = []
        for count in self._counts:
            self._shares.append((scale * below) >> 16)
            below += count
        self._until = self._cycle = min((5 * self._cycle) >> 2, (_SYMBOLS + 6) << 3)

    def _shift(self) -> None:
        while self._length < _LEAST:
            self.out.append(self._base >> 24)
            self._base = (self._base << 8) & 0xFFFFFFFF
            self._length = (self._length << 8) & 0xFFFFFFFF

    def _add(self, step: int) -> None:
        self._base += step
        if self._base > 0xFFFFFFFF:
            self._base &= 0xFFFFFFFF
            place = len(self.out) - 1
            while self.out[place] == 0xFF:
                self.out[place] = 0
                place -= 1
            self.out[place] += 1


def switches(n: int) -> bytes:
    """Return ``n`` symbols that switch the sequence: some ten bytes."""
    coder = _Coder()
    for _ in range(n):
        coder.encode(_SWITCH)
    return coder.end()


def overflowing(n: int = 200_000, name: str = "pf6.laz") -> bytes:
    """Return a LAZ file whose times overflow the stack of lazrs 0.8 (it dies between 20,000 and
    40,000 symbols).

    Skips the test where an older lazrs is installed: it counts the bytes first.
    """
    if int(version("lazrs").split(".")[1]) < 8:
        pytest.skip("this version of lazrs refuses the file: it counts the bytes first")
    sound = seed(name)
    start = struct.unpack_from("<I", sound, 96)[0]
    length = struct.unpack_from("<H", sound, 105)[0]
    (table_at,) = struct.unpack_from("<q", sound, start)
    place = start + 8 + length
    # one chunk: number of records, sizes of the layers, layers; extra bytes have a layer each
    n_extra = length - {"pf6.laz": 30, "pf7.laz": 36}[name]
    more = {"pf6.laz": 0, "pf7.laz": 1}[name]
    head = struct.Struct(f"<{1 + _N_LAYERS + more + n_extra}I")
    n_records, *sizes = head.unpack_from(sound, place)
    first = place + head.size + sum(sizes[:_GPS_TIME])
    layer = switches(n)
    body = sound[place + head.size : first] + layer + sound[first + sizes[_GPS_TIME] : table_at]
    sizes[_GPS_TIME] = len(layer)
    chunk = sound[start + 8 : place] + head.pack(n_records, *sizes) + body
    out = io.BytesIO(sound[:start] + struct.pack("<q", start + 8 + len(chunk)) + chunk)
    out.seek(0, 2)
    vlr = next(data for data in _vlrs(sound) if data[:16].rstrip(b"\0") == b"laszip encoded")
    lazrs.write_chunk_table(out, [(n_records, len(chunk))], lazrs.LazVlr(vlr[52:]))
    end = out.tell()
    data = bytearray(out.getvalue())
    data[235:247] = struct.pack("<QI", 0, 0)  # no extended VLRs
    return bytes(data[:end])


def _vlrs(data: bytes) -> list[bytes]:
    """Return the VLRs from their user id on."""
    offset = struct.unpack_from("<H", data, 94)[0]
    records = []
    for _ in range(struct.unpack_from("<I", data, 100)[0]):
        n = struct.unpack_from("<H", data, offset + 20)[0]
        records.append(data[offset + 2 : offset + 54 + n])
        offset += 54 + n
    return records


def endless_rows(path: Path, table: str) -> Path:
    """Let every pointer of a table's pages in a ``.db3`` lead to one child.

    Some 10^13 rows in five more pages.
    """
    with sqlite3.connect(path) as base:
        (root,) = base.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)
        ).fetchone()
        (size,) = base.execute("PRAGMA page_size").fetchone()
    data = bytearray(path.read_bytes())
    leaf = bytes(data[(root - 1) * size : root * size])
    n_pages = len(data) // size
    n_cells = (size - 12) // 7
    children = [*range(n_pages + 1, n_pages + 5), n_pages + 5]
    places = [(size - 5 * (i + 1)) for i in range(n_cells)]

    def inner(child: int) -> bytes:
        page = bytearray(struct.pack(">BHHHBI", 5, 0, n_cells, places[-1], 0, child)).ljust(
            size, b"\0"
        )
        for i, place in enumerate(places):
            struct.pack_into(">H", page, 12 + 2 * i, place)
            struct.pack_into(">IB", page, place, child, 100)
        return bytes(page)

    data[(root - 1) * size : root * size] = inner(children[0])
    for child in children[1:]:
        data += inner(child)
    data += leaf
    struct.pack_into(">I", data, 28, len(data) // size)
    path.write_bytes(data)
    return path


def endless_column(path: Path) -> Path:
    """Give the messages of a ``.db3`` data that are computed, for ever."""
    column = "data BLOB/**/AS/**/(instr(hex(zeroblob(4000000)), hex(zeroblob(2000000)) || 1))"
    with sqlite3.connect(path) as base:
        base.execute("PRAGMA writable_schema = ON")
        base.execute(
            "UPDATE sqlite_master SET sql = replace(sql, 'data BLOB NOT NULL', ?)", (column,)
        )
    base.close()
    return path


def huge_page(path: Path) -> Path:
    """Write a Parquet file whose column ``range`` has a page that says it holds 2 GB."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {
        "class": np.zeros(5000, np.uint8),
        "range": np.random.default_rng(1).normal(size=5000),
    }
    pq.write_table(pa.table(columns), path, use_dictionary=False, compression="snappy")
    data = path.read_bytes()
    with pq.ParquetFile(path) as file:
        offset = file.metadata.row_group(0).column(1).data_page_offset
    # type, size and stored size of the page; the longer size takes two bytes from its end
    kind = data[offset : offset + 3]
    size = data[offset + 3 : offset + 6]
    stored = data[offset + 6 : offset + 10]
    rest = data[offset + 10 :]
    assert (kind[2], stored[0], size[2] >> 7, stored[3] >> 7) == (0x15, 0x15, 0, 0)
    stored = bytes([stored[0], stored[1] - 4, *stored[2:]])
    end = offset + 10 + (stored[1] & 0x7F | (stored[2] & 0x7F) << 7 | stored[3] << 14) // 2
    path.write_bytes(
        data[:offset]
        + kind
        + b"\xfe\xff\xff\xff\x0f"
        + stored
        + rest[: end - offset - 10]
        + data[end + 2 :]
    )
    return path
