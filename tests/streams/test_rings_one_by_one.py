"""Turns of rings, compared with plain loops."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64
from prc_cli.streams import rings as ring_turns
from prc_cli.streams.rings import Turns, find_step, ring_columns, ring_lines

TURN = 2 * math.pi


@pytest.mark.parametrize("seed", range(8))
def test_cut_turns_equal_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.normal(0.05, 0.05, 500)) + rng.uniform(-9, 9)
    highest, rings, within = -math.inf, [], []
    for one in along.tolist():
        highest = max(highest, math.floor(one / TURN))
        rings.append(int(highest - math.floor(along[0] / TURN)))
        within.append(one % TURN)
    n = [rings.count(k) for k in range(max(rings) + 1)]
    few = ring_turns.MIN_RING * float(np.median(n))
    for k, ring in enumerate(rings):
        if ring == len(n) - 1 and n[-1] < few:
            rings[k], within[k] = ring - 1, math.nextafter(TURN, 0)
    if n[0] < few:
        within = [0.0 if ring == 0 else one for ring, one in zip(rings, within, strict=True)]
        rings = [max(ring - 1, 0) for ring in rings]
    found = ring_turns._cut_turns(along)
    assert found[0].tolist() == rings
    np.testing.assert_allclose(found[1], within)


def slow_cuts(along: F64) -> Iterator[float]:
    """Yield the middle of the longest run of whole degrees without a shot."""
    seen = {int(one % TURN / TURN * 360) % 360 for one in along.tolist()}
    best, middle = 0, 0.0
    held = sorted(seen)
    for a, b in pairwise([*held, *(one + 360 for one in held)]):
        if b - a > best:
            best, middle = b - a, (a + b + 1) / 2
    if len(seen) < 360:
        yield math.radians(middle)


@pytest.mark.parametrize("seed", range(6))
def test_rings_may_begin_at_axes_the_first_shot_and_in_the_longest_gap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.uniform(0.0, 0.4 if seed else 0.001, 9000 if not seed else 60)) + seed
    found = list(ring_turns._cuts(along, 0.2))
    assert found[:5] == [0.0, math.pi, math.pi / 2, -math.pi / 2, along[0] - 0.1]
    assert found[5:] == pytest.approx(list(slow_cuts(along)))


@pytest.mark.parametrize("seed", range(6))
def test_the_step_where_shots_are_densest_equals_a_plain_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ring = np.repeat(np.arange(3), 300)
    along = np.concatenate(
        [
            np.cumsum(
                rng.choice(
                    [0.01, 0.012, 0.05, -0.003], 300, p=[0.5, 0.45 if seed else 0.3, 0.04 if seed else 0.19, 0.01]
                )
            )
            for _ in range(3)
        ]
    )
    steps: list[float | None] = [
        b - a if i == j else None
        for (a, b), (i, j) in zip(pairwise(along.tolist()), pairwise(ring.tolist()), strict=True)
    ]
    limit = ring_turns.NEIGHBOUR * float(np.median([one for one in steps if one is not None and one > 0]))
    near = [one if one is not None and 0 <= one < limit else None for one in steps]
    windows = [near[k : k + ring_turns.WINDOW] for k in range(len(near) - ring_turns.WINDOW + 1)]
    means = [
        sum(one for one in window if one is not None) / ring_turns.WINDOW for window in windows if None not in window
    ]
    found = find_step(Turns(ring, along, 0.0, 1.0))
    if means:
        assert found == pytest.approx(float(np.percentile(means, ring_turns.DENSEST)))
    else:
        assert found == pytest.approx(float(np.mean([one for one in near if one])))


def test_shots_that_do_not_turn_have_no_step() -> None:
    assert find_step(Turns(np.zeros(5, np.int64), np.zeros(5), 0.0, 1.0)) == 0.0
    assert find_step(Turns(np.array([0, 1]), np.array([0.0, 1.0]), 0.0, 1.0)) == 0.0
    # too few for a window: the mean of what is near
    assert find_step(Turns(np.zeros(4, np.int64), np.array([0.0, 0.1, 0.2, 0.31]), 0.0, 1.0)) == pytest.approx(0.31 / 3)


@pytest.mark.parametrize("seed", range(10))
def test_the_longest_rise_is_the_longest(seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, 6, 9).astype(np.float64)
    marked = ring_turns._longest_rise(values)
    assert (np.diff(values[marked]) >= 0).all()
    longest = max(
        n for n in range(10) for some in combinations(values.tolist(), n) if all(a <= b for a, b in pairwise(some))
    )
    assert np.count_nonzero(marked) == longest
    assert ring_turns._longest_rise(np.empty(0)).tolist() == []


@pytest.mark.parametrize("seed", range(5))
def test_lines_of_rings_rise_and_stay_near_their_azimuth(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ring = np.repeat(np.arange(4), 50)
    along = np.concatenate([np.sort(rng.uniform(0, TURN * 0.999, 50)) for _ in range(4)])
    if seed % 2:
        along[[10, 11]], along[[70, 75]] = along[[11, 10]], along[[75, 70]]
    line, in_order = ring_lines(Turns(ring, along, 0.0, 1.0), 4, 200)
    assert line.min() >= 0
    assert line.max() < 200
    for k in range(4):
        own = ring == k
        assert in_order[own].tolist() == ring_turns._longest_rise(along[own]).tolist()
        assert (np.diff(line[own & in_order]) > 0).all()
    place = along / TURN * 200
    assert np.abs(line + 0.5 - place)[in_order].max() < 4
    assert (line[~in_order] == np.floor(place[~in_order])).all()
    # alone in their cells, shots are where they are
    alone = ring_lines(Turns(np.zeros(9, np.int64), (np.arange(9) + 0.4) * TURN / 9, 0.0, 1.0), 1, 9)
    assert alone[0].tolist() == list(range(9))


def frame(elevation_deg: list[float], n: int = 5) -> tuple[Any, Turns]:
    elevation = np.deg2rad(np.repeat(elevation_deg, n))
    xyz = np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], axis=1)
    return xyz, Turns(np.repeat(np.arange(len(elevation_deg)), n), np.zeros(len(xyz)), 0.0, 1.0)


def test_rings_are_counted_from_the_lowest() -> None:
    for rings, expected in (([-3.0, 0.0, 2.0], [0, 1, 2]), ([2.0, 0.0, -3.0], [2, 1, 0]), ([4.0], [0])):
        n, column = ring_columns(*frame(rings), None, "a.bin")
        assert (n, column[::5].tolist()) == (len(rings), expected)
        assert ring_columns(*frame(rings), len(rings), "a.bin")[0] == n
    with pytest.raises(InputError, match="found 3 rings, expected 4 as input.points_per_line says"):
        ring_columns(*frame([0.0, 1.0, 2.0]), 4, "a.bin")


@pytest.mark.parametrize("off", [0.99, 1.01])
def test_rings_out_of_order_are_told(off: float) -> None:
    most = math.degrees(ring_turns.MAX_RING_ORDER_RAD)
    rings = [0.0, 5.0, 5.0 - off * most, 20.0]
    for way in (1, -1):
        one = frame([way * ring for ring in rings])
        if off < 1:
            assert ring_columns(*one, None, "a.bin")[0] == 4
        else:
            said = f"ring 2 lies at {way * rings[2]:.2f} deg of elevation after one at {way * 5.0:.2f} deg"
            with pytest.raises(InputError, match=said):
                ring_columns(*one, None, "a.bin")
