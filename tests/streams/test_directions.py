"""Every limit of the directions, from both sides."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.types import F64
from prc_cli.streams.directions import fit_beams, turn_evenly
from prc_cli.streams.down import (
    LevelLinesError,
    NoddingError,
    NoDirectionError,
    TooFewReturnsError,
    WrongOriginError,
)


def arc(
    span_deg: float, tilt_deg: float | F64 = 90.0, *, n: int = 301, middle_deg: float = 30.0, off_deg: float = 0.0
) -> F64:
    """Return lines (lines, n, 3) in planes ``tilt_deg`` from horizontal, around ``middle_deg`` from straight down.

    Shots lie in turns ``off_deg`` off the plane on one side, on both, and on the other.
    """
    angle = np.deg2rad(middle_deg + np.linspace(-0.5, 0.5, n) * span_deg)
    tilt = np.deg2rad(np.atleast_1d(tilt_deg))[:, None]
    off = np.deg2rad(off_deg) * np.where(np.arange(n) % 4 < 2, 1.0, -1.0)
    across, down = np.cos(off) * np.sin(angle), np.cos(off) * np.cos(angle)
    x = np.cos(tilt) * down + np.sin(tilt) * np.sin(off)
    z = -np.sin(tilt) * down + np.cos(tilt) * np.sin(off)
    return 10.0 * np.stack([x, across + 0 * tilt, z], axis=-1)


def turned(angle_deg: F64) -> F64:
    """Return lines (lines, M, 3) in one vertical plane at angles (lines, M) from straight down."""
    angle = np.deg2rad(angle_deg)
    return 10.0 * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=-1)


@pytest.mark.parametrize("tilt_deg", [90.0, 50.0])
def test_lines_in_a_plane_are_taken(tilt_deg: float) -> None:
    found = fit_beams(arc(100.0, tilt_deg))
    np.testing.assert_allclose(np.rad2deg(found.beam_rad), np.linspace(-20, 80, 301), atol=1e-4)
    assert found.is_straight
    assert found.n_lines == 1


def test_a_line_needs_two_returns() -> None:
    one, two = (np.where(np.arange(5)[:, None] < n, turned(np.arange(5.0)[None]), np.nan) for n in (1, 2))
    with pytest.raises(TooFewReturnsError, match="no line has two returns"):
        fit_beams(one)
    assert fit_beams(np.concatenate([one, two])).n_lines == 1


def test_lines_of_half_a_degree_have_a_plane() -> None:
    assert fit_beams(arc(0.503, n=1001)).n_lines == 1
    with pytest.raises(NoDirectionError, match=r"every line spans less than 0\.5 deg"):
        fit_beams(arc(0.497, n=1001))
    # the others decide where some are shorter
    assert fit_beams(np.concatenate([arc(0.4), arc(5.0)])).n_lines == 1


@pytest.mark.parametrize(("span_deg", "limit_deg"), [(20.0, 0.4), (1.0, 0.1)])
def test_shots_may_be_off_the_plane_by_a_share_of_the_arc(span_deg: float, limit_deg: float) -> None:
    """A fiftieth of the arc, and a tenth of a degree where that is more."""
    assert fit_beams(arc(span_deg, off_deg=0.97 * limit_deg, n=400)).n_lines == 1
    with pytest.raises(WrongOriginError, match=f"lie {1.03 * limit_deg:.2f} deg off a plane through the origin"):
        fit_beams(arc(span_deg, off_deg=1.03 * limit_deg, n=400))


def test_planes_may_differ_by_fifteen_degrees() -> None:
    assert fit_beams(arc(100.0, np.repeat([60.0, 74.8], 10))).n_lines == 20
    with pytest.raises(NoddingError, match=r"60 to 75 deg from horizontal, expected the same within 15 deg"):
        fit_beams(arc(100.0, np.repeat([60.0, 75.2], 10)))


def test_one_line_in_twenty_and_short_lines_may_lean_as_they_like() -> None:
    assert fit_beams(arc(100.0, np.repeat([60.0, 85.0], [96, 4]))).n_lines == 100
    assert fit_beams(arc(100.0, np.repeat([85.0, 60.0], [96, 4]))).n_lines == 100
    for tilts in ([60.0, 85.0], [85.0, 60.0]):
        with pytest.raises(NoddingError):
            fit_beams(arc(100.0, np.repeat(tilts, [92, 8])))
    plain = arc(20.0, np.repeat(60.0, 14))
    assert fit_beams(np.concatenate([plain, arc(9.9, np.repeat(85.0, 6))])).n_lines == 20
    with pytest.raises(NoddingError):
        fit_beams(np.concatenate([plain, arc(10.1, np.repeat(85.0, 6))]))


def test_level_arcs_change_their_elevation_by_less_than_ten_degrees() -> None:
    """A plane that leans by 30 deg, seen around its highest direction."""
    rising, level = (arc(2 * half_deg, 30.0, middle_deg=180.0) for half_deg in (47.0, 46.3))
    assert fit_beams(rising).n_lines == 1
    with pytest.raises(LevelLinesError, match="most run sideways at an elevation that changes by less than 10 deg"):
        fit_beams(level)
    # half of the lines may
    assert fit_beams(np.concatenate([rising, level])).n_lines == 2
    with pytest.raises(LevelLinesError):
        fit_beams(np.concatenate([rising, level, level]))


def test_level_arcs_rise_by_less_than_half_of_what_they_run_sideways() -> None:
    """At the horizon a line rises by the tangent of its plane's tilt for what it runs sideways: half at 26.57 deg."""
    assert fit_beams(arc(5.0, 26.8, middle_deg=90.0)).n_lines == 1
    with pytest.raises(LevelLinesError):
        fit_beams(arc(5.0, 26.3, middle_deg=90.0))


def test_sideways_is_measured_at_the_elevation_of_the_line() -> None:
    """High up, a degree of azimuth is less: around an elevation of 60 deg, half a degree."""
    azimuth = np.deg2rad(np.linspace(-8.0, 8.0, 101))
    for rise_deg, is_level in ((3.5, True), (4.5, False)):
        elevation = np.deg2rad(60.0 + rise_deg * np.linspace(-0.5, 0.5, 101))
        line = 9.0 * np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
        )
        if is_level:
            with pytest.raises(LevelLinesError):
                fit_beams(line[None])
        else:
            assert fit_beams(line[None]).n_lines == 1


def test_shots_of_a_column_may_scatter_by_five_degrees() -> None:
    angle, sign = np.linspace(-50, 50, 41), np.where(np.arange(20) % 2, 1.0, -1.0)[:, None]
    assert fit_beams(turned(angle + 4.9 * sign)).n_lines == 20
    with pytest.raises(NoDirectionError, match=r"a column look different ways, 5\.1 deg apart"):
        fit_beams(turned(angle + 5.1 * sign))


def even(angle_deg: F64, weight: F64 | None = None) -> tuple[F64, bool]:
    n = len(angle_deg)
    beam, is_straight = turn_evenly(np.arange(n), np.deg2rad(angle_deg), np.ones(n) if weight is None else weight, n)
    return np.rad2deg(np.unwrap(beam)), is_straight


def test_steps_back_by_more_than_ten_degrees_go_around() -> None:
    angle = np.array([0.0, 30.0, 60.0, 90.0, 80.5, 120.0, 150.0])
    beam, is_straight = even(angle)
    assert not is_straight
    assert beam[-1] - beam[0] == pytest.approx(150.0, abs=1e-6)
    angle[4] = 79.5
    with pytest.raises(NoDirectionError, match=r"1\.4 turns in a line, expected one at most"):
        even(angle)


def test_lines_of_a_tenth_more_than_a_turn_are_taken() -> None:
    beam, is_straight = even(np.linspace(0.0, 395.0, 80))
    assert is_straight
    assert beam[-1] - beam[0] == pytest.approx(395.0)
    with pytest.raises(NoDirectionError, match=r"1\.1 turns in a line"):
        even(np.linspace(0.0, 397.0, 80))


def test_a_straight_line_is_taken_where_it_is_within_half_a_step() -> None:
    """Of nearly all columns: one in a hundred may be farther off."""
    line = 2.0 * np.arange(101)
    for off, expected in ((0.95, True), (1.05, False)):
        wave = np.where(np.arange(101) % 4 < 2, off, -off)
        assert even(line + wave - 100.0)[1] is expected
    for n_far, expected in ((1, True), (3, False)):
        far = line - 100.0
        far[50 : 50 + n_far] += 1.5
        beam, is_straight = even(far)
        assert is_straight is expected
        if expected:
            np.testing.assert_allclose(beam, line - 100.0, atol=1e-6)


def test_neighbours_look_less_than_half_a_turn_apart() -> None:
    assert even(np.array([0.0, 179.0]))[0][1] == pytest.approx(179.0)
    with pytest.raises(NoDirectionError, match=r"look 181 deg apart, expected less than half a turn"):
        even(np.array([0.0, 181.0]))


def test_columns_that_were_not_seen_share_the_step_of_the_others() -> None:
    beam, is_straight = turn_evenly(np.array([1, 2, 3, 5]), np.deg2rad([0.0, 5.0, 10.0, 45.0]), np.ones(4), 7)
    assert not is_straight
    np.testing.assert_allclose(np.rad2deg(beam), [-11.25, 0.0, 5.0, 10.0, 27.5, 45.0, 56.25], atol=1e-6)


def test_equal_angles_are_one_knot_in_the_middle_of_their_columns() -> None:
    """Weighted, as sums of equal angles differ in their last bits."""
    angle = np.array([0.0, 10.0, 10.0 + 4e-5, 10.0, 50.0, 90.0])
    beam, _ = even(angle, np.array([1.0, 1.0, 1.0, 2.0, 1.0, 1.0]))
    np.testing.assert_allclose(beam[4:], [50.0, 90.0], atol=1e-6)
    np.testing.assert_allclose(beam[:4], np.interp([0, 1, 2, 3], [0, 2.25, 4], [0.0, 10.0, 50.0]), atol=1e-3)
