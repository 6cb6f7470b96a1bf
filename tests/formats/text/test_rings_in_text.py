"""Points of a spinning scanner in text: read as in PLY, and several turns are named."""

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from tests.clouds import seen
from tests.formats.builders import of_points, write_csv


def points(n_turns: int) -> dict[str, np.ndarray]:
    """Sixteen rings, 360 firing columns a turn, in the order of their times."""
    column, ring = (index.ravel() for index in np.indices((360 * n_turns, 16)))
    azimuth = np.deg2rad(column + 0.25)
    elevation = np.deg2rad(2.0 * ring - 15)
    range_m = 8 + np.sin(3 * azimuth)
    xyz = seen(range_m, -azimuth, elevation)
    return {**of_points(xyz), "ring": ring, "time": column / 3600 + ring * 2e-6}


def test_several_turns_are_named_and_the_hint_reads_them(tmp_path):
    path = write_csv(tmp_path / "a.csv", points(3))
    with pytest.raises(InputError, match="the file holds 3.0 turns") as caught:
        open_input(Input.of(path), InputConfig())
    assert "--lines time:3600 --columns dimension:ring --range sensor-xyz" in caught.value.hint
    config = InputConfig(lines="time:3600", columns="dimension:ring", range="sensor-xyz")
    blocks = list(open_input(Input.of(path), config).blocks())
    assert sum(block.n_lines for block in blocks) == 3 * 360


FIRING = (0, 2, 4, 6, 8, 10, 12, 14, 1, 3, 5, 7, 9, 11, 13, 15)
"""Ring of every laser, in the order of firing."""


def test_several_frames_of_veloview_are_named(tmp_path):
    made = points(3)
    xyz = [made[axis] for axis in "xyz"]
    columns = {f'"Points_m_XYZ:{k}"': values for k, values in enumerate(xyz)} | {
        '"laser_id"': np.argsort(FIRING)[made["ring"]],
        '"azimuth"': (np.round(100 * np.degrees(np.arctan2(*xyz[:2]))) % 36000).astype(int),
        '"distance_m"': np.linalg.norm(xyz, axis=0),
        '"timestamp"': np.rint(made["time"] * 1e6).astype(int),
    }
    path = write_csv(tmp_path / "a.csv", columns)
    with pytest.raises(InputError, match="the file holds 3.0 turns") as caught:
        open_input(Input.of(path), InputConfig())
    assert caught.value.hint == "save every turn (frame) as a file of its own"
