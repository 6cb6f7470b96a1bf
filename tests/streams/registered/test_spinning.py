"""Spinning scanners from registered points and their times alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from prc_cli.streams.registered.firings import find_firings, firing_numbers
from prc_cli.streams.registered.spinning import (
    SpinningHead,
    find_head,
    scan_piece,
    share_one_time,
    shot_times,
)
from prc_cli.streams.registered.spinning_rate import NoScan, TurnRate, find_turn_hz, lock
from prc_cli.streams.registered.spinning_rings import Rings, sharpest_height
from prc_cli.streams.registered.turning import cut_windows, fit_linear, turned
from tests.streams.registered.spinning_clouds import TURN_HZ, Cloud, frame, spinning_cloud, station

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


@pytest.mark.parametrize("name", HEADS)
def test_rate_and_rings_are_found(name: str) -> None:
    elevation, ahead, _, _ = HEADS[name]
    spinning = head(name)
    assert isinstance(spinning, SpinningHead)
    assert spinning.rate.hz == pytest.approx(TURN_HZ, rel=3e-4)
    assert spinning.rings.n_rings == len(elevation)
    # the axis points down if the head turns to the right
    upward = elevation if spinning.rings.is_up else -elevation[::-1]
    assert np.degrees(spinning.rings.elevation_rad) == pytest.approx(upward, abs=0.05)
    apart = np.degrees(spinning.rings.ahead_rad) - ahead
    assert apart - np.median(apart) == pytest.approx(np.zeros(len(ahead)), abs=0.05)
    assert spinning.firings.period_s == pytest.approx(1.0 / 3000.0, rel=1e-6)


@pytest.mark.parametrize("name", HEADS)
def test_every_point_gets_its_ring_line_and_range(name: str) -> None:
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


@pytest.mark.parametrize("name", HEADS)
def test_stations_and_axis_are_found(name: str) -> None:
    _, _, tilt, sense = HEADS[name]
    points = cloud(name)
    spinning = head(name)
    assert isinstance(spinning, SpinningHead)
    path = scan_piece(points.time_s, points.xyz_m, spinning)[0].path
    assert path.poses.station_m == pytest.approx(station(path.time_s), abs=0.02)
    axis = sense * frame(path.time_s, np.radians(tilt))[:, :, 2]
    assert path.poses.frame[:, :, 2] == pytest.approx(axis, abs=0.003)


def test_pieces_give_the_lines_of_the_whole() -> None:
    points = cloud("even rings")
    spinning = head("even rings")
    assert isinstance(spinning, SpinningHead)
    whole, _ = scan_piece(points.time_s, points.xyz_m, spinning)
    middle = len(points.time_s) // 2
    first, then = scan_piece(points.time_s[:middle], points.xyz_m[:middle], spinning)
    second, _ = scan_piece(points.time_s[middle:], points.xyz_m[middle:], then)
    assert np.array_equal(np.concatenate([first.line, second.line]), whole.line)
    assert np.array_equal(np.concatenate([first.ring, second.ring]), whole.ring)
    assert whole.line.min() >= 0


def test_a_tenth_of_the_points_is_enough() -> None:
    kept = np.random.default_rng(1).random(len(cloud("even rings").time_s)) < 0.1
    points = cloud("even rings").part(kept)
    spinning = find_head(points.time_s, points.xyz_m)
    assert isinstance(spinning, SpinningHead)
    scan, _ = scan_piece(points.time_s, points.xyz_m, spinning)
    assert np.mean(scan.column == points.ring) > 0.99


def test_times_coarser_than_firings_are_told_by_the_azimuths() -> None:
    true_s = 5.0 + 55e-6 * np.arange(4000)
    ring = np.zeros(4000, np.int64)
    rate = TurnRate(TURN_HZ, 5.0, 0.0, 1.0)
    rings = Rings(np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1, np.int64), 0.0, True)
    azimuth = rate.azimuth(true_s)
    local = 9.0 * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(4000)], axis=1)
    coarse_s = np.round(true_s / 1e-4) * 1e-4
    shot_s = shot_times(coarse_s, local, ring, rate, rings)
    assert shot_s == pytest.approx(true_s, abs=1e-8)
    assert share_one_time(coarse_s, shot_s, ring, rate) > 0.3
    assert share_one_time(true_s, true_s, ring, rate) == 0.0


def test_points_of_one_plane_are_no_spinning_head() -> None:
    time_s = np.arange(20_000) / 20_000.0
    bearing = 2.0 * np.pi * 50.0 * time_s
    across = 5.0 + np.cos(3.0 * bearing)
    xyz = np.stack([5.0 * time_s, across * np.cos(bearing), across * np.sin(bearing)], axis=1)
    assert isinstance(find_turn_hz(time_s, xyz), NoScan)


def test_few_points_are_refused_with_their_number() -> None:
    refusal = find_turn_hz(np.arange(150.0), np.zeros((150, 3)))
    assert refusal == NoScan("150 points, fewer than a turn needs (200)")
    sparse = cloud("even rings").part(slice(None, None, 100))
    assert isinstance(find_head(sparse.time_s, sparse.xyz_m), NoScan)


def test_random_points_are_no_spinning_head() -> None:
    rng = np.random.default_rng(2)
    assert isinstance(
        find_head(np.sort(rng.random(20_000)), rng.normal(0.0, 10.0, (20_000, 3))), NoScan
    )


def test_a_window_is_fitted_in_closed_form() -> None:
    points = cloud("even rings")
    windows = cut_windows(points.time_s, points.xyz_m, np.array([0.5]), 0.1, 2000)
    azimuth = windows.azimuth(TURN_HZ, 0.0)
    fit = fit_linear(windows, azimuth)
    assert fit.roundness[0] > 0.95
    assert fit.in_front[0] == 1.0
    locked = lock(windows, azimuth)
    assert locked.is_locked[0]
    move = locked.poses.station_m[0] + windows.centre_m[0] - station(np.array([0.5]))[0]
    # half planes do not tell the height along the axis
    across = move - locked.poses.frame[0, :, 2] * (locked.poses.frame[0, :, 2] @ move)
    assert np.linalg.norm(across) < 0.01


def test_the_sharpest_height_is_that_of_the_rings_not_of_the_ground() -> None:
    rng = np.random.default_rng(3)
    elevation = np.radians(np.repeat(np.arange(-24.0, 2.0, 0.5), 60))
    wall = 4.0 + 20.0 * rng.random(len(elevation))
    with np.errstate(divide="ignore"):
        level = np.where(elevation < 0, np.minimum(-1.9 / np.tan(elevation), wall), wall)
    z = level * np.tan(elevation)
    assert sharpest_height(z - 3.0, level)[0] == pytest.approx(-3.0, abs=0.01)


def test_firings_follow_a_clock_that_drifts() -> None:
    n = 200_000
    firing, ring = np.divmod(np.arange(n), 4)
    true_s = firing * 50e-6 + ring * 5e-6
    time_s = 1e6 + true_s * (1.0 + 2e-5) + 3e-5 * np.sin(true_s)
    first = np.arange(20_000)
    firings = find_firings(time_s[first], ring[first], np.zeros(4), 10.0)
    assert firings is not None
    assert firings.period_s == pytest.approx(50e-6, rel=1e-3)
    assert firings.delay_s == pytest.approx(5e-6 * np.arange(4), abs=1e-7)
    number, _ = firing_numbers(time_s, ring, firings)
    assert len(np.unique(number - firing)) == 1


def test_uneven_times_have_no_firings() -> None:
    rng = np.random.default_rng(4)
    time_s = np.sort(rng.random(20_000))
    assert find_firings(time_s, np.arange(20_000) % 4, np.zeros(4), 10.0) is None


def test_azimuths_keep_their_digits_after_years() -> None:
    assert turned(10.0, np.array([3e8 + 0.025])) == pytest.approx([0.5 * np.pi], abs=1e-5)
