"""Broken files and wrong options: one clear line, the right exit code, nothing left behind."""

from __future__ import annotations

import errno
import gzip
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.formats.writing.base import StagedWriter
from tests import patience
from tests.cli.test_commands import Prc, prc
from tests.street import N_LINES, POINTS_PER_LINE, street, write_csv, write_npz, write_raw

__all__ = ["prc"]

M = ("-M", str(POINTS_PER_LINE))


def las(folder: Path, name: str = "drive.las") -> Path:
    """A LAS file with ranges, lines and columns as this program writes it."""
    from prc_cli.jobs.classify import classify

    path = folder / name
    classify(write_npz(folder / "source.npz", street()), path)
    (folder / f"{name}.prc.json").unlink()
    (folder / "source.npz").unlink()
    return path


def empty(folder: Path) -> Path:
    path = folder / "drive.las"
    path.touch()
    return path


def not_las(folder: Path) -> Path:
    path = folder / "drive.las"
    path.write_bytes(b"x" * 1000)
    return path


def las_header_only(folder: Path) -> Path:
    path = folder / "drive.las"
    with laspy.open(path, mode="w", header=laspy.LasHeader(point_format=6, version="1.4")):
        pass
    return path


def las_truncated(folder: Path) -> Path:
    path = las(folder)
    os.truncate(path, path.stat().st_size - 1000)
    return path


def laz_truncated(folder: Path) -> Path:
    path = las(folder, "drive.laz")
    os.truncate(path, path.stat().st_size * 2 // 3)
    return path


def las_count_lies(folder: Path) -> Path:
    path = las(folder)
    data = bytearray(path.read_bytes())
    data[247:255] = (2**62).to_bytes(8, "little")
    path.write_bytes(data)
    return path


def raw_truncated(folder: Path) -> Path:
    path = write_raw(folder / "drive.bin", street())
    os.truncate(path, path.stat().st_size - 3)
    return path


def raw_wrong_m(folder: Path) -> Path:
    path = write_raw(folder / "drive.bin", street())
    os.truncate(path, path.stat().st_size - 4)
    return path


def csv_not_a_number(folder: Path) -> Path:
    path = write_csv(folder / "drive.csv", street())
    rows = path.read_text().split("\n")
    rows[1000] = "5,99,198.0,7.x2"
    path.write_text("\n".join(rows))
    return path


def csv_without_range(folder: Path) -> Path:
    path = folder / "drive.csv"
    path.write_text("scan_line,column,distnace\n0,0,1.5\n")
    return path


def csv_header_only(folder: Path) -> Path:
    path = folder / "drive.csv"
    path.write_text("scan_line,column,range\n")
    return path


def gz_truncated(folder: Path) -> Path:
    path = folder / "drive.csv.gz"
    data = gzip.compress(write_csv(folder / "plain.csv", street()).read_bytes())
    (folder / "plain.csv").unlink()
    path.write_bytes(data[: len(data) // 2])
    return path


def npz_wrong_type(folder: Path) -> Path:
    path = folder / "drive.npz"
    np.savez(path, range_m=np.array([["a", "b"]]))
    return path


def npz_not_a_zip(folder: Path) -> Path:
    path = folder / "drive.npz"
    path.write_bytes(b"not a zip at all")
    return path


def npy_one_dimension(folder: Path) -> Path:
    path = folder / "drive.npy"
    np.save(path, street().ravel())
    return path


def unknown_suffix(folder: Path) -> Path:
    path = folder / "drive.shp"
    path.write_text("1 2 3\n")
    return path


def no_file(folder: Path) -> Path:
    return folder / "none.las"


def folder_as_file(folder: Path) -> Path:
    path = folder / "drive.las"
    path.mkdir()
    return path


CASES: list[tuple[Callable[[Path], Path], tuple[str, ...], int, list[str]]] = [
    (empty, (), 1, ["empty", "0 bytes"]),
    (not_las, (), 1, ["drive.las", "LASF"]),
    (las_header_only, (), 1, ["drive.las", "0 records"]),
    (las_truncated, (), 1, ["drive.las", "the file is cut short"]),
    (laz_truncated, (), 1, ["drive.laz"]),
    (las_count_lies, (), 1, ["drive.las", "the header promises 4611686018427387904 records"]),
    (raw_truncated, M, 1, ["drive.bin", "expected"]),
    (raw_wrong_m, M, 1, [f"{N_LINES * POINTS_PER_LINE - 1}", f"{POINTS_PER_LINE}"]),
    (raw_wrong_m, (), 1, ["points_per_line", "prc info"]),
    (csv_not_a_number, (), 1, ["1001", "7.x2", "range"]),
    (csv_without_range, (), 1, ["range", "distnace"]),
    (csv_header_only, (), 1, ["drive.csv", "no "]),
    (gz_truncated, (), 1, ["drive.csv.gz"]),
    (npz_wrong_type, (), 1, ["range_m"]),
    (npz_not_a_zip, (), 1, ["drive.npz", "zip"]),
    (npy_one_dimension, (), 1, ["points_per_line"]),
    (unknown_suffix, (), 1, [".shp", ".laz", ".npz"]),
    (no_file, (), 1, ["no such file"]),
    (folder_as_file, (), 1, ["is a folder"]),
]


@pytest.mark.parametrize(("make", "options", "code", "words"), CASES, ids=lambda value: getattr(value, "__name__", ""))
def test_one_clear_line_and_nothing_left(
    prc: Prc, tmp_path: Path, make: Callable[[Path], Path], options: tuple[str, ...], code: int, words: list[str]
) -> None:
    source = make(tmp_path)
    before = sorted(os.listdir(tmp_path))
    result = prc("classify", source, tmp_path / "labels.npy", *options)
    assert result.code == code, result.err
    assert result.out == ""
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, result.err
    assert lines[0].startswith("error: ")
    for word in words:
        assert word in lines[0]
    assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--set", "prc.support.zeta=1"), ["unknown key 'prc.support.zeta'", "did you mean"]),
        (("--set", "prc.background.alpha=0.9"), ["prc.background.alpha", "0.9"]),
        (("--lines", "hourly"), ["input.lines", "hourly"]),
        (("--config", "none.toml"), ["none.toml"]),
    ],
)
def test_wrong_options_are_exit_code_two(prc: Prc, tmp_path: Path, options: tuple[str, ...], words: list[str]) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    result = prc("classify", source, tmp_path / "labels.npy", *options)
    assert result.code == 2
    for word in words:
        assert word in result.err
    assert sorted(os.listdir(tmp_path)) == ["drive.npz"]


@pytest.mark.parametrize(
    ("output", "code", "words"),
    [
        ("none/labels.npy", 1, ["output folder does not exist"]),
        ("labels.xyz", 2, [".xyz", ".laz"]),
        ("labels", 2, [".laz"]),
        ("drive.npz", 2, ["the output is the input itself"]),
    ],
)
def test_wrong_outputs(prc: Prc, tmp_path: Path, output: str, code: int, words: list[str]) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    result = prc("classify", source, tmp_path / output, "--overwrite")
    assert result.code == code, result.err
    for word in words:
        assert word in result.err
    assert sorted(os.listdir(tmp_path)) == ["drive.npz"]


def test_odd_ranges_are_missing_and_counted(prc: Prc, tmp_path: Path) -> None:
    image = street()
    odd = image.copy()
    odd[3, :6] = [np.inf, -np.inf, -1.0, 0.0, np.nan, 1e30]
    image[3, :6] = np.nan
    image[3, 5] = 1e30
    write_raw(tmp_path / "odd.bin", odd)
    write_raw(tmp_path / "plain.bin", image)
    result = prc("classify", tmp_path / "odd.bin", tmp_path / "odd.npy", *M, "--verbose")
    assert result.code == 0
    assert "not finite: 2 records" in result.err
    assert "not positive: 2 records" in result.err
    prc("classify", tmp_path / "plain.bin", tmp_path / "plain.npy", *M)
    assert np.array_equal(np.load(tmp_path / "odd.npy"), np.load(tmp_path / "plain.npy"))


def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    mounted = patience.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(small)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a small file system needs root")
    try:
        source = write_npz(tmp_path / "drive.npz", np.tile(street(), (20, 1)))
        command = [sys.executable, "-m", "prc_cli", "classify", str(source), str(small / "labels.las"), "-q"]
        result = patience.run(command, capture_output=True, text=True)
        assert result.returncode == 1
        assert result.stderr.startswith("error: ")
        assert "the disk is full" in result.stderr
        assert len(result.stderr.splitlines()) == 1
        assert os.listdir(small) == []
    finally:
        patience.run(["umount", str(small)], check=True)


def test_names_with_control_characters_stay_on_one_line(prc: Prc, tmp_path: Path) -> None:
    result = prc("classify", tmp_path / "a\nb\x1b[31m.las", tmp_path / "labels.npy")
    assert result.code == 1
    assert len(result.err.splitlines()) == 1
    assert "\x1b" not in result.err


def test_names_with_brackets_are_printed_as_they_are(prc: Prc, tmp_path: Path) -> None:
    source = tmp_path / "[red]drive[bold].csv"
    source.write_text("scan_line,column,range,[/bold]\n0,0,5,1\n0,1,5,1\n1,0,5,1\n1,1,5,1\n")
    result = prc("info", source)
    assert result.code == 0
    assert "[red]drive[bold].csv" in result.out
    assert "[/bold]" in result.out
    result = prc("classify", source, tmp_path / "[bold]labels.npy")
    assert result.code == 0
    assert "[bold]labels.npy" in result.err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("command", [["config", "show"], ["config", "schema"], ["completion", "bash"], ["--help"]])
def test_a_result_that_cannot_be_printed_is_one_line(command: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        result = patience.run(
            [sys.executable, "-m", "prc_cli", *command], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert result.returncode == 1
    assert result.stderr == "error: the result cannot be printed (No space left on device)\n"


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_file_that_laspy_refuses_is_classified_and_doubted(prc: Prc, tmp_path: Path, suffix: str) -> None:
    drive = las(tmp_path, f"drive{suffix}")
    fine = prc("classify", drive, tmp_path / f"fine{suffix}", "--trust-order")
    data = bytearray(drive.read_bytes())
    data[data.index(b"prc-cli\0", 375)] = 0xFF  # of a VLR's user id, which laspy takes as UTF-8
    drive.write_bytes(data)
    with pytest.raises(UnicodeDecodeError):
        laspy.read(drive)
    result = prc("classify", drive, tmp_path / f"doubted{suffix}", "--trust-order")
    assert result.code == 4
    assert "other-readers" not in fine.err
    assert "other-readers: laspy refuses the header or its VLRs (UnicodeDecodeError" in result.err
    assert "laspy refuses" in prc("info", drive).out


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize(("option", "name"), [("--config", "x.toml"), ("--layout", "x.toml"), ("--metadata", "x.json")])
def test_settings_are_regular_files(prc: Prc, tmp_path: Path, option: str, name: str) -> None:
    os.mkfifo(tmp_path / name)
    drive = write_raw(tmp_path / "drive.bin", street())
    if option == "--metadata":
        shutil.copyfile(drive, drive := tmp_path / "drive.pcap")
    for path in (tmp_path / name, Path("/dev/zero")):
        result = prc("info", drive, option, path)
        assert (result.code, result.out) == (1 if option == "--metadata" else 2, "")
        assert f"{path}: cannot be read" in result.err
        assert "is no regular file" in result.err


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (
            OSError(errno.EMFILE, "Too many open files"),
            "Too many open files; no output was left behind; raise the limit",
        ),
        (OSError(errno.EFBIG, "File too large"), "File too large; no output was left behind; raise the limit of this"),
        (OSError(errno.EACCES, "Permission denied", "a.csv"), "a.csv: Permission denied; check the file"),
        (OSError(errno.EIO, "Input/output error"), "the result cannot be printed (Input/output error)"),
    ],
)
def test_what_the_system_refuses_is_named(
    prc: Prc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: OSError, line: str
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("prc_cli.cli.convert.convert_file", refuse)
    result = prc("convert", write_npz(tmp_path / "drive.npz", street()), tmp_path / "drive.csv")
    assert result.code == 1
    assert result.err.startswith(f"error: {line}")


def test_usage_errors_are_one_line(prc: Prc, tmp_path: Path) -> None:
    for arguments in (["classify", "a"], ["classify", "a", "b", "-M", "x"], ["evaluate", "a"], ["nonsense"]):
        result = prc(*arguments)
        assert result.code == 2
        assert len(result.err.splitlines()) == 1
        assert result.err.startswith("error: ")


@pytest.mark.parametrize("output", ["a.laz", "a.las", "a.npy"])
def test_interrupting_leaves_nothing_and_says_so(
    prc: Prc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, output: str
) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    seen: list[int] = []

    def interrupt(self: object, block: object) -> None:
        seen.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(StagedWriter, "add", interrupt)
    result = prc("classify", source, tmp_path / output)
    assert seen
    assert result.code == 130
    assert result.err.strip() == "error: interrupted; no output was left behind"
    assert sorted(os.listdir(tmp_path)) == ["drive.npz"]
