"""``prc convert`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_commands import Prc
from tests.street import N_LINES, POINTS_PER_LINE, street, write_csv, write_npz, write_raw


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


def test_losses_are_told_on_stderr_and_stdout_stays_clean(prc: Prc, tmp_path: Path) -> None:
    source = write_csv(tmp_path / "drive.csv.gz", street())
    result = prc("convert", source, tmp_path / "drive.npy")
    assert (result.code, result.out) == (0, "")
    assert "not kept: scan angles" in result.err
    assert f"{N_LINES} lines of {POINTS_PER_LINE} shots" in result.err
    assert np.array_equal(np.load(tmp_path / "drive.npy"), street(), equal_nan=True)


def test_json_quiet_and_overwrite(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    result = prc("convert", source, tmp_path / "drive.laz", "--json", "-q")
    assert result.err == ""
    found = json.loads(result.out)
    assert found["not_kept"][0].startswith(f"{np.isnan(street()).sum()} shots without return")
    assert found["input"]["name"] == "drive.npz"
    result = prc("convert", source, tmp_path / "drive.laz")
    assert (result.code, "exists already" in result.err) == (2, True)
    assert prc("convert", source, tmp_path / "drive.laz", "--overwrite", "-q").code == 0


def test_a_dump_is_read_by_the_configuration_beside_it(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    assert prc("convert", source, tmp_path / "drive.bin", "-q").code == 0
    out = tmp_path / "again.npz"
    assert prc("convert", tmp_path / "drive.bin", out, "-q", "--config", tmp_path / "drive.bin.toml").code == 0
    with np.load(source) as left, np.load(out) as right:
        assert np.array_equal(left["range_m"], right["range_m"], equal_nan=True)
        assert np.allclose(left["angle_deg"], right["angle_deg"], rtol=0, atol=1e-9)


def test_what_speaks_against_a_stream_is_told_and_it_is_converted(prc: Prc, tmp_path: Path) -> None:
    shuffled = np.random.default_rng(3).permuted(street(), axis=1)
    source = write_npz(tmp_path / "shuffled.npz", shuffled)
    result = prc("convert", source, tmp_path / "out.npy", "--json", "-q")
    assert (result.code, np.array_equal(np.load(tmp_path / "out.npy"), shuffled, equal_nan=True)) == (4, True)
    assert result.err.startswith("warning: shot-order: ")
    found = json.loads(result.out)
    assert found["doubts"][0]["verdict"] == "against"
    assert any(notice.startswith("doubt shot-order: ") for notice in found["notices"])
    names = [doubt["check"] for doubt in found["doubts"]]
    options = [part for name in names for part in ("--accept-doubt", name)]
    result = prc("convert", source, tmp_path / "out.npy", "--overwrite", "-q", *options)
    assert (result.code, result.err) == (0, "")


def test_options_find_the_stream(prc: Prc, tmp_path: Path) -> None:
    source = write_raw(tmp_path / "drive.bin", street())
    result = prc("convert", source, tmp_path / "a.npz")
    assert (result.code, "give -M NUMBER" in result.err or "points_per_line" in result.err) == (1, True)
    assert prc("convert", source, tmp_path / "a.npz", "-M", POINTS_PER_LINE, "-q").code == 0
    with np.load(tmp_path / "a.npz") as arrays:
        assert arrays["range_m"].shape == street().shape


def test_bad_input_is_one_line(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    for output, code, said in (
        ("a.ptx", 2, "found suffix '.ptx', expected one of .bin"),
        ("none/a.csv", 1, "output folder does not exist"),
        ("drive.npz", 2, "the output is the input itself"),
    ):
        result = prc("convert", source, tmp_path / output)
        assert (result.code, result.err.count("\n")) == (code, 1)
        assert said in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["drive.npz"]
    assert "Examples:" in prc("convert", "--help").out
