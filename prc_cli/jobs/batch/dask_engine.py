"""The engine of many machines: files as tasks of Dask's distributed scheduler.

Every worker runs the same functions as a local run, in its own process, on paths that all machines share. A worker
that dies costs nothing but time: the scheduler gives its files to another one, and gives a file up that has killed
several. What workers say on the way (begun, so many lines, ended) travels as events of the scheduler.

The only module that knows Dask, and it is imported where it is used: an installation without it works.
"""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import secrets
import signal
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from multiprocessing import resource_tracker
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any, TypeAlias

from prc_cli import __version__
from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.threads import TICK_S, take_waiting
from prc_cli.jobs.batch.types import (
    OWN_FOLDER,
    EngineSettings,
    Event,
    Failed,
    Outcome,
    Problem,
    Progress,
    Started,
    Task,
)
from prc_cli.jobs.batch.work import run_task
from prc_cli.jobs.batch.worker import BEAT_S, MOVED, bytes_moved
from prc_cli.jobs.classify import load_classifier

EXTRA = "prc-cli[dask]"
CONNECT_S = 20.0
"""How long the scheduler may take to answer [s]."""
WORKERS_S = 60.0
"""How long there may be no worker at all [s]."""
PROGRESS_S = 1.0
"""Finished lines are reported at most so often [s]: all workers' words go through one scheduler to one client."""
LOOK_S = 2.0
"""How often the engine asks who is there [s]."""
STOP_S = 5.0
"""How long workers may take to roll back what they are doing when a run is stopped [s]."""
SHARE_S = 5.0
"""How long a new file may take to be seen by other machines: network file systems keep listings a while [s]."""

BEGUN, LINES, ENDED = "begun", "lines", "ended"

Notice: TypeAlias = Callable[[str], None]


class StoppedError(BaseException):
    """The run does not want this file any more; no error of the file, so nothing that catches errors keeps it."""


@dataclass(frozen=True, slots=True)
class Order:
    """What a worker is asked to do."""

    task: Task
    threads: int
    topic: str
    """Where the worker tells how it goes on."""
    version: str
    """Version of this program that gives the order."""
    folder: str
    """Current folder of who gives the order: where relative names in the configuration start."""


@dataclass(frozen=True, slots=True)
class Report:
    """What came of an order."""

    worker: str
    result: Outcome


@dataclass(frozen=True, slots=True)
class WorkerFacts:
    """What a worker says of itself."""

    version: str
    host: str
    unseen: tuple[str, ...]
    """Paths that it should see and does not."""


def examine_worker(paths: tuple[str, ...]) -> WorkerFacts:
    """Say which version runs here, and which of the paths are not here; run on every worker."""
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
    """Do what is asked for; run on a worker, in one of its threads."""
    from distributed import get_worker

    worker = get_worker()
    key = str(worker.get_current_task())
    me, task = str(worker.address), order.task
    if order.version != __version__:
        problem = f"the worker on {socket.gethostname()} runs prc {__version__}, this run {order.version}"
        raise PrcError(f"worker {me}", problem, f"pip install '{EXTRA}=={order.version}' there")
    lines = _Lines(lambda kind, n: worker.log_event(order.topic, (kind, key, me, n)), lambda: _is_wanted(worker, key))
    lines.tell(BEGUN, 0)
    beat = threading.Thread(target=lines.beat, name="beat", daemon=True)
    beat.start()
    try:
        if not task.source.exists():
            problem = f"no such file on {socket.gethostname()}, where a worker looks for it"
            hint = "mount the archive there under the same path"
            return Report(me, Failed(task.name, None, 0.0, Problem("InputError", str(task.source), problem, hint)))
        if (trajectory := task.config.trajectory) is not None and not trajectory.is_absolute():
            os.chdir(order.folder)
        return Report(me, run_task(task, threads=order.threads, progress=lines))
    finally:
        lines.close()
        beat.join()
        lines.tell(ENDED, lines.n)


def _is_wanted(worker: Any, key: str) -> bool:
    """Tell whether anybody still waits for a task: who ends, or gives it up, lets go of it."""
    state = worker.state.tasks.get(key)
    return state is not None and state.state != "cancelled"


class _Lines:
    """Counts finished lines, tells now and then how many, and stops a file that nobody wants any more."""

    def __init__(self, tell: Callable[[str, int], None], is_wanted: Callable[[], bool]) -> None:
        self.n = 0
        self.tell = tell
        self._is_wanted = is_wanted
        self._last = 0.0
        self._end = threading.Event()

    def __call__(self, n_lines: int) -> None:
        self.n += n_lines
        now = time.monotonic()
        if now - self._last >= PROGRESS_S:
            self._last = now
            self.tell(LINES, self.n)
            if not self._is_wanted():
                raise StoppedError

    def beat(self) -> None:
        """Tell that data is moving although no line is finished, as at the end of a file; in a thread."""
        moved = bytes_moved()
        with contextlib.suppress(OSError, ValueError):
            last = moved()
            while not self._end.wait(BEAT_S):
                if (now := moved()) - last >= MOVED:
                    last = now
                    self.tell(LINES, self.n)

    def close(self) -> None:
        """End the thread."""
        self._end.set()


class DaskEngine:
    """Runs tasks on the workers of a Dask scheduler.

    Parameters
    ----------
    scheduler : str, optional
        Its address, ``tcp://HOST:8786`` (or ``tls://``); default: a scheduler and workers of our own on this machine,
        as many as ``EngineSettings.jobs``.
    notice : callable, optional
        Called with a sentence for the user: where the dashboard is, which worker hangs.
    jobs : int, optional
        Most files at a time on a scheduler that is given; default: as many as its workers have threads.
    threads : int
        Threads a file there. This machine's cores have no say in what happens on others.
    """

    def __init__(
        self,
        scheduler: str | None = None,
        *,
        notice: Notice | None = None,
        jobs: int | None = None,
        threads: int = 1,
    ) -> None:
        self._scheduler = scheduler
        self._notice = notice or (lambda text: None)
        self._jobs = jobs
        self._threads = threads

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        """Run tasks (see :class:`prc_cli.jobs.batch.types.Engine`).

        Parameters
        ----------
        tasks : iterable of Task
            Asked for as workers have room.
        settings : EngineSettings
            ``jobs``, ``threads`` and ``memory_limit_mib`` hold only where there is no scheduler yet.

        Yields
        ------
        Event
            In the order they happen. A task that kills several workers is Failed with kind ``killed``, one that gives
            no sign of life for ``stall_s`` seconds with kind ``timeout``.

        Raises
        ------
        ConfigError
            When Dask is not installed, the scheduler does not answer, or workers have another version of this program
            or do not see the files.
        PrcError
            When the scheduler goes away, or there is no worker for a minute.
        """
        _import()
        source = iter(tasks)
        first = next(source, None)
        if first is None:
            return
        jobs = None
        if self._scheduler is not None:
            jobs, settings = self._jobs, replace(settings, threads=self._threads)
        with _Cluster(self._scheduler, settings, self._notice, first) as cluster:
            cluster.examine(first)
            run = _Run(cluster, settings, jobs, self._notice)
            try:
                yield from run.events(chain([first], source))
            except OSError as error:  # whatever it was asked, it does not answer any more
                raise _lost() from error
            finally:
                run.stop()


def _import() -> Any:
    """Return Dask's distributed package."""
    try:
        import distributed
    except ImportError as error:
        problem = f"Dask is not installed here ({error})"
        raise ConfigError("--engine dask", problem, f"pip install '{EXTRA}'") from error
    return distributed


class _Cluster:
    """A connection to a scheduler, and the scheduler and workers too where there was none."""

    def __init__(self, scheduler: str | None, settings: EngineSettings, notice: Notice, first: Task) -> None:
        self._address = scheduler
        self._settings = settings
        self._notice = notice
        self._first = first
        self._stack = contextlib.ExitStack()
        self.client: Any = None

    def __enter__(self) -> _Cluster:
        with contextlib.ExitStack() as stack:
            stack.enter_context(_quiet())
            place = self._address
            if place is None:
                load_classifier(self._first.config)  # compiled once, not by every worker
                place = stack.enter_context(_own_cluster(self._settings))
            self.client = stack.enter_context(self._connect(place))
            if self._address is not None:
                self._wait_for_workers()
            if self.client.dashboard_link:
                self._notice(f"Dask's dashboard: {self.client.dashboard_link}")
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stack.close()

    def _connect(self, place: Any) -> Any:
        distributed = _import()
        try:
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                client = distributed.Client(place, timeout=CONNECT_S, set_as_default=False, name="prc")
        except (OSError, TimeoutError, ValueError, ImportError) as error:
            problem = f"no scheduler answers at {self._address} ({_one_line(error)})"
            hint = "start one with: dask scheduler; its address looks like tcp://HOST:8786"
            raise ConfigError("--scheduler", problem, hint) from error
        for warning in said:
            self._notice(f"Dask: {_one_line(warning.message)}")
        return client

    def _wait_for_workers(self) -> None:
        try:
            self.client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            raise self.no_workers() from error

    def no_workers(self) -> PrcError:
        """Return the refusal to wait any longer."""
        problem = f"there has been no worker for {WORKERS_S:g} s"
        return PrcError(f"scheduler {self._address or ''}".strip(), problem, f"start some: dask worker {self._address}")

    def examine(self, first: Task) -> None:
        """Make sure that everybody runs this version, and sees the archive and the outputs.

        Raises
        ------
        ConfigError
            Naming the worker.
        """
        try:
            version = self.client.run_on_scheduler(version_here)
        except Exception as error:
            problem = f"prc cannot be loaded there ({_one_line(error)})"
            raise ConfigError("scheduler", problem, f"pip install '{EXTRA}=={__version__}' there, too") from error
        self._check_version("scheduler", version)
        first = _absolute(first)
        token = _out_of(first) / OWN_FOLDER / f"shared-{secrets.token_hex(8)}"
        token.parent.mkdir(parents=True, exist_ok=True)
        try:
            token.write_bytes(b"")
            # a vanished input is its own failure, and no sign that disks are not shared
            paths = [str(token), *([str(first.source)] if first.source.exists() else [])]
            found = self.client.run(examine_worker, tuple(paths), on_error="return")
        finally:
            token.unlink(missing_ok=True)
        for address, facts in found.items():
            self._check_worker(f"worker {address}", facts)

    def _check_worker(self, who: str, facts: WorkerFacts | BaseException) -> None:
        if isinstance(facts, BaseException):
            if isinstance(facts, OSError):  # it is gone: who takes its place is looked at by its first task
                return
            problem = f"prc cannot be loaded there ({_one_line(facts)})"
            raise ConfigError(who, problem, f"pip install '{EXTRA}=={__version__}' there")
        self._check_version(f"{who} on {facts.host}", facts.version)
        if facts.unseen:
            problem = f"does not see {facts.unseen[0]}"
            hint = "all workers need the archive and the outputs under the same paths: mount them there"
            raise ConfigError(f"{who} on {facts.host}", problem, hint)

    def _check_version(self, who: str, version: str) -> None:
        if version != __version__:
            problem = f"found prc {version}, expected {__version__} as here"
            raise ConfigError(who, problem, f"pip install '{EXTRA}=={__version__}' there")


@dataclass(slots=True, eq=False)
class _Job:
    """A file on its way."""

    task: Task
    future: Any
    worker: str | None = None
    """Who is at work on it; None while it waits."""
    begun: float | None = None
    """When its first worker began [s]."""
    seen: float = 0.0
    """Last sign of life [s]."""
    n_told: int = 0
    """Lines reported so far, of whichever attempt got farthest."""


class _Run:
    """The tasks of one run: what waits, what is on its way, what is heard."""

    def __init__(self, cluster: _Cluster, settings: EngineSettings, jobs: int | None, notice: Notice) -> None:
        self._cluster = cluster
        self._client = cluster.client
        self._settings = settings
        self._jobs = jobs
        self._notice = notice
        self._topic = f"prc-{secrets.token_hex(8)}"
        self._messages: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._on_way: dict[str, _Job] = {}
        """Files on their way, by the key of their order."""
        self._running: dict[str, str] = {}
        """Worker by key, of orders that it has begun with and not ended, given up ones too."""
        self._n = 0
        self._workers: dict[str, int] = {}
        self._looked = 0.0
        self._workers_seen = time.monotonic()
        self._client.subscribe_topic(self._topic, self._hear_event)

    def events(self, tasks: Iterator[Task]) -> Iterator[Event]:
        """Keep the workers busy and tell what happens."""
        more = True
        while True:
            self._look()
            while more and len(self._on_way) < self._room():
                task = next(tasks, None)
                if task is None:
                    more = False
                else:
                    self._submit(_absolute(task))
            if not (more or self._on_way):
                return
            yield from self._hear()
            yield from self._watch()

    def stop(self) -> None:
        """Let go of everything, and wait a little until the workers have."""
        with contextlib.suppress(Exception):  # a scheduler that is gone has nothing to stop
            self._client.cancel([job.future for job in self._on_way.values()], force=True)
            end = time.monotonic() + STOP_S
            while self._running and time.monotonic() < end:
                with contextlib.suppress(queue.Empty):
                    kind, message = self._messages.get(timeout=TICK_S)
                    if kind == "event" and message[0] == ENDED:
                        self._running.pop(message[1], None)
            self._client.unsubscribe_topic(self._topic)
        self._on_way.clear()

    def _room(self) -> int:
        """Return how many orders may be on their way: a few more than can be done at a time, so that nobody waits."""
        if self._jobs is not None:
            return self._jobs
        slots = sum(self._workers.values())
        return slots + max(1, slots // 8)

    def _look(self) -> None:
        """See who is there."""
        now = time.monotonic()
        if now - self._looked < LOOK_S:
            return
        self._looked = now
        if self._client.status != "running":
            raise _lost()
        self._workers = dict(self._client.nthreads())
        if self._workers:
            self._workers_seen = now
        elif now - self._workers_seen > WORKERS_S:
            raise self._cluster.no_workers()
        for job in self._on_way.values():
            if job.worker is not None and job.worker not in self._workers:
                job.worker = None  # its worker died: the scheduler gives it to another one
        self._running = {key: worker for key, worker in self._running.items() if worker in self._workers}

    def _order(self, task: Task) -> Order:
        return Order(task, self._settings.threads, self._topic, __version__, str(Path.cwd()))

    def _submit(self, task: Task) -> None:
        self._n += 1
        # the word before the dash is what the dashboard groups by
        key = f"classify-{self._topic.removeprefix('prc-')}{self._n:08x}"
        future = self._client.submit(do_order, self._order(task), key=key, pure=False)
        self._on_way[key] = _Job(task, future)
        future.add_done_callback(self._hear_future)

    def _hear_event(self, event: tuple[float, Any]) -> None:
        """Take what a worker says, in Dask's thread."""
        self._messages.put(("event", event[1]))

    def _hear_future(self, future: Any) -> None:
        """Take what came of an order, in Dask's thread."""
        self._messages.put(("future", future.key))

    def _hear(self) -> Iterator[Event]:
        """Wait a little for messages and turn all there are into events."""
        for kind, message in take_waiting(self._messages):
            yield from self._see(*message) if kind == "event" else self._take(message)

    def _see(self, kind: str, key: str, worker: str, n_lines: int) -> Iterator[Event]:
        """Turn what a worker says into events."""
        if kind == ENDED:
            self._running.pop(key, None)
        elif kind == BEGUN:
            self._running[key] = worker
        job = self._on_way.get(key)
        if job is None:
            return
        job.seen = time.monotonic()
        if kind == BEGUN:
            job.worker = worker
            yield from _begin(job, worker)
        elif n_lines > job.n_told:
            # a second attempt is heard of when it gets farther than the first
            yield Progress(job.task.name, n_lines - job.n_told)
            job.n_told = n_lines

    def _take(self, key: str) -> Iterator[Event]:
        """Take what came of an order."""
        job = self._on_way.pop(key, None)
        if job is not None:
            report = self._report(job)
            yield from _begin(job, report.worker)
            yield report.result

    def _report(self, job: _Job) -> Report:
        """Return what came of an order, whatever went wrong."""
        future, name = job.future, job.task.name
        worker = job.worker or "?"
        if future.status == "finished":
            report: Report = future.result()
            return report
        seconds = time.monotonic() - (job.begun or time.monotonic())
        if future.status != "error":
            raise _lost()
        error = future.exception()
        if type(error).__name__ == "KilledWorker":
            died = f"{error.allowed_failures + 1} workers died while they had it"
            hint = "look at their logs; often memory is short: fewer threads a worker"
            return Report(worker, Failed(name, None, seconds, Problem("killed", name, died, hint)))
        if isinstance(error, PrcError):  # no outcome of a file: the worker itself is wrong
            raise error
        if isinstance(error, StoppedError):
            problem = Problem("interrupted", name, f"its worker {worker} was told to let go of it", "run again")
            return Report(worker, Failed(name, None, seconds, problem))
        return Report(worker, Failed(name, None, seconds, Problem.of(error)))

    def _watch(self) -> Iterator[Event]:
        """Give up files that give no sign of life, and restart their workers."""
        now, stall_s = time.monotonic(), self._settings.stall_s
        late = {key: job for key, job in self._on_way.items() if job.worker is not None and now - job.seen > stall_s}
        for key, job in late.items():
            del self._on_way[key]
            name = job.task.name
            hint = "check that its disk or share answers; --stall allows more"
            problem = Problem("timeout", name, f"no progress for {stall_s:g} s on {job.worker}, given up", hint)
            self._client.cancel([job.future], force=True)
            yield Failed(name, None, now - (job.begun or now), problem)
            try:
                came = self._client.restart_workers([job.worker], timeout=STOP_S, raise_for_error=False)
            except Exception as error:  # without a nanny nobody can
                came = {job.worker: _one_line(error)}
            if (what := came.get(job.worker)) != "OK":
                self._notice(f"worker {job.worker} hangs and cannot be restarted from here ({what})")


def _lost() -> PrcError:
    hint = "start it and run again: what is done is kept"
    return PrcError("scheduler", "went away or began anew while files were at work", hint)


def _begin(job: _Job, worker: str) -> Iterator[Event]:
    """Say once that a file has begun."""
    if job.begun is None:
        job.begun = time.monotonic()
        yield Started(job.task.name, worker)


@contextlib.contextmanager
def _own_cluster(settings: EngineSettings) -> Iterator[Any]:
    """Start a scheduler and single-threaded workers on this machine, and end them."""
    distributed = _import()
    memory = 0 if settings.memory_limit_mib is None else settings.memory_limit_mib << 20
    try:
        with _without_interrupts():
            cluster = distributed.LocalCluster(
                n_workers=settings.jobs,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=memory,
                silence_logs=logging.CRITICAL,
            )
    except (OSError, RuntimeError, TimeoutError) as error:
        raise PrcError("--engine dask", f"no workers could be started ({_one_line(error)})", "fewer --jobs") from error
    try:
        yield cluster
    finally:
        cluster.close(timeout=STOP_S)


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let threads that begin here, and the processes that they begin, never hear Ctrl-C: it is for this process."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # who begins Python's tracker of shared resources hears interrupts again: it must be there before
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask from printing: what matters becomes an event, a notice or an error."""
    # each has a level and a handler of its own
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def _absolute(task: Task) -> Task:
    """Name the files of a task as every machine does."""
    return replace(task, source=task.source.absolute(), output=task.output.absolute())


def _out_of(task: Task) -> Path:
    """Return the output tree that the output of a task is in."""
    return task.output.parents[len(PurePosixPath(task.name).parts) - 1]


def _one_line(error: object) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__


__all__ = ["EXTRA", "DaskEngine", "do_order", "examine_worker", "version_here"]
