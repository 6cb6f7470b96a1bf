"""Memory that is used again, block after block, instead of being given back to the system each time."""

from __future__ import annotations

import ctypes
import os
from functools import lru_cache

import numpy as np

_JUST_BELOW_LIMIT = (1 << 25) - (1 << 16)
"""Bytes; the GNU C library learns from blocks of up to 32 MiB."""
_M_ARENA_MAX = -8
"""From its ``malloc.h``."""


@lru_cache(maxsize=1)
def keep_memory() -> None:
    """Let the C library keep freed memory, up to 64 MiB, for the next arrays; once a process.

    The GNU C library returns arrays above 128 KiB to the system when they are freed, and every page of the next one
    has to be asked for again, which for images of a few hundred kilobytes takes longer than their computation. It
    learns from what is freed: after one large array, which nobody writes to and hence costs nothing, it keeps smaller
    ones. It also keeps what every thread has freed apart, up to eight times for every core, which would add up; the
    threads that begin after this call share what is kept. Other C libraries are not affected.
    """
    np.empty(_JUST_BELOW_LIMIT, np.uint8)
    if os.name == "posix":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_M_ARENA_MAX, 1)
