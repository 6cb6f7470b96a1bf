"""Worker processes of this machine, each for many files.

If a file kills its worker, only this file fails. A worker (:mod:`prc_cli.jobs.batch.worker`) is
started once, because loading the compiled loops takes a second. It gets the next task when it has
finished the one before, so no task waits in a queue.
"""

from __future__ import annotations

import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prc_cli.core.child import WorkerProcess
from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.threads import drain
from prc_cli.jobs.batch.engine import Comparison, EngineSettings, Event, Progress, Started, failures
from prc_cli.jobs.batch.outcomes import MEMORY, Failed, Problem, remove_left
from prc_cli.jobs.batch.types import Task
from prc_cli.jobs.batch.worker import READY, STOP_S

START_S = 120.0
"""Time limit for a worker to get ready [s]."""
FAILED_STARTS = 3
"""The run ends when this many workers in a row did not get ready."""
KILL_S = 5.0
"""How long the system may take to end a killed process [s]."""
LONGEST_CHECK_S = 1.0
"""Longest time between two checks of the workers, unless this process was paused [s]."""
ABANDON_S = 10.0
"""A worker that still exists this long after it was killed hangs in a system call [s]."""
_MODULE = "prc_cli.jobs.batch.worker"
_POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")
"""Variables of libraries that would otherwise start a thread for every core in every worker."""


@dataclass(slots=True, eq=False)
class _Worker:
    """A process and its task."""

    process: WorkerProcess
    name: str
    ready: bool = False
    retiring: bool = False
    """It gets no more tasks, and ends."""
    task: Task | Comparison | None = None
    begun: float = field(default_factory=time.monotonic)
    """When it got the task, or was started [s]."""
    seen: float = field(default_factory=time.monotonic)
    """When it last gave a sign of life [s]."""
    kill_reason: Problem | None = None
    """Why this process killed it."""
    killed: float = 0.0
    """When [s]."""

    def give(self, task: Task | Comparison) -> None:
        self.task = task
        self.begun = self.seen = time.monotonic()
        self.process.send(task)

    def kill(self, kill_reason: Problem) -> None:
        """Kill it; the reader thread then reports its end."""
        self.kill_reason = kill_reason
        self.killed = time.monotonic()
        self.process.kill()

    def clean_up(self) -> None:
        """Close its files after its end, and remove its temporary files."""
        self.process.close()
        if isinstance(self.task, Task):
            remove_left(self.task)


class LocalEngine:
    """Runs tasks in processes of this machine."""

    def run(
        self, tasks: Iterable[Task | Comparison], settings: EngineSettings
    ) -> Generator[Event, None, None]:
        """Run tasks, or compare outputs with references.

        See :class:`prc_cli.jobs.batch.engine.Engine`.
        """
        if settings.memory_limit_mib is not None and os.name != "posix":
            raise ConfigError(
                "batch.memory_limit",
                "this system cannot limit the memory of a process",
                "leave it out",
            )
        pool = _Pool(settings)
        try:
            yield from pool.run(iter(tasks))
        finally:
            pool.stop()


class _Pool:
    """The workers of one run."""

    def __init__(self, settings: EngineSettings) -> None:
        self._settings = settings
        self._workers: list[_Worker] = []
        self._messages: queue.SimpleQueue[tuple[_Worker, Any]] = queue.SimpleQueue()
        self._failed_starts = 0
        self._checked = time.monotonic()

    def run(self, tasks: Iterator[Task | Comparison]) -> Iterator[Event]:
        """Give every free worker a task, and yield what happens."""
        task = next(tasks, None)
        has_tasks = task is not None
        while has_tasks or any(worker.task is not None for worker in self._workers):
            while has_tasks and len(self._workers) < self._settings.jobs:
                self._start()
            while has_tasks and (worker := self._free_worker()) is not None:
                # not earlier: the journal records a task as started when the iterator yields it
                if task is None and (task := next(tasks, None)) is None:
                    has_tasks = False
                else:
                    for name in task.names:
                        yield Started(name, worker.name)
                    worker.give(task)
                    task = None
            yield from self._events()
            yield from self._watch()

    def stop(self) -> None:
        """End all workers within seconds, and remove temporary files of those that were killed."""
        for worker in self._workers:
            worker.process.close_input()
        end = time.monotonic() + STOP_S + 1
        for worker in self._workers:
            if not worker.process.wait(max(0.0, end - time.monotonic())):
                worker.process.kill()
        for worker in self._workers:
            worker.process.wait(KILL_S)  # one that hangs in a system call ends later
            worker.clean_up()
        self._workers.clear()

    def _free_worker(self) -> _Worker | None:
        free = (
            worker
            for worker in self._workers
            if worker.ready and not worker.retiring and worker.task is None
        )
        return next(free, None)

    def _start(self) -> None:
        threads = str(self._settings.threads)
        limit_mib = str(self._settings.memory_limit_mib or 0)
        path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
        environment = {**dict.fromkeys(_POOLS, threads), **os.environ, "PYTHONPATH": path}
        try:
            process = WorkerProcess(_MODULE, [threads, limit_mib], environment)
        except OSError as error:
            problem = f"cannot be started ({error.strerror or error})"
            raise PrcError(
                "worker process", problem, "fewer --jobs; check the limits of processes and memory"
            ) from error
        worker = _Worker(process, f"process {process.pid}")
        self._workers.append(worker)

        def read() -> None:
            for message in process.messages():
                self._messages.put((worker, message))
            self._messages.put((worker, None))

        threading.Thread(target=read, name="worker-messages", daemon=True).start()

    def _events(self) -> Iterator[Event]:
        # of the messages that come within a moment
        for worker, message in drain(self._messages):
            worker.seen = time.monotonic()
            if message is None:
                yield from self._reap(worker)
            elif message == READY:
                worker.ready = True
                self._failed_starts = 0
            elif isinstance(message, int):
                if message and worker.task is not None:
                    yield Progress(worker.task.name, message)
            else:
                worker.task = None
                if any(
                    isinstance(outcome, Failed) and outcome.problem.kind == MEMORY
                    for outcome in message
                ):
                    worker.retiring = True  # its memory may be fragmented
                    worker.process.close_input()
                yield from message

    def _reap(self, worker: _Worker) -> Iterator[Event]:
        """Remove a worker that has ended, and report its task as failed if it had one."""
        if worker not in self._workers:  # it was abandoned before
            return
        end = worker.process.how_ended()
        self._workers.remove(worker)
        worker.clean_up()
        if worker.task is not None:
            problem = worker.kill_reason or _death(worker, worker.task, end)
            yield from failures(worker.task, time.monotonic() - worker.begun, problem)
        elif not worker.ready:
            self._failed_starts += 1
            if self._failed_starts >= FAILED_STARTS:
                problem_of_starts = f"ended before it was ready, {FAILED_STARTS} times ({end})"
                hint = "prc doctor checks the installation"
                raise PrcError("worker process", problem_of_starts, hint)

    def _watch(self) -> Iterator[Event]:
        """Kill workers that are silent for too long; a pause of prc (Ctrl-Z) does not count."""
        now = time.monotonic()
        stall_s = self._settings.stall_s
        paused_s = max(0.0, now - self._checked - LONGEST_CHECK_S)
        self._checked = now
        for worker in tuple(self._workers):
            worker.seen = min(now, worker.seen + paused_s)
            if worker.kill_reason is not None:
                if now - worker.killed > ABANDON_S:
                    yield from self._abandon(worker, worker.kill_reason)
            elif worker.task is not None and now - worker.seen > stall_s:
                problem = f"no progress for {stall_s:g} s, given up"
                hint = "check that its disk or share answers; --set batch.stall=SECONDS allows more"
                worker.kill(Problem("timeout", worker.task.name, problem, hint))
            elif not worker.ready and now - worker.seen > START_S:
                worker.kill(Problem("timeout", "worker process", f"not ready after {START_S:g} s"))

    def _abandon(self, worker: _Worker, kill_reason: Problem) -> Iterator[Event]:
        """Continue without a worker that cannot be killed, because it hangs in a system call."""
        self._workers.remove(worker)
        # its temporary files stay as long as it exists
        task = worker.task
        worker.task = None
        worker.clean_up()
        if task is not None:
            yield from failures(task, time.monotonic() - worker.begun, kill_reason)


def _death(worker: _Worker, task: Task | Comparison, end: str) -> Problem:
    hint = "prc tries such a file once more, as the only one in work"
    if isinstance(task, Comparison):
        hint = f"look at it and at {task.reference}"
    elif worker.process.code == -getattr(signal, "SIGKILL", 9):
        hint = "the system does this when memory is short: fewer --jobs, or batch.memory_limit"
    return Problem("killed", task.name, f"its worker process {end}", hint)
