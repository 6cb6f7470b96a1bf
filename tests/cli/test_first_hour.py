"""Stumbles of the first hour: what a new user types before the documentation is read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import prc_cli
from tests.cli.test_commands import Prc
from tests.street import N_LINES, POINTS_PER_LINE, angles, street, write_raw

LAYOUT = "[layout]\n[[layout.fields]]\nname = 'range'\ntype = 'f4'\n"


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


@pytest.mark.parametrize("output", [".", "/", "", "sub"])
def test_a_folder_is_no_output(prc: Prc, tmp_path: Path, output: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    drive = write_raw(tmp_path / "drive.bin", street())
    found = prc("classify", drive, output, "-M", POINTS_PER_LINE)
    assert (found.code, found.out) == (1, "")
    assert found.err == f"error: {output or '.'}: is a folder, expected a file name; name the file inside it\n"


def test_a_layout_that_a_format_has_no_use_for_is_refused(prc: Prc, tmp_path: Path) -> None:
    layout = tmp_path / "layout.toml"
    layout.write_text(LAYOUT)
    image = tmp_path / "drive.npz"
    np.savez(image, range_m=street())
    said = "layout.fields: does nothing: .npz files describe their records themselves; leave it out; ranges in mm"
    for words in (("classify", image, tmp_path / "o.npy"), ("info", image)):
        found = prc(*words, "--layout", layout)
        assert found.code == 2
        assert said in found.err
    np.savez(image, range_m=1000 * street())
    found = prc("classify", image, tmp_path / "o.npy", "--set", "input.range_scale=0.001", "-v")
    assert found.code in (0, 4)
    assert "input.range_scale" in found.err
    dump = write_raw(tmp_path / "drive.bin", street())
    assert "not used" not in prc("classify", dump, tmp_path / "p.npy", "--layout", layout, "-M", POINTS_PER_LINE).err


def test_lines_of_the_files_come_before_a_line_length(prc: Prc, tmp_path: Path) -> None:
    """M would cut lines that do not exist."""
    reference = tmp_path / "reference.csv"
    rows = [f"{line},{column},2" for line in range(6) for column in range(10)]
    reference.write_text("line,column,label\n" + "\n".join(rows) + "\n")
    np.save(tmp_path / "labels.npy", np.full(60, 2, np.uint8))
    found = prc("evaluate", tmp_path / "labels.npy", reference, "--by-lines", 3, "-M", 4, "--format", "json")
    assert found.code == 0
    assert "lines 0-2" in found.out
    assert "lines 3-5" in found.out
    assert "lines 6-8" not in found.out
    assert "a column of the files; -M 4 is not used" in found.out + found.err


def test_the_python_function_gives_the_codes_of_the_file(prc: Prc, tmp_path: Path) -> None:
    """Numbers of the program and class codes cannot be mistaken for each other."""
    image = street()
    prc("classify", write_raw(tmp_path / "drive.bin", image), tmp_path / "o.npy", "-M", POINTS_PER_LINE)
    found = prc_cli.classify_ranges(image)
    np.testing.assert_array_equal(found.codes, np.load(tmp_path / "o.npy").reshape(image.shape))
    assert found.counts["ground"] == np.count_nonzero(found.codes == 2)
    assert found.counts["noise"] == np.count_nonzero(found.labels == prc_cli.Label.NOISE)
    assert repr(found).startswith(f"{N_LINES} lines of {POINTS_PER_LINE} shots: ")
    assert sum(found.counts.values()) == image.size == len(angles()) * N_LINES
    assert issubclass(prc_cli.EvidenceError, prc_cli.PrcError)


def test_classify_loads_no_library_that_the_input_does_not_need() -> None:
    """Each costs memory and time in every run."""
    code = (
        "import sys, prc_cli.cli.classify; "
        "print({'pyarrow', 'sqlite3', 'laspy', 'pye57', 'skimage', 'dask'} & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert found.stdout == "set()\n"


def test_a_folder_and_what_lies_beside_a_scan_name_the_file_to_give(prc: Prc, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    assert "this folder itself has no scan" in prc("info", bag).err
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    (bag / "bag_0.db3").write_bytes(b"SQLite format 3\0")
    assert f"{bag / 'bag_0.db3'}: found no SQLite header" in prc("info", bag).err
    assert prc("info", bag / "metadata.yaml").err.endswith(f"name the file beside it, {bag / 'bag_0.db3'}\n")
    (bag / "bag_1.db3").write_bytes(b"SQLite format 3\0")
    assert prc("info", bag).err.endswith(f"bag_0.db3, or {bag / 'bag_1.db3'}\n")
    drive = write_raw(tmp_path / "drive.bin", street())
    assert prc("info", tmp_path).err.endswith(f"name a file in it, for example {drive}\n")
    (tmp_path / "os.json").write_text("{}")
    (tmp_path / "os.pcap").write_bytes(b"x")
    assert prc("info", tmp_path / "os.json").err.endswith(f"name the capture beside it, {tmp_path / 'os.pcap'}\n")


def test_only_a_frame_is_read_as_a_frame(prc: Prc, tmp_path: Path) -> None:
    frame = np.stack([*frame_xyz(), np.full(64 * 900, 0.3)], axis=1).astype("<f4")
    frame.tofile(tmp_path / "frame.bin")
    found = prc("classify", tmp_path / "frame.bin", tmp_path / "frame.laz", "--accept-doubt", "ground-below")
    assert "look like x, y, z and intensity of a frame" in found.err
    assert "points are in the order of the shots" in found.err
    assert "compare it" not in found.err
    ranges = street()
    np.abs(frame).tofile(tmp_path / "other.bin")
    for path in (write_raw(tmp_path / "drive.bin", ranges), tmp_path / "other.bin"):
        refused = prc("classify", path, tmp_path / "labels.npy")
        assert refused.code == 1
        assert "no scan lines" in refused.err


def frame_xyz() -> np.ndarray:
    """Return a road and a round wall as 64 rings see them, ring after ring, (3, n)."""
    azimuth = np.tile(np.linspace(0.0, 2 * np.pi, 900, endpoint=False), 64)
    elevation = np.repeat(np.deg2rad(np.linspace(2.0, -24.8, 64)), 900)
    distance = np.minimum(
        20.0 / np.cos(elevation), np.where(elevation < 0, 1.7 / np.sin(np.maximum(-elevation, 1e-3)), 99)
    )
    flat = distance * np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)])
