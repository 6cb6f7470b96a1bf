"""Grouping of returns by shot, and choice of one return."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from prc_cli.core.stream import ReadTally
from prc_cli.formats.ranges import choose_returns, continues_run, mark_shots
from tests.streams.record_lists import open_records, read

NAN = np.nan


def shots(time: list[float], number_of_returns: list[int], return_number: list[int] | None = None) -> list[int]:
    """Return the shot of every record."""
    continues = continues_run((np.array(time),), np.array(number_of_returns))
    starts = mark_shots(continues, None if return_number is None else np.array(return_number))
    return [int(i) for i in np.cumsum(starts)]


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ([1, 2, 3, 1, 2, 3], [1, 1, 1, 2, 2, 2]),
        ([3, 2, 1, 3, 2, 1], [1, 1, 1, 2, 2, 2]),  # last return first
        ([1, 2, 2, 1, 2, 3], [1, 1, 2, 3, 3, 3]),  # filtered: returns were dropped
        ([1, 1, 1, 1, 1, 1], [1, 2, 3, 4, 5, 6]),
    ],
)
def test_return_numbers_tell_shots_of_one_stamp_apart(numbers: list[int], expected: list[int]) -> None:
    assert shots([5.0] * 6, [3] * 6, numbers) == expected


def choose(rule: Any, range_m: list[float], intensity: list[float] | None, number: list[int] | None) -> list[int]:
    starts = np.array([True, False, False, True])
    chosen = choose_returns(
        starts,
        np.array([*range_m, 9.0], np.float32),
        None if intensity is None else np.array([*intensity, 0.0]),
        None if number is None else np.array([*number, 1]),
        rule,
    )
    assert chosen[3]
    return [int(i) for i in np.flatnonzero(chosen[:3])]


@pytest.mark.parametrize(
    ("rule", "intensity", "number", "expected"),
    [
        ("strongest", [1, 7, 3], [1, 2, 3], 1),
        ("strongest", [7, 7, 3], [1, 2, 3], 0),
        ("strongest", [NAN, 0, -5], [1, 2, 3], 1),
        ("strongest", [NAN, NAN, NAN], [1, 2, 3], 0),
        ("strongest", None, [3, 1, 2], 1),
        ("first", [1, 7, 3], [2, 3, 1], 2),
        ("first", [1, 7, 3], None, 0),
        ("last", [1, 7, 3], [2, 3, 1], 1),
        ("last", None, None, 2),
    ],
)
def test_the_return_that_stands(
    rule: str, intensity: list[float] | None, number: list[int] | None, expected: int
) -> None:
    assert choose(rule, [5, 6, 7], intensity, number) == [expected]


def forest() -> dict[str, NDArray[Any]]:
    """Two lines of three shots: of 1, 3 and 2 returns, then of 2, 1, 1."""
    return {
        "range": np.array([5.0, 6, 7, 8, 9, 10, 11, 12, 13, 14]),
        "scan_line": np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1]),
        "time": np.array([0.0, 1, 1, 1, 2, 2, 10, 10, 11, 12]),
        "number_of_returns": np.array([1, 3, 3, 3, 2, 2, 2, 2, 1, 1], np.uint8),
        "return_number": np.array([1, 1, 2, 3, 1, 2, 1, 2, 1, 1], np.uint8),
        "intensity": np.array([9, 1, 8, 2, 5, 4, 3, 6, 9, 9], np.uint16),
    }


@pytest.mark.parametrize("chunk_records", [1, 3])
@pytest.mark.parametrize(
    ("rule", "standing"),
    [("strongest", [[0, 2, 4], [7, 8, 9]]), ("first", [[0, 1, 4], [6, 8, 9]]), ("last", [[0, 3, 5], [7, 8, 9]])],
)
@pytest.mark.parametrize("columns", ["order", "time:1", "dimension:column"])
def test_one_return_a_shot_in_the_image(rule: str, standing: list[list[int]], columns: str, chunk_records: int) -> None:
    records = forest()
    records["column"] = np.array([0, 1, 1, 1, 2, 2, 0, 0, 1, 2])
    whole = read(open_records(records, chunk_records, columns=columns, return_=rule))
    assert whole.record.tolist() == standing
    assert whole.range_m.tolist() == [[records["range"][i] for i in line] for line in standing]
    others = sorted(set(range(10)) - {i for line in standing for i in line})
    assert [item[3] for item in whole.extras] == others
    for line, column, range_m, record in whole.extras:
        assert (line, column) == (records["scan_line"][record], records["column"][record])
        assert range_m == records["range"][record]
    assert whole.tally == ReadTally(n_extra_returns=4)
