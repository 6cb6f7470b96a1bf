"""Reads text files in blocks of whole lines with their line numbers, compressed or not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read

BLOCK_BYTES = 3 << 18
"""Bytes of text read at a time.

Twice as many take 10 MiB more memory and save a few per cent of processor time.
"""
MAX_LINE_BYTES = 1 << 20
"""Longest line; files with longer ones are not tables."""

MAX_RATIO = 500
LEAST_BYTES = 1 << 27
"""Texts of more than ``LEAST_BYTES`` and ``MAX_RATIO`` times their compressed size are refused."""

_CODECS = {".gz": "gzip", ".zst": "zstd"}
_COMPRESSED = {b"\x1f\x8b": ("gzip", ".gz"), b"\x28\xb5\x2f\xfd": ("zstd", ".zst")}
_LINE_END = ord("\n")
_UTF8_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True, slots=True)
class Lines:
    """Consecutive whole lines."""

    first: int
    """Number of the first line, counted from 1 as by ``sed -n Np``."""
    data: bytes
    """The lines with line ends; only the last line of a file may lack one."""


def iter_lines(
    path: Path,
    block_bytes: int = BLOCK_BYTES,
    *,
    span: tuple[int, int] | None = None,
    line: int = 1,
) -> Iterator[Lines]:
    """Read text, compressed or not, in blocks of whole lines.

    Parameters
    ----------
    path
        The file.
    block_bytes
        Bytes read at a time.
    span
        First byte and end of the part to read; None = all.
    line
        Number of the first line.
    """
    remainder = b""
    at_start = span is None
    n_bytes = 0
    with _open(path) as handle:
        most = (
            max(LEAST_BYTES, MAX_RATIO * path.stat().st_size)
            if path.suffix.lower() in _CODECS
            else None
        )
        if span is not None:
            handle.seek(span[0])
        while piece := _read(
            path, handle, block_bytes if span is None else min(block_bytes, span[1] - span[0]), line
        ):
            n_bytes += len(piece)
            span = None if span is None else (span[0] + len(piece), span[1])
            if most is not None and n_bytes > most:
                problem = (
                    f"unpacks to more than {n_bytes >> 20} MiB, over {MAX_RATIO} times its size"
                )
                raise InputError(str(path), problem, "unpack it first if this is right")
            if at_start:
                piece = _without_mark(path, handle, piece, block_bytes)
                at_start = False
            data = remainder + piece
            end = data.rfind(b"\n") + 1
            remainder = data[end:]
            if len(remainder) > MAX_LINE_BYTES:
                raise too_long(path, line + count_line_ends(data))
            if end:
                yield Lines(line, data[:end])
                line += count_line_ends(data)
    if remainder:
        yield Lines(line, remainder)


def count_line_ends(data: bytes) -> int:
    r"""Return the number of line ends; for short lines four times as fast as ``bytes.count``.

    >>> count_line_ends(b"1.5\n2.5\n3")
    2
    """
    return int(np.count_nonzero(np.frombuffer(data, np.uint8) == _LINE_END))


def too_long(path: Path, line: int) -> InputError:
    """Return the error of a line that is too long."""
    problem = f"more than {MAX_LINE_BYTES} bytes without a line end, expected rows of text"
    return InputError(
        f"{path}: line {line}", problem, "check that this is a text file with LF or CR LF line ends"
    )


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    codec = _CODECS.get(path.suffix.lower())
    with open_to_read(path) as handle:
        if codec is None:
            yield handle
            return
        import pyarrow as pa

        with pa.CompressedInputStream(pa.PythonFile(handle, mode="r"), codec) as stream:
            yield stream


def _read(
    path: Path,
    handle: IO[bytes],
    n: int,
    line: int,
) -> bytes:
    try:
        return handle.read(n)
    except OSError as error:
        if path.suffix.lower() in _CODECS:
            kind = _CODECS[path.suffix.lower()]
            problem = f"the {kind} stream is cut short or damaged in or after line {line} ({error})"
            raise InputError(str(path), problem, "copy it from the archive again") from error
        problem = f"cannot be read after line {line} ({error.strerror or error})"
        raise InputError(str(path), problem, "check the disk or copy the file again") from error


def _without_mark(
    path: Path,
    handle: IO[bytes],
    piece: bytes,
    block_bytes: int,
) -> bytes:
    """Drop a byte order mark at the start, and refuse files that are not text."""
    while len(piece) < 4 and (next_piece := _read(path, handle, block_bytes, 1)):
        piece += next_piece
    for magic, (kind, suffix) in _COMPRESSED.items():
        if piece.startswith(magic):
            problem = f"the content is {kind}-compressed, expected text"
            raise InputError(str(path), problem, f"rename it to {path.name}{suffix}")
    if piece.startswith((b"\xff\xfe", b"\xfe\xff")):
        hint = "convert it: iconv -f UTF-16 -t UTF-8 IN > OUT"
        raise InputError(str(path), "the text is UTF-16, expected UTF-8", hint)
    head = piece[:4096]
    if b"\0" in head:
        problem = f"byte {head.index(0)} is 0, expected a text file in UTF-8"
        raise InputError(str(path), problem, "raw dumps are read from .bin, .raw and .dat files")
    return piece.removeprefix(_UTF8_MARK)
