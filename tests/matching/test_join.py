"""The merge join against a plain one, however its streams are cut."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.records import RecordChunk
from prc_cli.matching import join as join_module
from prc_cli.matching.join import JoinTally, join

RNG = np.random.default_rng


def chunked(key: Any, same: Any, codes: Any, step: int) -> Any:
    values = {"time": np.asarray(key, float), "same": np.asarray(same), "code": np.asarray(codes, np.uint8)}
    order = np.argsort(values["time"], kind="stable")
    for first in range(0, len(order), step):
        part = order[first : first + step]
        yield RecordChunk(first, {name: column[part] for name, column in values.items()}, len(part), part)


def plain_join(left: Any, right: Any, tolerance: float) -> tuple[list[int], int]:
    """Every point by itself: the code it gets, -1 = none; and how many labels are used."""
    found, used = [], set()
    order = sorted(range(len(right[0])), key=lambda i: right[0][i])
    for i in range(len(right[0])):
        near = [
            j for j in range(len(left[0])) if left[1][j] == right[1][i] and abs(left[0][j] - right[0][i]) <= tolerance
        ]
        if not near:
            found.append(-1)
            continue
        best = min(near, key=lambda j: (abs(left[0][j] - right[0][i]), left[0][j]))
        group = [j for j in near if left[0][j] == left[0][best]]
        used.update(group)
        mine = [k for k in order if right[0][k] == right[0][i] and right[1][k] == right[1][i]]
        if len(mine) == len(group):
            found.append(int(left[2][group[mine.index(i)]]))
            continue
        codes = [int(left[2][j]) for j in group]
        found.append(max(codes, key=lambda code: (codes.count(code), -codes.index(code))))
    return found, len(used)


@pytest.mark.parametrize("seed", range(12))
def test_join_like_a_plain_one_however_it_is_chunked(seed: int) -> None:
    rng = RNG(seed)
    tolerance = [0.0, 0.25, 1.0, 3.0][seed % 4]
    n = rng.integers(1, 60, 2)
    left, right = (
        (rng.integers(0, 40, size) / 2.0 + (seed % 3 == 0) * rng.choice([0, 0.125], size), rng.integers(1, 3, size),
         rng.integers(1, 5, size))
        for size in n
    )  # fmt: skip
    expected, used = plain_join(left, right, tolerance)
    for steps in ((1, 1), (3, 7), (100, 100), (100, 1), (1, 100)):
        tally = JoinTally()
        found = np.full(n[1], -2)
        for item in join(chunked(*left, steps[0]), chunked(right[0], right[1], np.zeros(n[1]), steps[1]), tally,
                         tolerance=tolerance):  # fmt: skip
            assert np.all(found[item.record] == -2)
            found[item.record] = np.where(item.matched, item.codes.astype(np.int64), -1)
        assert found.tolist() == expected
        assert (tally.n_points, tally.n_labels_matched) == (n[1], used)
        assert tally.n_matched == np.count_nonzero(np.array(expected) >= 0)


def test_too_many_records_of_one_key_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(join_module, "HELD_RECORDS", 100)
    key = np.concatenate([np.zeros(500), [1.0]])
    one = np.ones(len(key), np.int64)
    with pytest.raises(InputError, match="more than 100 records from 0.0 to 0.0 cannot be told apart"):
        list(join(chunked(key, one, one, 50), chunked(key, one, one, 50), JoinTally()))


def test_memory_does_not_grow_with_the_streams() -> None:
    def stream(n: int, step: int) -> Iterator[RecordChunk]:
        for first in range(0, n, 20_000):
            key = np.arange(first, first + 20_000) * float(step)
            one = np.ones(len(key), np.int64)
            yield RecordChunk(first, {"time": key, "same": one, "code": one.astype(np.uint8)}, len(key), one)

    def peak(n: int) -> int:
        tally = JoinTally()
        tracemalloc.start()
        # the points are sparse: the labels between them must not pile up
        for _ in join(stream(n, 1), stream(n // 10, 10), tally, tolerance=0.25):
            pass
        held = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert (tally.n_points, tally.n_matched, tally.n_labels_matched) == (n // 10, n // 10, n // 10)
        return held

    assert peak(2_000_000) < 1.2 * peak(400_000)


def test_distances_tell_which_tolerance_would_help() -> None:
    one = np.ones(10, np.int64)
    tally = JoinTally()
    found = list(join(chunked(np.arange(10.0), one, one, 4), chunked(np.arange(10.0) + 0.004, one, one, 3), tally))
    assert not any(item.matched.any() for item in found)
    assert tally.near() == pytest.approx(0.01)
    assert JoinTally().near() is None
