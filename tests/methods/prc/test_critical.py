"""Critical thresholds of PRC: with any thresholds they give the supported shots, no more and no fewer."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.types import F32
from prc_cli.methods.prc.support import SupportParams, critical_zetas, stream_window, support, window_reach


def random_window(rng: np.random.Generator, n_lines: int, m: int) -> F32:
    """Ranges on a coarse grid, so that differences equal thresholds now and then; every tenth is missing."""
    ranges = (rng.integers(40, 60, (n_lines, m)) * 0.125).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.1] = np.nan
    tail = rng.choice([5.0, 6.0, np.nan], window_reach(m)).astype(np.float32)
    return stream_window(tail, ranges, ranges[:1] if rng.random() < 0.5 else None)


@pytest.mark.parametrize("m", [1, 2, 3, 7, 40])
@pytest.mark.parametrize("rho_c", [0.1, 1 / 3, 1.0])
@pytest.mark.parametrize("rounding", ["ceil", "floor"])
def test_they_say_what_any_thresholds_support(m: int, rho_c: float, rounding: str) -> None:
    rng = np.random.default_rng(m)
    for _ in range(10):
        window = random_window(rng, 6, m)
        for zeta_p, zeta_s in rng.choice([0.125, 0.2, 0.25, 0.3, 1.0, 1e9], (4, 2)):
            params = SupportParams(zeta_p=zeta_p, zeta_s=zeta_s, rho_c=rho_c, rounding=rounding)
            found = critical_zetas(window, m, params)
            below = (found.in_line_m.astype(float) < zeta_p) & (found.adjacent_m.astype(float) < zeta_s)
            np.testing.assert_array_equal(below, support(window, m, params))
            reach = window_reach(m)
            missing = np.isnan(window[reach : len(window) - reach]).reshape(below.shape)
            np.testing.assert_array_equal(np.isnan(found.in_line_m), missing)
            np.testing.assert_array_equal(np.isnan(found.adjacent_m), missing)


def test_too_few_neighbours_never_support() -> None:
    window = stream_window(np.full(6, np.nan, np.float32), np.array([[5, 5, 5, np.nan, 5]], np.float32), None)
    found = critical_zetas(window, 5, SupportParams())
    assert found.in_line_m[0].tolist()[:3] == [0.0, 0.0, 0.0]
    assert np.isinf(found.adjacent_m[0, [0, 1, 2, 4]]).all()
