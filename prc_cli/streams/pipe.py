"""Reads records from a pipe as they arrive, from a live scanner or another program."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.formats.options import RANGES_ONLY, InputConfig, Layout, record_dtype
from prc_cli.formats.raw_binary.read import FORMAT, layout_columns
from prc_cli.formats.records import FieldSource
from prc_cli.streams.grid import open_grid
from prc_cli.streams.open import with_layout
from prc_cli.streams.stream import Stream

READ_BYTES = 1 << 20
"""Most bytes per read, and the requested size of the pipe where the system allows it."""
KEPT_BYTES = 256 << 20
"""Most bytes kept at the start until lines, columns and directions are known."""
_F_SETPIPE_SZ = 1031
"""Linux: fcntl command that sets the size of a pipe."""


class ByteStream(Protocol):
    """An unbuffered file object, such as ``sys.stdin.buffer.raw``."""

    def fileno(self) -> int:
        """Return the file descriptor."""

    def read(self, size: int = -1, /) -> bytes | None:
        """Return available bytes, at least one (waiting for it), at most ``size``.

        It is empty at the end.
        """


class PipeSource(FieldSource):
    """Records from a pipe: kept until :meth:`seal`, and read only once afterwards."""

    n_records = None
    """Unknown before reading."""

    def __init__(self, handle: ByteStream, layout: Layout, name: str = "stdin") -> None:
        super().__init__(name, FORMAT, layout_columns(layout), self)
        self._dtype = record_dtype(layout)
        self._header_bytes = layout.header_bytes
        self._handle = handle
        self._kept: list[bytes] = []
        self._n_kept = 0
        self._sealed = self._ended = False
        self.arrived_s = 0.0
        """Arrival time of the last bytes, by :func:`time.perf_counter` [s]."""
        widen_pipe(handle)

    def seal(self) -> None:
        """Stop keeping bytes: the next :meth:`chunks` is the last."""
        self._sealed = True

    def stored(self, keys: tuple[str, ...]) -> Iterator[tuple[int, NDArray[Any], int]]:
        """Yield records as they arrive: index of the first, the records, their number."""
        record_bytes = self._dtype.itemsize
        n_header = self._header_bytes
        first = 0
        rest = b""
        for piece in self._pieces():
            data = rest + piece if rest else piece
            if n_header:
                n_header, data = max(0, n_header - len(data)), data[n_header:]
            n_records = len(data) // record_bytes
            rest = data[n_records * record_bytes :]
            if n_records:
                records = np.frombuffer(data, self._dtype, count=n_records)
                yield first, records, n_records
                first += n_records
        if not first:
            problem = f"ended before the first record of {record_bytes} bytes"
            raise InputError(
                self.path,
                problem,
                "check that the program before the pipe runs and writes to stdout",
            )
        if (
            rest and self._sealed
        ):  # before, whoever asks what the stream is would take it for an answer
            problem = f"ended inside record {first}: found {len(rest)} bytes of {record_bytes}"
            raise InputError(
                self.path,
                problem,
                "check the layout, and that the program before the pipe has not died",
            )

    def _pieces(self) -> Iterator[bytes]:
        """Yield the kept bytes, then those that arrive."""
        position = 0
        while True:
            if position == len(self._kept):
                if self._ended:
                    return
                self._keep(self._read())
                continue
            yield self._kept[position]
            position += 1
            if self._sealed:
                # the last reading: no other needs them
                del self._kept[:position]
                position = 0

    def _keep(self, piece: bytes) -> None:
        if not piece:
            return
        self._kept.append(piece)
        self._n_kept += len(piece)
        if self._n_kept > KEPT_BYTES and not self._sealed:
            problem = (
                f"lines and columns are not known after {self._n_kept >> 20} MiB, "
                "and a pipe cannot be read twice"
            )
            raise InputError(
                self.path,
                problem,
                "give --points-per-line and, with angles, input.angle_start and _step",
            )

    def _read(self) -> bytes:
        try:
            piece = self._handle.read(READ_BYTES)
        except OSError as error:
            problem = f"cannot be read ({error.strerror or error})"
            raise InputError(self.path, problem, "check the program before the pipe") from error
        self.arrived_s = time.perf_counter()
        self._ended = not piece
        return piece or b""


def widen_pipe(handle: ByteStream) -> None:
    """Enlarge the pipe, so that its writer waits less, where the system allows it."""
    with contextlib.suppress(OSError, ImportError, ValueError, AttributeError):
        import fcntl

        if os.uname().sysname == "Linux":
            fcntl.fcntl(handle.fileno(), _F_SETPIPE_SZ, READ_BYTES)


def open_pipe(
    handle: ByteStream, config: InputConfig, layout: Layout | None = None
) -> tuple[PipeSource, Stream]:
    """Open a pipe as a stream, as :func:`prc_cli.streams.open.open_input`.

    Seal it before the end is read.
    """
    layout = RANGES_ONLY if layout is None else layout
    layout = layout if layout.fields else layout.model_copy(update={"fields": RANGES_ONLY.fields})
    config = with_layout(config, layout)
    if config.order == "sort-time":
        problem = "a pipe cannot be sorted by time: its labels leave before its end"
        raise ConfigError(
            "input.order", problem, "write the stream to a file first, or leave --sort-by-time out"
        )
    source = PipeSource(handle, layout)
    grid = open_grid(source, config, line_hz=layout.line_frequency)
    if not grid.rules.is_dense:
        # a sealed pipe can be read for the blocks alone
        grid.find_turns()
    return source, replace(Stream.of(grid), grid=grid)
