"""Straight down from level ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import PRESETS, load_config
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.classify import open_stream
from prc_cli.streams.beams import with_beams
from prc_cli.streams.down import _middle_of_lines, down_of_ground
from tests.classifiers.fused.street_lines import BEAM, street_lines


@pytest.mark.parametrize("turned_deg", [0.0, 75.0, 180.0, -120.0])
@pytest.mark.parametrize("way", [1, -1])
def test_a_street_tells_where_down_is(turned_deg: float, way: int) -> None:
    ranges, _ = street_lines(20)
    angle = way * BEAM + np.deg2rad(turned_deg)
    found = down_of_ground(angle, ranges)
    assert found is not None
    assert abs(np.rad2deg(np.angle(np.exp(1j * (found - np.deg2rad(turned_deg)))))) < 1.5


def test_one_side_of_a_street_is_enough() -> None:
    ranges, _ = street_lines(20)
    side = np.rad2deg(BEAM) > 10
    found = down_of_ground(BEAM[side], ranges[:, side])
    assert found is not None
    assert abs(np.rad2deg(found)) < 2


def test_what_tells_nothing_gives_nothing() -> None:
    rng = np.random.default_rng(1)
    ranges, _ = street_lines(20)
    assert down_of_ground(BEAM, ranges[:2]) is None
    assert down_of_ground(BEAM, np.full_like(ranges, np.nan)) is None
    assert down_of_ground(BEAM, rng.uniform(1, 60, (1, len(BEAM))).repeat(20, axis=0).astype(np.float32)) is None


def level_ground(width_deg: float, n_lines: int = 20) -> F32:
    """Ground 2 m below, seen so far around straight down, and nothing else."""
    is_seen = np.abs(BEAM) < np.deg2rad(width_deg / 2)
    depth = np.where(is_seen, 2.0 / np.cos(np.where(is_seen, BEAM, 0.0)), np.nan)
    return np.tile(depth, (n_lines, 1)).astype(np.float32)


@pytest.mark.parametrize(("width_deg", "is_enough"), [(13, False), (24, False), (26, True), (60, True)])
def test_less_than_25_degrees_of_ground_are_too_few(width_deg: float, is_enough: bool) -> None:
    assert (down_of_ground(BEAM, level_ground(width_deg)) is not None) == is_enough


@pytest.mark.parametrize(("n_seen", "is_enough"), [(5, False), (10, False), (11, True)])
def test_a_column_counts_where_most_lines_have_a_return(n_seen: int, is_enough: bool) -> None:
    ranges = level_ground(60.0)
    ranges[n_seen:] = np.nan
    assert (down_of_ground(BEAM, ranges) is not None) == is_enough


class Lines:
    """A stream of one block."""

    def __init__(self) -> None:
        ranges, _ = street_lines(20)
        self.angle = BEAM + 1.0
        self.info = StreamInfo("street.npz", "array", len(BEAM), None, 20, angle_rad=self.angle)
        self.block = ScanBlock(0, ranges, angle_rad=self.angle, is_last=True)

    def blocks(self) -> Iterator[ScanBlock]:
        yield replace(self.block)


def test_beams_come_from_the_ground_only_where_that_is_good_enough() -> None:
    with pytest.raises(InputError, match="no vertical direction known"):
        list(with_beams(Lines(), InputConfig()).blocks())
    directed = with_beams(Lines(), InputConfig(), from_ground=True)
    beams = next(iter(directed.blocks())).beam_rad
    assert beams is not None
    assert np.abs(beams - BEAM).max() < np.deg2rad(1.5)
    said = [one for one in directed.info.assumptions if one.key == "input.nadir"]
    assert "level ground" in said[0].why


def test_the_ground_tells_in_streets_alone() -> None:
    """In a forest a wall of leaves may be taken for it."""
    found = {preset: load_config(preset=preset).config.nadir_from_ground for preset in PRESETS}
    assert {preset for preset, is_guessed in found.items() if is_guessed} == {"fused"}


def test_the_refusal_asks_for_what_is_enough(tmp_path: Path) -> None:
    np.save(tmp_path / "drive.npy", street_lines(20)[0])
    asked = {"fused": r"give scan angles \(.*and input\.nadir if known", "fused-forest": r"give input\.nadir with"}
    for preset, hint in asked.items():
        with pytest.raises(InputError, match=hint):
            open_stream(tmp_path / "drive.npy", load_config(preset=preset))


def test_the_middle_of_lines_is_a_median_of_what_is_there() -> None:
    nan = np.nan
    lines = np.array([[9, 5, nan, nan], [1, 2, 4, nan], [8, nan, 6, nan], [2, 1, nan, 3], [7, 4, nan, 3]], np.float32)
    np.testing.assert_array_equal(_middle_of_lines(lines), [7, 4, nan, nan])
