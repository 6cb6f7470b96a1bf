"""The running process: its owner, the limits of a decoding step, and its memory.

Limits are switched on in processes that a crash may end: the child of a command and the workers of
``prc batch`` (:mod:`prc_cli.core.child`). A step that needs more processor time ends the process
(SIGXCPU), more memory is a ``MemoryError``.

Python may run a signal handler while the arguments of a compiled loop are unpacked. An exception
there leaves the loop's caller with a broken result. So the signal handlers of the command line call
:func:`raise_or_hold`, which raises at once, or, inside a :func:`held` function, when that function
ends.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

_T = TypeVar("_T")


class _State:
    is_own = limits_hold = False


def claim_process() -> None:
    """Declare that the command owns this process: packages load without parts it never uses."""
    _State.is_own = True
    # pydantic then does not look through all installed packages for plugins
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")


def is_own_process() -> bool:
    """Whether :func:`claim_process` was called.

    >>> is_own_process()
    False
    """
    return _State.is_own


_HIDING = threading.RLock()
"""Held while modules are hidden: two threads at once would each bring back what the other hides."""


@contextlib.contextmanager
def absent(*unneeded: str, always: tuple[str, ...] = ()) -> Iterator[None]:
    """Hide modules while a package is loaded; unneeded ones in the command's own process alone."""
    modules: dict[str, Any] = sys.modules
    with _HIDING:
        hidden = always + tuple(
            name for name in unneeded if is_own_process() and name not in modules
        )
        before = {name: modules[name] for name in hidden if name in modules}
        modules.update(dict.fromkeys(hidden))
        try:
            yield
        finally:
            for name in hidden:
                modules.pop(name, None)
            modules.update(before)


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


_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
"""From glibc's ``malloc.h``."""
_SMALL = 1 << 17
_LARGE = (1 << 25) - (1 << 16)
_KEPT = 1 << 26
"""glibc's first threshold for mapping, the largest that can be set, and the most kept free
[bytes]."""


def return_memory() -> None:
    """Let the C library return large arrays as they are freed; later threads share one arena."""
    _set_malloc(_M_ARENA_MAX, 1)
    _set_malloc(_M_MMAP_THRESHOLD, _SMALL)
    _set_malloc(_M_TRIM_THRESHOLD, _SMALL)


def keep_memory() -> None:
    """Let the C library keep up to 64 MiB of freed memory: new pages take longer."""
    _set_malloc(_M_ARENA_MAX, 1)
    _set_malloc(_M_MMAP_THRESHOLD, _LARGE)
    _set_malloc(_M_TRIM_THRESHOLD, _KEPT)


def _set_malloc(parameter: int, value: int) -> None:
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        mallopt(parameter, value)


_P = ParamSpec("_P")


class _Held(threading.local):
    """State per thread: the main thread handles signals, and does not wait for other loops."""

    depth = 0
    pending: BaseException | None = None


_STATE = _Held()


def raise_or_hold(error: BaseException) -> None:
    """Raise now, or when the running compiled code has ended; for signal handlers."""
    if _STATE.depth:
        _STATE.pending = error
        return
    raise error


def held(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Wrap a function so that interrupts are raised only after it has ended."""

    @wraps(function)
    def call(*arguments: _P.args, **named: _P.kwargs) -> _T:
        _STATE.depth += 1
        try:
            result = function(*arguments, **named)
        finally:
            _STATE.depth -= 1
            if not _STATE.depth and _STATE.pending is not None:
                error = _STATE.pending
                _STATE.pending = None
                raise error
        return result

    return call
