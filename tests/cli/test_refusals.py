"""Refusals that no golden case has: a command, its exit code and what its one line says."""

from __future__ import annotations

import shlex
from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.cli.test_commands import Prc, prc
from tests.formats.cloud_files import pcd
from tests.street import street, write_csv, write_npz, write_raw

__all__ = ["prc"]

LAYOUT = "[layout]\n{}fields = [{{name = 'range', type = '{}'}}]\n"
CASES = [
    ("calibrate drive.npz --json --format markdown", 2, "--json and --format markdown contradict each other"),
    ("evaluate codes.npy codes.npy --json --format csv", 2, "--json and --format csv contradict each other"),
    ("explain drive.npz --at here", 2, "found 'here', expected LINE,COLUMN, both from 0"),
    ("classify drive.npz o.npy --only-lines x:y", 2, "A:B, lines A to B - 1 counted from 0"),
    ("classify drive.npz o.npy --only-lines 30:20", 2, "A:B, lines A to B - 1 counted from 0"),
    ("classify drive.npz o.npy --first 5parsecs", 2, "a length with its unit, such as 30s, 2min or 500lines"),
    ("classify drive.npz o.npy --range dimension:none", 1, "no array 'none', the file has: "),
    ("classify view.pcd o.npy", 1, "VIEWPOINT needs seven numbers, x y z and a quaternion"),
    ("classify drive.csv o.npy --layout quote.toml", 2, "expected , ; a tab or a space"),
    ("classify drive.bin o.npy --layout type.toml", 2, "a numpy number type such as f4, u2, i4, float64"),
    ("classify drive.npz o.npy --set input.angle_step=0 --set input.angle_start=0", 2, "angle_step other than 0"),
    ("transfer drive.las other.las o.las", 1, "are these the same drive?"),
    ("classify old.las o.las --lines fixed -M 10 --range sensor-xyz", 1, "in LASzip's compatibility mode"),
]


def drive(path: Path, first_s: float) -> None:
    las = laspy.create(point_format=1, file_version="1.2")
    las.x = np.arange(100.0)
    las.gps_time = first_s + np.arange(100) * 0.01
    las.write(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("refused")
    write_npz(folder / "drive.npz", street(80))
    write_csv(folder / "drive.csv", street(80))
    write_raw(folder / "drive.bin", street(80))
    np.save(folder / "codes.npy", np.full(9, 2, np.uint8))
    cloud = pcd({name: np.ones(4, np.float32) for name in ("x", "y", "z")}, viewpoint="0 0 0")
    (folder / "view.pcd").write_bytes(cloud)
    (folder / "quote.toml").write_text(LAYOUT.format("delimiter = '\"'\n", "f4"))
    (folder / "type.toml").write_text(LAYOUT.format("", "f4,f4"))
    drive(folder / "drive.las", 1000.0)
    drive(folder / "other.las", 1000.8)
    drive(folder / "old.las", 1000.0)
    las = laspy.read(folder / "old.las")
    las.header.vlrs.append(laspy.VLR("lascompatible", 22204, "", bytes(2 + 2 + 4 + 148)))
    las.write(folder / "old.las")
    return folder


@pytest.mark.parametrize(("command", "code", "said"), CASES)
def test_one_line_says_why(
    prc: Prc, folder: Path, monkeypatch: pytest.MonkeyPatch, command: str, code: int, said: str
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    result = prc(*shlex.split(command))
    assert (result.code, result.out, said in result.err) == (code, "", True), result.err
    assert result.err.count("\n") == 1
    assert sorted(folder.iterdir()) == before
