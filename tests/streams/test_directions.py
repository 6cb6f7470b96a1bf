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


# -- scan angles


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


@pytest.mark.slow
def test_real_push_brooms(real_data: Path) -> None:
    """Half a degree, on real roads, which have a crown."""
    assert real_data.is_dir()
    from benchmarks.contest_data import oakland

    for strip in (1, 2, 3):
        measured = measure_step(oakland(strip).range_m)
        assert measured is not None
        assert math.degrees(measured.step_rad) == pytest.approx(0.5, rel=0.03)
