"""The sweep: errors and bounded memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.matching import join as join_module
from prc_cli.matching.join import CODE, KEY, SAME, Columns, JoinTally, UnsortedError, merge_join
from prc_cli.matching.keys import NearestLabel
from tests.matching.samples import join_by_key


def test_an_unsorted_side_is_named() -> None:
    rising, falling = {KEY: np.array([1.0, 2.0])}, {KEY: np.array([2.0, 1.0])}
    for side, streams in ((0, (falling, rising)), (1, (rising, falling))):
        with pytest.raises(UnsortedError) as caught:
            list(join_by_key(iter([streams[0]]), iter([streams[1]]), 0.0, JoinTally()))
        assert caught.value.side == side


def test_too_many_records_of_one_key_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(join_module, "MAX_HELD", 1000)
    same = [{KEY: np.ones(100), "id": np.arange(100)}] * 20
    with pytest.raises(InputError, match="left: more than 1000 records within the tolerance of key 1"):
        list(join_by_key(iter(same), iter(same), 0.0, JoinTally()))


def test_memory_does_not_grow_with_the_streams() -> None:
    def stream(n: int, step: int) -> Iterator[Columns]:
        for first in range(0, n, 20_000):
            key = np.arange(first, first + 20_000) * float(step)
            one = np.ones(len(key), np.int64)
            yield {KEY: key, SAME: one, CODE: one.astype(np.uint8)}

    def peak(n: int) -> int:
        tally = JoinTally()
        tracemalloc.start()
        # the points are sparse: the labels between them must not pile up
        for _ in merge_join(stream(n // 10, 10), stream(n, 1), NearestLabel(0.25), 0.25, tally):
            pass
        held = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert (tally.n_left, tally.n_pairs, tally.n_right) == (n // 10, n // 10, n // 10)
        return held

    assert peak(2_000_000) < 1.2 * peak(400_000)


def test_distances_are_counted_by_decades_and_the_largest_of_a_pair_is_kept() -> None:
    tally = JoinTally()
    tally.add_distances(np.array([0.3, 5.0, 0.002, np.inf]), np.array([True, False, True, False]))
    tally.add_distances(np.array([0.1, 1e-9, 1e6, 1.1e6, 0.01]), np.array([True, False, False, False, False]))
    assert tally.largest == 0.3
    found = {place - 9: n for place, n in enumerate(tally.distances.tolist()) if n}
    # a distance of just a power of ten belongs to it; far beyond, and without any right record, comes last
    assert found == {1: 1, 7: 2, -9: 1, 6: 1, -2: 1}


def test_how_near_most_of_the_records_without_partner_have_one() -> None:
    tally = JoinTally()
    assert tally.near() is None
    tally.add_distances(np.array([0.05, 0.5, 5.0, 50.0]), np.zeros(4, np.bool_))
    assert [tally.near(share) for share in (0.25, 0.26, 0.5, 0.51, 1.0)] == [0.1, 1.0, 1.0, 10.0, 100.0]
    assert tally.near() == 1.0
    tally.add_distances(np.full(5, np.inf), np.zeros(5, np.bool_))
    assert tally.near() is None
