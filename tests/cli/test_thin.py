"""``prc thin`` on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_commands import Prc
from tests.street import street, write_npz


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


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
