"""Memory that is used again, block after block, instead of being given back to the system each time."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_JUST_BELOW_LIMIT = (1 << 25) - (1 << 16)
"""Bytes; the GNU C library learns from blocks of up to 32 MiB."""


@lru_cache(maxsize=1)
def keep_memory() -> None:
    """Let the C library keep freed memory, up to 64 MiB, for the next arrays; once a process.

    The GNU C library returns arrays above 128 KiB to the system when they are freed, and every page of the next one
    has to be asked for again, which for images of a few hundred kilobytes takes longer than their computation. It
    learns from what is freed: after one large array, which nobody writes to and hence costs nothing, it keeps smaller
    ones. Other C libraries are not affected.
    """
    np.empty(_JUST_BELOW_LIMIT, np.uint8)
