"""Directions of lines and columns."""

import math

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.types import F32, F64, I64
from prc_cli.streams.angle_step import measure_step
from prc_cli.streams.angles import column_angles, find_angle_grid
from prc_cli.streams.directions import turn_evenly
from prc_cli.streams.down import NoDirectionError, wrap


def sweeps(n_lines: int, m: int, step_deg: float = 1.0) -> tuple[F64, I64]:
    """Return angles [rad] and lines of whole sweeps that begin at -20 deg."""
    angle = np.deg2rad(-20.0 + step_deg * np.tile(np.arange(float(m)), n_lines))
    return angle, np.repeat(np.arange(n_lines), m)


@pytest.mark.parametrize("seam", [0, 100, 350])
def test_columns_turn_evenly_but_for_a_sector_that_is_not_measured(seam):
    """288 degrees in 360 columns: the rest lies before a column of the line."""
    every = np.arange(360)
    truth = np.deg2rad(0.8 * ((every - seam) % 360) + 50.0)
    hidden = np.isin(every, [7, 8, 200, 359, *range(seam - 4, seam + 4)])
    column = every[~hidden]
    beam, is_straight = turn_evenly(column, wrap(truth[column]), np.ones(len(column)), 360)
    assert is_straight
    np.testing.assert_allclose(wrap(beam - truth), 0.0, atol=1e-9)
    angles = column_angles(np.tile(truth[column], 2), np.tile(column, 2), 360)
    assert angles is not None
    np.testing.assert_allclose(wrap(angles - truth), 0.0, atol=1e-9)


def test_directions_that_turn_several_times_in_a_line_are_refused():
    column = np.arange(0, 360, 2)
    with pytest.raises(NoDirectionError, match=r"4\.97 turns|5\.0 turns"):
        turn_evenly(column, wrap(np.deg2rad(5.0) * column), np.ones(180), 360)


@pytest.mark.parametrize("step_deg", [1e-310, 1e-9, 3.5e-5])
def test_no_turn_has_more_than_ten_million_columns(step_deg):
    angle = np.deg2rad(step_deg * np.tile(np.arange(100.0), 3))
    line = np.repeat(np.arange(3), 100)
    with pytest.raises(
        InputError,
        match=r"degrees apart, expected at most 10000000 columns in a turn; take the order",
    ):
        find_angle_grid(angle, line, "drive.csv")
    with pytest.raises(InputError, match="degrees apart"):
        find_angle_grid(*sweeps(3, 100), "drive.csv", step_rad=math.radians(step_deg))


def room(
    step_deg: float,
    m: int,
    n_lines: int = 60,
    noise_m: float = 0.0,
    seed: int = 0,
) -> F32:
    """A floor, two walls and a leaning roof, from a place that wanders."""
    rng = np.random.default_rng(seed)
    beam = np.deg2rad(step_deg) * (np.arange(m) - m / 2)
    lines = []
    for _ in range(n_lines):
        walls = [(0.0, 2.0), (1.7, 5.0), (-1.5, 7.0), (2.6, 9.0)]
        with np.errstate(divide="ignore"):
            depth = [
                d * rng.uniform(0.9, 1.1) / np.maximum(np.cos(beam - a), 0.05) for a, d in walls
            ]
        lines.append(np.min(depth, axis=0) + rng.normal(0.0, noise_m, m))
    return np.array(lines, np.float32)


@pytest.mark.slow
@pytest.mark.parametrize(
    "step_deg, m, noise_m, usual",
    [
        (0.1, 2500, 0.002, ""),
        (0.1, 2500, 0.01, ""),
        (0.1, 2500, 0.03, ""),
        (0.1, 2500, 0.1, ""),
        (0.072, 5000, 0.003, "360 deg / M"),
        (0.25, 1079, 0.005, "1/4 deg"),
        (0.5, 361, 0.005, "1/2 deg"),
        (0.47, 361, 0.005, ""),
    ],
)
def test_the_step_is_in_the_ranges(
    step_deg,
    m,
    noise_m,
    usual,
):
    measured = measure_step(room(step_deg, m, noise_m=noise_m))
    assert measured is not None
    assert math.degrees(measured.step_rad) == pytest.approx(step_deg, rel=0.005)
    assert measured.usual == usual
    assert measured.off < 0.03


@pytest.mark.slow
def test_real_push_brooms(real_data):
    """Half a degree, on real roads, which have a crown."""
    assert real_data.is_dir()
    from benchmarks.contest_data import oakland

    for strip in (1, 2, 3):
        measured = measure_step(oakland(strip).range_m)
        assert measured is not None
        assert math.degrees(measured.step_rad) == pytest.approx(0.5, rel=0.03)
