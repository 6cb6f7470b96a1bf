"""A worker process of :mod:`prc_cli.jobs.batch.local`, which does one file after another.

Every error is an outcome.

It reads tasks from its standard input and writes outcomes to its standard output. When its input
ends, because the parent closed it or died, the current file is rolled back and the process ends.
"""

from __future__ import annotations

import builtins
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

from prc_cli.core.classes import Label
from prc_cli.core.errors import ExitCode, OutputExistsError, PrcError
from prc_cli.core.process import claim_process, hold_limits, raise_or_hold, return_memory
from prc_cli.core.profile import peak_memory
from prc_cli.jobs.batch.plan import is_whole, outcome_of_record, remove_unfinished
from prc_cli.jobs.batch.types import (
    Compared,
    Comparison,
    Done,
    Failed,
    InputPrint,
    Outcome,
    Problem,
    Task,
)
from prc_cli.jobs.classify import Progress, RunSummary, classify, load_classifier
from prc_cli.jobs.drive import classify_drive

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
MEMORY = "memory"
CHANGED = "changed"
VANISHED = "vanished"
"""Kinds of problems that the content of the file does not cause."""


# -- one file ---------------------------------------------------------------------------------------------------------


def run_item(
    task: Task, *, threads: int = 1, progress: Progress | None = None
) -> tuple[Outcome, ...]:
    """Classify one file, or the files of a drive as one stream; only interrupts are raised."""
    if not task.others:
        return (run_task(task, threads=threads, progress=progress),)
    begun = time.perf_counter()
    cpu = time.process_time()
    before: dict[str, InputPrint] = {}
    ended: list[tuple[Task, RunSummary]] = []
    failed: list[Failed] = []
    try:
        for one in task.files:
            before[one.name] = _stat_input(one.source)
        load_classifier(task.config)
        begun = time.perf_counter()
        cpu = time.process_time()
        runs = classify_drive(
            [one.source for one in task.files],
            [one.output for one in task.files],
            task.config,
            progress=progress,
            overwrite=any(one.overwrite for one in task.files),
            threads=threads,
        )
        for summary in runs:
            ended.append((task.files[len(ended)], summary))
    except Exception as error:
        seconds = time.perf_counter() - begun
        for one in task.files[len(ended) :]:
            problem = _problem_of(error, one, before.get(one.name))
            failed.append(Failed(one.name, before.get(one.name), seconds, problem))
    seconds = time.perf_counter() - begun
    cpu = time.process_time() - cpu
    n_shots = sum(summary.counts.n_shots for _, summary in ended) or 1
    return *(
        _done(
            one,
            before[one.name],
            summary,
            *(each * summary.counts.n_shots / n_shots for each in (seconds, cpu)),
        )
        for one, summary in ended
    ), *failed


def run_task(task: Task, *, threads: int = 1, progress: Progress | None = None) -> Outcome:
    """Classify one file; only interrupts are raised."""
    begun = time.perf_counter()
    before: InputPrint | None = None
    try:
        before = _stat_input(task.source)
        task.output.parent.mkdir(parents=True, exist_ok=True)
        load_classifier(task.config)
        begun = time.perf_counter()
        cpu = time.process_time()
        summary = _classify(task, threads, progress)
        return _done(task, before, summary, time.perf_counter() - begun, time.process_time() - cpu)
    except Exception as error:
        if before is not None and isinstance(error, OutputExistsError):
            # an attempt before this one finished and could not report: nobody else writes here, the
            # run has the lock
            with contextlib.suppress(OSError):
                written = task.output.lstat()
                found = outcome_of_record(task, before, written)
                if found is not None and is_whole(task.output, written, found):
                    return found
        return Failed(
            task.name, before, time.perf_counter() - begun, _problem_of(error, task, before)
        )


def _classify(task: Task, threads: int, progress: Progress | None) -> RunSummary:
    """Classify; once more if an attempt before this one died just when its output had got its name."""
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
            if not remove_unfinished(task):
                raise


def _stat_input(path: Path) -> InputPrint:
    """Return size and time of an input, without the hash of its content."""
    status = path.stat()
    return InputPrint(status.st_size, status.st_mtime_ns, None)


def _done(
    task: Task,
    before: InputPrint,
    summary: RunSummary,
    seconds: float,
    cpu_seconds: float,
) -> Done:
    record = summary.record
    counts = summary.counts
    written = task.output.stat()
    peak = peak_memory()
    return Done(
        name=task.name,
        input=InputPrint(record.input.size, before.mtime_ns, record.input.sha256),
        output_size=written.st_size,
        output_mtime_ns=written.st_mtime_ns,
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        peak_mib=None if peak is None else peak / (1 << 20),
        n_lines=counts.n_lines,
        n_shots=counts.n_shots,
        n_records=record.n_records or 0,
        labels=tuple((label.name.lower(), int(counts.labels[label])) for label in Label),
        notices=record.notices,
        output_name=task.output.name,
        output_sha256=None if record.output is None else record.output.sha256,
    )


def _problem_of(error: Exception, task: Task, before: InputPrint | None) -> Problem:
    """Return why a file failed: separates causes outside the file, which may pass, from faults of the file."""
    found = Problem.of(error)
    if isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and "start new thread" in str(error)
    ):
        hint = "fewer --jobs or threads, or a higher --memory-limit"
        return Problem(MEMORY, task.name, f"out of memory ({found.problem})", hint)
    if isinstance(error, OSError):
        where = os.fsdecode(error.filename) if error.filename is not None else task.name
        found = Problem(
            found.kind,
            where,
            error.strerror or str(error),
            "check the disk, the name and its permissions",
        )
    elif isinstance(error, PrcError) and isinstance(error.__cause__, OSError):
        found = Problem(type(error.__cause__).__name__, found.where, found.problem, found.hint)
    elif isinstance(error, ImportError):
        found = Problem(
            found.kind, task.name, f"a package cannot be loaded ({error})", "prc doctor says which"
        )
    elif not isinstance(error, PrcError):
        found = Problem(
            found.kind,
            task.name,
            f"{found.kind}: {found.problem}",
            "a fault of prc; please report it",
        )
    if before is None:
        return found
    try:
        after = _stat_input(task.source)
    except OSError as gone:
        return Problem(
            VANISHED,
            found.where,
            f"the input went away while it was read ({gone.strerror})",
            found.hint,
        )
    if after != before:  # the change may have caused the error
        hint = "run again when the copy is complete"
        return Problem(CHANGED, str(task.source), "changed while it was read", hint)
    return found


def may_pass(problem: Problem) -> bool:
    """Tell whether another attempt may help; not for damaged files and wrong configurations.

    >>> may_pass(Problem("killed", "a.laz", "")), may_pass(Problem("InputError", "a.laz", "cut short"))
    (True, False)
    """
    if problem.kind in (
        "killed",
        "timeout",
        "interrupted",
        "OutputError",
        MEMORY,
        CHANGED,
        VANISHED,
    ):
        return True
    return problem.kind.isidentifier() and issubclass(
        getattr(builtins, problem.kind, object), OSError
    )


def _compare(pair: Comparison) -> Compared:
    """Compare an output with its reference."""
    from prc_cli.jobs.evaluate import evaluate_all

    try:
        found = evaluate_all([pair.predicted], [pair.reference], pair.mapping, options=pair.options)
    except (PrcError, OSError, MemoryError) as error:
        return Compared(pair.name, pair.shown, None, Problem.of(error))
    return Compared(pair.name, pair.shown, found.matrix)


# -- the process ------------------------------------------------------------------------------------------------------


class _Interrupts:
    """Raises SystemExit in the main thread, once, and again only where Python dropped it."""

    def __init__(self) -> None:
        self._armed = True
        signal.signal(signal.SIGTERM, self._handle)
        sys.unraisablehook = self._dropped

    def _handle(self, number: int, frame: object) -> None:
        if self._armed:
            self._armed = False
            raise_or_hold(SystemExit(ExitCode.TERMINATED))

    def _dropped(self, dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, SystemExit):
            self._armed = True
        else:
            sys.__unraisablehook__(dropped)

    def end(self) -> None:
        """End the main thread's work, from another thread.

        The process ends however long that takes.
        """
        end = time.monotonic() + STOP_S
        main = threading.main_thread().ident
        while time.monotonic() < end:
            if hasattr(signal, "pthread_kill") and main is not None:
                signal.pthread_kill(main, signal.SIGTERM)
            else:
                signal.raise_signal(signal.SIGTERM)
            time.sleep(AGAIN_S)
        os._exit(ExitCode.TERMINATED)


class _Parent:
    """Sends messages to the parent, from several threads; finished lines now and then."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self._n_lines = 0
        self._last = 0.0

    def send(self, message: Any) -> None:
        """Send a message; end the process when the parent is gone."""
        data = pickle.dumps(message)
        try:
            with self._lock:
                self._stream.write(data)
                self._stream.flush()
        except OSError:
            raise SystemExit(ExitCode.TERMINATED) from None

    def count(self, n_lines: int) -> None:
        """Count finished lines."""
        self._n_lines += n_lines
        if time.monotonic() - self._last >= PROGRESS_S:
            self.send_lines()

    def send_lines(self) -> None:
        """Report the lines that were counted."""
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
    """Do one task after the other until no more come."""
    while (task := tasks.get()) is not None:
        if isinstance(task, Comparison):
            parent.send((_compare(task),))
            continue
        if limit_mib is not None:
            with contextlib.suppress(
                Exception
            ):  # the same error comes again, and is reported, with the file
                load_classifier(task.config)  # memory of the libraries does not count
            _limit_memory(limit_mib)
            limit_mib = None
        outcomes = run_item(task, threads=threads, progress=parent.count)
        parent.send_lines()
        parent.send(outcomes)


def _limit_memory(mib: int) -> None:
    """Limit what this process may allocate: private memory on Linux, else address space."""
    import resource

    kind = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    _, hard = resource.getrlimit(kind)
    wanted = mib << 20
    resource.setrlimit(
        kind, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard)
    )


def bytes_moved() -> Callable[[], int]:
    """Return a function that tells how much this process has moved.

    Bytes where the system tells, else CPU time.
    """
    place = Path("/proc/self/io")
    own = 0

    def counted() -> int:
        nonlocal own
        text = place.read_text(encoding="ascii")
        own += len(text)  # reading this moves bytes, too
        return (
            sum(
                int(line.split()[1])
                for line in text.splitlines()
                if line.startswith(("rchar", "wchar"))
            )
            - own
        )

    try:
        counted()
    except (OSError, ValueError):  # 16 ms of CPU time for one unit of MOVED
        return lambda: int(time.process_time() * 1e6)
    return counted


def beat(tell: Callable[[], None], ended: threading.Event) -> None:
    """Tell that data is moving although no line is finished, as at the end of a file.

    In a thread.
    """
    moved = bytes_moved()
    last = 0
    while not ended.wait(BEAT_S):
        with contextlib.suppress(OSError, ValueError):
            if (now := moved()) - last >= MOVED:
                last = now
                tell()


def _receive(stream: IO[bytes], tasks: queue.SimpleQueue[Any], interrupts: _Interrupts) -> None:
    """Receive tasks from the parent, in a thread; end the process when the parent is gone."""
    with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            tasks.put(pickle.load(stream))
    tasks.put(None)
    interrupts.end()


def main(threads: int, limit_mib: int | None) -> int:
    """Run as a worker process; returns its exit code."""
    interrupts = _Interrupts()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    hold_limits()
    claim_process()
    return_memory()  # before any thread: else every file's threads keep memory of their own
    with contextlib.suppress(
        OSError
    ):  # when memory is short, the system kills a worker, not its parent
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")
    # what libraries print goes to stderr, which the parent keeps for error messages
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    parent = _Parent(out)
    tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
    try:
        threading.Thread(
            target=_receive, args=(sys.stdin.buffer, tasks, interrupts), daemon=True
        ).start()
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
