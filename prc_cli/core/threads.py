"""Worker threads with results in order, and bounded queues between threads.

Compiled loops, decompression and file access release the interpreter's lock, so threads are enough.
Results and their order do not depend on the number of threads.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from pathlib import Path
from types import TracebackType
from typing import Generic, TypeVar

from prc_cli.core.profile import timed

_A = TypeVar("_A")
_B = TypeVar("_B")

TICK_S = 0.2
"""Longest wait before signals are handled [s]; on POSIX signals interrupt waits at once."""
PATIENCE_S = 5.0
"""How long closing waits for a reader thread to end [s]."""
_CGROUP = Path("/sys/fs/cgroup")


def default_threads() -> int:
    """Return the number of cores of this process, by its affinity and its container's quota."""
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        cores = os.cpu_count() or 1
    quota = _quota(_CGROUP)
    return max(1, cores if quota is None else min(cores, math.ceil(quota)))


def share_cores(jobs: int | None, threads: int | None, n_files: int) -> tuple[int, int]:
    """Return the number of files at a time, and of threads for each.

    >>> share_cores(2, 3, n_files=10), share_cores(4, 1, n_files=2)
    ((2, 3), (2, 1))
    """
    cores = default_threads()
    n_workers = max(1, min(jobs or cores, max(1, n_files)))
    return n_workers, threads or max(1, cores // n_workers)


def _quota(folder: Path) -> float | None:
    """Read the cores that a control group (version 2, then 1) allows; None = no limit."""
    try:
        share, period = (folder / "cpu.max").read_text(encoding="ascii").split()
    except (OSError, ValueError):
        try:
            share, period = (
                (folder / "cpu" / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period")
            )
        except OSError:
            return None
    try:
        quota = float(share) / float(period)
    except (ValueError, ZeroDivisionError):  # "max": no limit
        return None
    return quota if quota > 0 else None


def ordered(
    function: Callable[[_A], _B],
    items: Iterable[_A],
    *,
    threads: int,
    ahead: int | None = None,
) -> Iterator[_B]:
    """Apply a function to items in worker threads; yield the results in the order of the items."""
    source = iter(items)
    try:
        if threads <= 1:
            for item in source:
                yield function(item)
        else:
            yield from _in_threads(
                function, source, threads, max(1, 2 * threads if ahead is None else ahead)
            )
    finally:
        close_items(source)


def _in_threads(
    function: Callable[[_A], _B],
    items: Iterator[_A],
    threads: int,
    ahead: int,
) -> Iterator[_B]:
    pending: deque[Future[_B]] = deque()
    error: Exception | None = None
    more = True
    pool = ThreadPoolExecutor(threads)
    try:
        while True:
            while more and len(pending) < ahead:
                try:
                    item = next(items)
                except StopIteration:
                    more = False
                except Exception as raised:  # the results before it come first
                    more = False
                    error = raised
                else:
                    pending.append(pool.submit(function, item))
                    del item
            if not pending:
                break
            yield _wait(pending.popleft())
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    if error is not None:
        raise error


def _wait(future: Future[_B]) -> _B:
    """Wait for a result, handling signals meanwhile on every system."""
    while not future.done():
        try:
            return future.result(TICK_S)
        except TimeoutError:
            # either the wait timed out, or the job raised TimeoutError: result() below raises it
            continue
    return future.result()


class Relay(Generic[_A]):
    """A value handed from job to job across threads, in the order of their turns 0, 1, 2 ..."""

    def __init__(self, value: _A) -> None:
        self._value = value
        self._turn = 0
        self._broken_at: int | None = None
        self._changed = threading.Condition()

    def take_turn(self, turn: int, function: Callable[[_A], tuple[_B, _A]]) -> tuple[_B, _A]:
        """Wait for a turn, then call the function: value -> (result, value of the next turn)."""
        with self._changed:
            while self._turn != turn and not self._is_broken(turn):
                with timed("waiting for the block before"):
                    self._changed.wait(TICK_S)
            if self._is_broken(turn):
                raise RelayBrokenError
            value = self._value
        try:
            result, value = function(value)
        except BaseException:
            self.give_up(turn)
            raise
        with self._changed:
            self._value = value
            self._turn = turn + 1
            self._changed.notify_all()
        return result, value

    def give_up(self, turn: int) -> None:
        """Make all later turns fail with RelayBrokenError; to be called by a job that fails."""
        with self._changed:
            self._broken_at = turn if self._broken_at is None else min(turn, self._broken_at)
            self._changed.notify_all()

    def _is_broken(self, turn: int) -> bool:
        return self._broken_at is not None and turn > self._broken_at


class RelayBrokenError(Exception):
    """A job before this one failed; the caller of :func:`ordered` gets the error of that job."""


class _Channel(Generic[_A]):
    """A bounded queue between two threads; the sender may end it, the receiver may cancel it."""

    def __init__(self, depth: int) -> None:
        self._items: deque[_A] = deque()
        self._depth = max(1, depth)
        self._changed = threading.Condition()
        self._ended = False
        self._cancelled = False
        self._error: BaseException | None = None

    def put(self, item: _A) -> bool:
        """Append an item when there is room; False if the receiver has cancelled."""
        with self._changed:
            while len(self._items) >= self._depth and not self._cancelled:
                self._changed.wait(TICK_S)
            if self._cancelled:
                return False
            self._items.append(item)
            self._changed.notify_all()
            return True

    def end(self, error: BaseException | None = None) -> None:
        """End the queue: no more items come. ``error`` is raised in the receiver."""
        with self._changed:
            self._ended = True
            self._error = error
            self._changed.notify_all()

    def cancel(self) -> None:
        """Cancel the queue: waiting items are dropped, and no more are accepted."""
        with self._changed:
            self._cancelled = True
            self._items.clear()
            self._changed.notify_all()

    def __iter__(self) -> Iterator[_A]:
        while True:
            with self._changed:
                while not (self._items or self._ended or self._cancelled):
                    self._changed.wait(TICK_S)
                if not self._items:
                    break
                item = self._items.popleft()
                self._changed.notify_all()
            yield item
            del item
        if self._error is not None and not self._cancelled:
            raise self._error


def read_ahead(
    items: Iterable[_A], *, depth: int = 2, patience_s: float = PATIENCE_S
) -> Iterator[_A]:
    """Run an iterator in its own thread, a few items ahead of the consumer."""
    channel: _Channel[_A] = _Channel(depth)

    def run() -> None:
        source = iter(items)
        error: BaseException | None = None
        try:
            for item in source:
                if not channel.put(item):
                    break
                del item
            close_items(source)
        except BaseException as raised:  # raised again in the consumer's thread
            error = raised
        channel.end(error)

    # a daemon: a read from a pipe that never comes back must not keep the program from ending
    thread = threading.Thread(
        target=copy_context().run, args=(run,), name="read-ahead", daemon=True
    )
    thread.start()
    try:
        yield from channel
    finally:
        channel.cancel()
        thread.join(patience_s)


class write_behind(Generic[_A]):  # noqa: N801  it is used like a function
    """Pass items to a sink that runs in its own thread."""

    def __init__(self, sink: Callable[[_A], object], *, depth: int = 2) -> None:
        self._channel: _Channel[_A] = _Channel(depth)
        self._sink = sink
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="write-behind", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            for item in self._channel:
                self._sink(item)
                del item
        except BaseException as raised:  # raised again by put() or close()
            self._error = raised
            self._channel.cancel()

    def put(self, item: _A) -> None:
        """Queue an item; raises the sink's error for an earlier one."""
        if not self._channel.put(item):
            self.close()
            msg = "put() after abort()"
            raise RuntimeError(msg)

    def close(self) -> None:
        """Wait until all items are written; raises the sink's error."""
        self._channel.end()
        self._join()
        if self._error is not None:
            error = self._error
            self._error = None
            raise error

    def abort(self) -> None:
        """Drop the waiting items and wait for the one in progress; its error is not raised."""
        self._channel.cancel()
        self._join()

    def _join(self) -> None:
        while self._thread.is_alive():
            self._thread.join(TICK_S)

    def __enter__(self) -> write_behind[_A]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def drain(messages: queue.SimpleQueue[_A]) -> list[_A]:
    """Take all messages from a queue; wait at most :data:`TICK_S` for the first.

    >>> messages: queue.SimpleQueue[int] = queue.SimpleQueue()
    >>> messages.put(1)
    >>> messages.put(2)
    >>> drain(messages)
    [1, 2]
    """
    taken = []
    with contextlib.suppress(queue.Empty):
        taken.append(messages.get(timeout=TICK_S))
        while True:
            taken.append(messages.get_nowait())
    return taken


def close_items(items: Iterator[object]) -> None:
    """Close a generator now instead of when it is garbage-collected."""
    close = getattr(items, "close", None)
    if close is not None:
        close()


@contextlib.contextmanager
def closing_items(items: Iterator[_A]) -> Iterator[Iterator[_A]]:
    """Close a generator at the end of a ``with``: its reader may have threads."""
    try:
        yield items
    finally:
        close_items(items)
