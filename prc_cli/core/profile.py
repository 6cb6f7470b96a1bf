"""Time spent per stage of a run; measured only inside :func:`profiling`.

A stage is a function decorated with :func:`stage`, or a ``with timed(...)`` block. Without
:func:`profiling` either costs one comparison. Times exclude those of nested stages.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")

_NOTHING: AbstractContextManager[None] = nullcontext()


@dataclass(frozen=True, slots=True)
class StageTime:
    """Time of one stage, summed over threads."""

    name: str
    wall_s: float
    """Elapsed time, summed over threads that ran at the same time [s]."""
    cpu_s: float
    """Processor time of the threads that ran it [s]; excludes threads started by libraries."""
    calls: int


class Profile:
    """Times of the stages of a run; see :func:`profiling`."""

    def __init__(self) -> None:
        self._start = time.perf_counter(), time.process_time()
        self._end: tuple[float, float] | None = None
        self._times: dict[str, tuple[float, float, int]] = {}
        self._lock = threading.Lock()
        self._inside = threading.local()

    @property
    def wall_s(self) -> float:
        """Elapsed time from begin to end, or so far [s]."""
        return (time.perf_counter() if self._end is None else self._end[0]) - self._start[0]

    @property
    def cpu_s(self) -> float:
        """Processor time of the process in this interval, all threads [s]."""
        return (time.process_time() if self._end is None else self._end[1]) - self._start[1]

    def stages(self) -> tuple[StageTime, ...]:
        """Return the stages, in the order in which they first ended."""
        with self._lock:
            return tuple(StageTime(name, *times) for name, times in self._times.items())

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Add the time of the ``with`` block to a stage."""
        stack: list[list[float]] = self._inside.__dict__.setdefault("stack", [])
        stack.append([0.0, 0.0])
        wall = time.perf_counter()
        cpu = time.thread_time()
        try:
            yield
        finally:
            wall = time.perf_counter() - wall
            cpu = time.thread_time() - cpu
            within = stack.pop()
            if stack:
                stack[-1][0] += wall
                stack[-1][1] += cpu
            with self._lock:
                before = self._times.get(name, (0.0, 0.0, 0))
                self._times[name] = (
                    before[0] + wall - within[0],
                    before[1] + cpu - within[1],
                    before[2] + 1,
                )

    def end(self) -> None:
        """Stop the clock."""
        self._end = time.perf_counter(), time.process_time()


class _Active:
    """The profile being recorded, if any; one per process, because a run has many threads."""

    profile: Profile | None = None


@contextmanager
def profiling() -> Iterator[Profile]:
    """Time the stages that run inside the ``with`` block, in all threads."""
    before = _Active.profile
    _Active.profile = Profile()
    try:
        yield _Active.profile
    finally:
        _Active.profile.end()
        _Active.profile = before


def timed(name: str) -> AbstractContextManager[None]:
    """Return a context that is timed as a stage, if inside :func:`profiling`."""
    profile = _Active.profile
    return _NOTHING if profile is None else profile.timed(name)


def stage(name: str) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Decorate a function so that its calls are timed as a stage.

    >>> @stage("doubling")
    ... def double(n: int) -> int:
    ...     return 2 * n
    >>> with profiling() as profile:
    ...     _ = double(2) + double(3)
    >>> profile.stages()[0].calls
    2
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        @wraps(function)
        def call(*arguments: _P.args, **named: _P.kwargs) -> _T:
            profile = _Active.profile
            if profile is None:
                return function(*arguments, **named)
            with profile.timed(name):
                return function(*arguments, **named)

        return call

    return decorate


def timed_items(items: Iterable[_T], name: str) -> Iterator[_T]:
    """Yield items; producing each is timed as a stage."""
    source = iter(items)
    try:
        while True:
            with timed(name):
                try:
                    item = next(source)
                except StopIteration:
                    return
            yield item
            del item
    finally:
        close = getattr(source, "close", None)
        if close is not None:
            close()


def peak_memory() -> int | None:
    """Return the peak memory of the process [bytes]; None where the system does not report it."""
    try:
        # getrusage would include the process that started this one
        with Path("/proc/self/status").open(encoding="ascii", errors="replace") as status:
            return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        pass
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
