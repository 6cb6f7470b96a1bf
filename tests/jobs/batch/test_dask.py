"""Files on Dask: the same bytes as the local engine, even if workers die."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import temporary_name
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.jobs.batch import dask_engine
from prc_cli.jobs.batch.dask_engine import DaskEngine
from prc_cli.jobs.batch.engine import EngineSettings, Event, Progress, Started
from prc_cli.jobs.batch.outcomes import Done, Failed, Problem
from prc_cli.jobs.batch.types import Task
from prc_cli.jobs.classify import classify, load_classifier
from tests.faults.machines import Machines
from tests.patience import HANGS_S, wait_until
from tests.street import write_endless

pytestmark = pytest.mark.slow

distributed = pytest.importorskip("distributed")

M = 40


@pytest.fixture(scope="module")
def quiet():
    """Dask's own log is not looked at here."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    yield
    logger.setLevel(level)


@pytest.fixture(scope="module")
def cluster(quiet):
    """A scheduler and two workers inside this process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0", memory_limit=0
    ) as scheduler:
        yield scheduler


def scene(n_lines: int, seed: int, m: int = M) -> Any:
    rng = np.random.default_rng(seed)
    image = np.repeat(rng.choice([5.0, 9.0, 20.0], (n_lines, m // 8 + 1)), 8, 1)[:, :m]
    image[rng.random(image.shape) < 0.05] = np.nan
    return image.astype(np.float32)


def config() -> LoadedConfig:
    # lines of nothing but random surfaces are no scan
    return load_config(
        options={"prc": {"lines_per_block": 10}, "input": {"accept_doubts": CHECK_NAMES}}
    )


def tasks_in(folder: Path, lines: dict[str, int], m: int = M) -> list[Task]:
    tasks = []
    for seed, (name, n_lines) in enumerate(lines.items()):
        source = folder / "in" / name
        output = folder / "out" / f"{name}.labels.npy"
        source.parent.mkdir(parents=True, exist_ok=True)
        output.parent.mkdir(parents=True, exist_ok=True)
        if not source.exists():
            np.save(source, scene(n_lines, seed, m))
        tasks.append(Task(name, source, output, config(), "c0ffee"))
    return tasks


def outcomes(events: list[Event]) -> dict[str, Done | Failed]:
    ended = [event for event in events if isinstance(event, (Done, Failed))]
    assert len({event.name for event in ended}) == len(ended), "one outcome a file"
    return {event.name: event for event in ended}


def run(engine: DaskEngine, tasks: list[Task], **settings: Any) -> list[Event]:
    return list(engine.run(iter(tasks), EngineSettings(**settings)))


def check_bytes(tasks: list[Task], folder: Path) -> None:
    """Outputs and records are those of ``prc classify``."""
    for task in tasks:
        whole = folder / f"whole-{task.source.name}.labels.npy"
        classify(task.source, whole, task.config, overwrite=True, threads=1)
        assert task.output.read_bytes() == whole.read_bytes()
        records = [
            path.with_name(f"{path.name}.prc.json").read_bytes() for path in (task.output, whole)
        ]
        assert records[0] == records[1]


def left_in(folder: Path) -> list[str]:
    """Everything in the output tree."""
    return sorted(path.name for path in folder.rglob("*") if not path.is_dir())


def test_files(cluster, tmp_path):
    tasks = tasks_in(tmp_path, {f"deep/{i}.npy": 30 + i for i in range(9)})
    bad = tmp_path / "in" / "bad.npy"
    bad.write_bytes(b"rubbish")
    tasks.insert(3, Task("bad.npy", bad, tmp_path / "out" / "bad.npy", config(), "c0ffee"))
    notices: list[str] = []
    events = run(DaskEngine(cluster.scheduler_address, notice=notices.append), tasks)
    results = outcomes(events)
    failed = results.pop("bad.npy")
    assert isinstance(failed, Failed)
    assert failed.problem.kind == "InputError"
    assert all(isinstance(outcome, Done) for outcome in results.values())
    tasks.pop(3)
    check_bytes(tasks, tmp_path)
    for task in tasks:
        events_of_task = [event for event in events if event.name == task.name]
        assert isinstance(events_of_task[0], Started)
        assert isinstance(events_of_task[-1], Done)
        assert (
            sum(event.n_lines for event in events_of_task if isinstance(event, Progress))
            <= events_of_task[-1].n_lines
        )
    assert len(left_in(tmp_path / "out")) == 18


def test_closing_stops_what_is_at_work(cluster, tmp_path):
    (tmp_path / "in").mkdir()
    names = [f"{i}.npy" for i in range(3)]
    for name in names:
        write_endless(tmp_path / "in" / name)
    tasks = tasks_in(tmp_path, dict.fromkeys(names, 0))
    events = DaskEngine(cluster.scheduler_address).run(iter(tasks), EngineSettings())
    with closing(events):  # type: ignore[type-var]
        next(event for event in events if isinstance(event, Progress))
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        wait_until(lambda: not any(client.processing().values()))
    # what was at work is rolled back
    wait_until(
        lambda: (
            not [
                name
                for name in left_in(tmp_path / "out")
                if name.endswith((".part", ".npy", ".json"))
            ]
        )
    )


def test_file_that_hangs_is_given_up(cluster, tmp_path, monkeypatch):
    tasks = tasks_in(tmp_path, {"hangs.npy": 20, **{f"{i}.npy": 20 for i in range(4)}})
    load_classifier(config())  # compiling loops is no progress either
    real = dask_engine.run_item
    let_go = threading.Event()
    stall_s = 1e5
    ahead_s = iter(range(0, 10**12, 200_000))
    results: dict[str, Done | Failed] = {}

    def clock() -> float:
        """Once all other files are done, the one that hangs is silent for too long whenever it is
        looked at."""
        return time.monotonic() + (next(ahead_s) if len(results) == 4 else 0)

    def hangs(task: Task, **how: Any) -> Any:
        if task.name == "hangs.npy":
            let_go.wait(HANGS_S)
        return real(task, **how)

    monkeypatch.setattr(dask_engine, "run_item", hangs)
    monkeypatch.setattr(dask_engine, "beat", lambda tell, ended: None)
    monkeypatch.setattr(dask_engine, "STOP_S", 0.2)
    monkeypatch.setattr(dask_engine, "time", SimpleNamespace(monotonic=clock))
    notices: list[str] = []
    events = []
    for event in DaskEngine(cluster.scheduler_address, notice=notices.append).run(
        iter(tasks), EngineSettings(stall_s=stall_s)
    ):
        events.append(event)
        results = outcomes(events)
        if isinstance(event, Failed):
            let_go.set()
    let_go.set()
    failed = results.pop("hangs.npy")
    assert isinstance(failed, Failed)
    assert failed.problem.kind == "timeout"
    assert "no progress for 100000 s" in failed.problem.problem
    assert all(isinstance(outcome, Done) for outcome in results.values()), results
    assert any("cannot be restarted from here" in text for text in notices)


@pytest.mark.parametrize("who", ["scheduler", "worker"])
def test_other_versions_are_refused(
    cluster,
    tmp_path,
    monkeypatch,
    who,
):
    tasks = tasks_in(tmp_path, {"a.npy": 20})
    if who == "scheduler":
        monkeypatch.setattr(dask_engine, "version_here", lambda: "0.0.1")
    else:
        facts = dask_engine.WorkerFacts("0.0.1", "elsewhere", ())
        monkeypatch.setattr(dask_engine, "examine_worker", lambda paths: facts)
    with pytest.raises(
        ConfigError, match=rf"{who}.*found prc 0.0.1, expected .* as here; pip install"
    ):
        run(DaskEngine(cluster.scheduler_address), tasks)


def test_without_dask(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"not installed here .*; pip install .\.\[dask\]."):
        run(DaskEngine("tcp://127.0.0.1:9"), tasks_in(tmp_path, {"a.npy": 20}))


def test_without_scheduler(tmp_path, monkeypatch, quiet):
    monkeypatch.setattr(dask_engine, "CONNECT_S", 0.5)
    tasks = tasks_in(tmp_path, {"a.npy": 20})
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(ConfigError, match="no scheduler answers at"):
            run(DaskEngine(address), tasks)


def test_what_a_dead_worker_left_is_removed_with_the_outcome(cluster, tmp_path):
    """It may have been alive yet when the second worker looked for what the first one left."""
    (task,) = tasks_in(tmp_path, {"a.npy": 20})
    task.output.parent.mkdir(parents=True, exist_ok=True)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    temporary = temporary_name(task.output)
    left = temporary.with_name(temporary.name.replace(f"-{os.getpid()}-", f"-{dead.pid}-"))
    left.write_bytes(b"half")
    report = dask_engine.Report(
        "tcp://b", (Failed("a.npy", None, 1.0, Problem("damaged", "a.npy", "cut", "")),)
    )

    class Finished:
        status = "finished"

        def result(self, timeout: float) -> Any:
            return report

    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        engine = dask_engine._ClusterRun(client, "tcp://a", EngineSettings(), print)
        for workers in (("tcp://a",), ("tcp://a", "tcp://b")):
            engine._pending["key"] = dask_engine._Job(task, Finished())
            for worker in workers:
                list(engine._on_event(dask_engine.BEGUN, "key", worker, 0))
            assert left.exists()
            list(engine._on_result("key"))
    assert not left.exists()


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_worker_killed_in_mid_run(tmp_path, quiet):
    """Separately started scheduler and workers; one is killed while it has a file."""
    lines = {"first.npy": 10_000, **{f"{i}.npy": 300 for i in range(4)}, "last.npy": 2400}
    tasks = tasks_in(tmp_path, lines, m=100)
    owner: dict[str, str] = {}
    killed: list[str] = []
    events: list[Event] = []
    with Machines(tmp_path) as machines:
        machines.start()
        with distributed.Client(machines.address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=HANGS_S)
            pids = client.run(os.getpid)
        stream = DaskEngine(machines.address).run(iter(tasks), EngineSettings())
        with closing(stream):  # type: ignore[type-var]
            for event in stream:
                events.append(event)
                if isinstance(event, Started):
                    owner[event.name] = event.worker
                if isinstance(event, Progress) and event.name == "first.npy" and not killed:
                    killed.append(owner["first.npy"])
                    os.kill(pids[killed[0]], signal.SIGKILL)
    results = outcomes(events)
    assert killed
    assert set(results) == set(lines)
    assert all(isinstance(outcome, Done) for outcome in results.values()), results
    check_bytes(tasks, tmp_path)
    # what the killed one was writing is not taken for an output
    assert len(
        [name for name in left_in(tmp_path / "out") if not name.endswith(".part")]
    ) == 2 * len(tasks)
