"""The running process: its garbage collector, the limits of a decoding step, and its memory.

Limits are switched on in processes that a crash may end: the child of a command and the workers of
``prc batch`` (:mod:`prc_cli.core.child`). A step that needs more processor time ends the process
(SIGXCPU), more memory is a ``MemoryError``.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

_T = TypeVar("_T")


class _State:
    limits_hold = False


@contextlib.contextmanager
def no_collecting() -> Iterator[None]:
    """Switch the garbage collector off, as while packages are loaded: their many objects stay."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


STEP_CPU_S = 60
"""Most processor time of a step, of all threads [s]."""
SPARE_BYTES = 1 << 30
BYTES_PER_BYTE = 64
"""A step may take so much memory, and so many times the size of its file [bytes]."""


def hold_limits() -> None:
    """Hold the limits in this process from now on, where the system can."""
    _State.limits_hold = sys.platform == "linux"


@contextlib.contextmanager
def step(path: Path) -> Iterator[None]:
    """Hold the limits while a library decodes a part of a file."""
    if not _State.limits_hold:
        yield
        return
    import resource

    with open("/proc/self/statm", "rb") as handle:  # noqa: PTH123 - once a step
        used = int(handle.read().split()[5]) * resource.getpagesize()
    most = {
        resource.RLIMIT_CPU: int(time.process_time()) + STEP_CPU_S,
        resource.RLIMIT_DATA: used + SPARE_BYTES + BYTES_PER_BYTE * path.stat().st_size,
    }
    before = {kind: resource.getrlimit(kind) for kind in most}
    for kind, (soft, hard) in before.items():
        limit = most[kind] if soft == resource.RLIM_INFINITY else min(most[kind], soft)
        resource.setrlimit(kind, (limit, hard))
    try:
        yield
    finally:
        for kind, limits in before.items():
            resource.setrlimit(kind, limits)


def bounded(path: Path, parts: Iterator[_T]) -> Iterator[_T]:
    """Yield the parts of a file; the decoding of each is a :func:`step`.

    >>> list(bounded(Path("a.bag"), iter("ab")))
    ['a', 'b']
    """
    end = object()
    while True:
        with step(path):
            part = next(parts, end)
        if part is end:
            return
        yield part  # type: ignore[misc]


_M_ARENA_MAX = -8
"""From glibc's ``malloc.h``."""


def share_arena() -> None:
    """Let threads that start later share freed memory: else each keeps its own.

    It saves 12 MB of a small file's 229.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)
