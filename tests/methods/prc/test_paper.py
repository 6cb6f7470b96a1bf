"""Statements of Lehtola et al. (2019) about their method, checked on ours."""

from __future__ import annotations

import os
from math import comb

import numpy as np
import pytest

from prc_cli import kernels
from prc_cli.core.types import F32
from prc_cli.methods.prc.support import SupportParams, required_counts, stream_window, support
from prc_cli.methods.prc.surfaces import SurfacesParams, area_threshold
from prc_cli.methods.prc.urban import ForestParams, is_dense

needs_compiler = pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="millions of shots")


def random_window(n_lines: int, width: int, seed: int = 2019) -> F32:
    ranges = np.random.default_rng(seed).uniform(0, 120, (n_lines, width)).astype(np.float32)
    return stream_window(np.full(width + 1, np.nan, dtype=np.float32), ranges, None)


@pytest.mark.parametrize(("zeta", "share"), [(0.0, 0.0), (1e-9, 0.0), (1e9, 1.0)])
def test_nothing_is_supported_at_small_limits_and_all_at_large_ones(zeta: float, share: float) -> None:
    """II-B: at the limits of zeta_s and zeta_p all points are noise, or none."""
    window = random_window(20, 50)
    assert support(window, 50, SupportParams(zeta_s=zeta, zeta_p=zeta)).mean() == share


def test_supported_share_grows_with_either_limit() -> None:
    """Fig. 4 rises along both axes."""
    window = random_window(30, 60)
    for name in ("zeta_s", "zeta_p"):
        shares = [
            support(window, 60, SupportParams.model_validate({"zeta_s": 60, "zeta_p": 60, name: zeta})).mean()
            for zeta in (0.01, 0.1, 1, 10, 30, 60, 120)
        ]
        assert shares == sorted(shares)
        assert shares[0] < shares[-1]


def at_least(count: int, of: int) -> float:
    """Probability that ``count`` or more of the neighbours are within 1 m, for ranges uniform in 0 to 120 m."""
    p = 1 - (1 - 1 / 120) ** 2
    return sum(comb(of, n) * p**n * (1 - p) ** (of - n) for n in range(count, of + 1))


def test_printed_probabilities_belong_to_two_neighbours_in_both() -> None:
    """IV-A prints .004 for 6 neighbours and .007 for 8: those of counts that are rounded down."""
    assert required_counts(SupportParams(rounding="floor")) == (2, 2)
    assert at_least(2, 6) == pytest.approx(0.0040, abs=5e-5)
    assert at_least(2, 8) == pytest.approx(0.0072, abs=5e-5)
    assert at_least(2, 6) * at_least(2, 8) == pytest.approx(3e-5, rel=0.1)


@needs_compiler
def test_random_ranges_support_each_other_as_seldom_as_printed() -> None:
    window = random_window(2000, 2000)

    def share(min_in_slice: int, min_adjacent: int) -> float:
        return float(kernels.support_mask(window, 2000, 2000, 1.0, 1.0, min_in_slice, min_adjacent).mean())

    assert share(0, 2) == pytest.approx(0.0040, abs=2e-4)
    assert share(2, 0) == pytest.approx(0.0072, abs=2e-4)
    assert share(2, 2) == pytest.approx(3e-5, abs=1.2e-5)
    assert share(0, 3) == pytest.approx(at_least(3, 6), rel=0.15)
    assert share(3, 0) == pytest.approx(0.00024, rel=0.15)
    assert share(3, 2) < 3e-6


def test_smoothness_density_is_taken_427_times_for_4270_columns() -> None:
    """II-F, eq. 12."""
    assert len(is_dense(np.zeros((255, 4270), dtype=bool), ForestParams())) == 427
    assert len(is_dense(np.zeros((255, 4271), dtype=bool), ForestParams())) == 428


def test_share_of_the_block_that_makes_a_surface_is_kept() -> None:
    """II-E: A / (k M) should stay the same; A = 30 for k = 99 and M = 2154."""
    auto = SurfacesParams(area="auto")
    assert area_threshold(auto, 99, 99, 2154) == 30
    assert area_threshold(auto, 255, 255, 4270) == pytest.approx(153, abs=0.5)
    assert area_threshold(auto, 33, 99, 2154) == area_threshold(SurfacesParams(), 33, 99, 2154) == 10
