"""Decompression of LAZ records, chunk table checked first.

A LAZ file is a row of independently compressed chunks and a table of their sizes. The table is compared with the
file and with the header's count before anything is decoded, so that a lie ends in one line and not in an
allocation; chunks are decoded in parallel (lazrs), each from its own bytes.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.threads import default_threads
from prc_cli.core.types import I64
from prc_cli.formats.las.chunks import RUN_BYTES, chunk_head, find_run
from prc_cli.formats.las.header import DAMAGED, LasHeader, damaged

_TOGETHER_BYTES = 16 << 20
"""Most bytes of records that are decoded together because there are many cores."""
_ONE_RETURN = 0x1F
"""Highest byte of a record that tells of at most one return: their number is in the upper half."""
_SERIAL_BYTES = 256 << 20
"""A chunk that unpacks to more than this is decoded bit by bit on one core instead of whole."""


@dataclass(frozen=True, slots=True)
class ChunkTable:
    """Where the compressed chunks lie."""

    first_record: I64
    """(n + 1,) int64, index of the first record of every chunk, then the number of records."""
    first_byte: I64
    """(n + 1,) int64, position in the file of every chunk, then the end of the last."""
    n_unread: int
    """Chunks that hold nothing but records beyond the header's count; they are not read."""


class LazRecords:
    """The records of a LAZ file as raw bytes, from the start, in batches.

    Parameters
    ----------
    where : str
        File name, for messages.
    handle : file object
        Open for binary reading, seekable.
    header : LasHeader
        Of this file.

    Raises
    ------
    InputError
        When the laszip VLR or the chunk table contradicts the header or the file.
    """

    def __init__(self, where: str, handle: BinaryIO, header: LasHeader) -> None:
        self._where = where
        self._handle = handle
        self._header = header
        found = header.find("laszip encoded", 22204)
        if not found:
            problem = "the records are compressed but the laszip VLR is missing"
            raise InputError(where, problem, DAMAGED)
        self._vlr_data = found[0]
        self._items = self._read_items()
        self.table = self._read_table()

    def _read_items(self) -> list[tuple[int, int]]:
        """Return (type, bytes) of the items of a record, after checking the VLR."""
        data, where = self._vlr_data, f"{self._where}: laszip VLR"
        n_items = struct.unpack_from("<H", data, 32)[0] if len(data) >= 34 else 0
        if n_items == 0 or len(data) < 34 + 6 * n_items:
            problem = f"{len(data)} bytes for {n_items} items, expected at least {34 + 6 * max(n_items, 1)}"
            raise InputError(where, problem, DAMAGED)
        items = [struct.unpack_from("<HH", data, 34 + 6 * i) for i in range(n_items)]
        n_bytes = sum(size for _, size in items)
        if n_bytes != self._header.record_bytes:
            problem = f"records of {n_bytes} bytes, expected the {self._header.record_bytes} of the header"
            raise InputError(where, problem, DAMAGED)
        if struct.unpack_from("<I", data, 12)[0] == 0:
            raise InputError(where, "chunks of 0 records, expected at least 1", DAMAGED)
        return [(int(kind), int(size)) for kind, size in items]

    def _read_table(self) -> ChunkTable:
        header, where = self._header, self._where
        start = header.data_offset + 8
        position = self._table_position()
        self._handle.seek(position)
        raw = self._handle.read(8)
        if len(raw) < 8:
            raise damaged(where, position, "the file ends, expected the LAZ chunk table: it changed while read")
        n_chunks = struct.unpack("<II", raw)[1]
        # every chunk begins with one record as it is: a bound for the count before anything is allocated
        if not 1 <= n_chunks <= (position - start) // header.record_bytes:
            most = (position - start) // header.record_bytes
            problem = f"chunk table of {n_chunks} chunks, expected 1 to {most} in {position - start} bytes"
            raise damaged(where, position + 4, problem)
        import lazrs

        with lazrs_errors(where, f"the chunk table at byte {position} cannot be read"):
            self._handle.seek(header.data_offset)
            pairs = lazrs.read_chunk_table(self._handle, lazrs.LazVlr(self._vlr_data))
        # 32 bits in the file; the decoder hands on what damage makes of them, so keep the sums within int64
        table = np.array(pairs, dtype=np.uint64).reshape(-1, 2).clip(max=2**32).astype(np.int64)
        n_bytes = int(table[:, 1].sum())
        if len(table) != n_chunks or n_bytes > position - start or (table[:, 1] < header.record_bytes).any():
            problem = f"chunk table of {n_bytes} bytes in {len(table)} chunks"
            raise damaged(where, position, f"{problem}, expected {position - start} bytes")
        return self._place(table, start)

    def _table_position(self) -> int:
        """Return the byte where the chunk table begins."""
        header = self._header
        ends_at = header.file_bytes
        self._handle.seek(header.data_offset)
        raw = self._handle.read(8)
        position = struct.unpack("<q", raw)[0] if len(raw) == 8 else 0
        if position == -1 and ends_at >= header.data_offset + 16:
            # written to a pipe: the position stands at the very end
            self._handle.seek(ends_at - 8)
            position = struct.unpack("<q", self._handle.read(8))[0]
        if not header.data_offset + 8 <= position <= ends_at - 8:
            problem = (
                f"the LAZ chunk table should begin at byte {position}, found the file's end at byte {ends_at}"
                if position > 0
                else "the LAZ chunk table was never written (an unfinished file)"
            )
            raise InputError(self._where, f"{problem}; expected it after the {header.n_records} records", DAMAGED)
        return position

    def _place(self, table: I64, start: int) -> ChunkTable:
        """Compare the table with the header's count and give every chunk its place."""
        n_records = self._header.n_records
        held = np.cumsum(table[:, 0])
        if held[-1] < n_records:
            problem = f"the header promises {n_records} records, the {len(table)} LAZ chunks hold at most {held[-1]}"
            raise InputError(self._where, problem, "the header lies or records are lost; write the file anew")
        n_used = int(np.searchsorted(held, n_records)) + 1
        first_record = np.concatenate(([0], held[: n_used - 1], [n_records])).astype(np.int64)
        first_byte = start + np.concatenate(([0], np.cumsum(table[:n_used, 1]))).astype(np.int64)
        return ChunkTable(first_record, first_byte, len(table) - n_used)

    def batches(self, n_max: int, selection: int, several: int | None = None) -> Iterator[tuple[int, memoryview]]:
        """Decode from the start.

        Parameters
        ----------
        n_max : int
            Most records of a batch. As many chunks are decoded together as there are cores, and given out in batches.
        selection : int
            Layers to decode (``lazrs.SELECTIVE_DECOMPRESS_*``), point formats 6-10 only.
        several : int, optional
            Layers to decode of records among which a shot has several returns, and of all after them; contains
            ``selection``. The others then hold anything in the layers between the two.

        Yields
        ------
        (int, memoryview)
            Index of the first record, the records.

        Raises
        ------
        InputError
            Naming the records that cannot be decoded.
        """
        import lazrs

        size = self._header.record_bytes
        largest = int(np.diff(self.table.first_record).max())
        # the parallel decoder sizes its buffers by the declared chunk, full or not
        declared = lazrs.LazVlr(self._vlr_data).chunk_size()
        whole = largest * size <= _SERIAL_BYTES and (declared * size <= _SERIAL_BYTES or self._variable())
        kind = lazrs.ParLasZipDecompressor if whole else lazrs.LasZipDecompressor
        if several is not None and not (whole and self._header.point_format >= 6):
            selection, several = several, None
        with lazrs_errors(self._where, "the compressed records cannot be opened"):
            decoder = self._open(kind, selection)
        n_chunks = len(self.table.first_record) - 1
        # every core decodes a chunk of its own
        n_together = max(n_max, min(default_threads() * largest, _TOGETHER_BYTES // size))
        chunk = 0
        while chunk < n_chunks:
            first = int(self.table.first_record[chunk])
            end = max(int(np.searchsorted(self.table.first_record, first + n_together, side="right")) - 1, chunk + 1)
            # a handle of its own: the decoder must find the other one where it left it
            with Path(self._where).open("rb") as handle:
                self._check_layers(handle, chunk, end)
                self._check_runs(handle, chunk, end)
            stop = int(self.table.first_record[end])
            # whole chunks are decoded at once even if they are longer than a batch: only then is damage noticed
            step = stop - first if whole else n_max
            for begin in range(first, stop, step):
                raw = np.empty(min(step, stop - begin) * size, np.uint8).data
                if not self._decode(decoder, raw):
                    raise self._damage(chunk, end, begin, kind)
                if several is not None and _has_several(raw, size):
                    with lazrs_errors(self._where, "the compressed records cannot be opened"):
                        decoder = self._open(kind, several)
                        decoder.seek(begin)
                    several = None
                    if not self._decode(decoder, raw):
                        raise self._damage(chunk, end, begin, kind)
                for start in range(0, len(raw), n_max * size):
                    yield begin + start // size, raw[start : start + n_max * size]
            chunk = end

    def _variable(self) -> bool:
        import lazrs

        return bool(lazrs.LazVlr(self._vlr_data).uses_variable_size_chunks())

    def _open(self, kind: Any, selection: int) -> Any:
        import lazrs

        self._handle.seek(self._header.data_offset)
        return kind(self._handle, self._vlr_data, lazrs.DecompressionSelection(selection))

    @staticmethod
    def _decode(decoder: Any, raw: memoryview) -> bool:
        try:
            with lazrs_errors("", ""):
                decoder.decompress_many(raw)
        except InputError:
            return False
        return True

    def _damage(self, chunk: int, end: int, begin: int, kind: Any) -> InputError:
        """Find the first chunk that cannot be decoded and say where it lies."""
        import lazrs

        bounds = self.table.first_record
        if kind is lazrs.ParLasZipDecompressor:
            with contextlib.suppress(InputError), lazrs_errors("", ""):
                decoder = self._open(kind, lazrs.SELECTIVE_DECOMPRESS_ALL)
                decoder.seek(begin)
                while chunk < end - 1:
                    decoder.decompress_many(
                        bytearray(int(bounds[chunk + 1] - bounds[chunk]) * self._header.record_bytes)
                    )
                    chunk += 1
            begin = int(bounds[chunk])
        problem = (
            f"records {begin} to {bounds[chunk + 1] - 1} cannot be decompressed (LAZ chunk {chunk} at byte "
            f"{self.table.first_byte[chunk]}): its {self.table.first_byte[chunk + 1] - self.table.first_byte[chunk]} "
            f"bytes do not hold the {bounds[chunk + 1] - bounds[chunk]} records expected"
        )
        return InputError(self._where, problem, DAMAGED)

    def _check_layers(self, handle: BinaryIO, first: int, end: int) -> None:
        """Compare the sizes that chunks of point formats 6-10 declare of themselves with the chunk table."""
        if self._items[0][0] < 10:
            return
        layout = chunk_head(self._items)
        size = self._header.record_bytes
        first_byte = self.table.first_byte[first : end + 1].tolist()
        first_record = self.table.first_record[first : end + 1].tolist()
        for k, chunk in enumerate(range(first, end)):
            begin, n_bytes = first_byte[k], first_byte[k + 1] - first_byte[k]
            n_records = first_record[k + 1] - first_record[k]
            handle.seek(begin + size)
            head = handle.read(layout.size)
            held, *layers = layout.unpack(head) if len(head) == layout.size else (0,)
            what = f"LAZ chunk {chunk} (from record {first_record[k]})"
            if held < n_records or (held > n_records and chunk < len(self.table.first_byte) - 2):
                raise damaged(self._where, begin + size, f"{what} holds {held} records, expected {n_records}")
            claimed = size + layout.size + sum(layers)
            if claimed > n_bytes:
                raise damaged(self._where, begin, f"{what} claims {claimed} bytes, expected {n_bytes}")

    def _check_runs(self, handle: BinaryIO, first: int, end: int) -> None:
        """Refuse chunks with a long run of 0xFF: the decoder would end the process."""
        byte = find_run(handle, int(self.table.first_byte[first]), int(self.table.first_byte[end]))
        if byte is None:
            return
        chunk = int(np.searchsorted(self.table.first_byte, byte, side="right")) - 1
        bounds = self.table.first_record[chunk : chunk + 2]
        problem = (
            f"records {bounds[0]} to {bounds[1] - 1} cannot be decompressed: LAZ chunk {chunk} holds "
            f"{RUN_BYTES} bytes of 0xFF in a row, expected compressed records"
        )
        raise damaged(self._where, byte, problem)


def _has_several(raw: memoryview, record_bytes: int) -> bool:
    """Tell whether a shot among records of point formats 6-10 has several returns."""
    returns = np.frombuffer(raw, np.uint8)[14::record_bytes]
    return bool(returns.max(initial=0) > _ONE_RETURN)


@contextlib.contextmanager
def lazrs_errors(where: str, problem: str) -> Iterator[None]:
    """Turn whatever the decompressor raises into :class:`InputError`; it may even panic on damaged bytes."""
    try:
        yield
    except Exception as error:
        raise InputError(where, f"{problem} ({error})", DAMAGED) from error
    except BaseException as error:
        # pyo3's PanicException is no Exception and cannot be imported; Ctrl-C must pass
        if type(error).__name__ != "PanicException":
            raise
        raise InputError(where, f"{problem} ({error})", DAMAGED) from error
