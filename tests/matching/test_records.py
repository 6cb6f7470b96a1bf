"""Pairs by key and by place, against pairs found one by one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.errors import InputError
from prc_cli.matching import places as matching
from prc_cli.matching.places import (
    KEY,
    Columns,
    JoinTally,
    UnsortedError,
    join_by_key,
    join_by_place,
)

NAMES = ("left", "right")


def cut(columns: Columns, seed: int, most: int = 7) -> Iterator[Columns]:
    """Yield columns in chunks of random length."""
    random = np.random.default_rng(seed)
    n, first = len(columns[KEY]), 0
    while first < n:
        stop = first + int(random.integers(0, most))
        yield {name: values[first:stop] for name, values in columns.items()}
        first = stop


def keyed(key: list[float], returns: list[int] | None = None) -> Columns:
    found = np.array(key, np.float64)
    order = np.argsort(found, kind="stable")
    columns: Columns = {KEY: found[order], "id": order}
    if returns is not None:
        columns["return"] = np.array(returns)[order]
    return columns


def pairs_of(pairs: Iterator[matching.Pairs]) -> set[tuple[int, int]]:
    found = [(int(a), int(b)) for one, other in pairs for a, b in zip(one["id"], other["id"], strict=True)]
    assert len(found) == len(set(found))
    return set(found)


def nearest_of(value: float, among: list[float]) -> float:
    return min(among, key=lambda other: (abs(other - value), other))


def by_hand(left: Columns, right: Columns, tolerance: float) -> set[tuple[int, int]]:
    """Mutual nearest keys within the tolerance, members of a key in their order, one after the other."""
    ours, theirs = (sorted(set(side[KEY].tolist())) for side in (left, right))
    found = set()
    for key in ours:
        if not theirs:
            break
        other = nearest_of(key, theirs)
        if abs(other - key) > tolerance or nearest_of(other, ours) != key:
            continue
        numbers = {int(r) for r in left["return"][left[KEY] == key]} if "return" in left else {None}
        for number in numbers:
            members, ats = [], []
            for side, value in ((left, key), (right, other)):
                here = side[KEY] == value
                ats.append(np.flatnonzero(here if number is None else here & (side["return"] == number)))
                members.append(side["id"][ats[-1]])
            larger = max((0, 1), key=lambda side: len(members[side]))
            clear = "code" in left and len({int((left, right)[larger]["code"][at]) for at in ats[larger]}) == 1
            if len(members[0]) == len(members[1]) or clear:
                found |= set(zip(members[0].tolist(), members[1].tolist(), strict=False))
    return found


KEYS = st.lists(st.integers(0, 40).map(lambda k: k / 4), max_size=40)


@given(left=KEYS, right=KEYS, tolerance=st.sampled_from([0.0, 0.25, 0.3, 1.0, 5.0]), seed=st.integers(0, 99))
def test_keys(left: list[float], right: list[float], tolerance: float, seed: int) -> None:
    one, other = keyed(left), keyed(right)
    tally = JoinTally()
    found = pairs_of(join_by_key(cut(one, seed), cut(other, seed + 1), tolerance, tally, NAMES))
    assert found == by_hand(one, other, tolerance)
    assert tally.n_pairs == tally.n_right == len(found)


@given(data=st.data(), n=st.integers(0, 30), m=st.integers(0, 30), seed=st.integers(0, 99))
def test_keys_return_numbers_and_classes(data: st.DataObject, n: int, m: int, seed: int) -> None:
    sides = []
    for k in (n, m):
        key = data.draw(st.lists(st.integers(0, 8).map(float), min_size=k, max_size=k))
        sides.append(keyed(key, data.draw(st.lists(st.integers(1, 3), min_size=k, max_size=k))))
        sides[-1]["code"] = np.array(data.draw(st.lists(st.sampled_from([2, 2, 2, 6]), min_size=k, max_size=k)), int)
    pairs = join_by_key(cut(sides[0], seed), cut(sides[1], seed + 1), 0.1, JoinTally(), NAMES)
    assert pairs_of(pairs) == by_hand(sides[0], sides[1], 0.1)


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
    found = pairs_of(join_by_place(*sides, tolerance, tally, NAMES, one_to_one=one_to_one))
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


def test_a_removed_record_does_not_take_its_neighbours_partner() -> None:
    key = np.arange(1000) * 1e-6
    kept = np.arange(1000) % 5 > 0
    left, right = {KEY: key, "id": np.arange(1000)}, {KEY: key[kept] + 2e-7, "id": np.flatnonzero(kept)}
    found = pairs_of(join_by_key(cut(left, 0, 90), cut(right, 1, 90), 6e-7, JoinTally(), NAMES))
    assert found == {(int(k), int(k)) for k in np.flatnonzero(kept)}


def test_what_goes_back_is_told_by_its_side() -> None:
    rising, falling = {KEY: np.array([1.0, 2.0])}, {KEY: np.array([2.0, 1.0])}
    for side, streams in ((0, (falling, rising)), (1, (rising, falling))):
        with pytest.raises(UnsortedError) as caught:
            list(join_by_key(iter([streams[0]]), iter([streams[1]]), 0.0, JoinTally(), NAMES))
        assert caught.value.side == side


def test_one_key_for_everything_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_HELD", 1000)
    same = [{KEY: np.ones(100), "id": np.arange(100)}] * 20
    with pytest.raises(InputError, match="left: more than 1000 records within the tolerance of key 1"):
        list(join_by_key(iter(same), iter(same), 0.0, JoinTally(), NAMES))


def test_little_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_HELD", 300)
    chunks = ({KEY: np.arange(k, k + 100) * 1.0, "id": np.arange(k, k + 100)} for k in range(0, 100_000, 100))
    rare = ({KEY: np.array([float(k)]), "id": np.array([k])} for k in range(0, 100_000, 1000))
    assert len(pairs_of(join_by_key(chunks, rare, 0.4, JoinTally(), NAMES))) == 100
