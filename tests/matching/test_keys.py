"""Joins by keys, streams side by side, and pairs of files."""

import tracemalloc
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prc_cli.core.errors import InputError
from prc_cli.matching import join as join_module
from prc_cli.matching.join import (
    CODE,
    KEY,
    SAME,
    Columns,
    Joined,
    JoinTally,
    UnsortedError,
    merge_join,
)
from prc_cli.matching.keys import MutualKeys, NearestLabel

RNG = np.random.default_rng


def keyed(key: list[float], returns: list[int] | None = None) -> Columns:
    keys = np.array(key, np.float64)
    order = np.argsort(keys, kind="stable")
    columns: Columns = {KEY: keys[order], "id": order}
    if returns is not None:
        columns[SAME] = np.array(returns)[order]
    return columns


def nearest_of(value: float, among: list[float]) -> float:
    return min(among, key=lambda number: (abs(number - value), number))


def by_hand(left: Columns, right: Columns, tolerance: float) -> set[tuple[int, int]]:
    """Mutual nearest keys within the tolerance, members of a key in their order."""
    ours, theirs = (sorted(set(side[KEY].tolist())) for side in (left, right))
    pairs = set()
    for key in ours:
        if not theirs:
            break
        partner = nearest_of(key, theirs)
        if abs(partner - key) > tolerance or nearest_of(partner, ours) != key:
            continue
        numbers = {int(r) for r in left[SAME][left[KEY] == key]} if SAME in left else {None}
        for number in numbers:
            members = []
            ats = []
            for side, value in ((left, key), (right, partner)):
                here = side[KEY] == value
                ats.append(
                    np.flatnonzero(here if number is None else here & (side[SAME] == number))
                )
                members.append(side["id"][ats[-1]])
            larger = max((0, 1), key=lambda side: len(members[side]))
            clear = (
                CODE in left
                and len({int((left, right)[larger][CODE][index]) for index in ats[larger]}) == 1
            )
            if len(members[0]) == len(members[1]) or clear:
                pairs |= set(zip(members[0].tolist(), members[1].tolist(), strict=False))
    return pairs


@given(
    data=st.data(),
    n=st.integers(0, 30),
    m=st.integers(0, 30),
    tolerance=st.sampled_from([0.0, 0.1, 0.3, 1.0, 5.0]),
    has_codes=st.booleans(),
    seed=st.integers(0, 99),
)
@settings(max_examples=50)
def test_keys_return_numbers_and_classes(data, n, m, tolerance, has_codes, seed):
    sides = []
    for k in (n, m):
        key = data.draw(st.lists(st.integers(0, 16), min_size=k, max_size=k))
        returns = data.draw(st.lists(st.integers(1, 3), min_size=k, max_size=k))
        sides.append(keyed([value / 4 for value in key], returns))
        if has_codes:
            codes = data.draw(st.lists(st.sampled_from([2, 2, 2, 6]), min_size=k, max_size=k))
            sides[-1][CODE] = np.array(codes, int)
    tally = JoinTally()
    pairs = pairs_of(join_by_key(cut(sides[0], seed), cut(sides[1], seed + 1), tolerance, tally))
    assert pairs == by_hand(sides[0], sides[1], tolerance)


def chunked(
    key: Any,
    same: Any,
    codes: Any,
    step: int,
) -> Any:
    values = {
        KEY: np.asarray(key, float),
        SAME: np.asarray(same),
        CODE: np.asarray(codes, np.uint8),
    }
    order = np.argsort(values[KEY], kind="stable")
    values["record"] = np.arange(len(order))
    for first in range(0, len(order), step):
        part = order[first : first + step]
        yield {name: column[part] for name, column in values.items()}


def join(
    labels: Iterator[Columns],
    points: Iterator[Columns],
    tally: JoinTally,
    tolerance: float = 0.0,
) -> Any:
    return merge_join(
        points, labels, NearestLabel(tolerance), tolerance, tally, "points", "labels", spare=1
    )


def plain_join(left: Any, right: Any, tolerance: float) -> tuple[list[int], int]:
    """Every point by itself: the code it gets, -1 = none; and how many labels are used."""
    joined = []
    used = set()
    order = sorted(range(len(right[0])), key=lambda i: right[0][i])
    for i in range(len(right[0])):
        near = [
            j
            for j in range(len(left[0]))
            if left[1][j] == right[1][i] and abs(left[0][j] - right[0][i]) <= tolerance
        ]
        if not near:
            joined.append(-1)
            continue
        best = min(near, key=lambda j: (abs(left[0][j] - right[0][i]), left[0][j]))
        group = [j for j in near if left[0][j] == left[0][best]]
        used.update(group)
        mine = [k for k in order if right[0][k] == right[0][i] and right[1][k] == right[1][i]]
        if len(mine) == len(group):
            joined.append(int(left[2][group[mine.index(i)]]))
            continue
        codes = [int(left[2][j]) for j in group]
        joined.append(max(codes, key=lambda code: (codes.count(code), -codes.index(code))))
    return joined, len(used)


@pytest.mark.parametrize("seed", range(4))
def test_join_like_a_plain_one_however_it_is_chunked(seed):
    rng = RNG(seed)
    tolerance = [0.0, 0.25, 1.0, 3.0][seed % 4]
    n = rng.integers(1, 60, 2)
    left, right = (
        (
            rng.integers(0, 40, size) / 2.0 + (seed % 3 == 0) * rng.choice([0, 0.125], size),
            rng.integers(1, 3, size),
            rng.integers(1, 5, size),
        )
        for size in n
    )
    expected, used = plain_join(left, right, tolerance)
    for steps in ((1, 1), (3, 7), (100, 100), (100, 1), (1, 100)):
        tally = JoinTally()
        codes = np.full(n[1], -2)
        for item in join(
            chunked(*left, steps[0]),
            chunked(right[0], right[1], np.zeros(n[1]), steps[1]),
            tally,
            tolerance=tolerance,
        ):
            record = item.left["record"]
            assert np.all(codes[record] == -2)
            codes[record] = -1
            codes[record[item.left_index]] = item.right[CODE][item.right_index]
        assert codes.tolist() == expected
        assert (tally.n_left, tally.n_right) == (n[1], used)
        assert tally.n_pairs == np.count_nonzero(np.array(expected) >= 0)


def test_distances_show_which_tolerance_would_help():
    ones = np.ones(10, np.int64)
    tally = JoinTally()
    joined = list(
        join(
            chunked(np.arange(10.0), ones, ones, 4),
            chunked(np.arange(10.0) + 0.004, ones, ones, 3),
            tally,
        )
    )
    assert not any(len(item.left_index) for item in joined)
    assert tally.near() == pytest.approx(0.01)
    assert JoinTally().near() is None


def test_an_unsorted_side_is_named():
    rising = {KEY: np.array([1.0, 2.0])}
    falling = {KEY: np.array([2.0, 1.0])}
    for side, streams in ((0, (falling, rising)), (1, (rising, falling))):
        with pytest.raises(UnsortedError) as caught:
            list(join_by_key(iter([streams[0]]), iter([streams[1]]), 0.0, JoinTally()))
        assert caught.value.side == side


def test_too_many_records_of_one_key_are_refused(monkeypatch):
    monkeypatch.setattr(join_module, "MAX_HELD", 1000)
    same = [{KEY: np.ones(100), "id": np.arange(100)}] * 20
    with pytest.raises(
        InputError, match="left: more than 1000 records within the tolerance of key 1"
    ):
        list(join_by_key(iter(same), iter(same), 0.0, JoinTally()))


def test_memory_does_not_grow_with_the_streams():
    def stream(n: int, step: int) -> Iterator[Columns]:
        for first in range(0, n, 20_000):
            key = np.arange(first, first + 20_000) * float(step)
            ones = np.ones(len(key), np.int64)
            yield {KEY: key, SAME: ones, CODE: ones.astype(np.uint8)}

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


def cut(columns: Columns, seed: int, most: int = 7) -> Iterator[Columns]:
    """Yield columns in chunks of random length."""
    random = np.random.default_rng(seed)
    n = len(columns[KEY])
    first = 0
    while first < n:
        stop = first + int(random.integers(0, most))
        yield {name: values[first:stop] for name, values in columns.items()}
        first = stop


def pairs_of(joined: Iterator[Joined]) -> set[tuple[int, int]]:
    pairs = (item.pairs() for item in joined if len(item.left_index))
    record_pairs = [
        (int(a), int(b))
        for left, right in pairs
        for a, b in zip(left["id"], right["id"], strict=True)
    ]
    assert len(record_pairs) == len(set(record_pairs))
    return set(record_pairs)


def join_by_key(
    left: Iterator[Columns],
    right: Iterator[Columns],
    tolerance: float,
    tally: JoinTally,
) -> Iterator[Joined]:
    return merge_join(left, right, MutualKeys(tolerance), tolerance, tally)
