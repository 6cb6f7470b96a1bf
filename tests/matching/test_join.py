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
from tests.matching.samples import join_by_key, pairs_of


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


def test_windows_stay_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(join_module, "MAX_HELD", 300)
    chunks = ({KEY: np.arange(k, k + 100) * 1.0, "id": np.arange(k, k + 100)} for k in range(0, 100_000, 100))
    rare = ({KEY: np.array([float(k)]), "id": np.array([k])} for k in range(0, 100_000, 1000))
    assert len(pairs_of(join_by_key(chunks, rare, 0.4, JoinTally()))) == 100


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
