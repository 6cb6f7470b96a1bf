"""Matcher by position, against pairs found one by one."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.matching.join import KEY, Columns, JoinTally, merge_join
from prc_cli.matching.keys import NearestPlaces
from tests.matching.samples import cut, pairs_of


def cloud(n: int, seed: int, step: float) -> Columns:
    random = np.random.default_rng(seed)
    xyz = np.round(random.uniform(0, 3, (n, 3)) / step) * step + random.uniform(-1e-5, 1e-5, (n, 3))
    xyz = np.concatenate([xyz, xyz[: n // 5]])  # some places are taken twice
    xyz = xyz[np.argsort(xyz[:, 0], kind="stable")]
    return {KEY: xyz[:, 0], "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2], "id": np.arange(len(xyz))}


@pytest.mark.parametrize("one_to_one", [True, False])
@pytest.mark.parametrize(("tolerance", "n"), [(0.05, 300), (0.3, 300), (0.3, 20), (9.0, 40), (0.3, 0)])
def test_places(tolerance: float, n: int, one_to_one: bool) -> None:
    left, right = cloud(n, 1, 0.01), cloud(200, 2, 0.01)
    tally = JoinTally()
    sides = cut(left, 3, 60), cut(right, 4, 60)
    found = pairs_of(merge_join(*sides, NearestPlaces(tolerance, one_to_one), tolerance, tally))
    xyz = [np.stack([side[axis] for axis in "xyz"], axis=1) for side in (left, right)]
    apart = np.linalg.norm(xyz[0][:, None] - xyz[1][None], axis=2) if n else np.empty((0, len(xyz[1])))
    expected = set()
    for i in range(len(apart)):
        to = np.flatnonzero(apart[i] == apart[i].min())
        if apart[i].min() > tolerance:
            continue
        if not one_to_one:
            expected.add((i, int(to[0])))
            continue
        back = np.flatnonzero(apart[:, to[0]] == apart[:, to[0]].min())
        if i in back and len(back) == len(to):
            expected.add((i, int(to[list(back).index(i)])))
    assert found == expected
    assert tally.n_pairs == len(expected)
    assert tally.n_right == len({b for _, b in expected})
