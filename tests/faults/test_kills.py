"""Killed at any moment: no partial file under its final name, and the next run completes as
usual."""

import os
import random
import re
import signal
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from prc_cli.jobs.batch.journal import Entry, read_runs
from prc_cli.jobs.batch.types import OWN_FOLDER
from tests.faults import step_kills
from tests.faults.harness import (
    FAST,
    Archive,
    Batch,
    check_nothing_half,
    check_whole,
    entries,
    hooked,
    part_of,
    parts,
    resume,
)
from tests.faults.kills import kill_many
from tests.faults.step_kills import Strike, strike_step
from tests.patience import wait_until

pytestmark = pytest.mark.slow


def test_some_kills(few, tmp_path):
    """Everything, then the first process alone, then a worker, while a file is at work in one
    folder."""
    out = tmp_path / "out"
    for n_known, strike in ((1, Batch.strike_all), (2, Batch.strike)):
        batch = run_into(few, out, FAST[n_known : n_known + 1], jobs=1)
        assert strike(batch)
        batch.process.communicate()
        batch.wait_until_gone()
        check_nothing_half(few, out)
        states = [entry.state for entry in sorted(known(out), key=lambda entry: entry.name)]
        assert states == ["done"] * n_known + ["running"]
    batch = run_into(few, out, FAST[2:], jobs=1)
    assert batch.strike_worker(random.Random(3))
    release(out)
    batch.ends(0)
    check_whole(few, out)


@pytest.mark.long
def test_many_kills(archive, tmp_path):
    """``python -m tests.faults.kills --kills 200`` does this 200 times."""
    tally = kill_many(archive, tmp_path, 40, seed=4)
    assert tally.with_running > 5


@pytest.mark.long
def test_kills_with_dask(fast, tmp_path):
    """Of the run, its workers and the scheduler."""
    kill_many(fast, tmp_path, 4, seed=13, engine="dask")


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 12))]
)
def test_a_kill_just_before_a_step_in_the_output_folder(fast, tmp_path, seed):
    """``python -m tests.faults.step_kills`` takes every step."""
    rng = random.Random(seed)
    two = part_of(fast, tmp_path / "archive", step_kills.NAMES)
    strike_step(two, tmp_path / "out", Strike(rng.randint(8, 44), rng.choice(["all", "self"])))


@pytest.mark.long
@pytest.mark.parametrize("victims", ["all", "self"])
def test_a_kill_right_after_a_file_got_its_name(fast, tmp_path, victims):
    """``python -m tests.faults.step_kills --names`` takes every name."""
    two = part_of(fast, tmp_path / "archive", step_kills.NAMES)
    strike_step(two, tmp_path / "out", Strike(4, victims, names=True))


def run_into(
    archive: Archive,
    out: Path,
    names: Sequence[str],
    *options: str,
    jobs: int = 2,
) -> Batch:
    """Start a run and return when its workers are about to open all these inputs, which
    :func:`release` lets them."""
    held = [Path(f"{_release(out)}.{number}") for number in range(len(names))]
    for path in (_release(out), *held):
        path.unlink(missing_ok=True)
    hold = hooked(
        "PRC_FAULTS_HOLD",
        os.pathsep.join([str(_release(out)), *(str(archive.folder / n) for n in names)]),
    )
    batch = Batch(archive, out, *options, jobs=jobs, environment=hold)
    wait_until(lambda: all(path.exists() for path in held) or batch.process.poll() is not None)
    return batch


def release(out: Path) -> None:
    """Let the workers of a run into an output folder go on."""
    _release(out).touch()


def _release(out: Path) -> Path:
    return out.with_name("release")


def known(out: Path) -> list[Entry]:
    return list(entries(out).values()) if (out / OWN_FOLDER).exists() else []


@pytest.mark.parametrize(
    "number, n_times",
    [
        (signal.SIGTERM, 1),
        (signal.SIGINT, 1),
        pytest.param(signal.SIGINT, 3, marks=pytest.mark.long),
    ],
)
def test_a_signal_ends_the_run_within_seconds(
    few,
    tmp_path,
    number,
    n_times,
):
    out = tmp_path / "out"
    batch = run_into(few, out, FAST[1:])
    assert batch.strike(number)
    for _ in range(n_times - 1):  # somebody who is impatient
        time.sleep(0.1)
        batch.strike(number)
    code, said = batch.end()
    # the last of several may come when Python has put back the system's own handling, which shells
    # show as the same
    assert code == 128 + number or (n_times > 1 and code == -number), said
    assert "Traceback" not in said
    if n_times == 1:
        assert batch.members() == []
    batch.wait_until_gone()
    assert parts(out) == []
    check_nothing_half(few, out)
    if n_times == 1:
        assert [run.exit_code for run in read_runs(out / OWN_FOLDER)] == [code]
        assert {entry.state for entry in known(out)} <= {"done", "running"}
    resume(few, out)


@pytest.mark.long
def test_a_closed_terminal_leaves_no_worker(few, tmp_path):
    batch = run_into(few, tmp_path / "out", FAST[1:])
    batch.strike(signal.SIGHUP)
    batch.ends(128 + signal.SIGHUP)
    batch.wait_until_gone()
    check_nothing_half(few, tmp_path / "out")
    resume(few, tmp_path / "out")


@pytest.mark.long
def test_two_runs_at_once_do_no_harm(few, tmp_path):
    out = tmp_path / "out"
    runs = [Batch(few, out, jobs=1) for _ in range(2)]
    ended = sorted(run.end() for run in runs)
    assert [code for code, _ in ended] == [0, 5] or [code for code, _ in ended] == [0, 0], ended
    if ended[1][0] == 5:
        (line,) = [
            line for line in ended[1][1].splitlines() if "another run is at work here" in line
        ]
        assert re.search(r"kill \d+", line)
    check_whole(few, out)
    assert {entry.attempts for entry in known(out)} == {1}


@pytest.mark.long
def test_shards_side_by_side_and_killed_end_with_the_same_bytes(archive, tmp_path):
    out = tmp_path / "out"
    for _ in range(2):
        runs = [Batch(archive, out, "--shard", f"{i}/3", jobs=1) for i in (1, 2, 3)]
        time.sleep(archive.seconds / 2)
        runs[1].strike_all()
        for run in runs:
            run.process.communicate()
    runs = [Batch(archive, out, "--shard", f"{i}/3", jobs=1) for i in (1, 2, 3)]
    assert [run.end()[0] for run in runs] == [0, 0, 0]
    assert {entry.state for entry in known(out)} == {"done"}
    # the whole archive knows what the shards did
    Batch(archive, out).ends(0)
    assert {entry.name for entry in known(out)} == archive.names
    check_nothing_half(archive, out)
    assert parts(out) == []
