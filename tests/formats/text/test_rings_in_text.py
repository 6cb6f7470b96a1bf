"""Points of a spinning scanner in text: read as in PLY, and several turns are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from tests.formats.builders import write_csv


def write(path: Path, n_turns: int) -> Path:
    """Sixteen rings, 360 firing columns a turn, in the order of their times."""
    column, ring = (index.ravel() for index in np.indices((360 * n_turns, 16)))
    azimuth = np.deg2rad(column + 0.25)
    elevation = np.deg2rad(2.0 * ring - 15)
    range_m = 8 + np.sin(3 * azimuth)
    flat = range_m * np.cos(elevation)
    return write_csv(
        path,
        {
            "x": flat * np.cos(azimuth),
            "y": -flat * np.sin(azimuth),
            "z": range_m * np.sin(elevation),
            "ring": ring,
            "time": column / 3600 + ring * 2e-6,
        },
    )


def test_several_turns_are_named_and_the_hint_reads_them(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", 3)
    with pytest.raises(InputError, match="the file holds 3.0 turns") as caught:
        open_input(Input.of(path), InputConfig())
    assert "--lines time:3600 --columns dimension:ring --range sensor-xyz" in caught.value.hint
    config = InputConfig(lines="time:3600", columns="dimension:ring", range="sensor-xyz")
    blocks = list(open_input(Input.of(path), config).blocks())
    assert sum(block.n_lines for block in blocks) == 3 * 360


NAMES = (
    '"Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2",'
    '"laser_id","azimuth","distance_m","timestamp"'
)
FIRING = (0, 2, 4, 6, 8, 10, 12, 14, 1, 3, 5, 7, 9, 11, 13, 15)
"""Ring of every laser, in the order of firing."""


def write_veloview(path: Path, n_turns: int) -> Path:
    x, y, z, ring, time_s = np.loadtxt(write(path, n_turns), delimiter=",", skiprows=1, unpack=True)
    laser = np.argsort(FIRING)[ring.astype(int)]
    azimuth = np.round(100 * np.degrees(np.arctan2(x, y))) % 36000
    table = np.column_stack([x, y, z, laser, azimuth, np.sqrt(x * x + y * y + z * z), time_s * 1e6])
    formats = ["%.6f"] * 3 + ["%d", "%d", "%.3f", "%d"]
    np.savetxt(path, table, delimiter=",", header=NAMES, comments="", fmt=formats)
    return path


def test_several_frames_of_veloview_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the file holds 3.0 turns") as caught:
        open_input(Input.of(write_veloview(tmp_path / "a.csv", 3)), InputConfig())
    assert caught.value.hint == "save every turn (frame) as a file of its own"
