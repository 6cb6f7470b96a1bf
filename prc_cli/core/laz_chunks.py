"""Heads of LASzip's layered chunks (point formats 6-10), for who reads LAZ files and who writes them again."""

from __future__ import annotations

import struct
from collections.abc import Iterable

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
