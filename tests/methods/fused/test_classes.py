"""The fused classifier on cars, curbs and poles.

What they are, and what they are without their steps.
"""

from functools import partial

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, F64, Mask
from prc_cli.methods.fused.pipeline import FusedScanner
from prc_cli.methods.fused.thresholds import Foliage
from tests.methods.fused.street_lines import (
    BEAM,
    BUILDING,
    GROUND,
    HEIGHT_M,
    classified,
    street_lines,
)

SIDE = np.sin(BEAM)
DOWN = np.cos(BEAM)


def surface(side_m: float, low_m: float, high_m: float) -> F64:
    """Return the ranges of an upright surface between two heights above the road, infinite beside
    it."""
    with np.errstate(divide="ignore"):
        ranges = np.where(SIDE * side_m > 0, side_m / SIDE, np.inf)
    height = HEIGHT_M - ranges * DOWN
    surface_m: F64 = np.where((height > low_m) & (height < high_m), ranges, np.inf)
    return surface_m


@pytest.fixture(scope="module")
def street():
    return street_lines(48)


def test_a_curb_is_the_step_between_road_and_sidewalk(street):
    ranges, kind = street
    is_curb = classified(ranges) == Label.CURB
    height = HEIGHT_M - ranges * DOWN
    face = (
        (np.abs(np.abs(ranges * SIDE) - 4.0) < 0.015)
        & (height > 0.03)
        & (height < 0.09)
        & (kind == GROUND)
    )
    assert face.sum() > 200
    assert is_curb[face].mean() > 0.9
    near = np.abs(np.abs(ranges[is_curb] * SIDE[np.nonzero(is_curb)[1]]) - 4.0) < 0.1
    assert near.mean() > 0.95


def van(ranges: F32) -> tuple[F32, Mask]:
    """Put a van of 2.4 m with 20 cm of air beneath beside the road, seen from the side alone."""
    flank = surface(3.0, 0.2, 2.4)
    hit = np.zeros(ranges.shape, np.bool_)
    hit[10:40] = flank < np.where(np.isnan(ranges[10:40]), np.inf, ranges[10:40])
    noise = np.random.default_rng(3).normal(0, 0.002, ranges.shape)
    return np.where(hit, flank + noise, ranges).astype(np.float32), hit


def test_a_van_is_no_wall(street):
    ranges, hit = van(street[0])
    labels = classified(ranges)
    missed = classified(ranges, flanks=None)
    assert (labels[hit] == Label.CAR).mean() > 0.9
    assert (missed[hit] == Label.BUILDING).mean() > 0.4
    facade = (street[1] == BUILDING) & ~hit
    assert (labels[facade] == Label.BUILDING).mean() > 0.95


def with_box(ranges: F32, lines: slice, deep_m: float) -> tuple[F32, Mask]:
    """Put a box of 1.4 m on the sidewalk of the left, 4.6 m away; mark its shots from 0.3 m on."""
    with np.errstate(divide="ignore"):
        lid = np.where(DOWN > 0, (HEIGHT_M - 1.4) / DOWN, np.inf)
    lid = np.where((lid * SIDE > 4.6) & (lid * SIDE < 4.6 + deep_m), lid, np.inf)
    box = np.minimum(surface(4.6, 0.12, 1.4), lid)
    hit = np.zeros(ranges.shape, np.bool_)
    hit[lines] = np.isfinite(box)
    noise = np.random.default_rng(3).normal(0, 0.002, ranges.shape)
    boxed = np.where(hit, box + noise, ranges).astype(np.float32)
    return boxed, hit & (HEIGHT_M - boxed * DOWN > 0.45)


def test_a_bin_is_street_furniture(street):
    ranges, hit = with_box(street[0], slice(4, 10), 0.5)
    assert (classified(ranges)[hit] == Label.POLE).mean() > 0.9
    assert not (classified(ranges, decision={"box_m": 0.0})[hit] == Label.POLE).any()


def test_a_lamp_post_is_a_pole(street):
    ranges = street[0].copy()
    post = surface(-3.0, 0.0, 5.0)
    hit = np.zeros(ranges.shape, np.bool_)
    hit[20] = np.isfinite(post)
    ranges[hit] = np.broadcast_to(post, ranges.shape)[hit].astype(np.float32)
    high = hit & (HEIGHT_M - np.broadcast_to(post * DOWN, ranges.shape) > 0.5)
    assert (classified(ranges)[high] == Label.POLE).mean() > 0.7


def test_a_post_goes_on_beyond_single_shots_that_miss_it(street):
    ranges = street[0].copy()
    post = surface(-3.0, 0.5, 5.0)
    hit = np.flatnonzero(np.isfinite(post))
    ranges[20, hit] = post[hit].astype(np.float32)
    ranges[20, hit[5::6]] = np.nan
    seen = np.delete(hit, slice(5, None, 6))
    assert (classified(ranges, columns={"reach": 2})[20, seen] == Label.POLE).mean() > 0.7
    assert not (classified(ranges, columns={"reach": 1})[20, seen] == Label.POLE).any()


@pytest.mark.parametrize("n_columns, reach", [(47, 1), (48, 2)])
def test_few_rings_are_not_followed_beyond_missed_shots(n_columns, reach):
    beams = np.deg2rad(np.linspace(60, 100, n_columns))
    assert FusedScanner.of(beams).limits.columns.reach == reach


def test_a_person_is_no_thing_of_the_street(street):
    ranges = street[0].copy()
    hit = np.zeros(street[0].shape, np.bool_)
    legs = surface(-3.15, 0.0, 0.85)
    trunk = surface(-3.0, 0.85, 1.5)
    head = surface(-3.1, 1.5, 1.75)
    person = np.minimum(np.minimum(legs, trunk), head)
    hit[20:24] = np.isfinite(person)
    noise = np.random.default_rng(3).normal(0, 0.005, ranges.shape)
    ranges = np.where(hit, person + noise, ranges).astype(np.float32)
    hit &= HEIGHT_M - ranges * DOWN > 0.4
    assert (classified(ranges)[hit] == Label.UNCLASSIFIED).mean() > 0.9
    assert not (classified(ranges, columns={"small_lines": 0})[hit] == Label.UNCLASSIFIED).any()


def trunk(off: float, *, radius_m: float = 0.3, turn_deg: float = 0.0) -> float:
    """Return how much nearer than its middle a round thing is; off the middle by -1 to 1 radii.

    The scan plane is turned about the vertical.
    """
    return radius_m * float(np.sqrt(1 - off**2) + off * np.tan(np.deg2rad(turn_deg)))


def corner(off: float) -> float:
    """Return the same of a corner, whose sides go away from the scanner unlike."""
    return -0.2 * max(0.3 - off, 0.0) - 0.6 * max(off - 0.3, 0.0)


@pytest.mark.parametrize(
    "nearer_m, label",
    [
        (trunk, Label.VEGETATION),
        (partial(trunk, radius_m=0.11), Label.POLE),
        (partial(trunk, radius_m=0.11, turn_deg=35), Label.POLE),
        (partial(trunk, turn_deg=35), Label.VEGETATION),
        (partial(trunk, turn_deg=-35), Label.VEGETATION),
        (lambda _: 0.0, Label.BUILDING),
        (corner, Label.BUILDING),
    ],
)
def test_what_stands_alone_is_a_wall_only_if_not_round(street, nearer_m, label):
    ranges = street[0].copy()
    hit = np.zeros(street[0].shape, np.bool_)
    for line in range(18, 30):  # between the car's lines and the ends
        thing = surface(-3.3 + nearer_m((line - 23.5) / 6), 0.0, 4.0)
        hit[line] = np.isfinite(thing)
        ranges[line, hit[line]] = thing[hit[line]]
    high = hit & (HEIGHT_M - ranges * DOWN > 0.5)
    ranges += np.random.default_rng(2).normal(0, 0.002, ranges.shape).astype(np.float32)
    assert (classified(ranges)[high] == label).mean() > 0.9
    assert (classified(ranges, columns={"lines": -1})[high] == Label.BUILDING).mean() > 0.9


def test_rooms_have_no_cars(street):
    ranges, hit = van(street[0])
    near = np.where(ranges < 5.8, ranges, np.float32(np.nan))
    assert not (classified(near) == Label.CAR).any()
    assert (classified(near, room_m=0.0)[hit & ~np.isnan(near)] == Label.CAR).mean() > 0.3


def test_columns_far_apart_are_looked_at_again_whatever_their_smooth_pairs():
    foliage = Foliage(depth_m=2.0, depth_pairs=3, depth_step_rad=0.25)
    assert [foliage.thresholds(0.5, step) for step in (0.2, 0.25)] == [(0.5, 2, 3), (0.5, 2, 0)]
    assert foliage._replace(at_depth=False).thresholds(0.5, 0.2) == (0, 2, 3)
