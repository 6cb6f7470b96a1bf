"""Outputs exist complete or not at all."""

import errno
import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from prc_cli.core import files
from prc_cli.core.errors import OutputError, OutputExistsError
from prc_cli.core.files import (
    atomic_output,
    atomic_outputs,
    check_output,
    is_left_behind,
    temporary_name,
)
from tests import patience
from tests.patience import wait_until


@pytest.mark.parametrize("overwrite", [None, False])
def test_a_file_that_appears_meanwhile_is_not_replaced(tmp_path, overwrite):
    target = tmp_path / "labels.npy"
    with (
        pytest.raises(OutputExistsError, match="appeared while it was being written"),
        atomic_output(target, overwrite=overwrite) as temporary,
    ):
        temporary.write_bytes(b"mine")
        target.write_bytes(b"theirs")
    assert target.read_bytes() == b"theirs"
    assert os.listdir(tmp_path) == ["labels.npy"]


def test_of_several_files_all_appear_or_none(tmp_path):
    first = tmp_path / "labels.npy"
    second = tmp_path / "labels.npy.prc.json"
    with pytest.raises(OutputExistsError), atomic_outputs(first, second) as temporaries:
        for temporary in temporaries:
            temporary.write_bytes(b"mine")
        second.write_bytes(b"theirs")
    assert os.listdir(tmp_path) == [second.name]
    with atomic_outputs(first, second) as temporaries:  # it was there from the beginning
        for temporary in temporaries:
            temporary.write_bytes(b"mine")
    assert first.read_bytes() == second.read_bytes() == b"mine"


@pytest.mark.parametrize("number", [errno.EPERM, errno.ENOTSUP])
def test_a_file_system_without_hard_links(tmp_path, monkeypatch, number):
    def refused(source: Path, target: Path) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(files.os, "link", refused)
    target = tmp_path / "labels.npy"
    with atomic_output(target) as temporary:
        temporary.write_bytes(b"mine")
    with pytest.raises(OutputExistsError), atomic_output(target, overwrite=False) as temporary:
        temporary.write_bytes(b"second")
    assert target.read_bytes() == b"mine"


def test_only_small_regular_files_are_read(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    assert files.read_small(tmp_path / "a", 5) == b"12345"
    os.mkfifo(tmp_path / "pipe")
    for name, limit in (("a", 4), ("pipe", 9), (".", 9), ("none", 9)):
        with pytest.raises(OSError):
            files.read_small(tmp_path / name, limit)


@pytest.mark.parametrize("failure", [ValueError("wrong"), KeyboardInterrupt()])
def test_an_interrupted_file_leaves_nothing(tmp_path, failure):
    target = tmp_path / "labels.npy"
    with pytest.raises(type(failure)), atomic_output(target) as temporary:
        temporary.write_bytes(b"half")
        raise failure
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_said_so(tmp_path):
    target = tmp_path / "labels.npy"
    with pytest.raises(OutputError, match="the disk is full"), atomic_output(target) as temporary:
        temporary.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert os.listdir(tmp_path) == []


def test_check_output_refuses_before_any_work(tmp_path, monkeypatch):
    source = tmp_path / "drive.las"
    source.write_bytes(b"x")
    with pytest.raises(OutputExistsError, match="the output is the input itself"):
        check_output(source, overwrite=True, inputs=(source,))
    link = tmp_path / "link.las"
    link.hardlink_to(source)
    with pytest.raises(OutputExistsError, match="the output is the input itself"):
        check_output(link, overwrite=True, inputs=(source,))
    with pytest.raises(
        OutputExistsError, match="exists already; choose another name or add --overwrite"
    ):
        check_output(source, overwrite=False)
    check_output(source, overwrite=True)
    with pytest.raises(OutputError, match="output folder does not exist; create it: mkdir -p"):
        check_output(tmp_path / "none" / "out.las", overwrite=False)
    with pytest.raises(OutputError, match="is a folder"):
        check_output(tmp_path, overwrite=True)
    # root may write anywhere, so the permission itself cannot be tested as root
    monkeypatch.setattr(files.os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match="not writable"):
        check_output(tmp_path / "out.las", overwrite=False)


@pytest.mark.skipif(os.name != "posix", reason="processes can only be asked on POSIX")
def test_what_a_killed_run_left_is_removed_and_nothing_else(tmp_path):
    target = tmp_path / "labels[1].npy"
    code = (
        "import sys; from pathlib import Path; from prc_cli.core.files import temporary_name\n"
        "path = temporary_name(Path(sys.argv[1])); path.write_bytes(b'half'); print(path)"
    )
    command = [sys.executable, "-c", code, str(target)]
    dead = Path(patience.run(command, capture_output=True, text=True, check=True).stdout.strip())
    mine = files.temporary_name(target)
    mine.write_bytes(b"half")
    unrelated = tmp_path / ".labels[1].npy.0badcafe-1-00000000.part"
    unrelated.write_bytes(b"another machine's")
    assert files.remove_stale(tmp_path / "labels1.npy") == ()
    assert files.remove_stale(target) == (dead,)
    assert sorted(tmp_path.iterdir()) == sorted([mine, unrelated])


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_dead_process_that_nobody_waits_for_is_dead(tmp_path):
    """As in a container whose first process does not."""
    with patience.start([sys.executable, "-c", ""]) as process:
        wait_until(lambda: b") Z" in Path(f"/proc/{process.pid}/stat").read_bytes())
        part = temporary_name(tmp_path / "a.npy").name.replace(
            f"-{os.getpid()}-", f"-{process.pid}-"
        )
        assert is_left_behind(tmp_path / part)


@pytest.mark.skipif(not Path("/proc/uptime").exists(), reason="needs /proc")
def test_a_process_that_was_given_the_number_of_a_dead_one_is_not_the_writer(
    tmp_path,
):
    """As after a restart of the machine, when the numbers begin anew."""
    part = temporary_name(tmp_path / "a.npy")
    part.touch()
    assert is_left_behind(part) is False
    long_ago = time.time() - 400 - float(Path("/proc/uptime").read_text().split()[0])
    os.utime(part, (long_ago, long_ago))
    assert is_left_behind(part) is True


def test_an_output_onto_a_device_or_a_pipe_is_refused():
    with pytest.raises(OutputError, match="is a pipe or a device"):
        check_output(Path(os.devnull), overwrite=True)


def test_what_a_library_does_not_say_of_a_full_disk(tmp_path, monkeypatch):
    path = tmp_path / "o.sqlite"
    path.write_bytes(b"half")
    assert files.why_not_written(path) == 0
    monkeypatch.setattr(files.shutil, "disk_usage", lambda folder: SimpleNamespace(free=4096))
    assert files.why_not_written(path) == errno.ENOSPC
