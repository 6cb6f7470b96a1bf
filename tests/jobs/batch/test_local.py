"""Real worker processes: files that crash or block them, and cleaning up afterwards."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.core.errors import ExitCode, PrcError
from prc_cli.jobs.batch import local
from prc_cli.jobs.batch.engine import EngineSettings, Event, Progress, Started
from prc_cli.jobs.batch.local import LocalEngine
from prc_cli.jobs.batch.outcomes import Done, Failed
from prc_cli.jobs.batch.types import Task
from tests import patience
from tests.patience import wait_until
from tests.street import street, write_endless, write_npz

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="sends signals")]


STALL_S = 100_000.0
"""So long that no machine is slow enough to be taken for one that hangs.

Tests turn the clock on instead.
"""


class Clock:
    """The clock of the engine, which a test may turn on."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.ahead_s = 0.0
        patch.setattr(
            local, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + self.ahead_s)
        )

    def turn_on(self) -> None:
        """Let every worker be silent for longer than it may be."""
        self.ahead_s += 2 * STALL_S

    def turn_on_when_given(self, patch: pytest.MonkeyPatch, name: str) -> None:
        """Do so when a worker has got a task of this name."""
        give = local._Worker.give

        def give_and_turn_on(worker: local._Worker, task: Task) -> None:
            give(worker, task)
            if task.name == name:
                self.turn_on()

        patch.setattr(local._Worker, "give", give_and_turn_on)


def count_pauses_as_silence(patch: pytest.MonkeyPatch) -> None:
    """Let the engine hold the time by which its clock was turned on against its workers."""
    patch.setattr(local, "LONGEST_CHECK_S", float("inf"))


def task(folder: Path, name: str, source: Path) -> Task:
    return Task(name, source, folder / "out" / f"{name}.npy", LoadedConfig(RunConfig()), "")


def process_of(event: Started) -> int:
    return int(event.worker.removeprefix("process "))


def is_running(process: int) -> bool:
    """Whether a process runs; one that ended and was not waited for does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children(process: int) -> list[int]:
    """Processes that a process has begun and that run."""
    processes = []
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = place.read_text().rpartition(")")[2].split()[1]
        except OSError:
            continue
        if int(parent) == process:
            processes.append(int(place.parent.name))
    return processes


@pytest.fixture(scope="module")
def events(tmp_path_factory):
    """One run over good files, a damaged one, one that kills its worker, and one that hangs."""
    folder = tmp_path_factory.mktemp("local")
    sound = write_npz(folder / "sound.npz", street(80))
    damaged = folder / "damaged.npz"
    damaged.write_bytes(b"PK\x03\x04 and then nothing")
    names = ["a", "damaged", "killed", "b", "hangs", "gone", "c"]
    sources = {"damaged": damaged, "gone": folder / "gone.npz"}
    tasks = [task(folder, name, sources.get(name, sound)) for name in names]
    events_of_run: list[Event] = []
    with pytest.MonkeyPatch.context() as patch:
        clock = Clock(patch)
        count_pauses_as_silence(patch)
        for event in LocalEngine().run(iter(tasks), EngineSettings(jobs=2, stall_s=STALL_S)):
            events_of_run.append(event)
            # the task is sent when the next event is asked for: the process dies, or sleeps, with
            # the task before it
            if isinstance(event, Started) and event.name == "killed":
                os.kill(process_of(event), signal.SIGKILL)
            if isinstance(event, Started) and event.name == "hangs":
                os.kill(process_of(event), signal.SIGSTOP)
            if (
                len(outcomes(events_of_run)) == len(tasks) - 1 and not clock.ahead_s
            ):  # all but the one that hangs
                clock.turn_on()
    return folder, events_of_run


def outcomes(events: list[Event]) -> dict[str, Done | Failed]:
    return {event.name: event for event in events if isinstance(event, Done | Failed)}


def test_every_file_has_one_outcome_whatever_the_others_did(
    events,
):
    ended = [event.name for event in events[1] if isinstance(event, Done | Failed)]
    assert sorted(ended) == ["a", "b", "c", "damaged", "gone", "hangs", "killed"]
    assert {name for name, event in outcomes(events[1]).items() if isinstance(event, Done)} == {
        "a",
        "b",
        "c",
    }


def test_a_file_begins_before_it_progresses_and_ends(events):
    for name in ("a", "b", "c"):
        kinds = [type(event) for event in events[1] if event.name == name]
        assert kinds[0] is Started
        assert kinds[-1] is Done
        assert set(kinds[1:-1]) == {Progress}
        lines = sum(
            event.n_lines
            for event in events[1]
            if isinstance(event, Progress) and event.name == name
        )
        assert lines == 80


def test_a_dead_worker_says_which_signal_killed_it(events):
    outcome = outcomes(events[1])["killed"]
    assert isinstance(outcome, Failed)
    assert outcome.problem.kind == "killed"
    assert "signal 9 (SIGKILL)" in outcome.problem.problem
    assert "--jobs" in outcome.problem.hint


def test_a_file_without_progress_is_given_up(events):
    outcome = outcomes(events[1])["hangs"]
    assert isinstance(outcome, Failed)
    assert outcome.problem.kind == "timeout"
    assert outcome.seconds >= STALL_S


def test_closing_ends_the_workers_and_rolls_back(tmp_path):
    source = write_endless(tmp_path / "endless.npy")
    others = children(
        os.getpid()
    )  # such as Python's own tracker of resources, which an earlier test started
    run = LocalEngine().run([task(tmp_path, name, source) for name in "ab"], EngineSettings(jobs=1))
    for event in run:
        if isinstance(event, Progress):
            break
    workers = [process for process in children(os.getpid()) if process not in others]
    run.close()  # type: ignore[attr-defined]
    assert workers
    assert not any(is_running(process) for process in workers)
    assert list((tmp_path / "out").iterdir()) == []


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    source = write_endless(tmp_path / "endless.npy")
    script = """
import sys
from pathlib import Path
from prc_cli.jobs.batch.local import LocalEngine
from prc_cli.jobs.batch.engine import EngineSettings, Progress
from prc_cli.jobs.batch.types import Task
from prc_cli.config import LoadedConfig, RunConfig
source = Path(sys.argv[1])
tasks = [Task("a", source, source.parent / "out" / "a.npy", LoadedConfig(RunConfig()), "")]
for event in LocalEngine().run(tasks, EngineSettings(jobs=1)):
    if isinstance(event, Progress):
        print("progress", flush=True)
"""
    with patience.start(
        [sys.executable, "-c", script, str(source)], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "progress\n"
        workers = children(parent.pid)
        assert workers
    wait_until(lambda: not any(is_running(process) for process in workers))
    assert list((tmp_path / "out").iterdir()) == []


def test_a_worker_does_not_hear_ctrl_c(tmp_path):
    source = write_npz(tmp_path / "a.npz", street(80))
    events_of_run: list[Event] = []
    for event in LocalEngine().run(
        [task(tmp_path, name, source) for name in "ab"], EngineSettings(jobs=1)
    ):
        events_of_run.append(event)
        if isinstance(event, Started):
            assert os.getpgid(process_of(event)) != os.getpgid(
                0
            )  # the terminal sends it to a group
            os.kill(process_of(event), signal.SIGINT)
    assert [
        type(event) for event in events_of_run if not isinstance(event, Started | Progress)
    ] == [
        Done,
        Done,
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems count address space")
def test_a_file_that_takes_too_much_memory_fails_and_the_next_is_done(tmp_path):
    wide = tmp_path / "wide.npy"
    np.lib.format.open_memmap(wide, mode="w+", dtype=np.float32, shape=(40, 4_000_000)).flush()
    small = write_npz(tmp_path / "small.npz", street(80))
    tasks = [task(tmp_path, "wide", wide), task(tmp_path, "small", small)]
    results = outcomes(list(LocalEngine().run(tasks, EngineSettings(jobs=1, memory_limit_mib=400))))
    wide_found = results["wide"]
    assert isinstance(wide_found, Failed)
    assert wide_found.problem.kind == "memory", wide_found
    assert isinstance(results["small"], Done)


def test_workers_that_cannot_start_end_the_run(tmp_path, monkeypatch):
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho no libraries here >&2\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setattr(local.sys, "executable", str(broken))
    with pytest.raises(PrcError, match=r"ended with exit code 3.*no libraries here.*prc doctor"):
        list(LocalEngine().run([task(tmp_path, "a", tmp_path / "a.npz")], EngineSettings(jobs=1)))


def test_a_dropped_interrupt_is_raised_again(tmp_path):
    """Python drops an exception in a destructor; the worker must end all the same."""
    script = """
import threading, time
from prc_cli.jobs.batch import worker
worker.catch_sigterm()
class Deleted:
    def __del__(self):
        threading.Thread(target=worker.end_soon, daemon=True).start()
        time.sleep(600)
try:
    Deleted()
    time.sleep(600)
finally:
    print("rolled back", flush=True)
"""
    process = patience.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert process.stdout == "rolled back\n"
    assert process.returncode == ExitCode.TERMINATED
