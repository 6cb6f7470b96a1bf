"""A worker process of :mod:`prc_cli.jobs.batch.local`, which classifies one file after another.

It reads tasks from its standard input and writes outcomes to its standard output. Every error is an
outcome. When its input ends, because the parent closed it or died, the worker rolls back the
current file and ends.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from prc_cli.core.classes import Label
from prc_cli.core.errors import ExitCode, OutputExistsError, PrcError
from prc_cli.core.interrupts import AGAIN_S, Interrupts, send_to_main_thread
from prc_cli.core.process import hold_limits, share_arena
from prc_cli.core.profile import peak_memory
from prc_cli.jobs.batch.engine import Compared, Comparison
from prc_cli.jobs.batch.outcomes import (
    CHANGED,
    MEMORY,
    VANISHED,
    Done,
    Failed,
    InputPrint,
    Outcome,
    Problem,
    is_whole,
    recorded_outcome,
    remove_unplaced,
)
from prc_cli.jobs.batch.types import Task
from prc_cli.jobs.classify import classify, load_classifier
from prc_cli.jobs.drive import classify_drive
from prc_cli.jobs.run import Progress, RunSummary

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


# -- one file --------------------------------------------------------------------------------------


def run_item(
    task: Task, *, threads: int = 1, progress: Progress | None = None
) -> tuple[Outcome, ...]:
    """Classify a file, or the files of a drive as one stream; it raises only interrupts."""
    if not task.others:
        return (run_task(task, threads=threads, progress=progress),)
    begun = time.perf_counter()
    cpu = time.process_time()
    before: dict[str, InputPrint] = {}
    ended: list[tuple[Task, RunSummary]] = []
    failed: list[Failed] = []
    try:
        for file in task.files:
            before[file.name] = InputPrint.of(file.source)
        load_classifier(task.config)
        begun = time.perf_counter()
        cpu = time.process_time()
        runs = classify_drive(
            [file.source for file in task.files],
            [file.output for file in task.files],
            task.config,
            progress=progress,
            overwrite=any(file.overwrite for file in task.files),
            threads=threads,
        )
        for summary in runs:
            ended.append((task.files[len(ended)], summary))
    except Exception as error:
        seconds = time.perf_counter() - begun
        for file in task.files[len(ended) :]:
            problem = _problem_of(error, file, before.get(file.name))
            failed.append(Failed(file.name, before.get(file.name), seconds, problem))
    seconds = time.perf_counter() - begun
    cpu = time.process_time() - cpu
    # every file gets its share of the time
    n_shots = sum(summary.counts.n_shots for _, summary in ended) or 1
    done = [
        _done(
            file,
            before[file.name],
            summary,
            seconds * summary.counts.n_shots / n_shots,
            cpu * summary.counts.n_shots / n_shots,
        )
        for file, summary in ended
    ]
    return (*done, *failed)


def run_task(task: Task, *, threads: int = 1, progress: Progress | None = None) -> Outcome:
    """Classify one file; it raises only interrupts."""
    begun = time.perf_counter()
    before: InputPrint | None = None
    try:
        before = InputPrint.of(task.source)
        task.output.parent.mkdir(parents=True, exist_ok=True)
        load_classifier(task.config)
        begun = time.perf_counter()
        cpu = time.process_time()
        summary = _classify(task, threads, progress)
        return _done(task, before, summary, time.perf_counter() - begun, time.process_time() - cpu)
    except Exception as error:
        if before is not None and isinstance(error, OutputExistsError):
            # an earlier attempt finished but could not report: only this run, which has the lock,
            # writes here
            with contextlib.suppress(OSError):
                written = task.output.lstat()
                outcome = recorded_outcome(task, before, written)
                if outcome is not None and is_whole(task.output, written, outcome):
                    return outcome
        return Failed(
            task.name, before, time.perf_counter() - begun, _problem_of(error, task, before)
        )


def _classify(task: Task, threads: int, progress: Progress | None) -> RunSummary:
    # again, if an earlier attempt died just after it had renamed its output
    while True:
        try:
            return classify(
                task.source,
                task.output,
                task.config,
                overwrite=task.overwrite,
                progress=progress,
                threads=threads,
            )
        except OutputExistsError:
            if not remove_unplaced(task):
                raise


def _done(
    task: Task,
    before: InputPrint,
    summary: RunSummary,
    seconds: float,
    cpu_seconds: float,
) -> Done:
    counts = summary.counts
    peak = peak_memory()
    return Done.of(
        task,
        summary.record.as_dict(),
        before.mtime_ns,
        task.output.stat().st_mtime_ns,
        n_shots=counts.n_shots,
        labels=tuple((label.name.lower(), int(counts.labels[label])) for label in Label),
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        peak_mib=None if peak is None else peak / (1 << 20),
    )


def _problem_of(error: Exception, task: Task, before: InputPrint | None) -> Problem:
    """Return why a file failed: by a cause outside the file, which may pass, or by its fault."""
    problem = Problem.of(error)
    if isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and "start new thread" in str(error)
    ):
        hint = "fewer --jobs or threads, or a higher batch.memory_limit"
        return Problem(MEMORY, task.name, f"out of memory ({problem.problem})", hint)
    if isinstance(error, OSError):
        problem = replace(
            problem,
            where=task.name if error.filename is None else os.fsdecode(error.filename),
            problem=error.strerror or str(error),
            hint="check the disk, the name and its permissions",
        )
    elif isinstance(error, PrcError) and isinstance(error.__cause__, OSError):
        problem = replace(problem, kind=type(error.__cause__).__name__)
    elif isinstance(error, ImportError):
        why = f"a package cannot be loaded ({error})"
        problem = Problem(problem.kind, task.name, why, "prc doctor says which")
    elif not isinstance(error, PrcError):
        why = f"{problem.kind}: {problem.problem}"
        problem = Problem(problem.kind, task.name, why, "a fault of prc; please report it")
    if before is None:
        return problem
    try:
        after = InputPrint.of(task.source)
    except OSError as vanished:
        why = f"the input went away while it was read ({vanished.strerror})"
        return Problem(VANISHED, problem.where, why, problem.hint)
    if after != before:  # the change may have caused the error
        hint = "run again when the copy is complete"
        return Problem(CHANGED, str(task.source), "changed while it was read", hint)
    return problem


def _compare(pair: Comparison) -> Compared:
    from prc_cli.jobs.evaluate import evaluate_all

    try:
        evaluation = evaluate_all(
            [pair.predicted], [pair.reference], pair.mapping, options=pair.options
        )
    except (PrcError, OSError, MemoryError) as error:
        return Compared(pair.name, pair.shown, None, Problem.of(error))
    return Compared(pair.name, pair.shown, evaluation.matrix)


# -- the process -----------------------------------------------------------------------------------


class _Parent:
    """Sends messages to the parent, from several threads; finished lines now and then."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self._n_lines = 0
        self._last = 0.0

    def send(self, message: Any) -> None:
        """Send a message, or end the process if the parent has ended."""
        data = pickle.dumps(message)
        try:
            with self._lock:
                self._stream.write(data)
                self._stream.flush()
        except OSError:
            raise SystemExit(ExitCode.TERMINATED) from None

    def count(self, n_lines: int) -> None:
        self._n_lines += n_lines
        if time.monotonic() - self._last >= PROGRESS_S:
            self.send_lines()

    def send_lines(self) -> None:
        if self._n_lines:
            self.send(self._n_lines)
        self._n_lines = 0
        self._last = time.monotonic()


def _serve(
    tasks: queue.SimpleQueue[Any],
    parent: _Parent,
    threads: int,
    limit_mib: int | None,
) -> None:
    while (task := tasks.get()) is not None:
        if isinstance(task, Comparison):
            parent.send((_compare(task),))
            continue
        if limit_mib is not None:
            # the limit does not count the memory of the libraries; an error comes again below
            with contextlib.suppress(Exception):
                load_classifier(task.config)
            _limit_memory(limit_mib)
            limit_mib = None
        outcomes = run_item(task, threads=threads, progress=parent.count)
        parent.send_lines()
        parent.send(outcomes)


def _limit_memory(mib: int) -> None:
    # private memory on Linux, else address space
    import resource

    kind = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    _, hard = resource.getrlimit(kind)
    limit = mib << 20
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(kind, (limit, hard))


def bytes_moved() -> Callable[[], int]:
    """Return a function that measures how much this process has read and written.

    It returns bytes if the system counts them, else CPU time in units of about the same effect.
    """
    counters = Path("/proc/self/io")
    n_bytes_of_counters = 0

    def counted() -> int:
        nonlocal n_bytes_of_counters
        text = counters.read_text(encoding="ascii")
        n_bytes_of_counters += len(text)  # reading the counters moves bytes, too
        n_bytes = 0
        for line in text.splitlines():
            if line.startswith(("rchar", "wchar")):
                n_bytes += int(line.split()[1])
        return n_bytes - n_bytes_of_counters

    try:
        counted()
    except (OSError, ValueError):  # 16 ms of CPU time for one unit of MOVED
        return lambda: int(time.process_time() * 1e6)
    return counted


def beat(report: Callable[[], None], ended: threading.Event) -> None:
    """Report that data is moving although no line is finished, as at the end of a file.

    Runs in a thread.
    """
    moved = bytes_moved()
    last = 0
    while not ended.wait(BEAT_S):
        with contextlib.suppress(OSError, ValueError):
            if (now := moved()) - last >= MOVED:
                last = now
                report()


def _receive(stream: IO[bytes], tasks: queue.SimpleQueue[Any]) -> None:
    """Receive tasks from the parent, in a thread; end the process when the parent has ended."""
    with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            tasks.put(pickle.load(stream))
    tasks.put(None)
    end_soon()


def end_soon() -> None:
    """End the work of the main thread, from another thread; after STOP_S end the process."""
    end = time.monotonic() + STOP_S
    while time.monotonic() < end:
        send_to_main_thread(signal.SIGTERM)
        time.sleep(AGAIN_S)
    os._exit(ExitCode.TERMINATED)


def catch_sigterm() -> None:
    """Let SIGTERM roll back the work of the main thread: once, as further ones would disturb it."""
    interrupts = Interrupts(repeated_s=math.inf)
    interrupts.on(signal.SIGTERM, lambda: SystemExit(ExitCode.TERMINATED))


def main(threads: int, limit_mib: int | None) -> int:
    """Run as a worker process; returns its exit code."""
    catch_sigterm()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    hold_limits()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    share_arena()
    # when memory is short, the system kills a worker, not its parent
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")
    # libraries print to stderr, which the parent keeps for error messages
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    parent = _Parent(out)
    tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
    try:
        threading.Thread(target=_receive, args=(sys.stdin.buffer, tasks), daemon=True).start()
        threading.Thread(
            target=beat, args=(lambda: parent.send(0), threading.Event()), daemon=True
        ).start()
        parent.send(READY)
        _serve(tasks, parent, threads, limit_mib)
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else ExitCode.FAILED
    return ExitCode.DONE


if __name__ == "__main__":
    # all files are closed; unloading the libraries would only take time
    os._exit(main(int(sys.argv[1]), int(sys.argv[2]) or None))
