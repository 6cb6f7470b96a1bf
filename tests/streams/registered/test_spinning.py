"""Spinning scanners from registered points and their times alone."""

from functools import cache

import numpy as np
import pytest

from prc_cli.streams.registered.firings import find_firings
from prc_cli.streams.registered.spinning import (
    SpinningHead,
    find_head,
    scan_piece,
)
from prc_cli.streams.registered.spinning_rate import NoScan, find_turn_hz
from prc_cli.streams.registered.spinning_rings import RING_BIN_RAD, _ring_bins, _ring_density
from tests.streams.registered.spinning_clouds import Cloud, spinning_cloud

EVEN = np.arange(-15.0, 16.0, 2.0)
STAGGERED = np.concatenate(
    [np.arange(-25.0, -5.0, 2.5), np.arange(-5.0, 5.0, 0.5), np.arange(5.0, 16.0, 3.0)]
)
AHEAD = np.array([1.2, -1.2, 3.6, -1.2, 1.2, -3.6] * 6)[: len(STAGGERED)]
HEADS = {
    "even rings": (EVEN, np.zeros(16), 0.0, 1.0),
    "tilted, turning right": (EVEN, np.zeros(16), 35.0, -1.0),
    "rings that look ahead": (STAGGERED, AHEAD, 0.0, 1.0),
}


@cache
def cloud(name: str) -> Cloud:
    elevation, ahead, tilt, sense = HEADS[name]
    return spinning_cloud(elevation, ahead, tilt_deg=tilt, sense=sense)


@cache
def head(name: str) -> SpinningHead | NoScan:
    return find_head(cloud(name).time_s, cloud(name).xyz_m)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("even rings", marks=pytest.mark.slow),
        "tilted, turning right",
        pytest.param("rings that look ahead", marks=pytest.mark.slow),
    ],
)
def test_every_point_gets_its_ring_line_and_range(name):
    points = cloud(name)
    spinning = head(name)
    assert isinstance(spinning, SpinningHead)
    scan, _ = scan_piece(points.time_s, points.xyz_m, spinning)
    assert np.mean(scan.column == points.ring) > 0.995
    placed = scan.ring >= 0
    shift = np.unique(scan.line[placed] - points.line[placed])
    assert len(shift) == 1
    assert np.median(np.abs(scan.range_m - points.range_m)) < 0.005
    assert scan.trusted == 1.0
    assert scan.on_rings > 0.995
    assert scan.residual_m < 0.005


def test_points_of_one_plane_are_no_spinning_head():
    time_s = np.arange(20_000) / 20_000.0
    bearing = 2.0 * np.pi * 50.0 * time_s
    across = 5.0 + np.cos(3.0 * bearing)
    xyz = np.stack([5.0 * time_s, across * np.cos(bearing), across * np.sin(bearing)], axis=1)
    assert isinstance(find_turn_hz(time_s, xyz), NoScan)


def test_few_points_are_refused_with_their_number():
    refusal = find_turn_hz(np.arange(150.0), np.zeros((150, 3)))
    assert refusal == NoScan("150 points, fewer than a turn needs (200)")
    sparse = cloud("even rings").part(slice(None, None, 100))
    assert isinstance(find_head(sparse.time_s, sparse.xyz_m), NoScan)


def test_random_points_are_no_spinning_head():
    rng = np.random.default_rng(2)
    assert isinstance(
        find_head(np.sort(rng.random(20_000)), rng.normal(0.0, 10.0, (20_000, 3))), NoScan
    )


def test_uneven_times_have_no_firings():
    rng = np.random.default_rng(4)
    time_s = np.sort(rng.random(20_000))
    assert find_firings(time_s, np.arange(20_000) % 4, np.zeros(4), 10.0) is None


def test_the_density_of_points_is_a_bell_around_each():
    elevation = np.array([-0.3, -0.3, 0.4])
    density = _ring_density(elevation, 10.0 * RING_BIN_RAD)
    low, _, high = _ring_bins(elevation)
    off = np.arange(-40, 41)
    bell = np.exp(-0.5 * (off / 10.0) ** 2)
    np.testing.assert_allclose(density[low + off], 2.0 * bell)
    np.testing.assert_allclose(density[high + off], bell)
    assert density.sum() == pytest.approx(3.0 * bell.sum())
