"""The path of a profiler from its points: closed forms, rates, smoothing, cells."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from prc_cli.streams.registered import path, resection, rotation, start
from prc_cli.streams.registered.along import turning_along
from prc_cli.streams.registered.fit import find_turning, fit_track, read_clock
from prc_cli.streams.registered.returns import returns_of
from prc_cli.streams.registered.scan import make_scan
from tests.streams.registered.canyon import LINE_HZ, SHOT_HZ, SHOTS, canyon, frame, station


def test_a_line_of_a_standing_scanner_tells_its_station_exactly() -> None:
    bearing = np.linspace(0.0, 4.5, 80)[None, :]
    place = np.array([3.0, -2.0, 1.5])
    turn = 0.4
    ranges = np.minimum(5.0 / np.abs(np.cos(bearing + turn)), 8.0 / np.abs(np.sin(bearing + turn)))
    local = ranges[:, :, None] * np.stack(
        [np.cos(bearing + turn), np.sin(bearing + turn), np.zeros_like(bearing)], axis=2
    )
    tilt = path.rotation_matrices(np.array([[0.3, -0.2, 0.9]]))[0]
    points = local @ tilt.T + place
    weight = np.ones_like(bearing)
    planes = resection.fit_planes(points, weight)
    fits = [resection.resect(planes, points, bearing, weight, sense) for sense in (1, -1)]
    best = min(fits, key=lambda fit: fit.residual_m[0] / fit.in_front[0])
    np.testing.assert_allclose(best.position_m[0], place, atol=1e-6)
    assert best.in_front[0] == 1.0
    np.testing.assert_allclose(
        best.frame[0][:, 0], tilt @ [np.cos(turn), np.sin(turn), 0.0], atol=1e-6
    )


def test_the_rate_is_that_of_the_beam() -> None:
    cloud = canyon(1.0, noise_m=0.003)
    turns = rotation.find_rotation(cloud.time_s, cloud.xyz_m, n_pieces=24)
    assert turns is not None
    assert turns.is_clear
    assert turns.hz == pytest.approx(LINE_HZ, rel=2e-3)
    turning = find_turning(cloud.time_s, cloud.xyz_m, turns)
    assert turning.hz == pytest.approx(LINE_HZ, rel=3e-4)
    assert not turning.is_arc


@pytest.mark.parametrize("kind", ["noise", "plane", "shuffled"])
def test_what_no_beam_measured_has_no_rotation(kind: str) -> None:
    cloud = canyon(0.6)
    rng = np.random.default_rng(3)
    points = {
        "noise": rng.uniform(-20, 20, cloud.xyz_m.shape),
        "plane": np.column_stack(
            [rng.uniform(-20, 20, (len(cloud.time_s), 2)), np.zeros(len(cloud.time_s))]
        ),
        "shuffled": rng.permutation(cloud.xyz_m),
    }[kind]
    turns = rotation.find_rotation(cloud.time_s, points, n_pieces=12)
    assert turns is None or not turns.is_possible


@pytest.mark.parametrize(
    ("noise_m", "step_m", "most_m"), [(0.0, 0.0, 2e-3), (0.005, 0.001, 6e-3), (0.02, 0.01, 2e-2)]
)
def test_the_path_is_found_between_and_along_lines(
    noise_m: float, step_m: float, most_m: float
) -> None:
    cloud = canyon(1.5, noise_m=noise_m, step_m=step_m)
    turning = rotation.Turning(LINE_HZ * (1 + 2e-5), LINE_HZ * (1 + 2e-5), float(cloud.time_s[0]))
    track = fit_track(lambda: iter([(cloud.time_s, cloud.xyz_m)]), turning, 1.5)
    assert track is not None
    inside = (track.knots.time_s > 0.02) & (track.knots.time_s < 1.45)
    off = np.linalg.norm(track.knots.position_m - station(track.knots.time_s), axis=1)[inside]
    assert np.median(off) < most_m
    assert off.max() < 4 * most_m
    axis = frame(track.knots.time_s)[:, :, 2]
    cosine = np.abs(np.einsum("ni,ni->n", track.knots.frame[:, :, 2], axis))[inside]
    assert np.degrees(np.arccos(np.minimum(cosine, 1.0))).max() < 0.2


def test_the_path_does_not_depend_on_how_points_are_handed_over() -> None:
    cloud = canyon(1.0, noise_m=0.003)
    turning = rotation.Turning(LINE_HZ, LINE_HZ, float(cloud.time_s[0]))
    cuts = [0, 1000, 1001, 20_000, len(cloud.time_s)]
    parts = [(cloud.time_s[a:b], cloud.xyz_m[a:b]) for a, b in pairwise(cuts)]
    whole = fit_track(lambda: iter([(cloud.time_s, cloud.xyz_m)]), turning, 1.0)
    pieces = fit_track(lambda: iter(parts), turning, 1.0)
    assert whole is not None
    assert pieces is not None
    np.testing.assert_array_equal(whole.knots.position_m, pieces.knots.position_m)


def test_lines_of_open_ground_are_held_by_their_neighbours() -> None:
    """Lines that see one straight line alone cannot tell their station."""
    cloud = canyon(1.5, noise_m=0.003)
    middle = (cloud.time_s > 0.6) & (cloud.time_s < 0.75)
    cloud = cloud.part(np.flatnonzero(~middle | (cloud.xyz_m[:, 2] < 0.05)))
    turning = rotation.Turning(LINE_HZ, LINE_HZ, float(cloud.time_s[0]))
    track = fit_track(lambda: iter([(cloud.time_s, cloud.xyz_m)]), turning, 1.5)
    assert track is not None
    off = np.linalg.norm(track.knots.position_m - station(track.knots.time_s), axis=1)
    bridged = (track.knots.time_s > 0.62) & (track.knots.time_s < 0.73)
    assert off[bridged].max() < 0.05
    assert np.median(track.sigma_m[bridged]) > 1.4 * np.median(track.sigma_m)


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


def test_a_beam_that_turns_on_a_cone_is_no_offset_of_the_path() -> None:
    """A mirror that is off by 0.3 degrees.

    Found beside the path, which it would move along the axis.
    """
    cloud = canyon(1.5, noise_m=0.003)
    axis = frame(cloud.time_s)[:, :, 2]
    points = cloud.xyz_m + np.tan(np.radians(0.3)) * cloud.range_m[:, None] * axis
    turning = rotation.Turning(LINE_HZ, LINE_HZ, float(cloud.time_s[0]))
    track = fit_track(lambda: iter([(cloud.time_s, points)]), turning, 1.5)
    assert track is not None
    assert abs(np.degrees(np.arctan(track.slope))) == pytest.approx(0.3, abs=0.02)
    off = np.linalg.norm(track.knots.position_m - station(track.knots.time_s), axis=1)
    assert np.median(off) < 0.01


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


def test_rotation_vectors_and_matrices_are_inverse() -> None:
    vectors = np.random.default_rng(0).normal(0.0, 0.5, (20, 3))
    np.testing.assert_allclose(
        path.rotation_vectors(path.rotation_matrices(vectors)), vectors, atol=1e-12
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


def test_points_of_one_time_are_returns_of_one_shot() -> None:
    records = np.zeros(5, [("time", "f8")])
    records["time"] = [1.0, 1.0, 2.0, 3.0, 3.0]
    number, of = returns_of(records, np.array([9.0, 4.0, 5.0, 1.0, 2.0]), by_time=True)
    assert number.tolist() == [2, 1, 1, 1, 2]
    assert of.tolist() == [2, 2, 1, 2, 2]


def test_windows_out_of_line_are_not_trusted() -> None:
    cloud = canyon(1.0)
    turning = rotation.Turning(LINE_HZ, LINE_HZ, float(cloud.time_s[0]))
    moved = cloud.xyz_m.copy()
    moved[(cloud.time_s > 0.5) & (cloud.time_s < 0.52)] += [0.0, 0.0, 4.0]
    windows = start.stations_of_lines(cloud.time_s, moved, turning, 0.02)
    odd = np.flatnonzero((windows.time_s > 0.5) & (windows.time_s < 0.52))
    assert len(odd) == 1
    assert not windows.trusted[odd].any()
    assert windows.trusted.mean() > 0.9
