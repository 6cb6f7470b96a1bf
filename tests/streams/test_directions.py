"""Directions of lines and columns."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prc_cli.core.errors import InputError
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.streams import directions
from prc_cli.streams.angle_step import measure_step
from prc_cli.streams.angles import find_angle_grid
from prc_cli.streams.directions import fit_beams
from prc_cli.streams.down import WrongOriginError


def arc(
    span_deg: float,
    tilt_deg: float | F64 = 90.0,
    *,
    n: int = 301,
    middle_deg: float = 30.0,
    off_deg: float = 0.0,
) -> F64:
    """Return lines (lines, n, 3) in planes ``tilt_deg`` from horizontal, around ``middle_deg`` from
    straight down.

    Shots lie in turns ``off_deg`` off the plane on one side, on both, and on the other.
    """
    angle = np.deg2rad(middle_deg + np.linspace(-0.5, 0.5, n) * span_deg)
    tilt = np.deg2rad(np.atleast_1d(tilt_deg))[:, None]
    off = np.deg2rad(off_deg) * np.where(np.arange(n) % 4 < 2, 1.0, -1.0)
    across = np.cos(off) * np.sin(angle)
    down = np.cos(off) * np.cos(angle)
    x = np.cos(tilt) * down + np.sin(tilt) * np.sin(off)
    z = -np.sin(tilt) * down + np.cos(tilt) * np.sin(off)
    return 10.0 * np.stack([x, across + 0 * tilt, z], axis=-1)


@pytest.mark.parametrize("tilt_deg", [90.0, 50.0])
def test_lines_in_a_plane_are_taken(tilt_deg: float) -> None:
    beams = fit_beams(arc(100.0, tilt_deg))
    np.testing.assert_allclose(np.rad2deg(beams.beam_rad), np.linspace(-20, 80, 301), atol=1e-4)
    assert beams.is_straight
    assert beams.n_lines == 1


@pytest.mark.parametrize(("span_deg", "limit_deg"), [(20.0, 0.4), (1.0, 0.1)])
def test_shots_may_be_off_the_plane_by_a_share_of_the_arc(
    span_deg: float, limit_deg: float
) -> None:
    """A fiftieth of the arc, and a tenth of a degree where that is more."""
    assert fit_beams(arc(span_deg, off_deg=0.97 * limit_deg, n=400)).n_lines == 1
    with pytest.raises(
        WrongOriginError, match=f"lie {1.03 * limit_deg:.2f} deg off a plane through the origin"
    ):
        fit_beams(arc(span_deg, off_deg=1.03 * limit_deg, n=400))


TURN = 2 * math.pi


def planes(seed: int, n: int = 9, m: int = 40) -> tuple[F64, Mask]:
    """Return directions about planes that lean all ways, some missing, some off."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(rng.uniform(-3, 0), rng.uniform(0.2, 3), m)
    off = rng.normal(0.0, 0.004, (n, m)) * rng.choice([1.0, 8.0], (n, m), p=[0.9, 0.1])
    local = np.stack(
        [np.cos(off) * np.sin(angle), np.sin(off), -np.cos(off) * np.cos(angle)], axis=-1
    )
    turns = Rotation.random(n, random_state=seed).as_matrix()
    seen = rng.random((n, m)) < 0.8
    return np.where(seen[..., None], local @ turns, 0.0), seen


@pytest.mark.parametrize("seed", range(4))
def test_planes_equal_those_of_single_lines(seed: int) -> None:
    unit, seen = planes(seed)
    normal, arc, off = directions._planes(unit, seen)
    for row, (line, has) in enumerate(zip(unit, seen, strict=True)):
        use = has.copy()
        for _ in range(5):
            moments = sum(np.outer(shot, shot) for shot in line[use])
            values, vectors = np.linalg.eigh(moments)
            away = np.abs(line @ vectors[:, 0])
            middle = np.median(away[has])
            use = has & (away <= max(3 * 1.4826 * middle, math.radians(0.5)))
        assert abs(abs(normal[row] @ vectors[:, 0]) - 1) < 1e-12
        assert off[row] == pytest.approx(math.asin(middle))
        assert arc[row] == pytest.approx(math.sqrt(12 * values[1] / values.sum()))


@pytest.mark.parametrize("seed", range(4))
def test_angles_in_planes_equal_those_of_single_shots(seed: int) -> None:
    unit, seen = planes(seed)
    normal, _, _ = directions._planes(unit, seen)
    angles = directions._angles_in_plane(unit, seen, normal)
    assert (np.isnan(angles) == ~seen).all()
    for row, has in enumerate(seen):
        # the lowest direction of the plane, and the level one across it
        down = np.array([0.0, 0.0, -1.0]) + normal[row] * normal[row, 2]
        side = np.cross(normal[row], [0.0, 0.0, -1.0])
        expected = np.array(
            [
                math.atan2(shot @ side / np.linalg.norm(side), shot @ down / np.linalg.norm(down))
                for shot in unit[row, has]
            ]
        )
        steps = [math.remainder(step, TURN) for step in np.diff(expected)]
        if sum(np.sign(step) for step in steps if abs(step) < math.pi / 2) < 0:
            expected = -expected
        both = np.abs(np.exp(1j * angles[row, has]) - np.exp(1j * expected)).max()
        if both > 1e-9:  # the side may be the other one, which turns all signs before the choice
            both = np.abs(np.exp(1j * angles[row, has]) - np.exp(-1j * expected)).max()
        assert both < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_straight_lines_without_outliers_equal_a_plain_fit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    column = np.sort(rng.choice(200, 30, replace=False)).astype(np.float64)
    angle = (
        0.3
        + 0.02 * column
        + rng.normal(0, 0.003, 30)
        + np.where(rng.random(30) < 0.2, rng.normal(0, 0.5, 30), 0.0)
    )
    weight = rng.integers(1, 9, 30).astype(np.float64)
    use = weight
    for _ in range(5):
        kept = use > 0
        slope, start = np.polyfit(column[kept], angle[kept], 1, w=np.sqrt(use[kept]))
        off = np.abs(angle - start - slope * column)
        use = np.where(off <= 3 * 1.4826 * np.median(off), weight, 0.0)
    assert directions._straight(column, angle, weight) == pytest.approx((slope, start))
    assert directions._straight(column[:1], angle[:1], weight[:1])[0] == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_columns_are_medians_of_their_lines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = np.cumsum(rng.uniform(0.04, 0.14, 25)) + seed
    angle = true + rng.normal(0, 0.01, (15, 25)) + np.where(rng.random((15, 25)) < 0.1, 0.5, 0.0)
    seen = rng.random(angle.shape) < 0.8
    seen[:, 7] = False
    angle = np.where(seen, np.remainder(angle + math.pi, TURN) - math.pi, np.nan)
    columns = directions._columns(angle, seen)
    assert columns.n_lines == 15
    for column in range(25):
        if column != 7:
            near = np.array(
                [
                    math.remainder(angle_rad - true[column], TURN)
                    for angle_rad in angle[seen[:, column], column]
                ]
            )
            # rising medians are as they are; others are pooled with their neighbours
            assert (
                abs(math.remainder(columns.beam_rad[column] - true[column] - np.median(near), TURN))
                < 0.02
            )
    assert not columns.is_straight


# -- scan angles


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("phase", [0.0, 0.3, -0.4])
def test_column_0_is_the_earliest_start_fitted_to_all_angles(sign: int, phase: float) -> None:
    """The first line is cut; lines begin in columns 2, 0, 1 and so on, and all angles are off by a
    part of a step."""
    step = math.radians(0.5)
    first = [20, 2, 0, 1, 3]
    column = np.concatenate([np.arange(start, 100) for start in first])
    line = np.repeat(np.arange(5), [100 - start for start in first])
    noise = np.random.default_rng(3).normal(0.0, 0.05, len(column))
    angle = sign * step * (column + phase + noise - noise.mean()) + 2.0
    grid = find_angle_grid(angle, line, "a.laz")
    assert math.remainder(grid.start_rad - (2.0 + sign * step * phase), TURN) == pytest.approx(
        0.0, abs=0.02 * step
    )
    assert grid.step_rad == pytest.approx(sign * step, rel=1e-3)
    assert (grid.n_columns, grid.whole_turn) == (100, False)


def sweeps(n_lines: int, m: int, step_deg: float = 1.0) -> tuple[F64, I64]:
    """Return angles [rad] and lines of whole sweeps that begin at -20 deg."""
    angle = np.deg2rad(-20.0 + step_deg * np.tile(np.arange(float(m)), n_lines))
    return angle, np.repeat(np.arange(n_lines), m)


@pytest.mark.parametrize("step_deg", [1e-310, 1e-9, 3.5e-5])
def test_no_turn_has_more_than_ten_million_columns(step_deg: float) -> None:
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
    ("step_deg", "m", "noise_m", "usual"),
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
    step_deg: float,
    m: int,
    noise_m: float,
    usual: str,
) -> None:
    measured = measure_step(room(step_deg, m, noise_m=noise_m))
    assert measured is not None
    assert math.degrees(measured.step_rad) == pytest.approx(step_deg, rel=0.005)
    assert measured.usual == usual
    assert measured.off < 0.03


def test_bent_surfaces_do_not_move_the_step() -> None:
    """Round columns spread the curvatures to one side; the median of all moves with them."""
    rng = np.random.default_rng(5)
    lines = room(0.0714, 4270, noise_m=0.001)
    for line in lines:
        for column in rng.integers(0, 4000, 20):
            x = np.linspace(-1.0, 1.0, 200)
            line[column : column + 200] = (
                4.0 - rng.uniform(0.0, 0.4) * np.sqrt(1.2 - x * x) + rng.normal(0.0, 0.001, 200)
            )
    measured = measure_step(lines.astype(np.float32))
    assert measured is not None
    assert math.degrees(measured.step_rad) == pytest.approx(0.0714, rel=0.001)


@pytest.mark.slow
def test_real_push_brooms(real_data: Path) -> None:
    """Half a degree, on real roads, which have a crown."""
    assert real_data.is_dir()
    from benchmarks.contest_data import oakland

    for strip in (1, 2, 3):
        measured = measure_step(oakland(strip).range_m)
        assert measured is not None
        assert math.degrees(measured.step_rad) == pytest.approx(0.5, rel=0.03)
