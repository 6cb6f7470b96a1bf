"""The engine for many machines: files are tasks of Dask's distributed scheduler.

Every worker runs the same functions as a local run, in its own process, on paths that all machines
share. If a worker dies, the scheduler gives its files to another one. A file that has killed
several workers fails. Workers report their progress (begun, number of lines, ended) as events of
the scheduler.

Only this module uses Dask. It imports Dask inside functions, because Dask is an optional package.
"""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import secrets
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.threads import TICK_S, drain
from prc_cli.core.version import __version__
from prc_cli.jobs.batch.engine import EngineSettings, Event, Progress, Started, failures
from prc_cli.jobs.batch.outcomes import Outcome, Problem, remove_left
from prc_cli.jobs.batch.types import OWN_FOLDER, Task
from prc_cli.jobs.batch.worker import beat, run_item

EXTRA = '".[dask]"'
CONNECT_S = 20.0
"""How long the scheduler may take to answer [s]."""
WORKERS_S = 60.0
"""How long there may be no worker [s]."""
FETCH_S = 10.0
"""How long the outcome of a finished order may take to arrive [s]."""
FETCHES = 5
"""A file whose outcome was lost with its worker this often fails."""
PROGRESS_S = 1.0
"""Least time between two reports of finished lines [s]: one scheduler gets those of all workers."""
CHECK_S = 2.0
"""How often the engine asks the scheduler which workers there are [s]."""
STOP_S = 5.0
"""How long workers may take to roll back their files when a run is stopped [s]."""
SHARE_S = 5.0
"""How long a new file may take to appear on other machines [s].

Network file systems cache listings.
"""

BEGUN = "begun"
LINES = "lines"
ENDED = "ended"

Notice: TypeAlias = Callable[[str], None]


class StoppedError(BaseException):
    """The run was stopped while a worker had this file. No handler of Exception may catch it."""


@dataclass(frozen=True, slots=True)
class Order:
    """A task for a worker."""

    task: Task
    threads: int
    topic: str
    """Topic of the events by which the worker reports progress."""
    version: str
    """Version of the program that sends the order."""
    folder: str
    """Current folder of the program that sends the order, for relative names."""


@dataclass(frozen=True, slots=True)
class Report:
    """The outcome of an order."""

    worker: str
    results: tuple[Outcome, ...]
    """One outcome for every file of the task."""


@dataclass(frozen=True, slots=True)
class WorkerFacts:
    """Version, machine and visible files of a worker."""

    version: str
    host: str
    unseen: tuple[str, ...]
    """Paths that the worker does not see."""


def examine_worker(paths: tuple[str, ...]) -> WorkerFacts:
    """Return the version, and the paths that do not exist on this machine; run on every worker."""
    end = time.monotonic() + SHARE_S
    unseen = tuple(path for path in paths if not os.path.lexists(path))
    while unseen and time.monotonic() < end:
        time.sleep(TICK_S)
        unseen = tuple(path for path in paths if not os.path.lexists(path))
    return WorkerFacts(__version__, socket.gethostname(), unseen)


def version_here() -> str:
    """Return the version of this program; run on the scheduler."""
    return __version__


def do_order(order: Order) -> Report:
    """Classify a file; run on a worker, in one of its threads."""
    from distributed import get_worker

    worker = get_worker()
    key = str(worker.get_current_task())
    me = str(worker.address)
    task = order.task
    if order.version != __version__:
        problem = (
            f"the worker on {socket.gethostname()} runs prc {__version__}, this run {order.version}"
        )
        raise PrcError(
            f"worker {me}", problem, f"pip install {EXTRA} of version {order.version} there"
        )
    lines = _Lines(
        lambda kind, n: worker.log_event(order.topic, (kind, key, me, n)),
        lambda: _is_wanted(worker, key),
    )
    lines.report(BEGUN, 0)
    ended = threading.Event()
    beating = threading.Thread(
        target=beat, args=(lambda: lines.report(LINES, lines.n), ended), daemon=True
    )
    beating.start()
    try:
        if not task.source.exists():
            problem = f"no such file on {socket.gethostname()}, where a worker needs it"
            hint = "mount the archive there under the same path"
            missing = Problem("InputError", str(task.source), problem, hint)
            return Report(me, tuple(failures(task, 0.0, missing)))
        if (trajectory := task.config.trajectory) is not None and not trajectory.is_absolute():
            os.chdir(order.folder)
        return Report(me, run_item(task, threads=order.threads, progress=lines))
    finally:
        ended.set()
        beating.join()
        lines.report(ENDED, lines.n)


def _is_wanted(worker: Any, key: str) -> bool:
    # the client cancels a task when the run ends or the file has timed out
    state = worker.state.tasks.get(key)
    return state is not None and state.state != "cancelled"


class _Lines:
    """Counts finished lines, reports them at intervals, and stops a file that was cancelled."""

    def __init__(self, report: Callable[[str, int], None], is_wanted: Callable[[], bool]) -> None:
        self.n = 0
        self.report = report
        self._is_wanted = is_wanted
        self._last = 0.0

    def __call__(self, n_lines: int) -> None:
        self.n += n_lines
        now = time.monotonic()
        if now - self._last >= PROGRESS_S:
            self._last = now
            self.report(LINES, self.n)
            if not self._is_wanted():
                raise StoppedError


class DaskEngine:
    """Runs tasks on the workers of a Dask scheduler."""

    def __init__(
        self,
        scheduler: str,
        *,
        notice: Notice = lambda text: None,
        jobs: int | None = None,
        threads: int = 1,
    ) -> None:
        self._scheduler = scheduler
        self._notice = notice
        self._jobs = jobs
        self._threads = threads

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        """Run tasks (see :class:`prc_cli.jobs.batch.engine.Engine`)."""
        source = iter(tasks)
        first = next(source, None)
        if first is None:
            return
        settings = replace(settings, jobs=self._jobs or 0, threads=self._threads)
        with _quiet(), self._connect() as client:
            try:
                client.wait_for_workers(1, timeout=WORKERS_S)
            except TimeoutError as error:
                raise _no_workers(self._scheduler) from error
            if client.dashboard_link:
                self._notice(f"Dask's dashboard: {client.dashboard_link}")
            _examine(client, _absolute(first))
            run = _ClusterRun(client, self._scheduler, settings, self._notice)
            try:
                yield from run.events(chain([first], source))
            except OSError as error:  # the scheduler does not answer any more
                raise _lost() from error
            finally:
                run.stop()

    def _connect(self) -> Any:
        try:
            from distributed import Client
        except ImportError as error:
            problem = f"Dask is not installed here ({error})"
            raise ConfigError("--engine dask", problem, f"pip install {EXTRA}") from error
        connect: Any = Client
        try:
            with warnings.catch_warnings(record=True) as raised:
                warnings.simplefilter("always")
                client = connect(
                    self._scheduler, timeout=CONNECT_S, set_as_default=False, name="prc"
                )
        except (OSError, TimeoutError, ValueError, ImportError) as error:
            problem = f"no scheduler answers at {self._scheduler} ({_one_line(error)})"
            hint = "start one with: dask scheduler; its address looks like tcp://HOST:8786"
            raise ConfigError("--scheduler", problem, hint) from error
        for warning in raised:
            self._notice(f"Dask: {_one_line(warning.message)}")
        return client


def _no_workers(scheduler: str) -> PrcError:
    problem = f"there has been no worker for {WORKERS_S:g} s"
    return PrcError(f"scheduler {scheduler}", problem, f"start some: dask worker {scheduler}")


def _examine(client: Any, first: Task) -> None:
    # scheduler and workers must run this version, and see the archive and the outputs
    try:
        version = client.run_on_scheduler(version_here)
    except Exception as error:
        version = error
    _check_version("scheduler", version)
    out = first.output.parents[len(PurePosixPath(first.name).parts) - 1]
    token = out / OWN_FOLDER / f"shared-{secrets.token_hex(8)}"
    token.parent.mkdir(parents=True, exist_ok=True)
    try:
        token.write_bytes(b"")
        paths = [str(token)]
        if first.source.exists():  # else the file fails by itself
            paths.append(str(first.source))
        answers = client.run(examine_worker, tuple(paths), on_error="return")
    finally:
        token.unlink(missing_ok=True)
    for address, facts in answers.items():
        if isinstance(facts, OSError):  # it is gone: the first task checks its successor
            continue
        if not isinstance(facts, WorkerFacts):
            _check_version(f"worker {address}", facts)
        worker = f"worker {address} on {facts.host}"
        _check_version(worker, facts.version)
        if facts.unseen:
            hint = "mount the archive and the outputs there under the same paths"
            raise ConfigError(worker, f"does not see {facts.unseen[0]}", hint)


def _check_version(name: str, version: str | BaseException) -> None:
    if version != __version__:
        problem = f"found prc {version}, expected {__version__} as here"
        if not isinstance(version, str):
            problem = f"prc cannot be loaded there ({_one_line(version)})"
        raise ConfigError(name, problem, f"pip install {EXTRA} of version {__version__} there")


@dataclass(slots=True, eq=False)
class _Job:
    """A file that was sent to the scheduler."""

    task: Task
    future: Any
    worker: str | None = None
    """Address of its worker; None while it waits."""
    begun: float | None = None
    """When its first worker began [s]."""
    seen: float = 0.0
    """Last sign of life [s]."""
    n_reported: int = 0
    """Lines reported by the attempt that got farthest."""
    n_lost: int = 0
    """How often its outcome could not be fetched."""
    is_again: bool = False
    """Whether a second worker began it because the first one died."""


class _ClusterRun:
    """The tasks of one run on a cluster, and the messages about them."""

    def __init__(
        self,
        client: Any,
        scheduler: str,
        settings: EngineSettings,
        notice: Notice,
    ) -> None:
        self._client = client
        self._scheduler = scheduler
        self._settings = settings
        self._notice = notice
        self._topic = f"prc-{secrets.token_hex(8)}"
        self._messages: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._pending: dict[str, _Job] = {}
        """Files without an outcome, by key of the Dask task."""
        self._running: dict[str, str] = {}
        """Worker by key, of orders that have begun and not ended, also of files that timed out."""
        self._n = 0
        self._workers: dict[str, int] = {}
        self._checked = 0.0
        self._workers_seen = time.monotonic()
        self._client.subscribe_topic(
            self._topic, lambda event: self._messages.put(("event", event[1]))
        )

    def events(self, tasks: Iterator[Task]) -> Iterator[Event]:
        has_tasks = True
        while True:
            self._check_cluster()
            slots = sum(self._workers.values())
            # a few more orders than threads of workers, so that no thread is idle
            while has_tasks and len(self._pending) < (
                self._settings.jobs or slots + max(1, slots // 8)
            ):
                task = next(tasks, None)
                if task is None:
                    has_tasks = False
                else:
                    self._submit(_absolute(task))
            if not (has_tasks or self._pending):
                return
            yield from self._next_events()
            yield from self._watch()

    def stop(self) -> None:
        """Cancel everything, and wait a little until the workers have stopped."""
        with contextlib.suppress(Exception):  # a scheduler that is gone has nothing to stop
            self._client.cancel([job.future for job in self._pending.values()], force=True)
            end = time.monotonic() + STOP_S
            while self._running and time.monotonic() < end:
                with contextlib.suppress(queue.Empty):
                    kind, message = self._messages.get(timeout=TICK_S)
                    if kind == "event" and message[0] == ENDED:
                        self._running.pop(message[1], None)
            self._client.unsubscribe_topic(self._topic)
        self._pending.clear()

    def _check_cluster(self) -> None:
        """Update the workers; raise if the scheduler is gone or there are no workers for long."""
        now = time.monotonic()
        if now - self._checked < CHECK_S:
            return
        self._checked = now
        if self._client.status != "running":
            raise _lost()
        self._workers = dict(self._client.nthreads())
        if self._workers:
            self._workers_seen = now
        elif now - self._workers_seen > WORKERS_S:
            raise _no_workers(self._scheduler)
        for job in self._pending.values():
            if job.worker is not None and job.worker not in self._workers:
                job.worker = None  # its worker died: the scheduler gives it to another one
        self._running = {
            key: worker for key, worker in self._running.items() if worker in self._workers
        }

    def _submit(self, task: Task) -> None:
        self._n += 1
        # the dashboard groups tasks by the word before the dash
        key = f"classify-{self._topic.removeprefix('prc-')}{self._n:08x}"
        order = Order(task, self._settings.threads, self._topic, __version__, str(Path.cwd()))
        future = self._client.submit(do_order, order, key=key, pure=False)
        self._pending[key] = _Job(task, future)
        future.add_done_callback(self._queue_future)

    def _queue_future(self, future: Any) -> None:
        """Queue the key of an order that has ended; called in Dask's thread."""
        self._messages.put(("future", future.key))

    def _next_events(self) -> Iterator[Event]:
        # of the messages that come within a moment
        for kind, message in drain(self._messages):
            yield from self._on_event(*message) if kind == "event" else self._on_result(message)

    def _on_event(
        self,
        kind: str,
        key: str,
        worker: str,
        n_lines: int,
    ) -> Iterator[Event]:
        if kind == ENDED:
            self._running.pop(key, None)
        elif kind == BEGUN:
            self._running[key] = worker
        job = self._pending.get(key)
        if job is None:
            return
        job.seen = time.monotonic()
        if kind == BEGUN:
            job.is_again = job.is_again or job.begun is not None
            job.worker = worker
            yield from _started(job, worker)
        elif n_lines > job.n_reported:
            # a second attempt reports nothing until it gets farther than the first
            yield Progress(job.task.name, n_lines - job.n_reported)
            job.n_reported = n_lines

    def _on_result(self, key: str) -> Iterator[Event]:
        job = self._pending.get(key)
        if job is None:
            return
        report = self._report(job)
        if report is None:
            job.future.add_done_callback(self._queue_future)
            return
        del self._pending[key]
        if job.is_again:  # perhaps the first worker still wrote when the second one began
            remove_left(job.task)
        yield from _started(job, report.worker)
        yield from report.results

    def _report(self, job: _Job) -> Report | None:
        """Return the outcome of an order; None if it died with its worker and comes again."""
        future = job.future
        name = job.task.name
        worker = job.worker or "?"
        seconds = time.monotonic() - (job.begun or time.monotonic())
        if future.status == "finished":
            with contextlib.suppress(Exception, CancelledError):
                report: Report = future.result(timeout=FETCH_S)
                return report
            if self._client.status != "running":
                raise _lost()
        if future.status in ("finished", "pending", "lost"):
            job.n_lost += 1
            if job.n_lost < FETCHES:
                return None
            lost = f"its outcome was lost {FETCHES} times with the worker that had it"
            problem = Problem("killed", name, lost, "")
        elif future.status != "error":
            raise _lost()
        elif isinstance(error := future.exception(), PrcError):
            # not the fault of a file: the worker is wrong
            raise error
        elif type(error).__name__ == "KilledWorker":
            died = f"{error.allowed_failures + 1} workers died while they had it"
            hint = "look at their logs; often memory is short: fewer threads a worker"
            problem = Problem("killed", name, died, hint)
        elif isinstance(error, StoppedError):
            stopped = f"its worker {worker} was stopped"
            problem = Problem("interrupted", name, stopped, "run again")
        else:
            problem = Problem.of(error)
        return Report(worker, tuple(failures(job.task, seconds, problem)))

    def _watch(self) -> Iterator[Event]:
        """Fail files without progress for too long, and restart their workers."""
        now = time.monotonic()
        stall_s = self._settings.stall_s
        late = {
            key: job
            for key, job in self._pending.items()
            if job.worker is not None and now - job.seen > stall_s
        }
        for key, job in late.items():
            del self._pending[key]
            name = job.task.name
            hint = "check that its disk or share answers; --set batch.stall=SECONDS allows more"
            problem = Problem(
                "timeout", name, f"no progress for {stall_s:g} s on {job.worker}, given up", hint
            )
            self._client.cancel([job.future], force=True)
            yield from failures(job.task, now - (job.begun or now), problem)
            try:
                answers = self._client.restart_workers(
                    [job.worker], timeout=STOP_S, raise_for_error=False
                )
            except Exception as error:  # a worker without a nanny cannot be restarted
                answers = {job.worker: _one_line(error)}
            answer = answers.get(job.worker)
            if answer != "OK":
                self._notice(
                    f"worker {job.worker} hangs and cannot be restarted from here ({answer})"
                )


def _lost() -> PrcError:
    hint = "start it and run again: finished files are kept"
    return PrcError("scheduler", "went away or restarted while files were in work", hint)


def _started(job: _Job, worker: str) -> Iterator[Event]:
    if job.begun is None:
        job.begun = time.monotonic()
        for name in job.task.names:
            yield Started(name, worker)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    # Dask prints nothing: prc reports its events, notices and errors
    # every logger has its own level and handler
    names = [
        name
        for name in logging.root.manager.loggerDict
        if name.split(".")[0] in ("distributed", "tornado")
    ]
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def _absolute(task: Task) -> Task:
    # absolute paths are the same on every machine
    others = tuple(map(_absolute, task.others))
    return replace(
        task, source=task.source.absolute(), output=task.output.absolute(), others=others
    )


def _one_line(error: object) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
