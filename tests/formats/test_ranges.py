"""Valid ranges, and counts of invalid ones by reason."""

from __future__ import annotations

import numpy as np

from prc_cli.core.stream import ReadTally
from prc_cli.formats.ranges import clean_ranges


def test_keeps_good_ranges_as_they_are_and_leaves_its_input_alone() -> None:
    given = np.asfortranarray(np.array([[1.5, np.nan], [-2.0, 7.25]], np.float32))
    before = given.copy()
    ranges, tally = clean_ranges(given)
    assert ranges.dtype == np.float32
    assert ranges.flags.c_contiguous
    assert not np.shares_memory(ranges, given)
    np.testing.assert_array_equal(given, before)
    np.testing.assert_array_equal(ranges, np.array([[1.5, np.nan], [np.nan, 7.25]], np.float32))
    assert tally == ReadTally(n_not_positive=1)


def test_every_reason_is_counted_once() -> None:
    given = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, -5.0, 0.5, 1.0, 1.5, 100.0, 100.5])
    ranges, tally = clean_ranges(given, min_range=1.0, max_range=100.0)
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(ranges)), [8, 9])
    assert tally == ReadTally(n_not_finite=2, n_not_positive=3, n_beyond=3)


def test_bounds_are_judged_the_same_for_float32_float64_and_integers() -> None:
    rng = np.random.default_rng(1)
    millimetres = rng.integers(0, 40_000, 5_000)
    exact = millimetres / 1000.0
    for bound in (30.1, 17.003, 0.007):
        narrow, tally_narrow = clean_ranges(exact.astype(np.float32), bound, bound + 2.3)
        wide, tally_wide = clean_ranges(exact, bound, bound + 2.3)
        np.testing.assert_array_equal(narrow, wide)
        assert tally_narrow == tally_wide
    whole, _ = clean_ranges(millimetres, 5.0, 30_000.0)
    np.testing.assert_array_equal(whole, clean_ranges(millimetres.astype(np.float64), 5.0, 30_000.0)[0])
