"""The path of a profiler from its points: closed forms, rates, smoothing, cells."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.streams.registered import path, rotation
from prc_cli.streams.registered.along import turning_along
from prc_cli.streams.registered.fit import fit_track, read_clock
from prc_cli.streams.registered.scan import make_scan
from tests.streams.registered.canyon import LINE_HZ, SHOT_HZ, SHOTS, canyon, frame, station


def test_every_shot_finds_its_cell_and_range() -> None:
    cloud = canyon(1.5, start_s=400_000.0)
    start_s = float(cloud.time_s[0])
    turning = rotation.Turning(LINE_HZ, LINE_HZ, start_s)
    track = fit_track(lambda: iter([(cloud.time_s, cloud.xyz_m)]), turning, 1.5)
    assert track is not None
    clock = read_clock(cloud.time_s)
    assert clock is not None
    assert clock.distinct_hz == pytest.approx(SHOT_HZ, rel=1e-6)
    scan = make_scan(
        track.knots, turning, clock.shots_per_turn(turning, coarse=False), by_bearing=False
    )
    assert scan.points_per_line == SHOTS
    assert np.degrees(np.arccos(scan.cos_tilt)) == pytest.approx(20.0, abs=0.3)
    cells = scan.cells(cloud.time_s, cloud.xyz_m)
    steps = np.diff(cells.line * SHOTS + cells.column)
    np.testing.assert_array_equal(steps, np.diff(cloud.line * SHOTS + cloud.column))
    assert np.median(np.abs(cells.range_m - cloud.range_m)) < 2e-3


def test_a_given_path_tells_the_rate_from_the_directions_alone() -> None:
    cloud = canyon(1.0, noise_m=0.005)
    turning = turning_along(cloud.time_s, cloud.xyz_m, station)
    assert turning is not None
    assert turning.hz == pytest.approx(LINE_HZ, rel=3e-4)


def test_selected_inversion_is_the_inverse() -> None:
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


def test_normal_equations_are_those_of_the_residuals() -> None:
    """The gradient of the smoother against differences of its cost."""
    cloud = canyon(0.2, noise_m=0.01)
    times = np.arange(0.0, 0.2, 0.02)
    knots = path.Knots(
        times,
        station(times) + 0.01,
        frame(times) @ path.rotation_matrices(np.full((len(times), 3), 0.004)),
    )
    bearing = 2.0 * np.pi * LINE_HZ * cloud.time_s + np.pi
    observed = path.observe(times, cloud.time_s, cloud.xyz_m, bearing, 40)
    system = path._normal_equations(knots, observed, 1e6, 0.01)

    def cost(moved: path.Knots) -> float:
        fit = path._normal_equations(moved, observed, 1e6, 0.01)
        squares = observed.weight * (fit.in_plane_m**2 + fit.across_m**2)
        return 0.5 * float(squares.sum())

    step = 1e-6
    for knot in (2, 5):
        for axis in range(3):
            numeric = []
            for sign in (1, -1):
                position = knots.position_m.copy()
                position[knot, axis] += sign * step
                numeric.append(cost(path.Knots(times, position, knots.frame)))
            slope_of_cost = (numeric[0] - numeric[1]) / (2 * step)
            assert system.gradient[knot, 3 + axis] == pytest.approx(
                slope_of_cost, rel=2e-2, abs=2e-3
            )
