"""``.xyz``, ``.asc`` and ``.pts``; decimal commas; units in names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.formats import open_source
from prc_cli.formats.options import Layout


def values(path: Path, text: str, layout: Layout | None = None) -> dict[str, list[float]]:
    path.write_text(text)
    source = open_source(path, layout)
    assert source is not None
    (chunk,) = source.chunks(source.dimensions)
    return {name: np.round(column, 9).tolist() for name, column in chunk.values.items()}


def test_columns_without_names(tmp_path: Path) -> None:
    assert values(tmp_path / "a.xyz", "1 2 3\n4 5 6\n") == {"x": [1, 4], "y": [2, 5], "z": [3, 6]}
    found = values(tmp_path / "a.pts", "2\n1.5 2 3 9 255 255 255\n4 5 6 8 1 2 3\n")
    assert found["x"] == [1.5, 4]
    assert found["intensity"] == [9, 8]
    assert values(tmp_path / "a.asc", "//X Y Z R G B\n1 2 3 4 5 6\n") == {
        "x": [1], "y": [2], "z": [3], "R": [4], "G": [5], "B": [6],
    }  # fmt: skip


@pytest.mark.parametrize(
    "text", ["range;z\n1,5;2\n-3,25;4,5\n", "range z\n1,5 2\n-3,25 4,5\n", "range\tz\n1,5\t2\n-3,25\t4,5\n"]
)
def test_decimal_commas_are_found(tmp_path: Path, text: str) -> None:
    assert values(tmp_path / "a.csv", text) == {"range": [1.5, -3.25], "z": [2, 4.5]}


def test_units_from_names(tmp_path: Path) -> None:
    found = values(tmp_path / "a.csv", "range [mm];angle_gon;time_ms;z (ft)\n1500;100;2000;10\n")
    assert found == {"range": [1.5], "angle": [round(np.pi / 2, 9)], "time": [2.0], "z": [3.048]}
