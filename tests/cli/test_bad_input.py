"""Broken files and wrong options: one clear line, the right exit code, nothing left behind."""

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from prc_cli.cli import cli
from prc_cli.formats.writing.base import StagedWriter
from tests import patience
from tests.street import street, write_npz, write_raw


def test_names_with_control_characters_stay_on_one_line(prc, tmp_path):
    result = prc("classify", tmp_path / "a\nb\x1b[31m.las", tmp_path / "labels.npy")
    assert result.code == 1
    assert len(result.err.splitlines()) == 1
    assert "\x1b" not in result.err


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    "command", [["config", "show"], ["config", "schema"], ["completion", "bash"], ["--help"]]
)
def test_a_result_that_cannot_be_printed_is_one_line(command):
    with Path("/dev/full").open("w") as full:
        result = patience.run(
            [sys.executable, "-m", "prc_cli", *command],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert result.returncode == 1
    assert result.stderr == "error: the result cannot be printed (No space left on device)\n"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize(
    "option, name",
    [("--config", "x.toml"), ("--layout", "x.toml"), ("--set", "x.json")],
)
def test_settings_are_regular_files(
    prc,
    tmp_path,
    option,
    name,
):
    os.mkfifo(tmp_path / name)
    drive = write_raw(tmp_path / "drive.bin", street())
    if option == "--set":
        shutil.copyfile(drive, drive := tmp_path / "drive.pcap")
    for path in (tmp_path / name, Path("/dev/zero")):
        typed = f"input.metadata={path}" if option == "--set" else path
        result = prc(f"info {drive} {option} {typed}")
        assert (result.code, result.out) == (1 if option == "--set" else 2, "")
        assert f"{path}: cannot be read" in result.err
        assert "is no regular file" in result.err


@pytest.mark.parametrize(
    "error, line",
    [
        (
            OSError(errno.EMFILE, "Too many open files"),
            "Too many open files; no output was left behind; raise the limit",
        ),
        (
            OSError(errno.EFBIG, "File too large"),
            "File too large; no output was left behind; raise the limit of this",
        ),
        (
            OSError(errno.EACCES, "Permission denied", "a.csv"),
            "a.csv: Permission denied; check the file",
        ),
        (
            OSError(errno.EIO, "Input/output error"),
            "the result cannot be printed (Input/output error)",
        ),
    ],
)
def test_what_the_system_refuses_is_named(
    prc,
    tmp_path,
    monkeypatch,
    error,
    line,
):
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("prc_cli.cli.convert.convert_file", refuse)
    result = prc("convert", write_npz(tmp_path / "drive.npz", street()), tmp_path / "drive.csv")
    assert result.code == 1
    assert result.err.startswith(f"error: {line}")


@pytest.mark.parametrize("output", ["a.laz", "a.las", "a.npy"])
def test_interrupting_leaves_nothing_and_says_so(
    prc,
    tmp_path,
    monkeypatch,
    output,
):
    source = write_npz(tmp_path / "drive.npz", street())
    seen: list[int] = []

    def interrupt(self: object, block: object) -> None:
        seen.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(StagedWriter, "add", interrupt)
    result = prc(f"classify {source} {tmp_path}/{output}")
    assert seen
    assert result.code == 130
    assert result.err.strip() == "error: interrupted; no output was left behind"
    assert sorted(os.listdir(tmp_path)) == ["drive.npz"]


@pytest.mark.parametrize("error", [MemoryError(), ImportError("no libx")])
def test_what_the_machine_lacks_ends_in_one_line(prc, monkeypatch, error):
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(cli, "main", fail)
    result = prc("info a.laz")
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert result.err.startswith("error: ")
