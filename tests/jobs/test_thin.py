"""Thinned streams: dropped shots become missing, others stay unchanged, and all are counted."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.jobs.thin.rules import keep_by_pattern, keep_by_spacing


@given(st.integers(0, 30), st.integers(1, 30), st.integers(0, 10**6))
def test_a_share_is_exact_along_every_line(part, whole, line):
    share = Fraction(min(part, whole), whole)
    columns = np.arange(share.denominator * 5)
    kept = keep_by_pattern(np.full(len(columns), line), columns, share)
    assert kept.sum() == share.numerator * 5
    for start in range(len(columns) - share.denominator):  # evenly: in every window of a period
        assert kept[start : start + share.denominator].sum() == share.numerator


@given(st.lists(st.floats(0, 100), min_size=1, max_size=60), st.floats(0.1, 20))
def test_spacing_against_a_plain_loop(places, spacing):
    position = np.array(places)[None, :, None]
    chosen = np.ones((1, len(places)), np.bool_)
    wanted = []
    last = np.inf
    for place in places:
        taken = bool((place - last) ** 2 >= spacing**2)
        wanted.append(taken)
        last = place if taken else last
    assert keep_by_spacing(position, chosen, spacing)[0].tolist() == wanted
