"""A worker process of :mod:`prc_cli.jobs.batch.local`, which classifies one file after another.

It reads tasks from its standard input and writes outcomes to its standard output. When its input ends, because the
parent closed it or died, the current file is rolled back and the process ends.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from prc_cli.core.interrupts import raise_or_hold
from prc_cli.core.limits import hold_limits
from prc_cli.core.memory import return_memory
from prc_cli.core.process import claim_process
from prc_cli.jobs.batch.types import Outcome, Task
from prc_cli.jobs.batch.work import run_task
from prc_cli.jobs.classify import load_classifier

READY = "ready"
"""First message of a worker."""
BEAT_S = 1.0
"""How often a worker checks whether it has moved data [s]."""
PROGRESS_S = 0.2
"""Finished lines are reported at most so often [s]."""
MOVED = 1 << 14
"""So many bytes read or written are a sign of life [bytes]; looking itself moves a few hundred."""
STOP_S = 5.0
"""How long a worker that must end may take to remove its temporary files [s]."""
AGAIN_S = 0.05
"""An interrupt that Python dropped is raised again so much later [s]."""
ENDED = 128 + signal.SIGTERM


class _Interrupts:
    """Raises SystemExit in the main thread, once, and again only where Python dropped it."""

    def __init__(self) -> None:
        self._armed = True
        signal.signal(signal.SIGTERM, self._handle)
        sys.unraisablehook = self._dropped

    def _handle(self, number: int, frame: object) -> None:
        if self._armed:
            self._armed = False
            raise_or_hold(SystemExit(ENDED))

    def _dropped(self, dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, SystemExit):
            self._armed = True
        else:
            sys.__unraisablehook__(dropped)

    def end(self) -> None:
        """End the main thread's work, from another thread; the process ends however long that takes."""
        end = time.monotonic() + STOP_S
        main = threading.main_thread().ident
        while time.monotonic() < end:
            if hasattr(signal, "pthread_kill") and main is not None:
                signal.pthread_kill(main, signal.SIGTERM)
            else:
                signal.raise_signal(signal.SIGTERM)
            time.sleep(AGAIN_S)
        os._exit(ENDED)


class _Parent:
    """Sends messages to the parent; from several threads."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._lock = threading.Lock()

    def send(self, message: Any) -> None:
        """Send a message; end the process when the parent is gone."""
        data = pickle.dumps(message)
        try:
            with self._lock:
                self._stream.write(data)
                self._stream.flush()
        except OSError:
            raise SystemExit(ENDED) from None


class _Lines:
    """Counts finished lines and reports them now and then."""

    def __init__(self, parent: _Parent) -> None:
        self._parent = parent
        self._waiting = 0
        self._last = 0.0

    def __call__(self, n_lines: int) -> None:
        self._waiting += n_lines
        now = time.monotonic()
        if now - self._last >= PROGRESS_S:
            self.flush()
            self._last = now

    def flush(self) -> None:
        if self._waiting:
            self._parent.send(self._waiting)
            self._waiting = 0


def _serve(tasks: queue.SimpleQueue[Task | None], parent: _Parent, threads: int, limit_mib: int | None) -> None:
    """Do one task after the other until no more come."""
    limited = False
    while (task := tasks.get()) is not None:
        if limit_mib is not None and not limited:
            with contextlib.suppress(Exception):  # the same error comes again, and is reported, with the file
                load_classifier(task.config)  # memory of the libraries does not count
            limit_memory(limit_mib)
            limited = True
        lines = _Lines(parent)
        outcome: Outcome = run_task(task, threads=threads, progress=lines)
        lines.flush()
        parent.send(outcome)


def limit_memory(mib: int) -> None:
    """Limit what this process may allocate; beyond it Python raises MemoryError.

    On Linux private memory counts (code, mapped files and address space that is only reserved do not), elsewhere
    address space.
    """
    import resource

    kind = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    _, hard = resource.getrlimit(kind)
    wanted = mib << 20
    resource.setrlimit(kind, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))


def bytes_moved() -> Callable[[], int]:
    """Return a function that tells how much this process has moved: bytes where the system tells, else CPU time."""
    place = Path("/proc/self/io")
    own = 0

    def counted() -> int:
        nonlocal own
        text = place.read_text(encoding="ascii")
        moved = sum(int(line.split()[1]) for line in text.splitlines() if line.startswith(("rchar", "wchar")))
        moved -= own
        own += len(text)
        return moved

    try:
        counted()
    except (OSError, ValueError):  # 16 ms of CPU time for one unit of MOVED
        return lambda: int(time.process_time() * 1e6)
    return counted


def _beat(parent: _Parent) -> None:
    """Tell the parent that data is moving although no line is finished, as at the end of a file; in a thread."""
    moved = bytes_moved()
    last = moved()
    while True:
        time.sleep(BEAT_S)
        with contextlib.suppress(OSError, ValueError):
            now = moved()
            if now - last >= MOVED:
                last = now
                parent.send(0)


def _receive(stream: IO[bytes], tasks: queue.SimpleQueue[Task | None], interrupts: _Interrupts) -> None:
    """Receive tasks from the parent, in a thread; end the process when the parent is gone."""
    while True:
        try:
            task = pickle.load(stream)
        except (EOFError, OSError, pickle.UnpicklingError):
            break
        tasks.put(task)
    tasks.put(None)
    interrupts.end()


def main(threads: int, limit_mib: int | None) -> int:
    """Run as a worker process; returns its exit code."""
    interrupts = _Interrupts()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    hold_limits()
    claim_process()
    return_memory()  # before any thread: else every file's threads keep memory of their own
    with contextlib.suppress(OSError):  # when memory is short, the system kills a worker, not its parent
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")
    # what libraries print goes to stderr, which the parent keeps for error messages
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    parent = _Parent(out)
    tasks: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
    code = 0
    try:
        threading.Thread(target=_receive, args=(sys.stdin.buffer, tasks, interrupts), daemon=True).start()
        threading.Thread(target=_beat, args=(parent,), daemon=True).start()
        parent.send(READY)
        _serve(tasks, parent, threads, limit_mib)
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    return code


if __name__ == "__main__":
    # all files are closed; unloading the libraries would only take time
    os._exit(main(int(sys.argv[1]), int(sys.argv[2]) or None))
