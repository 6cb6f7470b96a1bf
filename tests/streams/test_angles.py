"""Sweeps, and the step of their angles."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.types import F32, F64, I64
from prc_cli.streams.angle_step import measure_step
from prc_cli.streams.angles import find_angle_grid


def sweeps(n_lines: int, m: int, step_deg: float = 1.0) -> tuple[F64, I64]:
    """Return angles [rad] and lines of whole sweeps that begin at -20 deg."""
    angle = np.deg2rad(-20.0 + step_deg * np.tile(np.arange(float(m)), n_lines))
    return angle, np.repeat(np.arange(n_lines), m)


@pytest.mark.parametrize("step_deg", [1e-310, 1e-9, 3.5e-5])
def test_no_turn_has_more_than_ten_million_columns(step_deg: float) -> None:
    angle, line = np.deg2rad(step_deg * np.tile(np.arange(100.0), 3)), np.repeat(np.arange(3), 100)
    with pytest.raises(InputError, match=r"degrees apart, expected at most 10000000 columns in a turn; take the order"):
        find_angle_grid(angle, line, "drive.csv")
    with pytest.raises(InputError, match="degrees apart"):
        find_angle_grid(*sweeps(3, 100), "drive.csv", step_rad=math.radians(step_deg))


def room(step_deg: float, m: int, n_lines: int = 60, noise_m: float = 0.0, seed: int = 0) -> F32:
    """A floor, two walls and a leaning roof, from a place that wanders."""
    rng = np.random.default_rng(seed)
    beam = np.deg2rad(step_deg) * (np.arange(m) - m / 2)
    lines = []
    for _ in range(n_lines):
        walls = [(0.0, 2.0), (1.7, 5.0), (-1.5, 7.0), (2.6, 9.0)]
        with np.errstate(divide="ignore"):
            depth = [d * rng.uniform(0.9, 1.1) / np.maximum(np.cos(beam - a), 0.05) for a, d in walls]
        lines.append(np.min(depth, axis=0) + rng.normal(0.0, noise_m, m))
    return np.array(lines, np.float32)


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
def test_the_step_is_in_the_ranges(step_deg: float, m: int, noise_m: float, usual: str) -> None:
    found = measure_step(room(step_deg, m, noise_m=noise_m))
    assert found is not None
    assert math.degrees(found.step_rad) == pytest.approx(step_deg, rel=0.005)
    assert found.usual == usual
    assert found.off < 0.03


def test_bent_surfaces_do_not_move_the_step() -> None:
    """Round columns spread the curvatures to one side; the median of all moves with them."""
    rng = np.random.default_rng(5)
    lines = room(0.0714, 4270, noise_m=0.001)
    for line in lines:
        for at in rng.integers(0, 4000, 20):
            x = np.linspace(-1.0, 1.0, 200)
            line[at : at + 200] = 4.0 - rng.uniform(0.0, 0.4) * np.sqrt(1.2 - x * x) + rng.normal(0.0, 0.001, 200)
    found = measure_step(lines.astype(np.float32))
    assert found is not None
    assert math.degrees(found.step_rad) == pytest.approx(0.0714, rel=0.001)


def test_real_push_brooms(real_data: Path) -> None:
    """Half a degree, on real roads, which have a crown."""
    assert real_data.is_dir()
    from benchmarks.contest_data import oakland

    for strip in (1, 2, 3):
        found = measure_step(oakland(strip).range_m)
        assert found is not None
        assert math.degrees(found.step_rad) == pytest.approx(0.5, rel=0.03)
