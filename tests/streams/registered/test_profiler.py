"""The path of a profiler from its points: rates, cells, uncertainty."""

import numpy as np
import pytest

from prc_cli.streams.registered import path, rotation
from prc_cli.streams.registered.along import turning_along
from prc_cli.streams.registered.fit import fit_track, read_clock
from prc_cli.streams.registered.rotation import pieces_between
from prc_cli.streams.registered.scan import make_scan
from tests.streams.registered.corridor import (
    CORNER_M,
    DURATION_S,
    LINES_HZ,
    SHOTS_HZ,
    make_corridor,
    stations,
)


def test_every_shot_finds_its_cell_and_range():
    cloud = make_corridor()
    xyz_m = cloud.xyz_m - CORNER_M
    turning = rotation.Turning(LINES_HZ, LINES_HZ, float(cloud.time_s[0]))
    track = fit_track(lambda: iter([(cloud.time_s, xyz_m)]), turning, DURATION_S)
    assert track is not None
    clock = read_clock(cloud.time_s)
    assert clock is not None
    assert clock.distinct_hz == pytest.approx(SHOTS_HZ, rel=1e-6)
    scan = make_scan(
        track.knots, turning, clock.shots_per_turn(turning, coarse=False), by_bearing=False
    )
    assert scan.points_per_line == SHOTS_HZ / LINES_HZ
    assert np.degrees(np.arccos(scan.cos_tilt)) == pytest.approx(20.0, abs=0.3)
    cells = scan.cells(cloud.time_s, xyz_m)
    steps = np.diff(cells.line * scan.points_per_line + cells.column)
    np.testing.assert_array_equal(steps, np.diff(cloud.shot))
    assert np.median(np.abs(cells.range_m - cloud.range_m)) < 5e-3


def test_a_given_path_tells_the_rate_from_the_directions_alone():
    cloud = make_corridor(begin_s=0.0)
    turning = turning_along(cloud.time_s, cloud.xyz_m, stations)
    assert turning is not None
    assert turning.hz == pytest.approx(LINES_HZ, rel=3e-4)


def test_selected_inversion_is_the_inverse():
    rng = np.random.default_rng(1)
    n = 7
    full = np.zeros((6 * n, 6 * n))
    for k in range(n - 2):
        block = rng.normal(size=(6, 18))
        rows = slice(6 * k, 6 * k + 18)
        full[rows, rows] += block.T @ block
    full += 3.0 * np.eye(6 * n)
    banded = np.zeros((18, 6 * n))
    for d in range(18):
        banded[d, : 6 * n - d] = np.diagonal(full, -d)
    inverse = np.linalg.inv(full)
    blocks = path.inverse_blocks(banded)
    for k in range(n):
        np.testing.assert_allclose(
            blocks[k], inverse[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], atol=1e-10
        )


def test_pieces_are_even_points_about_their_middle_and_first():
    time_s = 7.0 + 0.5 * np.arange(100.0)
    xyz_m = np.stack([time_s, -time_s, time_s**2], axis=1)
    pieces = pieces_between(time_s, xyz_m, np.array([0, 20, 40]), np.array([12, 22, 40]), 4)
    assert pieces.weight.tolist() == [[1, 1, 1, 1], [1, 1, 0, 0], [0, 0, 0, 0]]
    chosen = np.array([1, 4, 7, 10])
    middle_s = 0.5 * (time_s[1] + time_s[11])
    assert pieces.middle_s[0] == middle_s
    np.testing.assert_array_equal(pieces.time_s[0], time_s[chosen] - middle_s)
    np.testing.assert_array_equal(pieces.first_m[0], xyz_m[1])
    np.testing.assert_array_equal(pieces.xyz_m[0], xyz_m[chosen] - xyz_m[1])
    np.testing.assert_array_equal(pieces.time_s[1, :2], [-0.25, 0.25])
