"""Output folders that are full, read-only or owned by another user."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from prc_cli.core.files import temporary_name
from prc_cli.jobs.batch.types import OWN_FOLDER
from tests import patience
from tests.faults.harness import Archive, Batch, check_nothing_half, check_whole, entries, parts, tree
from tests.faults.test_inputs import failures, resume
from tests.patience import dead_process

pytestmark = pytest.mark.slow


@contextlib.contextmanager
def small_disk(folder: Path, kib: int) -> Iterator[Path]:
    """Mount a file system of so many KiB."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(folder)]
    result = patience.run(command, capture_output=True, text=True) if os.getuid() == 0 else None
    if result is None or result.returncode:
        pytest.skip("only root can mount a small disk" if result is None else f"cannot mount: {result.stderr}")
    try:
        yield folder
    finally:
        patience.run(["umount", str(folder)], check=True)


def change(disk: Path, options: str) -> None:
    patience.run(["mount", "-o", f"remount,{options}", str(disk)], check=True)


@pytest.mark.parametrize(
    "share", [pytest.param(0.02, marks=pytest.mark.long), 0.5, pytest.param(0.9, marks=pytest.mark.long)]
)
def test_a_full_disk_is_said_so_and_after_room_was_made_the_run_goes_on(
    few: Archive, tmp_path: Path, share: float
) -> None:
    needed = sum(map(len, few.whole.values())) // 1024
    with small_disk(tmp_path / "disk", max(60, int(share * needed))) as disk:
        out = disk / "out"
        code, said = Batch(few.folder, out, few.config).end()
        assert code == 1, said
        assert "disk is full" in said
        assert "Traceback" not in said
        check_nothing_half(few, out)
        assert len(tree(out)) < len(few.whole)
        assert parts(out) == []
        change(disk, f"size={4 * needed}k")
        resume(few, out)


@pytest.mark.long
def test_a_disk_that_becomes_read_only_keeps_what_it_has(few: Archive, tmp_path: Path) -> None:
    """The state an ext4 gets into after an error."""
    with small_disk(tmp_path / "disk", 50_000) as disk:
        out = disk / "out"
        code, said = Batch(few.folder, out, few.config, "--limit", "1").end()
        assert code == 0, said
        before = tree(out)
        change(disk, "ro")
        code, said = Batch(few.folder, out, few.config).end()
        assert code == 1, said
        (line,) = [line for line in said.splitlines() if line.startswith("error: ")]
        assert "ead-only file system" in line
        assert tree(out) == before
        status = patience.run(
            [sys.executable, "-m", "prc_cli", "batch", "status", str(out)], capture_output=True, text=True
        )
        assert status.returncode == 0, status.stderr
        change(disk, "rw")
        resume(few, out)


@pytest.mark.long
@pytest.mark.parametrize("what", ["all of it", "a folder in it"])
def test_a_shut_output_folder_is_said_so(few: Archive, tmp_path: Path, what: str) -> None:
    out = tmp_path / "out"
    shut = out if what == "all of it" else out / "2026"
    shut.mkdir(parents=True)
    shut.chmod(0o555)
    try:
        code, said = Batch(few.folder, out, few.config, plain_user=True).end()
    finally:
        shut.chmod(0o755)
    assert code == 1, said
    assert "ermission" in said
    assert "Traceback" not in said
    if what == "all of it":
        assert len([line for line in said.splitlines() if line.startswith("error: ")]) == 1
        assert os.listdir(out) == []
    else:
        assert len(failures(said)) == 2
        check_nothing_half(few, out)
        assert "rückweg.las" in tree(out)
    resume(few, out)


def test_outputs_of_somebody_else_stay(few: Archive, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "rückweg.las").write_bytes(b"mine")
    for _ in range(2):  # the journal of the first run must not make it ours in the second
        code, said = Batch(few.folder, out, few.config).end()
        assert code in (1, 2), said
        assert len(failures(said)) == 1
        assert (out / "rückweg.las").read_bytes() == b"mine"
    (out / "rückweg.las").unlink()
    # what runs leave that are killed just before they rename a file of their own
    for path in (out / "summary.json", out / OWN_FOLDER / "command.json", out / OWN_FOLDER / "lock.json"):
        name = temporary_name(path).name.replace(f"-{os.getpid()}-", f"-{dead_process()}-")
        path.with_name(name).write_bytes(b"half")
    resume(few, out)


@pytest.mark.long
def test_a_lost_or_damaged_journal_costs_no_output_and_no_work(few: Archive, tmp_path: Path) -> None:
    out = tmp_path / "out"
    resume(few, out)
    stamps = {path: path.stat().st_mtime_ns for path in out.rglob("*.l*")}
    journal = out / OWN_FOLDER / "journal.sqlite"
    journal.write_bytes(b"SQLite format 3\0" + os.urandom(journal.stat().st_size))
    code, said = Batch(few.folder, out, few.config).end()
    assert code == 1, said
    (line,) = [line for line in said.splitlines() if line.startswith("error: ")]
    assert "is no whole journal" in line
    assert "--adopt" in line
    journal.rename(journal.with_suffix(".damaged"))
    code, said = Batch(few.folder, out, few.config, "--adopt").end()
    assert code == 0, said
    journal.with_suffix(".damaged").unlink()
    check_whole(few, out)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.l*")} == stamps
    assert {entry.state for entry in entries(out).values()} == {"done"}
