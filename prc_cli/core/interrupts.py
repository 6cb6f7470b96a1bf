"""Delays Ctrl-C and SIGTERM until compiled code has returned.

Python may run a signal handler while the arguments of a compiled loop are unpacked. An exception there leaves the
loop's caller with a broken result. So the signal handlers of the command line call :func:`raise_or_hold`, which raises
at once, or, inside a :func:`held` function, when that function ends.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


class _Held(threading.local):
    """State per thread: signals are handled in the main thread, which must not wait for loops of other threads."""

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
                error, _STATE.pending = _STATE.pending, None
                raise error
        return result

    return call
