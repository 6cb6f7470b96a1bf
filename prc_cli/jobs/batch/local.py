"""Worker processes of this machine that live for many files; a file that kills its worker costs itself alone.

A worker is a process of its own (:mod:`prc_cli.jobs.batch.worker`), begun once, because loading the compiled loops
takes a second. It gets the next task when it has done the one before, so that nothing waits in queues.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.files import remove_stale
from prc_cli.core.threads import default_threads, take_waiting
from prc_cli.formats.writing.record import record_path
from prc_cli.jobs.batch.types import (
    EngineSettings,
    Event,
    Failed,
    Outcome,
    Problem,
    Progress,
    Started,
    Task,
)
from prc_cli.jobs.batch.work import MEMORY
from prc_cli.jobs.batch.worker import PATIENCE_S, READY

START_S = 120.0
"""A worker that is not ready after so long is given up [s]."""
FAILED_STARTS = 3
"""So many workers in a row that never got ready end the run."""
KILL_S = 5.0
"""How long the system may take to end a process that was killed [s]."""
LONGEST_LOOK_S = 1.0
"""Between two looks at the workers lies less than this, unless this process was stopped [s]."""
ABANDON_S = 10.0
"""A worker that is still there so long after it was killed hangs in the system [s]."""
LAST_WORDS = 400
"""Of what a worker printed before it died [bytes]."""
_POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")
"""Libraries that would otherwise start a thread for every core in every worker."""


def share_cores(jobs: int | None, threads: int | None, n_files: int) -> tuple[int, int]:
    """Return how many files at a time, and how many threads a file.

    Parameters
    ----------
    jobs, threads : int or None
        As asked for.
    n_files : int
        Files to do: no more workers than these are begun.

    Examples
    --------
    >>> share_cores(2, 3, n_files=10), share_cores(4, 1, n_files=2)
    ((2, 3), (2, 1))
    """
    cores = default_threads()
    wanted = max(1, min(jobs or cores, max(1, n_files)))
    return wanted, threads or max(1, cores // wanted)


@dataclass(slots=True, eq=False)
class _Worker:
    """A process and what it is doing."""

    process: subprocess.Popen[bytes]
    words: Any
    """File of what it prints."""
    name: str
    ready: bool = False
    leaves: bool = False
    """It gets no more tasks."""
    task: Task | None = None
    begun: float = 0.0
    """When it got the task, or was started [s]."""
    seen: float = 0.0
    """When it last gave a sign of life [s]."""
    verdict: Problem | None = None
    """Why this process killed it."""
    killed: float = 0.0
    """When [s]."""

    def give(self, task: Task) -> None:
        """Send a task; if the worker is dead by now, its end tells."""
        self.task = task
        self.begun = self.seen = time.monotonic()
        with contextlib.suppress(OSError):
            assert self.process.stdin is not None
            pickle.dump(task, self.process.stdin)
            self.process.stdin.flush()

    def dismiss(self) -> None:
        """Tell it that no more tasks come; it rolls back what it is doing."""
        with contextlib.suppress(OSError):
            assert self.process.stdin is not None
            self.process.stdin.close()

    def kill(self, verdict: Problem) -> None:
        """End it at once; its end comes as a message."""
        self.verdict, self.killed = verdict, time.monotonic()
        self.process.kill()

    def clean_up(self) -> None:
        """After its end: close its files, and remove what it left."""
        self.dismiss()
        with contextlib.suppress(OSError):
            self.words.close()
        if self.task is not None:
            for path in (self.task.output, record_path(self.task.output)):
                with contextlib.suppress(OSError):
                    remove_stale(path)

    def last_words(self) -> str:
        """Return the end of what it printed, as one line."""
        with contextlib.suppress(OSError):
            size = self.words.seek(0, os.SEEK_END)
            self.words.seek(max(0, size - LAST_WORDS))
            return " ".join(self.words.read().decode("utf-8", "replace").split())
        return ""


class LocalEngine:
    """Runs tasks in processes of this machine.

    Examples
    --------
    >>> list(LocalEngine().run([], EngineSettings()))
    []
    """

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        """Run tasks (see :class:`prc_cli.jobs.batch.types.Engine`).

        Parameters
        ----------
        tasks : iterable of Task
            Asked for one at a time, when a worker is free.
        settings : EngineSettings
            ``jobs`` workers are begun at once, each with ``threads`` threads.

        Yields
        ------
        Event
            In the order they happen. A task that kills its worker is Failed with kind ``killed``; one that neither
            finishes a line nor moves data for ``stall_s`` seconds is Failed with kind ``timeout``.

        Raises
        ------
        ConfigError
            When memory cannot be limited on this system.
        PrcError
            When no worker can be started.
        """
        if settings.memory_limit_mib is not None and os.name != "posix":
            raise ConfigError("--memory-limit", "this system cannot limit the memory of a process", "leave it out")
        pool = _Pool(settings)
        source = iter(tasks)
        first = next(source, None)
        if first is None:
            return
        try:
            yield from pool.run(chain([first], source))
        finally:
            pool.stop()


class _Pool:
    """The workers of one run."""

    def __init__(self, settings: EngineSettings) -> None:
        self._settings = settings
        self._workers: list[_Worker] = []
        self._messages: queue.SimpleQueue[tuple[_Worker, Any]] = queue.SimpleQueue()
        self._failed_starts = 0
        self._looked = time.monotonic()

    def run(self, tasks: Iterator[Task]) -> Iterator[Event]:
        """Give every worker a task when it is free, and tell what becomes of it."""
        more = True
        while True:
            while more and len(self._workers) < self._settings.jobs:
                self._start()
            while more and (worker := self._free_worker()) is not None:
                task = next(tasks, None)
                if task is None:
                    more = False
                else:
                    yield Started(task.name, worker.name)
                    worker.give(task)
            if not more and all(worker.task is None for worker in self._workers):
                return
            yield from self._hear()
            yield from self._watch()

    def stop(self) -> None:
        """End all workers within seconds, and remove what those left that had to be killed."""
        for worker in self._workers:
            worker.dismiss()
        end = time.monotonic() + PATIENCE_S + 1
        for worker in self._workers:
            with contextlib.suppress(subprocess.TimeoutExpired):
                worker.process.wait(max(0.0, end - time.monotonic()))
        for worker in self._workers:
            if worker.process.poll() is None:
                worker.process.kill()
        for worker in self._workers:
            with contextlib.suppress(subprocess.TimeoutExpired):  # it hangs in the system: the kill waits for it
                worker.process.wait(KILL_S)
            worker.clean_up()
        self._workers.clear()

    def _free_worker(self) -> _Worker | None:
        free = (worker for worker in self._workers if worker.ready and not worker.leaves and worker.task is None)
        return next(free, None)

    def _start(self) -> None:
        words = tempfile.TemporaryFile()  # noqa: SIM115 - closed in clean_up
        threads = self._settings.threads
        path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
        environment = {**{name: str(threads) for name in _POOLS}, **os.environ, "PYTHONPATH": path}
        apart: dict[str, Any] = {"process_group": 0} if os.name == "posix" else {"creationflags": _NEW_GROUP}
        try:
            process = subprocess.Popen(
                # -P: nothing is imported from the current folder
                [sys.executable, "-P", "-m", "prc_cli.jobs.batch.worker",
                 str(threads), str(self._settings.memory_limit_mib or 0)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=words, env=environment,
                **apart,  # Ctrl-C on the terminal is for this process, which knows what to do
            )  # fmt: skip
        except OSError as error:
            words.close()
            problem = f"cannot be started ({error.strerror or error})"
            raise PrcError(
                "worker process", problem, "fewer --jobs; check the limits of processes and memory"
            ) from error
        worker = _Worker(process, words, f"process {process.pid}", begun=time.monotonic(), seen=time.monotonic())
        self._workers.append(worker)
        threading.Thread(target=_read, args=(worker, self._messages), name="worker-messages", daemon=True).start()

    def _hear(self) -> Iterator[Event]:
        """Wait a little for messages and turn all there are into events."""
        for worker, message in take_waiting(self._messages):
            worker.seen = time.monotonic()
            if message is None:
                yield from self._bury(worker)
            elif message == READY:
                worker.ready, self._failed_starts = True, 0
            elif isinstance(message, int):
                if message and worker.task is not None:
                    yield Progress(worker.task.name, message)
            else:
                outcome: Outcome = message
                worker.task = None
                if isinstance(outcome, Failed) and outcome.problem.kind == MEMORY:
                    worker.leaves = True  # what is left of its memory is in pieces
                    worker.dismiss()
                yield outcome

    def _bury(self, worker: _Worker) -> Iterator[Event]:
        """Say what became of the task of a worker that has ended."""
        if worker not in self._workers:  # it was given up before
            return
        code = worker.process.wait()
        self._workers.remove(worker)
        words = worker.last_words()
        worker.clean_up()
        if worker.task is not None:
            problem = worker.verdict or _death(worker.task.name, code, words)
            yield Failed(worker.task.name, None, time.monotonic() - worker.begun, problem)
        elif not worker.ready:
            self._failed_starts += 1
            if self._failed_starts >= FAILED_STARTS:
                found = f"ended before it was ready, {FAILED_STARTS} times ({_how(code)}{_said(words)})"
                raise PrcError("worker process", found, "prc doctor checks the installation")

    def _watch(self) -> Iterator[Event]:
        """Kill workers that give no sign of life; their end comes as a message.

        Time in which nobody listened, as after Ctrl-Z, is not held against them.
        """
        now, stall_s = time.monotonic(), self._settings.stall_s
        deaf_s = max(0.0, now - self._looked - LONGEST_LOOK_S)
        self._looked = now
        for worker in tuple(self._workers):
            worker.seen = min(now, worker.seen + deaf_s)
            if worker.verdict is not None:
                if now - worker.killed > ABANDON_S:
                    yield from self._abandon(worker, worker.verdict)
            elif worker.task is not None and now - worker.seen > stall_s:
                problem = f"no progress for {stall_s:g} s, given up"
                hint = "check that its disk or share answers; --stall allows more"
                worker.kill(Problem("timeout", worker.task.name, problem, hint))
            elif not worker.ready and now - worker.seen > START_S:
                worker.kill(Problem("timeout", "worker process", f"not ready after {START_S:g} s"))

    def _abandon(self, worker: _Worker, verdict: Problem) -> Iterator[Event]:
        """Go on without a worker that cannot even be killed, because it hangs in the system."""
        self._workers.remove(worker)
        task, worker.task = worker.task, None  # its temporary files stay, as long as it is there
        worker.clean_up()
        if task is not None:
            yield Failed(task.name, None, time.monotonic() - worker.begun, verdict)


_NEW_GROUP = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)


def _read(worker: _Worker, messages: queue.SimpleQueue[tuple[_Worker, Any]]) -> None:
    """Pass on what a worker says, in a thread; None when it has ended."""
    stream = worker.process.stdout
    assert stream is not None
    with stream:
        while True:
            try:
                message = pickle.load(stream)
            except Exception:  # the end, or a message that was cut by it
                break
            messages.put((worker, message))
    worker.process.wait()
    messages.put((worker, None))


def _death(name: str, code: int, words: str) -> Problem:
    """Say how a worker ended that should not have."""
    hint = "the file is tried again alone"
    if code == -getattr(signal, "SIGKILL", 9):
        hint = "the system kills so when memory is short: fewer --jobs, or --memory-limit"
    return Problem("killed", name, f"its worker process {_how(code)}{_said(words)}", hint)


def _how(code: int) -> str:
    """Name an exit code.

    >>> _how(3)
    'ended with exit code 3'
    """
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was killed by signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"was killed by signal {-code}"


def _said(words: str) -> str:
    return f"; it said: {words}" if words else ""
