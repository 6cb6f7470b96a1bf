"""``prc transfer`` on the command line: output, exit codes, files."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.cli.test_commands import Prc, prc
from tests.jobs.test_transfer import Drive, N, write_las, write_raw

__all__ = ["prc"]


@pytest.fixture
def inputs(tmp_path: Path) -> tuple[Drive, Path, Path, Path]:
    drive = Drive()
    raw = write_raw(tmp_path / "drive.csv", drive)
    return drive, raw.with_suffix(".npy"), raw, write_las(tmp_path / "registered.las", drive, drive.registered())


def test_options_reach_the_transfer(prc: Prc, tmp_path: Path) -> None:
    drive = Drive()
    rest = np.arange(N, dtype=np.uint32)
    labels = write_las(
        tmp_path / "labels.las",
        drive,
        np.arange(N),
        head=(rest % 3).astype(np.uint8),
        segment_id=rest,
        mine=drive.codes,
    )
    drive.time = drive.time + 100.0000004
    registered = write_las(tmp_path / "registered.las", drive, np.arange(N), head=(rest % 3).astype(np.uint8))
    options = ["--match", "time", "--tolerance", "1e-6", "--time-offset", "100", "--same", "head",
               "--dimension", "mine", "--carry", "segment_id", "--min-matched", "0.9"]  # fmt: skip
    result = prc("transfer", labels, registered, tmp_path / "out.laz", "-q", *options)
    assert (result.code, result.err) == (0, "")
    las = laspy.read(tmp_path / "out.laz")
    assert np.array_equal(las.classification, drive.codes)
    assert np.array_equal(las["segment_id"], rest)
    result = prc("transfer", labels, registered, tmp_path / "other.las", "-q", "--time-offset", "100")
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert "--tolerance 1e-06" in result.err
    result = prc("transfer", labels, registered, tmp_path / "other.las", "-q", "--ignore-return",
                 "--match", "record:head", "--min-matched", "0.1")  # fmt: skip
    assert result.code == 0


def test_a_layout_and_wrong_usage(prc: Prc, inputs: tuple[Drive, Path, Path, Path], tmp_path: Path) -> None:
    drive, labels, _, registered = inputs
    layout = tmp_path / "layout.toml"
    layout.write_text('[layout]\nfields = [{name = "time", type = "f8"}, {name = "range", type = "f4"}]\n')
    records = np.zeros(N, "<f8,<f4")
    records["f0"] = drive.time
    records.tofile(tmp_path / "drive.bin")
    np.save(tmp_path / "whole.npy", drive.codes)
    result = prc("transfer", tmp_path / "whole.npy", registered, tmp_path / "out.las", "-q",
                 "--points", tmp_path / "drive.bin", "--layout", layout)  # fmt: skip
    assert (result.code, result.err) == (0, "")
    for options, code, text in (
        (["--match", "space"], 2, "--match: found 'space'"),
        (["--tolerance", "-1"], 2, "--tolerance"),
        ([], 1, "--points RAW"),
    ):
        result = prc("transfer", labels, registered, tmp_path / "no.las", *options)
        assert (result.code, result.err.count("\n")) == (code, 1)
        assert result.err.startswith("error: ")
        assert text in result.err
    assert not list(tmp_path.glob("*no.las*"))
