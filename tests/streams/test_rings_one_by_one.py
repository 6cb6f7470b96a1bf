"""Turns of rings, compared with plain loops."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import InputError
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
