"""Curbs: none under the ceiling of a building, all under a bridge and between high houses."""

from typing import NamedTuple

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.jobs.classify import classify_ranges
from prc_cli.simulation.settings import load_settings, open_simulation
from tests.runner import runner

LINES = 512


class Street(NamedTuple):
    """A scan of a street."""

    ranges: np.ndarray
    """(lines, beams) float32 [m]."""
    beam: np.ndarray
    """(beams,) float64, angle from straight down [rad]."""


@pytest.fixture(scope="module")
def street():
    options = {"lines": LINES, "seed": 3, "trajectory": {"stop_every_m": 0.0}}
    scan = open_simulation("street", load_settings("street", options=options)).scan
    ranges = np.concatenate([block.range_m for block in scan.blocks()])
    return Street(ranges, scan.scanner.angle_rad())


def roofed(street: Street, height_m: float) -> np.ndarray:
    """The street with a level roof so far above the scanner."""
    ranges = street.ranges.copy()
    beam = street.beam
    up = np.cos(beam) < -0.2
    roof = np.float32(height_m) / np.abs(np.cos(beam[up])).astype(np.float32)
    ranges[:, up] = np.where(ranges[:, up] < roof, ranges[:, up], roof)
    return ranges


def curbs(ranges: np.ndarray, beam: np.ndarray) -> np.ndarray:
    """Number of shots on curbs of every line."""
    config = load_config(preset="fused", options={"input": {"accept_doubts": CHECK_NAMES}})
    labels = classify_ranges(ranges, config, beam_rad=beam).labels
    return (labels == Label.CURB).sum(axis=1)


def test_a_street_has_curbs_under_a_bridge_and_none_under_a_ceiling(
    street,
):
    open_air = curbs(*street)
    assert open_air.sum() > 500
    # 2.6 m of the scanner and 2.4 m to the bridge
    bridge = curbs(roofed(street, 2.4), street.beam)
    assert np.abs(bridge - open_air).sum() < 0.2 * open_air.sum()
    assert curbs(roofed(street, 1.2), street.beam).sum() == 0


def test_an_alley_between_high_houses_keeps_its_curbs(
    street,
):
    ranges = street.ranges.copy()
    beam = street.beam
    # walls of 40 m beside the road, the sky above
    with np.errstate(divide="ignore"):
        wall = np.float32(6.5) / np.abs(np.sin(beam)).astype(np.float32)
    is_wall = (np.cos(beam) < 0.3) & (-wall * np.cos(beam) < 40.0)
    ranges[:, is_wall] = np.where(
        ranges[:, is_wall] < wall[is_wall], ranges[:, is_wall], wall[is_wall]
    )
    is_curb = curbs(ranges, beam)
    assert is_curb.sum() > 0.5 * curbs(*street).sum()


@pytest.mark.data
def test_floor_and_ceiling_of_a_museum_are_not_taken_for_each_other(real_data, tmp_path):
    """The scanner's angle 0 points up, and its dead angle down.

    1.2 m to the floor, 3.8 m to the ceiling.
    """
    bag = str(real_data / "cartographer" / "b0_short.bag")
    labels = str(tmp_path / "labels.npy")
    words = ["classify", bag, labels, "--set", "input.topic=vertical_laser_2d", "--overwrite"]
    outcome = runner().invoke(cli, words)
    assert outcome.exit_code == 4
    assert (
        "at -1 deg of the scan angle or at 179 (one the floor, the other a ceiling)"
        in outcome.stderr
    )
    assert "--set input.nadir=-1 or --set input.nadir=179" in outcome.stderr
    for nadir, n_ground in ((179, 40_000), (-1, 100_000)):
        outcome = runner().invoke(cli, [*words, "--set", f"input.nadir={nadir}"])
        assert outcome.exit_code in {0, 4}
        assert np.count_nonzero(np.load(labels) == 2) > n_ground
