"""``prc thin`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.cli.test_commands import Prc
from tests.street import street, write_npz


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


def test_the_table_is_the_result(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    assert prc("classify", source, tmp_path / "drive.laz", "-q").code == 0
    result = prc("thin", tmp_path / "drive.laz", tmp_path / "thin.laz", "--keep", "ground=1/4")
    assert result.code == 0
    assert "bytes saved" in result.out
    assert "note: thinned: " in result.err
    assert (tmp_path / "thin.laz").stat().st_size < (tmp_path / "drive.laz").stat().st_size
    assert 7 not in laspy.read(tmp_path / "thin.laz").classification


def test_json_holds_the_same_figures(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    options = ["--preset", "urban", "--spacing", "ground=0.5", "--drop", "vegetation", "--json"]
    result = prc("thin", source, tmp_path / "thin.npz", *options, "-q")
    assert (result.code, result.err) == (0, "")
    found = json.loads(result.out)
    by_name = {item["name"]: item for item in found["classes"]}
    assert by_name["vegetation"]["n_kept"] == by_name["noise"]["n_kept"] == 0
    assert 0 < by_name["ground"]["n_kept"] < by_name["ground"]["n_input"]
    assert found["rules"] == ["ground=0.5 m", "vegetation=0", "noise=0"]
    assert found["bytes"]["output"] == (tmp_path / "thin.npz").stat().st_size
    kept = sum(item["n_kept"] for item in found["classes"])
    with np.load(tmp_path / "thin.npz") as arrays:
        assert kept == np.count_nonzero(~np.isnan(arrays["range_m"]))
    result = prc("thin", source, tmp_path / "thin2.npz", *options)
    assert json.loads(result.out)["classes"] == found["classes"]
    assert "bytes saved" in result.err


def test_bad_input_is_one_line(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    np.save(tmp_path / "labels.npy", np.ones(5, np.uint8))
    for options, code, said in (
        (["--keep", "gruond=1/4"], 2, "--keep: unknown class 'gruond'; did you mean 'ground'?"),
        (["--keep", "ground=4/1"], 2, "expected a fraction from 0 to 1"),
        (["--spacing", "ground=-1"], 2, "expected a distance above 0"),
        (["--keep-only", "ground", "--drop", "ground"], 2, "found ground=0 beside --keep-only ground, which says"),
        (["--keep-only", "ground", "--keep", "car=1/2"], 2, "found car=1/2 beside --keep-only ground"),
        (["--every-frame"], 2, "--every-frame: drive.npz is a file"),
        (["--labels", tmp_path / "labels.npy"], 1, "found 5 labels, expected 24660"),
        (["--labels", tmp_path / "none.npy"], 1, "no such file, expected class codes"),
    ):
        result = prc("thin", source, tmp_path / "out.npz", *options)
        assert (result.code, result.err.count("\n")) == (code, 1), result.err
        assert said in result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.npz", "labels.npy"]
    assert "Examples:" in prc("thin", "--help").out
