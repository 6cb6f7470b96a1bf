"""Sample streams for joins, and their results."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prc_cli.matching.join import KEY, Columns, Joined, JoinTally, merge_join
from prc_cli.matching.keys import MutualKeys


def cut(columns: Columns, seed: int, most: int = 7) -> Iterator[Columns]:
    """Yield columns in chunks of random length."""
    random = np.random.default_rng(seed)
    n, first = len(columns[KEY]), 0
    while first < n:
        stop = first + int(random.integers(0, most))
        yield {name: values[first:stop] for name, values in columns.items()}
        first = stop


def pairs_of(joined: Iterator[Joined]) -> set[tuple[int, int]]:
    pairs = (item.pairs() for item in joined if len(item.at))
    found = [(int(a), int(b)) for one, other in pairs for a, b in zip(one["id"], other["id"], strict=True)]
    assert len(found) == len(set(found))
    return set(found)


def join_by_key(
    left: Iterator[Columns], right: Iterator[Columns], tolerance: float, tally: JoinTally
) -> Iterator[Joined]:
    return merge_join(left, right, MutualKeys(tolerance), tolerance, tally)
