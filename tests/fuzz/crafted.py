"""LAZ files that are made to end a process: the decoder of times in lazrs calls itself for certain symbols."""

from __future__ import annotations

import io
import struct
from importlib.metadata import version

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
        self._base, self._length = 0, 0xFFFFFFFF
        self._counts, self._total, self._cycle = [1] * _SYMBOLS, 0, _SYMBOLS
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
        scale, below = 0x80000000 // self._total, 0
        self._shares = []
        for count in self._counts:
            self._shares.append((scale * below) >> 16)
            below += count
        self._until = self._cycle = min((5 * self._cycle) >> 2, (_SYMBOLS + 6) << 3)

    def _shift(self) -> None:
        while self._length < _LEAST:
            self.out.append(self._base >> 24)
            self._base, self._length = (self._base << 8) & 0xFFFFFFFF, (self._length << 8) & 0xFFFFFFFF

    def _add(self, step: int) -> None:
        self._base += step
        if self._base > 0xFFFFFFFF:
            self._base &= 0xFFFFFFFF
            at = len(self.out) - 1
            while self.out[at] == 0xFF:
                self.out[at] = 0
                at -= 1
            self.out[at] += 1


def switches(n: int) -> bytes:
    """Return ``n`` symbols that switch the sequence: some ten bytes."""
    coder = _Coder()
    for _ in range(n):
        coder.encode(_SWITCH)
    return coder.end()


def overflowing(n: int = 200_000, name: str = "pf6.laz") -> bytes:
    """Return a LAZ file whose times overflow the stack of lazrs 0.8 (it dies between 20,000 and 40,000 symbols).

    Skips the test where an older lazrs is installed: it counts the bytes first.
    """
    if int(version("lazrs").split(".")[1]) < 8:
        pytest.skip("this version of lazrs refuses the file: it counts the bytes first")
    sound = seed(name)
    start, length = struct.unpack_from("<I", sound, 96)[0], struct.unpack_from("<H", sound, 105)[0]
    (table_at,) = struct.unpack_from("<q", sound, start)
    at = start + 8 + length
    # one chunk: number of records, sizes of the layers, layers; extra bytes have a layer each
    n_extra = length - {"pf6.laz": 30, "pf7.laz": 36}[name]
    more = {"pf6.laz": 0, "pf7.laz": 1}[name]
    head = struct.Struct(f"<{1 + _N_LAYERS + more + n_extra}I")
    n_records, *sizes = head.unpack_from(sound, at)
    first = at + head.size + sum(sizes[:_GPS_TIME])
    layer = switches(n)
    body = sound[at + head.size : first] + layer + sound[first + sizes[_GPS_TIME] : table_at]
    sizes[_GPS_TIME] = len(layer)
    chunk = sound[start + 8 : at] + head.pack(n_records, *sizes) + body
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
    at, found = struct.unpack_from("<H", data, 94)[0], []
    for _ in range(struct.unpack_from("<I", data, 100)[0]):
        n = struct.unpack_from("<H", data, at + 20)[0]
        found.append(data[at + 2 : at + 54 + n])
        at += 54 + n
    return found
