"""One run at a time: a live owner is respected, a dead one inherited from by exactly one rival."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import pytest

from prc_cli.core.errors import BusyError, ConfigError, OutputError
from prc_cli.jobs.batch import lock as subject
from prc_cli.jobs.batch.lock import (
    Lock,
    Owner,
    holders,
    lock_path,
)
from prc_cli.jobs.batch.types import Shard
from tests.patience import wait_until

RIVALS = Path(__file__).with_name("rivals.py")
HOLD = """
import sys, time
from pathlib import Path
from prc_cli.jobs.batch.lock import Lock
with Lock(Path(sys.argv[1]), beat_s=0.1):
    print("held", flush=True)
    time.sleep(3600)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / ".prc"


def leave(path: Path, owner: Owner, silent_s: float = 0.0) -> None:
    """Leave the lock of somebody whose last heartbeat is so long ago."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(asdict(owner)))
    then = path.stat().st_mtime - silent_s
    os.utime(path, (then, then))


def dead_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_lock_is_held_and_released(folder: Path) -> None:
    with Lock(folder) as lock:
        (holder,) = holders(folder)
        assert holder.alive
        assert holder.owner == lock.owner
        assert holder.owner.pid == os.getpid()
        lock.check()
        assert lock.inherited_from is None
    assert os.listdir(folder) == []
    assert holders(folder) == []


def test_a_second_run_is_told_who_is_at_work(folder: Path) -> None:
    with Lock(folder), pytest.raises(BusyError) as caught, Lock(folder):
        pass
    assert caught.value.exit_code == 5
    for word in (str(os.getpid()), platform.node(), "another run is at work", f"kill {os.getpid()}"):
        assert word in str(caught.value)
    assert os.listdir(folder) == []


@pytest.mark.parametrize(
    ("first", "second", "together"),
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
    folder: Path, monkeypatch: pytest.MonkeyPatch, first: str | None, second: str | None, together: bool
) -> None:
    monkeypatch.setattr(subject, "CONFLICT_PAUSE_S", 0.001)
    one, other = (None if text is None else Shard.parse(text) for text in (first, second))
    with Lock(folder, one) as lock:
        if together:
            with Lock(folder, other):
                assert len(holders(folder)) == 2
        else:
            with pytest.raises(BusyError), Lock(folder, other):
                pass
        assert [holder.owner for holder in holders(folder)] == [lock.owner]


def test_the_lock_of_a_killed_process_is_taken_over_at_once(folder: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    with pytest.raises(BusyError, match=f"process {process.pid}"), Lock(folder):
        pass
    process.kill()
    # not asked for its exit code yet: a dead process whose parent is busy is dead all the same
    wait_until(lambda: not holders(folder)[0].alive)
    with Lock(folder) as lock:
        assert lock.inherited_from is not None
        assert lock.inherited_from.pid == process.pid
        lock.check()
    process.wait()
    process.stdout.close()
    assert os.listdir(folder) == []


def test_a_stopped_process_of_this_machine_is_not_dead(folder: Path) -> None:
    leave(lock_path(folder), Owner.myself(), silent_s=10_000)
    with pytest.raises(BusyError), Lock(folder):
        pass


def test_a_process_number_that_was_given_again_is_not_the_owner(folder: Path) -> None:
    """Our own number, but a process that started at another time."""
    leave(lock_path(folder), replace(Owner.myself(), born="1"))
    with Lock(folder) as lock:
        assert lock.inherited_from is not None


@pytest.mark.parametrize(
    ("silent_s", "changes", "alive"),
    [
        (0, {"host": "elsewhere"}, True),
        (60, {"host": "elsewhere"}, True),
        (121, {"host": "elsewhere"}, False),
        (0, {"boot": "before the crash"}, True),
        (5, {"boot": "before the crash"}, True),
        (31, {"boot": "before the crash"}, False),
        (60, {"pid_space": "another container"}, True),
        (121, {"pid_space": "another container"}, False),
        (60, {"boot": "", "pid_space": ""}, True),
        (121, {"boot": "", "pid_space": ""}, False),
        (60, {"born": ""}, True),
        (121, {"born": ""}, False),
    ],
)
def test_owners_that_cannot_be_asked_live_by_their_heartbeat(
    folder: Path, silent_s: float, changes: dict[str, str], alive: bool
) -> None:
    leave(lock_path(folder), replace(Owner.myself(), **changes), silent_s)
    assert [holder.alive for holder in holders(folder)] == [alive]
    if alive:
        with pytest.raises(BusyError), Lock(folder):
            pass
    else:
        with Lock(folder):
            pass


@pytest.mark.parametrize("skew_s", [-86_400.0, 86_400.0])
def test_clocks_of_machines_do_not_matter(folder: Path, monkeypatch: pytest.MonkeyPatch, skew_s: float) -> None:
    """Heartbeats are compared with a file that is touched at the same place, not with the clock of this machine."""
    now = time.time
    monkeypatch.setattr(subject.time, "time", lambda: now() + skew_s)
    leave(lock_path(folder), replace(Owner.myself(), host="elsewhere"), silent_s=60)
    with pytest.raises(BusyError), Lock(folder):
        pass
    leave(lock_path(folder), replace(Owner.myself(), host="elsewhere"), silent_s=180)
    with Lock(folder):
        pass


def test_the_heartbeat_beats_while_the_lock_is_held(folder: Path) -> None:
    with Lock(folder, beat_s=0.02) as lock:
        os.utime(lock.path, (1000, 1000))
        wait_until(lambda: lock.path.stat().st_mtime > 1000)
        assert holders(folder)[0].silent_s < 3600


@pytest.mark.parametrize("event", ["taken over", "inherited", "removed"])
def test_an_owner_that_lost_its_lock_finds_out_and_leaves_the_others(folder: Path, event: str) -> None:
    """As after a machine slept: the owner was taken for dead."""
    other = replace(Owner.myself(), host="elsewhere")
    with Lock(folder, beat_s=0.02) as lock:
        if event == "taken over":
            leave(lock.path, other)
        elif event == "inherited":
            leave(lock.path.with_name(f"{lock.path.name}.heir-{lock.owner.token}"), other)
        else:
            lock.path.unlink()
        with pytest.raises(BusyError, match="the lock was lost"):
            wait_until(lock.check)
    if event == "taken over":
        assert [holder.owner for holder in holders(folder)] == [other]


@pytest.mark.parametrize("n_dead_heirs", [0, 1, 3])
def test_heirs_that_died_before_they_had_the_lock_are_inherited_from(folder: Path, n_dead_heirs: int) -> None:
    path = lock_path(folder)
    dead = [replace(Owner.myself(), pid=dead_process()) for _ in range(n_dead_heirs + 1)]
    leave(path, dead[0])
    for before, heir in pairwise(dead):
        leave(path.with_name(f"{path.name}.heir-{before.token}"), heir)
    with Lock(folder) as lock:
        assert lock.inherited_from == dead[-1]
        assert os.listdir(folder) == [path.name]


def test_a_living_heir_that_has_not_got_the_lock_yet_is_respected(folder: Path) -> None:
    path = lock_path(folder)
    dead = replace(Owner.myself(), pid=dead_process())
    leave(path, dead)
    leave(path.with_name(f"{path.name}.heir-{dead.token}"), replace(Owner.myself(), user="heir"))
    with pytest.raises(BusyError, match="of heir on"), Lock(folder):
        pass


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"\x00" * 4096, b'{"pid": "x"}', b"[" * 100_000, b'{"token": "../../x"}']
)
def test_a_lock_that_says_nothing_is_respected_for_two_minutes(folder: Path, content: bytes) -> None:
    folder.mkdir()
    path = lock_path(folder)
    path.write_bytes(content)
    with pytest.raises(BusyError, match="an unknown user on an unknown machine"), Lock(folder):
        pass
    then = path.stat().st_mtime - 121
    os.utime(path, (then, then))
    with Lock(folder) as lock:
        lock.check()
    assert os.listdir(folder) == []


def test_without_second_names_of_files_there_is_one_owner_as_well(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(source: Path, target: Path) -> None:
        raise PermissionError("Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    with Lock(folder), pytest.raises(BusyError), Lock(folder):
        pass
    leave(lock_path(folder), replace(Owner.myself(), pid=dead_process()))
    with Lock(folder) as lock:
        assert lock.inherited_from is not None


def test_a_link_whose_answer_was_lost_is_ours(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    link = os.link

    def lost_answer(source: Path, target: Path) -> None:
        link(source, target)
        raise FileExistsError

    monkeypatch.setattr(os, "link", lost_answer)
    with Lock(folder) as lock:
        assert [holder.owner for holder in holders(folder)] == [lock.owner]


def test_a_folder_that_cannot_be_made_is_said_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="cannot be made"), Lock(tmp_path / "file" / ".prc"):
        pass


@pytest.mark.parametrize("found", ["nothing", "the lock of a dead owner"])
def test_a_rival_that_comes_at_any_step_of_another_makes_one_owner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: str
) -> None:
    """The random fights below in all their variants of one rival that is quick while the other one is slow."""
    until: int | None = None
    """Steps until the rival comes; None when it has come."""

    def stepped(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            nonlocal until
            if until is not None:
                until -= 1
                if until == 0:
                    until = None
                    come()
            return function(*arguments, **named)

        return call

    def come() -> None:
        with suppress(BusyError):
            inside.append(stack.enter_context(Lock(folder)))

    for name in ("_read", "_link", "_write", "_judge", "_chain"):
        monkeypatch.setattr(subject, name, stepped(getattr(subject, name)))
    for name in ("replace", "unlink"):
        monkeypatch.setattr(Path, name, stepped(getattr(Path, name)))
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    dead = replace(Owner.myself(), pid=dead_process())
    for n_steps in count(1):
        folder, inside = tmp_path / f"{n_steps}", list[Lock]()
        if found != "nothing":
            leave(lock_path(folder), dead)
        with ExitStack() as stack:
            until = n_steps
            come()
            if until is not None:  # there are fewer steps
                break
            assert len(inside) == 1, n_steps
            assert [holder.owner for holder in holders(folder)] == [inside[0].owner]
            inside[0].check()
        assert os.listdir(folder) == []
    until = None
    assert n_steps > 5


def fight(folder: Path, seed: int, n_lives: int, n_inherited: int, kinds: str) -> None:
    """Let rivals fight until so many lived and so many inherited a lock; nobody may have met another inside."""
    command = [sys.executable, str(RIVALS), str(folder), str(seed), str(n_lives), str(n_inherited), kinds]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=3600)
    assert result.returncode == 0, result.stderr
    counts: dict[str, int] = json.loads(result.stdout)
    assert counts.get("VIOLATION", 0) == 0
    assert counts.get("LOST", 0) == 0
    assert counts["failed"] == 0, result.stderr
    assert counts["inherited"] >= n_inherited, counts


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc and fork")
@pytest.mark.parametrize(("seed", "kinds"), [(1, "whole"), (2, "whole,1/2,2/2,1/3")])
def test_rivals_that_die_at_any_step_are_never_two_inside(tmp_path: Path, seed: int, kinds: str) -> None:
    fight(tmp_path, seed, 40, 8, kinds)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc and fork")
@pytest.mark.parametrize("kinds", ["whole", "whole,1/2,2/2,1/3", "2/5"])
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_many_rivals_are_never_two_inside(tmp_path: Path, seed: int, kinds: str) -> None:
    fight(tmp_path, seed, 1200, 100, kinds)


def test_a_shard_is_a_part_of_the_whole_and_the_same_for_ever() -> None:
    names = [f"2026/day {i}/drive.laz" for i in range(400)]
    parts = [{name for name in names if Shard(i, 7).holds(name)} for i in range(1, 8)]
    assert sum(map(len, parts)) == len(set.union(*parts)) == len(names)
    assert min(map(len, parts)) > 30
    of_four = [
        next(i for i in range(1, 5) if Shard(i, 4).holds(name))
        for name in ["a.laz", "b.laz", "night/c d.laz", "odd\udcff.laz"]
    ]
    assert of_four == [2, 1, 1, 1]


@pytest.mark.parametrize(
    "text", ["", "3", "0/4", "5/4", "1/0", "a/b", "1/2/3", "-1/4", "1.0/4", "²/4", "1/99999999999"]
)
def test_odd_shards_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--shard"):
        Shard.parse(text)
