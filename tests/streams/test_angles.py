"""Sweeps, and the step of their angles."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.types import F32, F64, I64
from prc_cli.streams.angle_step import AngleStep, measure_step
from prc_cli.streams.angles import column_angles, find_angle_grid, find_sweep
from tests.simulated import drive_arrays


def sweeps(n_lines: int, m: int, step_deg: float = 1.0) -> tuple[F64, I64]:
    """Return angles [rad] and lines of whole sweeps that begin at -20 deg."""
    angle = np.deg2rad(-20.0 + step_deg * np.tile(np.arange(float(m)), n_lines))
    return angle, np.repeat(np.arange(n_lines), m)


@pytest.mark.parametrize(("n_far", "span"), [(8, 2.0), (12, 12.0)])
def test_one_angle_in_a_thousand_at_either_end_does_not_widen_the_sweep(n_far: int, span: float) -> None:
    angle = np.tile(np.linspace(-1.0, 1.0, 100), 100)
    angle[: n_far * 37 : 37] = -6.0
    angle[-1 : -1 - n_far * 37 : -37] = 6.0
    assert find_sweep(angle, "drive.laz").span_rad == pytest.approx(span, abs=0.2)


@pytest.mark.parametrize(("n_back", "is_sweep"), [(24, True), (26, False)])
def test_three_of_four_steps_run_one_way(n_back: int, is_sweep: bool) -> None:
    step = np.where(np.arange(100) < n_back, -0.01, 0.01)
    angle = np.concatenate([[0.0], np.cumsum(np.random.default_rng(1).permutation(step))])
    for sign in (1, -1):
        if is_sweep:
            assert find_sweep(sign * angle, "drive.laz").direction == sign
        else:
            with pytest.raises(InputError, match=f"grows in {74 if sign > 0 else 26} steps and falls in"):
                find_sweep(sign * angle, "drive.laz")


@pytest.mark.parametrize(("m", "is_whole"), [(323, False), (324, True)])
def test_nine_tenths_of_a_turn_are_a_whole_one(m: int, is_whole: bool) -> None:
    found = find_angle_grid(*sweeps(6, m), "drive.laz")
    assert found.whole_turn is is_whole
    assert found.n_columns == (360 if is_whole else m)
    assert found.start_rad == pytest.approx(np.deg2rad(-20.0))


@pytest.mark.parametrize(("n_equal", "is_refused"), [(50, False), (51, True)])
def test_half_of_the_neighbours_may_have_equal_angles(n_equal: int, is_refused: bool) -> None:
    step = np.where(np.arange(100) < n_equal, 0.0, 1.0)
    angle = np.deg2rad(np.concatenate([[0.0], np.cumsum(np.random.default_rng(1).permutation(step))]))
    line = np.zeros(101, np.int64)
    if is_refused:
        with pytest.raises(InputError, match="51 % of neighbouring shots have equal scan angles"):
            find_angle_grid(angle, line, "drive.laz")
    else:
        assert find_angle_grid(angle, line, "drive.laz").n_columns > 1


@pytest.mark.parametrize("step_deg", [1e-310, 1e-9, 3.5e-5])
def test_no_turn_has_more_than_ten_million_columns(step_deg: float) -> None:
    angle, line = np.deg2rad(step_deg * np.tile(np.arange(100.0), 3)), np.repeat(np.arange(3), 100)
    with pytest.raises(InputError, match=r"degrees apart, expected at most 10000000 columns in a turn; take the order"):
        find_angle_grid(angle, line, "drive.csv")
    with pytest.raises(InputError, match="degrees apart"):
        find_angle_grid(*sweeps(3, 100), "drive.csv", step_rad=math.radians(step_deg))


@pytest.mark.parametrize(("wobble", "is_known"), [(0.9, True), (1.1, False)])
def test_angles_of_a_column_differ_by_less_than_the_step(wobble: float, is_known: bool) -> None:
    column = np.tile(np.arange(30), 10)
    angle = np.deg2rad(column + wobble * np.where(np.repeat(np.arange(10), 30) % 2, 1.0, -1.0))
    assert (column_angles(angle, column, 30) is not None) is is_known


def test_columns_beyond_those_seen_go_on_evenly_around_the_turn() -> None:
    angle = np.deg2rad(170.0 + 2.0 * np.arange(20))
    use = np.arange(5, 16)
    found = column_angles(np.angle(np.exp(1j * angle[use])), use, 20)
    assert found is not None
    np.testing.assert_allclose(np.remainder(found - angle + math.pi, 2 * math.pi) - math.pi, 0.0, atol=1e-9)
    assert (np.diff(found) > 0).all()


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


def test_a_simulated_street_is_enough() -> None:
    block, _ = drive_arrays(64, 1500, 7)
    assert block.angle_rad is not None
    found = measure_step(block.range_m)
    assert found is not None
    assert found.step_rad == pytest.approx(float(np.diff(block.angle_rad)[0]), rel=0.01)


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


def test_where_no_planes_are_there_is_no_step() -> None:
    lines = room(0.1, 2500)
    shuffled = np.random.default_rng(1).permuted(lines, axis=1)
    for tells_nothing in (shuffled, lines[:, :150], lines[:0], np.full_like(lines, np.nan), np.full_like(lines, 5.0)):
        assert measure_step(tells_nothing) is None


def test_real_push_brooms(real_data: Path) -> None:
    """Half a degree, on real roads, which have a crown."""
    assert real_data.is_dir()
    from benchmarks.contest_data import oakland

    for strip in (1, 2, 3):
        found = measure_step(oakland(strip).range_m)
        assert found is not None
        assert math.degrees(found.step_rad) == pytest.approx(0.5, rel=0.03)


def test_texts() -> None:
    found = AngleStep(math.radians(0.1442), 0.0014, 2951)
    assert found.shown(2154) == "0.1442 deg ± 0.0002 deg (2951 pieces of planes), a field of 310.6 deg"
