"""What is known of compressed chunks before they are decoded, for who reads LAZ files and who writes them again."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Protocol

import numpy as np

RUN_BYTES = 512
"""A run of 0xFF, or nearly so, as long as this is found wherever it begins in one of twice the length."""
_LOOK_BYTES = 4 << 20

_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Compressed layers by item type; extra bytes (14) have one a byte."""


def chunk_head(items: Iterable[tuple[int, int]]) -> struct.Struct:
    """Return what follows the first record of a chunk: the number of records, and the bytes of every layer.

    Parameters
    ----------
    items : iterable of (type, bytes)
        Of the laszip VLR.

    Examples
    --------
    Point format 6 with four extra bytes:

    >>> chunk_head([(10, 30), (14, 4)]).format
    '<14I'
    """
    return struct.Struct(f"<{1 + sum(_LAYERS.get(kind, n_bytes) for kind, n_bytes in items)}I")


class _Readable(Protocol):
    def seek(self, position: int, /) -> int: ...

    def read(self, n: int, /) -> bytes: ...


def find_run(handle: _Readable, start: int, stop: int) -> int | None:
    r"""Return where a long run of 0xFF lies in a file, as bad blocks of a disk leave them; None without.

    The decoder of times calls itself once for every such code (lazrs 0.8) until its stack is used up, which ends the
    process. Compressed data look random: a run of this length does not occur in sound files.

    Parameters
    ----------
    handle : binary stream
        File; its position is changed.
    start, stop : int
        First byte to look at, and first behind.

    Examples
    --------
    >>> import io
    >>> find_run(io.BytesIO(bytes(600) + b"\xff" * 1400), 0, 2000), find_run(io.BytesIO(bytes(2000)), 0, 2000)
    (512, None)
    """
    handle.seek(start)
    position = start
    while position < stop:
        raw = np.frombuffer(handle.read(min(_LOOK_BYTES, stop - position)), np.uint8)
        if not len(raw):
            return None
        # a run of twice the block covers a whole block wherever it begins; a few other bytes in it change nothing
        blocks = raw[: len(raw) // RUN_BYTES * RUN_BYTES].reshape(-1, RUN_BYTES)
        full = np.flatnonzero((blocks[:, ::8] == 0xFF).sum(axis=1) > RUN_BYTES // 16)
        if len(full):
            return position + int(full[0]) * RUN_BYTES
        position += len(raw)
    return None
