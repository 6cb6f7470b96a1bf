"""Broken files and wrong options: one clear line, the right exit code, nothing left behind."""

import errno
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.cli import cli, main
from prc_cli.formats.writing.base import StagedWriter
from tests import patience
from tests.formats.cloud_files import pcd
from tests.street import POINTS_PER_LINE, street, write_csv, write_npz, write_raw

M = ("-M", str(POINTS_PER_LINE))


def las(folder: Path, name: str = "drive.las") -> Path:
    """A LAS file with ranges, lines and columns as this program writes it."""
    from prc_cli.jobs.classify import classify

    path = folder / name
    classify(write_npz(folder / "source.npz", street()), path)
    (folder / f"{name}.prc.json").unlink()
    (folder / "source.npz").unlink()
    return path


def test_odd_ranges_are_missing_and_counted(prc, tmp_path):
    image = street()
    odd = image.copy()
    odd[3, :6] = [np.inf, -np.inf, -1.0, 0.0, np.nan, 1e30]
    image[3, :6] = np.nan
    image[3, 5] = 1e30
    write_raw(tmp_path / "odd.bin", odd)
    write_raw(tmp_path / "plain.bin", image)
    result = prc(f"classify {tmp_path}/odd.bin {tmp_path}/odd.npy", *M, "--verbose")
    assert result.code == 0
    assert "not finite: 2 records" in result.err
    assert "not positive: 2 records" in result.err
    prc(f"classify {tmp_path}/plain.bin {tmp_path}/plain.npy", *M)
    assert np.array_equal(np.load(tmp_path / "odd.npy"), np.load(tmp_path / "plain.npy"))


def test_a_message_has_a_line_for_the_fault_the_reason_and_the_hint(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "o.npz").mkdir()
    with pytest.raises(SystemExit):
        main(["simulate", "street", "o.npz", "--lines", "2"])
    message = "error: o.npz: is a folder\n  expected a file name\n  hint: name the file inside it\n"
    assert capsys.readouterr().err == message


def test_names_with_control_characters_stay_on_one_line(prc, tmp_path):
    result = prc("classify", tmp_path / "a\nb\x1b[31m.las", tmp_path / "labels.npy")
    assert result.code == 1
    assert len(result.err.splitlines()) == 1
    assert "\x1b" not in result.err


def test_names_with_brackets_are_printed_as_they_are(prc, tmp_path):
    source = tmp_path / "[red]drive[bold].csv"
    source.write_text("scan_line,column,range,[/bold]\n0,0,5,1\n0,1,5,1\n1,0,5,1\n1,1,5,1\n")
    result = prc(f"info {source}")
    assert result.code == 0
    assert "[red]drive[bold].csv" in result.out
    assert "[/bold]" in result.out
    result = prc(f"classify {source} {tmp_path}/[bold]labels.npy")
    assert result.code == 0
    assert "[bold]labels.npy" in result.err


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


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_file_that_laspy_refuses_is_classified_and_doubted(prc, tmp_path, suffix):
    drive = las(tmp_path, f"drive{suffix}")
    fine = prc(f"classify {drive} {tmp_path}/fine{suffix} --trust-order")
    data = bytearray(drive.read_bytes())
    data[data.index(b"prc-cli\0", 375)] = 0xFF  # of a VLR's user id, which laspy takes as UTF-8
    drive.write_bytes(data)
    with pytest.raises(UnicodeDecodeError):
        laspy.read(drive)
    result = prc(f"classify {drive} {tmp_path}/doubted{suffix} --trust-order")
    assert result.code == 4
    assert "other-readers" not in fine.err
    assert "other-readers: laspy refuses the header or its VLRs (UnicodeDecodeError" in result.err
    assert "laspy refuses" in prc(f"info {drive}").out


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


LAYOUT = "[layout]\n{}fields = [{{name = 'range', type = '{}'}}]\n"
CASES = [
    (
        "evaluate codes.npy codes.npy --dimension a --dimension b",
        2,
        "--dimension: found a and b for one side, expected one",
    ),
    ("explain drive.npz --at here", 2, "found 'here', expected LINE,COLUMN, counted from 0"),
    ("classify drive.npz o.npy --only x:y", 2, "in the stream's own seconds"),
    ("classify drive.npz o.npy --only 30:20", 2, "A:B, lines A to B - 1 counted from 0"),
    (
        "classify drive.npz o.npy --only 5parsecs",
        2,
        "a length with its unit, such as 30s, 2min or 500lines",
    ),
    ("classify drive.npz o.npy --range dimension:none", 1, "no array 'none', the file has: "),
    ("classify view.pcd o.npy", 1, "VIEWPOINT needs seven numbers, x y z and a quaternion"),
    ("classify drive.csv o.npy --layout quote.toml", 2, "expected , ; a tab or a space"),
    (
        "classify drive.bin o.npy --layout type.toml",
        2,
        "a numpy number type such as f4, u2, i4, float64",
    ),
    (
        "classify drive.npz o.npy --set input.angle_step=0 --set input.angle_start=0",
        2,
        "angle_step other than 0",
    ),
    ("transfer drive.las other.las o.las", 1, "are these the same drive?"),
    (
        "classify old.las o.las --lines fixed -M 10 --range sensor-xyz",
        1,
        "in LASzip's compatibility mode",
    ),
    ("classify drive.bin '' -M 180", 2, "the name is empty; give the name of a file"),
    (
        "classify drive.npz o.npy --layout plain.toml",
        2,
        "layout.fields: does nothing: .npz files describe",
    ),
    ("info drive.npz --layout plain.toml", 2, "layout.fields: does nothing"),
    ("calibrate drive.npz -o curves.png", 2, "expected one of: .toml .svg"),
    (
        "classify drive.npz o.npy --preset street-scan --method prc",
        2,
        "is for --method sequential-angle",
    ),
    (
        "classify drive.npz o.npy --preset prc-2019-urban --method sequential-angle",
        2,
        "prc-2019-urban is for --method prc",
    ),
    ("classify drive.npz o.npy --set sequential_angle.curb.min_lines=201", 2, "equal to 200"),
    ("classify drive.npz o.npy --set sequential_angle.curb.max_lines=2", 2, "max_lines = 200"),
    ("classify drive.npz o.npy --set sequential_angle.ground.bridge=4", 2, "it went in 2.0"),
    (
        "evaluate codes.npy table.csv -o a.pdf",
        2,
        "a.pdf: found the suffix '.pdf', expected one of: .json",
    ),
    ("evaluate codes.npy table.csv -o none/a.md", 1, "none: output folder does not exist"),
    ("evaluate codes.npy table.csv -o a.md -o a.md", 2, "a.md: found one output twice"),
    (
        "evaluate codes.npy table.csv -o table.csv --overwrite",
        2,
        "table.csv: the output is the input",
    ),
    (
        "evaluate codes.npy table.csv --by range:5,3",
        2,
        "expected increasing ranges in metres, such as 5,10,20,40",
    ),
    ("evaluate codes.npy table.csv --by range:5,,8", 2, "--by range: found '5,,8'"),
    ("evaluate codes.npy table.csv --by range:-5,8", 2, "--by range: found '-5,8'"),
    ("evaluate codes.npy table.csv --by range:5,nan", 2, "--by range: found '5,nan'"),
    ("evaluate codes.npy table.csv --by lines:0", 2, "--by: found 'lines:0'"),
    ("evaluate codes.npy table.csv --min-matched 1.5", 2, "--min-matched"),
    (
        "evaluate codes.npy table.csv --fail-under recall.road=1 -o a.md",
        2,
        "score: found class 'road'",
    ),
    (
        "evaluate codes.npy table.csv --fail-under recall.noise=1 --mapping oakland",
        2,
        "which the mapping does not have on both sides",
    ),
    ("evaluate codes.npy table.csv --intervals", 1, "give -M, or compare more lines"),
    ("evaluate codes.npy table.csv --match magic", 2, "magic"),
    ("evaluate codes.npy table.csv --match nearest --points reference=none.laz", 1, "none.laz"),
    (
        "objects drive.bin -M 180 --preset prc-2019-urban",
        2,
        "which tells none of: stem, pole, car, curb",
    ),
    ("objects drive.bin -M 10 --preset fused", 1, "no vertical direction known"),
    (
        "objects drive.bin -M 180 --preset fused -o o.txt",
        2,
        "expected one of .csv, .geojson, .parquet",
    ),
    ("objects drive.bin -M 180 --preset fused -o drive.csv", 2, "exists already"),
    ("render drive.npz a.png -q --steps coarse", 2, "possible here: range, intensity, classes"),
    ("render drive.npz a.png -q --steps top", 1, "no coordinates for a cloud"),
    ("render drive.npz a.png -q --steps top --only 0:9", 2, "--only: belongs to lines and columns"),
    ("render drive.npz a.png -q --steps top,classes", 2, "expected top by itself"),
    (
        "render drive.npz a.png -q --steps figure1 --set method=fused",
        2,
        "--steps figure1: belongs to prc",
    ),
    ("render drive.npz a.png -q --only 9-12", 2, "--only: found '9-12', expected A:B"),
    ("render drive.npz a.png -q --only 500:600", 2, "found 500:600, expected A:B within 0:80"),
    ("render drive.npz a.png -q --labels codes.npy", 1, "found 9 labels, expected 14,400"),
    ("render drive.npz a.png -q --labels none.npy", 1, "none.npy: no such file"),
    (
        "render drive.npz a.png -q --mapping nothing",
        2,
        "class mapping: found 'nothing', expected a .toml",
    ),
    ("render drive.npz a.jpg", 2, "expected .png; for a page to look around in: OUT.html"),
    ("render drive.npz drive.npz", 2, "the output is the input itself"),
    ("render drive.npz", 2, "prc render needs IN OUT"),
    ("render drive.npz a.html --steps classes", 2, "found a page to write"),
    ("render drive.npz old.png", 2, "exists already"),
    ("simulate street", 2, "prc simulate street needs OUT"),
    ("simulate street a.xyz", 2, "found suffix '.xyz', expected one of .bin"),
    ("simulate street drive.npz", 2, "exists already"),
    ("simulate street none/a.npz", 1, "output folder does not exist"),
    ("simulate street a.npz --trajectory w.txt", 2, ".csv or .sbet or .out"),
    ("simulate forest a.npz --stems s.txt", 2, "found suffix '.txt', expected .csv"),
    ("simulate street a.npz --length 5 --lines 3", 2, "--length and --lines contradict"),
    ("simulate street a.npz --scanner scanstation2", 2, "choose one of: photon-80"),
    ("simulate street a.npz --set scene.tree=1", 2, "did you mean 'scene.trees'?"),
    ("simulate street a.npz --set scene.trees=9", 2, "see `prc simulate parameters street`"),
    ("simulate meadow a.npz", 2, "No such command 'meadow'"),
    ("transfer codes.npy drive.las o.las --match space", 2, "--match: found 'space'"),
    ("transfer codes.npy drive.las o.las --tolerance -1", 2, "--tolerance"),
    ("transfer codes.npy drive.las o.las", 1, "--points RAW"),
]


def drive(path: Path, first_s: float) -> None:
    las = laspy.create(point_format=1, file_version="1.2")
    las.x = np.arange(100.0)
    las.gps_time = first_s + np.arange(100) * 0.01
    las.write(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("refused")
    write_npz(folder / "drive.npz", street(80))
    write_csv(folder / "drive.csv", street(80))
    write_raw(folder / "drive.bin", street(80))
    np.save(folder / "codes.npy", np.full(9, 2, np.uint8))
    (folder / "table.csv").write_text("class\n" + "2\n" * 9)
    (folder / "old.png").write_bytes(b"old")
    cloud = pcd({name: np.ones(4, np.float32) for name in ("x", "y", "z")}, viewpoint="0 0 0")
    (folder / "view.pcd").write_bytes(cloud)
    (folder / "quote.toml").write_text(LAYOUT.format("delimiter = '\"'\n", "f4"))
    (folder / "plain.toml").write_text(LAYOUT.format("", "f4"))
    (folder / "type.toml").write_text(LAYOUT.format("", "f4,f4"))
    drive(folder / "drive.las", 1000.0)
    drive(folder / "other.las", 1000.8)
    drive(folder / "old.las", 1000.0)
    las = laspy.read(folder / "old.las")
    las.header.vlrs.append(laspy.VLR("lascompatible", 22204, "", bytes(2 + 2 + 4 + 148)))
    las.write(folder / "old.las")
    return folder


@pytest.mark.parametrize("command, code, said", CASES)
def test_one_line_says_why(
    prc,
    folder,
    monkeypatch,
    command,
    code,
    said,
):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    result = prc(*shlex.split(command))
    assert (result.code, result.out, said in result.err) == (code, "", True), result.err
    assert result.err.count("\n") == 1
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("error", [MemoryError(), ImportError("no libx")])
def test_what_the_machine_lacks_ends_in_one_line(prc, monkeypatch, error):
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(cli, "main", fail)
    result = prc("info a.laz")
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert result.err.startswith("error: ")
