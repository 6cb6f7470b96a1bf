"""Shot timing: found where possible, else unknown rather than wrong."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.streams.setup import UNKNOWN, find_timing

HZ, M = 48.0, 120
LINE, COLUMN = np.divmod(np.arange(50 * M), M)
TIME = 100 + LINE / HZ + COLUMN / (HZ * M)
SHOT_S = 1 / (HZ * M)


@pytest.mark.parametrize("decimals", [3, 6, 12])
@pytest.mark.parametrize("share", [0.2, 1.0])
def test_columns_tell_their_step(decimals: int, share: float) -> None:
    keep = np.random.default_rng(2).random(len(TIME)) < share
    found = find_timing(np.round(TIME[keep], decimals), COLUMN[keep], HZ, None)
    assert found.shot_s == 0
    assert found.column_s == pytest.approx(SHOT_S, rel=0.02)


def test_shots_tell_their_step() -> None:
    assert find_timing(np.round(TIME, 6), None, HZ, None).shot_s == pytest.approx(SHOT_S, rel=0.01)
    # stamps of six shots and of three returns: the mean
    assert find_timing(np.round(TIME, 3), None, HZ, None).shot_s == pytest.approx(SHOT_S, rel=0.1)
    thin = np.random.default_rng(2).random(len(TIME)) < 0.6
    assert find_timing(TIME[thin], None, HZ, None).shot_s == pytest.approx(SHOT_S)
    assert find_timing(TIME, None, HZ, 60).shot_s == 1 / (HZ * 60)
    for nothing in (np.empty(0), np.full(3, np.nan), np.full(3, 7.0), np.array([0.0, 1.0])):
        assert find_timing(nothing, None, HZ, None) == UNKNOWN
