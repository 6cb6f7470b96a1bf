"""Outputs exist complete or not at all."""

from __future__ import annotations

import errno
import io
import os
import pickle
import sys
from pathlib import Path

import pytest

from prc_cli.core import files
from prc_cli.core.errors import ConfigError, GateError, InputError, OutputError, OutputExistsError, PrcError
from prc_cli.core.files import atomic_output, check_output
from tests import patience


def test_a_finished_file_takes_its_name_and_leaves_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "labels.npy"
    target.write_bytes(b"old")
    with atomic_output(target) as temporary:
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["labels.npy"]


@pytest.mark.parametrize("failure", [ValueError("wrong"), KeyboardInterrupt()])
def test_an_interrupted_file_leaves_nothing(tmp_path: Path, failure: BaseException) -> None:
    target = tmp_path / "labels.npy"
    with pytest.raises(type(failure)), atomic_output(target) as temporary:
        temporary.write_bytes(b"half")
        raise failure
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_said_so(tmp_path: Path) -> None:
    target = tmp_path / "labels.npy"
    with pytest.raises(OutputError, match="the disk is full"), atomic_output(target) as temporary:
        temporary.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert os.listdir(tmp_path) == []


def test_reading_errors_inside_keep_their_own_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic_output(tmp_path / "out.npy"):
        (tmp_path / "folder" / "input.las").read_bytes()


def test_check_output_refuses_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "drive.las"
    source.write_bytes(b"x")
    with pytest.raises(OutputExistsError, match="the output is the input itself"):
        check_output(source, overwrite=True, inputs=(source,))
    link = tmp_path / "link.las"
    link.hardlink_to(source)
    with pytest.raises(OutputExistsError, match="the output is the input itself"):
        check_output(link, overwrite=True, inputs=(source,))
    with pytest.raises(OutputExistsError, match="exists already; choose another name or add --overwrite"):
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


def test_cache_folder_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    assert files.cache_folder().name == "prc-cli"


@pytest.mark.parametrize("kind", [PrcError, InputError, OutputError, ConfigError, GateError])
def test_errors_survive_worker_processes(kind: type[PrcError]) -> None:
    error = kind("drive.las", "found 3, expected 4", "look")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == "drive.las: found 3, expected 4; look"
    assert again.exit_code in (1, 2, 3)


@pytest.mark.skipif(os.name != "posix", reason="processes can only be asked on POSIX")
def test_what_a_killed_run_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "labels[1].npy"
    code = (
        "import sys; from pathlib import Path; from prc_cli.core.files import temporary_name\n"
        "path = temporary_name(Path(sys.argv[1])); path.write_bytes(b'half'); print(path)"
    )
    command = [sys.executable, "-c", code, str(target)]
    dead = Path(patience.run(command, capture_output=True, text=True, check=True).stdout.strip())
    mine = files.temporary_name(target)
    mine.write_bytes(b"half")
    other = tmp_path / ".labels[1].npy.0badcafe-1-00000000.part"
    other.write_bytes(b"another machine's")
    assert files.remove_stale(tmp_path / "labels1.npy") == ()
    assert files.remove_stale(target) == (dead,)
    assert sorted(tmp_path.iterdir()) == sorted([mine, other])


def test_to_begin_a_flush_changes_nothing_and_never_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / "a").open("w+b") as handle:
        handle.write(b"abc")
        files.begin_flush(handle, 0, 3)
        monkeypatch.delattr(os, "posix_fadvise", raising=False)
        files.begin_flush(handle, 0, 3)
    monkeypatch.undo()
    files.begin_flush(io.BytesIO(b"abc"), 0, 3)
    assert (tmp_path / "a").read_bytes() == b"abc"
