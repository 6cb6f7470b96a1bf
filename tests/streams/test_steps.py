"""Numbers of lines and columns that rise in steps.

The step is divided out, told, and no number is lost unseen.
"""

import numpy as np
import pytest

from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.streams.evidence.result import MAX_COLUMNS, _Kept
from tests.streams.record_lists import M, only, open_records, read, scene


@pytest.mark.parametrize("name", ["scan_line", "column"])
@pytest.mark.parametrize("size, phase", [(1, 0), (2, 1), (10, 0), (176, 3)])
def test_numbers_in_steps_give_the_same_lines(name, size, phase):
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


def columns_of(range_m: np.ndarray) -> np.ndarray:
    """The columns whose labels are kept."""
    labels = np.zeros(range_m.shape, np.uint8)
    block = ScanBlock(0, range_m)
    return _Kept(LabelledBlock(block, labels, np.empty(0, np.uint8))).columns


def test_labels_are_judged_in_columns_that_hold_returns():
    image = np.full((40, 4 * MAX_COLUMNS), np.nan, np.float32)
    image[:, ::4] = 5.0
    columns = columns_of(image)
    assert np.isfinite(image[:, columns]).all()
    assert len(columns) == MAX_COLUMNS
    full = columns_of(np.full((40, 300), 5.0, np.float32))
    np.testing.assert_array_equal(full, np.arange(1, 300, 3))
