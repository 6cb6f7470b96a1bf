"""One run at a time: a living owner is respected, the lock of a dead one is free."""

import errno
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from filelock import FileLock

from prc_cli.core.errors import BusyError, OutputError
from prc_cli.jobs.batch import lock as subject
from prc_cli.jobs.batch.lock import Lock, Owner, has_locks, holders
from prc_cli.jobs.batch.types import Shard
from tests.patience import start, wait_until

DIED = 9
"""Exit code of a run that dropped dead."""
HOLD = """
import sys, time
from pathlib import Path
from prc_cli.jobs.batch.lock import Lock
with Lock(Path(sys.argv[1])):
    if len(sys.argv) > 2:  # as a run starts its workers
        import subprocess
        sleeper = [sys.executable, "-c", "import time; time.sleep(3600)"]
        child = subprocess.Popen(sleeper, stdin=subprocess.DEVNULL)
        print(child.pid, flush=True)
    print("held", flush=True)
    time.sleep(3600)
"""


@pytest.fixture
def folder(tmp_path):
    return tmp_path / ".prc"


def leave(path: Path, owner: Owner) -> None:
    """Leave the file of an owner."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(asdict(owner)))


@contextmanager
def held_by_another_process(folder: Path, *more: str) -> Iterator[subprocess.Popen[str]]:
    with start(
        [sys.executable, "-c", HOLD, str(folder), *more], stdout=subprocess.PIPE, text=True
    ) as process:
        yield process


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().rstrip("\n")


def test_a_second_run_is_told_who_is_at_work(folder):
    with Lock(folder), pytest.raises(BusyError) as caught, Lock(folder):
        pass
    assert caught.value.exit_code == 5
    for word in (
        str(os.getpid()),
        platform.node(),
        "another run is at work",
        "since 20",
        f"kill {os.getpid()}",
    ):
        assert word in str(caught.value)
    assert os.listdir(folder) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "first, second, together",
    [
        (None, None, False),
        (None, "1/2", False),
        ("1/2", None, False),
        ("1/2", "1/2", False),
        ("1/2", "2/2", True),
        ("1/2", "1/3", False),
        ("11/12", "1/2", False),
    ],
)
def test_runs_with_files_in_common_exclude_each_other(
    folder,
    first,
    second,
    together,
):
    first_shard, second_shard = (
        None if text is None else Shard.parse(text) for text in (first, second)
    )
    with Lock(folder, first_shard) as lock:
        if together:
            with Lock(folder, second_shard):
                assert len(holders(folder)) == 2
        else:
            with pytest.raises(BusyError), Lock(folder, second_shard):
                pass
        assert [holder.owner for holder in holders(folder)] == [lock.owner]
        lock.check()
    assert os.listdir(folder) == []


@pytest.mark.slow
def test_workers_do_not_keep_the_lock_of_their_parent(folder):
    """Files of the parent are not open in its children, so its lock ends with it."""
    with held_by_another_process(folder, "with a child") as process:
        child = int(line_of(process))
        assert line_of(process) == "held"
        with pytest.raises(BusyError, match=f"process {process.pid}"), Lock(folder):
            pass
        process.kill()
        wait_until(lambda: not holders(folder)[0].alive)
        os.kill(child, 0)  # it still runs
        with Lock(folder) as lock:
            assert lock.inherited_from is not None
            assert lock.inherited_from.pid == process.pid
            lock.check()
    assert os.listdir(folder) == []


@pytest.mark.parametrize("event", ["taken over", "removed"])
def test_an_owner_that_lost_its_lock_finds_out_and_leaves_the_others(folder, event):
    """As after somebody removed files."""
    new_owner = Owner(host="elsewhere")
    with Lock(folder) as lock:
        if event == "taken over":
            leave(lock.path, new_owner)
        else:
            lock.path.unlink()
        with pytest.raises(BusyError, match="the lock was lost"):
            lock.check()
    assert [holder.owner for holder in holders(folder)] == (
        [new_owner] if event == "taken over" else []
    )


@pytest.mark.parametrize("number", [errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS, errno.EINVAL])
def test_a_file_system_without_locks_is_refused_and_left_as_it_was(folder, monkeypatch, number):
    def flock(handle: int, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(fcntl, "flock", flock)
    with (
        pytest.raises(OutputError, match="this file system has no file locks.*another disk"),
        Lock(folder),
    ):
        pass
    assert holders(folder) == []
    assert not has_locks(folder)


# -- rivals


def call_at_step(monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]) -> SimpleNamespace:
    """Do something in the middle of a lock.

    ``until`` is the number of its steps in the file system before that, and None afterwards.
    """
    steps = SimpleNamespace(until=None)

    def stepped(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            if steps.until is not None:
                steps.until -= 1
                if steps.until == 0:
                    steps.until = None
                    act()
            return function(*arguments, **named)

        return call

    for room, names in (
        (subject, ("_read", "_is_held")),
        (Path, ("replace", "unlink")),
        (FileLock, ("acquire", "release")),
    ):
        for name in names:
            monkeypatch.setattr(room, name, stepped(getattr(room, name)))
    monkeypatch.setattr(subject, "LOOK_S", 0.01)
    return steps


STAGES = ["nothing", "the file of a dead owner"]


def begin(folder: Path, stage: str) -> None:
    if stage != "nothing":
        leave((folder / "lock.json"), Owner())


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("rival", [None, "1/2"])
def test_a_rival_that_comes_at_any_step_of_another_makes_one_owner(
    tmp_path,
    monkeypatch,
    stage,
    rival,
):
    """The rival is quick while the other one is slow."""

    def come(shard: Shard | None = None) -> None:
        with suppress(BusyError):
            inside.append(stack.enter_context(Lock(folder, shard)))

    shard_of_rival = None if rival is None else Shard.parse(rival)
    steps = call_at_step(monkeypatch, lambda: come(shard_of_rival))
    for n_steps in count(1):
        folder = tmp_path / f"{n_steps}"
        inside = list[Lock]()
        begin(folder, stage)
        with ExitStack() as stack:
            steps.until = n_steps
            come()
            if steps.until is not None:  # there are fewer steps
                steps.until = None
                break
            assert len(inside) == 1, n_steps
            living = [holder.owner for holder in holders(folder) if holder.alive]
            assert living == [inside[0].owner]
            inside[0].check()
    assert n_steps > 5


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("stage", STAGES)
def test_the_lock_of_a_run_that_dies_at_any_step_is_free(tmp_path, monkeypatch, stage):
    steps = call_at_step(monkeypatch, lambda: os._exit(DIED))
    ended = DIED
    for n_steps in count(1):
        folder = tmp_path / f"{n_steps}"
        begin(folder, stage)
        pid = os.fork()
        if pid == 0:  # as a kill would end it
            steps.until = n_steps
            with Lock(folder):
                pass
            os._exit(0)
        ended = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        with Lock(folder) as lock:
            assert [holder.owner for holder in holders(folder) if holder.alive] == [lock.owner]
            lock.check()
        assert holders(folder) == []
        if ended != DIED:  # there are fewer steps
            break
    assert (ended, n_steps > 5) == (0, True)


def test_a_shard_is_a_part_of_the_whole_and_the_same_for_ever():
    names = [f"2026/day {i}/drive.laz" for i in range(400)]
    parts = [{name for name in names if Shard(i, 7).holds(name)} for i in range(1, 8)]
    assert sum(map(len, parts)) == len(set.union(*parts)) == len(names)
    assert min(map(len, parts)) > 30
    of_four = [
        next(i for i in range(1, 5) if Shard(i, 4).holds(name))
        for name in ["a.laz", "b.laz", "night/c d.laz", "odd\udcff.laz"]
    ]
    assert of_four == [2, 1, 1, 1]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_a_pipe_in_the_place_of_the_owner_stops_nobody(tmp_path):
    """Reading it waited for a writer, for ever; SIGTERM did not end that."""
    folder = tmp_path / ".prc"
    folder.mkdir()
    os.mkfifo(folder / "lock.json")
    assert [holder.owner.user for holder in holders(folder)] == ["an unknown user"]
    with Lock(folder) as lock:
        lock.check()
    assert not (folder / "lock.json").exists()
