"""Numbers of lines and columns that rise in steps.

The step is divided out, told, and no number is lost unseen.
"""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.streams.evidence.result import MAX_COLUMNS, _Kept
from prc_cli.streams.steps import ONE, Step, find_step
from tests.streams.record_lists import M, only, open_records, read, scene


@pytest.mark.parametrize("name", ["scan_line", "column"])
@pytest.mark.parametrize(("size", "phase"), [(1, 0), (2, 1), (10, 0), (176, 3)])
def test_numbers_in_steps_give_the_same_lines(name: str, size: int, phase: int) -> None:
    image, records = scene()
    changed = {**records, name: records[name].astype(np.int64) * size + phase}
    stream = open_records(only(changed, "range", "scan_line", "column"), 100)
    whole = read(stream)
    m = M + phase if name == "column" and size == 1 else M
    assert stream.info.points_per_line == m
    np.testing.assert_array_equal(whole.range_m[:, :M], image)
    notes = [note for note in stream.info.facts.notes if "rise by" in note]
    assert len(notes) == (size > 1)
    assert not notes or f"rise by {size}" in notes[0]


def test_a_number_off_the_step_is_counted() -> None:
    _, records = scene()
    changed = {**records, "scan_line": records["scan_line"].astype(np.int64) * 5}
    changed["scan_line"][3] += 2
    whole = read(open_records(only(changed, "range", "scan_line", "column"), 100))
    assert whole.tally.n_unplaced == 1


def test_column_numbers_that_fit_into_the_given_line_are_meant() -> None:
    _, records = scene()
    changed = {**records, "column": records["column"].astype(np.int64) * 2}
    stream = open_records(only(changed, "range", "scan_line", "column"), 100, points_per_line=2 * M)
    assert stream.info.points_per_line == 2 * M
    assert np.isnan(read(stream).range_m[:, 1::2]).all()


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (np.array([0, 4, 8]), ONE),
        (np.arange(0, 900, 3) + (np.arange(300) == 7), Step(3, 0)),
        (np.arange(0, 900, 3) + (np.arange(300) % 10 == 7), ONE),
        (np.r_[np.arange(0, 400, 4), np.arange(400, 800, 8)], Step(4, 0)),
        (np.full(100, np.nan), ONE),
        (np.arange(100) * 0.5, ONE),
    ],
)
def test_the_step_is_that_of_nearly_all_numbers(numbers: np.ndarray, expected: Step) -> None:
    assert find_step(numbers) == expected


def columns_of(range_m: np.ndarray) -> np.ndarray:
    """The columns whose labels are kept."""
    labels = np.zeros(range_m.shape, np.uint8)
    block = ScanBlock(0, range_m)
    return _Kept(LabelledBlock(block, labels, np.empty(0, np.uint8))).columns


def test_labels_are_judged_in_columns_that_hold_returns() -> None:
    image = np.full((40, 4 * MAX_COLUMNS), np.nan, np.float32)
    image[:, ::4] = 5.0
    columns = columns_of(image)
    assert np.isfinite(image[:, columns]).all()
    assert len(columns) == MAX_COLUMNS
    full = columns_of(np.full((40, 300), 5.0, np.float32))
    np.testing.assert_array_equal(full, np.arange(1, 300, 3))
