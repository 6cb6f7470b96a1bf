"""``prc convert`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_commands import Prc
from tests.street import street, write_npz


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


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
