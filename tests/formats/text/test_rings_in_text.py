"""Points of a spinning scanner in text: read as in PLY, and several turns are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input


def write(path: Path, n_turns: int) -> Path:
    """Sixteen rings, 360 firing columns a turn, in the order of their times."""
    column, ring = (index.ravel() for index in np.indices((360 * n_turns, 16)))
    azimuth = np.deg2rad(column + 0.25)
    elevation = np.deg2rad(2.0 * ring - 15)
    range_m = 8 + np.sin(3 * azimuth)
    flat = range_m * np.cos(elevation)
    xyz = np.stack(
        [flat * np.cos(azimuth), -flat * np.sin(azimuth), range_m * np.sin(elevation)], axis=1
    )
    table = np.column_stack([xyz, ring, column / 3600 + ring * 2e-6])
    formats = ["%.6f"] * 3 + ["%d", "%.9f"]
    np.savetxt(path, table, delimiter=",", header="x,y,z,ring,time", comments="", fmt=formats)
    return path


def test_a_turn_in_text_is_a_frame(tmp_path: Path) -> None:
    info = open_input(write(tmp_path / "a.csv", 1), InputConfig()).info
    assert info.points_per_line == 16
    assert info.n_lines == 360


def test_several_turns_are_named_and_the_hint_reads_them(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", 3)
    with pytest.raises(InputError, match="the file holds 3.0 turns") as caught:
        open_input(path, InputConfig())
    assert "--lines time:3600 --columns dimension:ring --range sensor-xyz" in caught.value.hint
    told = InputConfig(lines="time:3600", columns="dimension:ring", range="sensor-xyz")
    blocks = list(open_input(path, told).blocks())
    assert sum(block.n_lines for block in blocks) == 3 * 360
