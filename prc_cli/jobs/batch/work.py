"""Classify one file in this process; every error becomes an outcome, only interrupts are raised."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from pathlib import Path

from prc_cli.core.classes import Label
from prc_cli.core.errors import OutputExistsError, PrcError
from prc_cli.jobs.batch.plan import is_whole, outcome_of_record, remove_unfinished
from prc_cli.jobs.batch.types import (
    Done,
    Failed,
    InputPrint,
    Outcome,
    Problem,
    Task,
)
from prc_cli.jobs.classify import (
    Progress,
    RunSummary,
    classify,
    load_classifier,
)

MEMORY, CHANGED, VANISHED = "memory", "changed", "vanished"
"""Kinds of problems that the content of the file does not cause."""


def run_task(task: Task, *, threads: int = 1, progress: Progress | None = None) -> Outcome:
    """Classify one file."""
    begun = time.perf_counter()
    before: InputPrint | None = None
    try:
        before = stat_input(task.source)
        task.output.parent.mkdir(parents=True, exist_ok=True)
        load_classifier(task.config)
        begun, cpu = time.perf_counter(), time.process_time()
        _reset_peak()
        summary = _classify(task, threads, progress)
        return _done(task, before, summary, time.perf_counter() - begun, time.process_time() - cpu)
    except Exception as error:
        if before is not None and isinstance(error, OutputExistsError):
            found = _written_before(task, before)
            if found is not None:
                return found
        return Failed(task.name, before, time.perf_counter() - begun, problem_of(error, task, before))


def _classify(task: Task, threads: int, progress: Progress | None) -> RunSummary:
    """Classify; once more if an attempt before this one died just when its output had got its name."""
    for again in (True, False):
        try:
            return classify(
                task.source, task.output, task.config, overwrite=task.overwrite, progress=progress, threads=threads
            )
        except OutputExistsError:
            if not (again and remove_unfinished(task)):
                raise
    raise AssertionError  # the second attempt returns or raises


def _written_before(task: Task, before: InputPrint) -> Done | None:
    """Return the outcome of an output that an attempt before this one finished, but could not report.

    A scheduler repeats an order whose worker was lost. Nobody else writes here: the run has the lock.
    """
    try:
        written = task.output.lstat()
    except OSError:
        return None
    found = outcome_of_record(task, before, written)
    return found if found is not None and is_whole(task.output, written, found) else None


def stat_input(path: Path) -> InputPrint:
    """Return size and time of an input, without the hash of its content."""
    status = path.stat()
    return InputPrint(status.st_size, status.st_mtime_ns, None)


def _done(task: Task, before: InputPrint, summary: RunSummary, seconds: float, cpu_seconds: float) -> Done:
    record, counts = summary.record, summary.counts
    written = task.output.stat()
    return Done(
        name=task.name,
        input=InputPrint(record.input.size, before.mtime_ns, record.input.sha256),
        output_size=written.st_size,
        output_mtime_ns=written.st_mtime_ns,
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        peak_mib=peak_mib(),
        n_lines=counts.n_lines,
        n_shots=counts.n_shots,
        n_records=record.n_records or 0,
        labels=tuple((label.name.lower(), int(counts.labels[label])) for label in Label),
        notices=record.notices,
        output_name=task.output.name,
        output_sha256=None if record.output is None else record.output.sha256,
    )


def problem_of(error: Exception, task: Task, before: InputPrint | None) -> Problem:
    """Return why a file failed: separates causes outside the file, which may pass, from faults of the file."""
    found = Problem.of(error)
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "start new thread" in str(error)):
        hint = "fewer --jobs or threads, or a higher --memory-limit"
        return Problem(MEMORY, task.name, f"out of memory ({found.problem})", hint)
    if isinstance(error, OSError):
        where = os.fsdecode(error.filename) if error.filename is not None else task.name
        found = Problem(found.kind, where, error.strerror or str(error), "check the disk, the name and its permissions")
    elif isinstance(error, PrcError) and isinstance(error.__cause__, OSError):
        found = Problem(type(error.__cause__).__name__, found.where, found.problem, found.hint)
    elif isinstance(error, ImportError):
        found = Problem(found.kind, task.name, f"a package cannot be loaded ({error})", "prc doctor says which")
    elif not isinstance(error, PrcError):
        found = Problem(found.kind, task.name, f"{found.kind}: {found.problem}", "a fault of prc; please report it")
    if before is None:
        return found
    try:
        after = stat_input(task.source)
    except OSError as gone:
        return Problem(VANISHED, found.where, f"the input went away while it was read ({gone.strerror})", found.hint)
    if after != before:  # the change may have caused the error
        hint = "run again when the copy is complete"
        return Problem(CHANGED, str(task.source), "changed while it was read", hint)
    return found


def may_pass(problem: Problem) -> bool:
    """Tell whether another attempt may help; not for damaged files and wrong configurations.

    >>> may_pass(Problem("killed", "a.laz", "")), may_pass(Problem("InputError", "a.laz", "cut short"))
    (True, False)
    """
    if problem.kind in ("killed", "timeout", "interrupted", MEMORY, CHANGED, VANISHED):
        return True
    return problem.kind in _system_errors()


def _system_errors() -> set[str]:
    """Return the names of OutputError, OSError and its built-in subclasses."""
    found, waiting = {"OutputError"}, [OSError]
    while waiting:
        kind = waiting.pop()
        found.add(kind.__name__)
        waiting.extend(item for item in kind.__subclasses__() if item.__module__ == "builtins")
    return found


def peak_mib() -> float | None:
    """Return the highest resident memory of this process since :func:`_reset_peak` [MiB]; None if unknown."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    try:
        import resource
    except ImportError:  # not on this system
        return None
    scale = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale / (1 << 20)


def _reset_peak() -> None:
    """Reset the peak on Linux; elsewhere it is the peak since the process started."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
