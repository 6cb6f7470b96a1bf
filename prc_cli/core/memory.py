"""Lets the C library reuse freed memory for the next block instead of returning it to the system."""

from __future__ import annotations

import ctypes
import os
from functools import lru_cache

import numpy as np

_JUST_BELOW_LIMIT = (1 << 25) - (1 << 16)
"""Bytes; the GNU C library adapts its threshold to freed blocks of up to 32 MiB."""
_M_ARENA_MAX = -8
"""From glibc's ``malloc.h``."""


@lru_cache(maxsize=1)
def keep_memory() -> None:
    """Let the C library keep up to 64 MiB of freed memory for the next arrays; once per process.

    The GNU C library returns arrays above 128 KiB to the system when they are freed. Requesting the pages again takes
    longer than the computation on images of a few hundred kilobytes. The library raises that limit after a large
    array is freed; one is allocated and freed here, never written, so it costs nothing. The library also keeps a
    separate arena per thread, up to eight per core, which would add up; threads started after this call share one.
    Other C libraries are not affected.
    """
    np.empty(_JUST_BELOW_LIMIT, np.uint8)
    if os.name == "posix":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_M_ARENA_MAX, 1)
