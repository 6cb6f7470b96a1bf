"""Streams side by side."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.matching.join import in_step


def test_streams_walk_in_equal_steps_however_they_are_chunked() -> None:
    values = np.arange(100, dtype=np.int64)
    seen: list[list[int]] = []
    streams = [({"a": part} for part in np.split(values, cuts)) for cuts in ([1, 1, 30, 31, 90], [7, 50, 50])]
    steps = list(in_step(streams, lambda n: seen.append(list(n))))
    for side in (0, 1):
        assert np.array_equal(np.concatenate([step[side]["a"] for step in steps]), values)
    assert seen == [[100, 100]]


@pytest.mark.parametrize(("one", "other"), [(0, 3), (3, 0), (5, 3), (3, 9)])
def test_lengths_that_differ_are_counted_to_the_end(one: int, other: int) -> None:
    seen: list[list[int]] = []
    streams = [({"a": np.zeros(1)} for _ in range(n)) for n in (one, other)]
    assert len(list(in_step(streams, lambda n: seen.append(list(n))))) == min(one, other)
    assert seen == [[one, other]]
