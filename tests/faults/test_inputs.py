"""Inputs that vanish, change or are damaged fail with one line and do not stop the run.

Folders that are full.
"""

import contextlib
import os
import random
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from prc_cli.core.files import temporary_name
from prc_cli.jobs.batch.types import OWN_FOLDER
from tests import patience
from tests.faults.harness import (
    FAST,
    Batch,
    check_nothing_half,
    entries,
    hooked,
    parts,
    resume,
    tree,
)
from tests.faults.test_kills import release, run_into
from tests.messages import folded
from tests.patience import dead_process

pytestmark = pytest.mark.slow

FIRST = "2026/day 1/drive.npz"
LAST = "rückweg.las"
"""The files are begun in the order of their names."""


def failures(said: str) -> list[str]:
    return [line for line in said.splitlines() if line.startswith("[") and "] failed " in line]


@pytest.mark.long
@pytest.mark.parametrize("fate", ["vanishes", "becomes a pipe"])
def test_an_input_that_is_gone_when_its_turn_comes(few, tmp_path, fate):
    out = tmp_path / "out"
    path = few.folder / LAST
    aside = tmp_path / "aside"
    batch = run_into(few, out, [FIRST], jobs=1)
    path.rename(aside)
    if fate == "becomes a pipe":
        os.mkfifo(path)
    release(out)
    said = batch.ends(1)
    (line,) = failures(said)
    assert LAST in line
    check_nothing_half(few, out)
    assert entries(out)[LAST].state == "failed"
    path.unlink(missing_ok=True)
    aside.rename(path)
    resume(few, out)


def test_inputs_that_change_while_they_are_read_are_not_done(few, tmp_path):
    """As copies that are not complete.

    Whenever the run opens them again one is longer, the other one is younger.
    """
    out = tmp_path / "out"
    path = few.folder / LAST
    size = path.stat().st_size
    change = hooked("PRC_FAULTS_CHANGE", os.pathsep.join([str(path), str(few.folder / FIRST)]))
    said = Batch(few, out, jobs=1, environment=change).ends(1)
    changed = [line.partition(" failed ")[2].partition(";")[0] for line in failures(said)]
    assert changed == [f"{name}: changed while it was read" for name in (FIRST, LAST)], said
    assert path.stat().st_size > size
    os.truncate(path, size)
    check_nothing_half(few, out)
    assert not {FIRST, LAST} & set(tree(out))
    resume(few, out)


@pytest.mark.long
def test_an_input_that_is_replaced_again_and_again_ends_with_the_output_of_the_last(few, tmp_path):
    """By renaming, as a careful copy does."""
    out = tmp_path / "out"
    rng = random.Random(5)
    path = few.folder / "2026/day 2/drive.laz"
    first = tmp_path / "one.laz"
    second = tmp_path / "other.laz"
    shutil.copy(path, first)
    second.write_bytes(first.read_bytes()[:-1])
    for _ in range(4):
        batch = Batch(few, out)
        while batch.process.poll() is None:
            new = tmp_path / "new.laz"
            shutil.copy(rng.choice([first, second]), new)
            new.replace(path)
            with contextlib.suppress(Exception):
                batch.process.wait(rng.random() * 0.3)
        code, said = batch.end()
        assert code in (0, 1), said
        check_nothing_half(few, out)
    shutil.copy2(first, path)
    resume(few, out)


@pytest.mark.long
def test_a_shut_input_costs_itself_alone(few, tmp_path):
    out = tmp_path / "out"
    (few.folder / FIRST).chmod(0)
    (few.folder / "2026/day 2").chmod(0)
    try:
        said = Batch(few, out, plain_user=True).ends(1)
    finally:
        (few.folder / FIRST).chmod(0o644)
        (few.folder / "2026/day 2").chmod(0o755)
    assert any(FIRST in line and "ermission denied" in line for line in failures(said)), said
    assert "day 2" in said, "a folder that cannot be listed must be named"
    check_nothing_half(few, out)
    assert LAST in tree(out)
    resume(few, out)


def test_corrupt_files_and_things_that_are_no_files_cost_themselves_alone(few, tmp_path):
    out = tmp_path / "out"
    rng = random.Random(6)
    bad = few.folder / "bad"
    bad.mkdir()
    good = {name: (few.folder / name).read_bytes() for name in FAST}
    laz = good["2026/day 2/drive.laz"]
    las = good[LAST]
    npz = good[FIRST]
    made = {
        "cut.laz": laz[: len(laz) // 2],
        "cut header.las": las[:100],
        "cut.las": las[:-1001],
        "empty.las": b"",
        "empty.csv": b"",
        "cut.npz": npz[: len(npz) // 2],
        "wrong suffix.laz": b"x,y,z\n1,2,3\n",
        "wrong suffix.csv": laz,
        "wrong suffix.npz": las,
        "zeros.laz": bytes(20_000),
    }
    for number in range(3):
        flipped = bytearray(laz)
        for _ in range(40):
            flipped[rng.randrange(600, len(flipped))] ^= 1 << rng.randrange(8)
        made[f"flipped\n{number}.laz"] = bytes(flipped)
    for name, content in made.items():
        (bad / name).write_bytes(content)
    os.mkfifo(bad / "pipe.laz")
    (bad / "away.laz").symlink_to("/etc/passwd")
    (bad / "loop.laz").symlink_to("loop.laz")
    (bad / "folder.laz").mkdir()
    said = Batch(few, out).ends(1)
    assert "\x1b" not in said
    lines = failures(said)
    for name in made:
        shown = name.replace("\n", "\\n")
        assert (
            sum(f"bad/{shown}" in line.split(": ")[0] for line in lines) == 1 or "flipped" in name
        ), (name, said)
    outputs = tree(out)
    assert {
        name: content for name, content in outputs.items() if not name.startswith("bad/")
    } == few.whole
    assert not [name for name in outputs if name.startswith("bad/") and "flipped" not in name]
    assert parts(out) == []
    shutil.rmtree(bad)
    shutil.rmtree(out / "bad", ignore_errors=True)
    Batch(few, out).ends(0)
    assert tree(out) == few.whole


@contextlib.contextmanager
def small_disk(folder: Path, kib: int) -> Iterator[Path]:
    """Mount a file system of so many KiB."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(folder)]
    result = patience.run(command, capture_output=True, text=True) if os.getuid() == 0 else None
    if result is None or result.returncode:
        pytest.skip(
            "only root can mount a small disk"
            if result is None
            else f"cannot mount: {result.stderr}"
        )
    try:
        yield folder
    finally:
        patience.run(["umount", str(folder)], check=True)


def change(disk: Path, options: str) -> None:
    patience.run(["mount", "-o", f"remount,{options}", str(disk)], check=True)


@pytest.mark.parametrize(
    "share",
    [pytest.param(0.02, marks=pytest.mark.long), 0.5, pytest.param(0.9, marks=pytest.mark.long)],
)
def test_a_full_disk_is_said_so_and_after_room_was_made_the_run_goes_on(few, tmp_path, share):
    needed = sum(map(len, few.whole.values())) // 1024
    with small_disk(tmp_path / "disk", max(60, int(share * needed))) as disk:
        out = disk / "out"
        assert "disk is full" in Batch(few, out).ends(1)
        check_nothing_half(few, out)
        assert len(tree(out)) < len(few.whole)
        assert parts(out) == []
        change(disk, f"size={4 * needed}k")
        resume(few, out)


@pytest.mark.long
def test_a_disk_that_becomes_read_only_keeps_what_it_has(few, tmp_path):
    """The state an ext4 gets into after an error."""
    with small_disk(tmp_path / "disk", 50_000) as disk:
        out = disk / "out"
        Batch(few, out, "--limit", "1").ends(0)
        before = tree(out)
        change(disk, "ro")
        said = Batch(few, out).ends(1)
        (line,) = [line for line in folded(said).splitlines() if line.startswith("error: ")]
        assert "ead-only file system" in line
        assert tree(out) == before
        status = patience.run(
            [sys.executable, "-m", "prc_cli", "batch", "status", str(out)],
            capture_output=True,
            text=True,
        )
        assert status.returncode == 0, status.stderr
        change(disk, "rw")
        resume(few, out)


@pytest.mark.long
@pytest.mark.parametrize("what", ["all of it", "a folder in it"])
def test_a_shut_output_folder_is_said_so(few, tmp_path, what):
    out = tmp_path / "out"
    shut = out if what == "all of it" else out / "2026"
    shut.mkdir(parents=True)
    shut.chmod(0o555)
    try:
        said = Batch(few, out, plain_user=True).ends(1)
    finally:
        shut.chmod(0o755)
    assert "ermission" in said
    if what == "all of it":
        assert len([line for line in said.splitlines() if line.startswith("error: ")]) == 1
        assert os.listdir(out) == []
    else:
        assert len(failures(said)) == 2
        check_nothing_half(few, out)
        assert "rückweg.las" in tree(out)
    resume(few, out)


def test_outputs_of_somebody_else_stay(few, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "rückweg.las").write_bytes(b"mine")
    assert len(failures(Batch(few, out).ends(1))) == 1
    assert (out / "rückweg.las").read_bytes() == b"mine"
    (out / "rückweg.las").unlink()
    # what runs leave that are killed just before they rename a file of their own
    for path in (
        out / "summary.json",
        out / OWN_FOLDER / "command.json",
        out / OWN_FOLDER / "lock.json",
    ):
        name = temporary_name(path).name.replace(f"-{os.getpid()}-", f"-{dead_process()}-")
        path.with_name(name).write_bytes(b"half")
    resume(few, out)
