"""Tells the C library when to return freed memory to the system, and when to reuse it for the next block."""

from __future__ import annotations

import ctypes
import os

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""From glibc's ``malloc.h``."""
_SMALL, _LARGE, _KEPT = 1 << 17, (1 << 25) - (1 << 16), 1 << 26
"""Bytes: what glibc maps by itself at the start, the most that it may be told to, and the most that it keeps."""


def return_memory() -> None:
    """Let the C library return every large array as it is freed; the first time before any thread.

    What is read to look at an input does not stay beside the blocks then. The library also keeps a separate arena per
    thread, up to eight per core, which would add up; threads started after this call share one. Other C libraries are
    not affected.
    """
    _tell(_M_ARENA_MAX, 1)
    _tell(_M_MMAP_THRESHOLD, _SMALL)
    _tell(_M_TRIM_THRESHOLD, _SMALL)


def keep_memory() -> None:
    """Let the C library keep up to 64 MiB of freed memory for the next arrays.

    Requesting the pages of a block again takes longer than the computation on images of a few hundred kilobytes.
    """
    _tell(_M_ARENA_MAX, 1)
    _tell(_M_MMAP_THRESHOLD, _LARGE)
    _tell(_M_TRIM_THRESHOLD, _KEPT)


def _tell(what: int, value: int) -> None:
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        mallopt(what, value)
