"""Arrays on disk and run records."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.formats.writing import disk as module
from prc_cli.formats.writing.disk import DiskColumn
from tests.formats.common import run_record


def read(column: DiskColumn, n: int = 1000) -> np.ndarray:
    parts = list(column.chunks(n))
    return np.concatenate(parts) if parts else np.empty(0)


@given(
    st.lists(
        st.lists(st.tuples(st.integers(0, 200), st.integers(0, 2**32 - 1)), max_size=40), max_size=6
    )
)
def test_equals_an_array_in_memory(tmp_path_factory, parts):
    """Tiny pages and buffers: every boundary is met; the last value of a record stands."""
    expected = np.full(201, 3, np.uint32)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PAGE_BYTES", 32)
        patch.setattr(module, "BUFFER_ITEMS", 16)
        column = DiskColumn(tmp_path_factory.mktemp("s") / "s", np.uint32, 3, n_records=201)
        for part in parts:
            record = np.array([item[0] for item in part], np.int64)
            values = np.array([item[1] for item in part], np.uint32)
            column.put(record, values)
            for index, value in part:
                expected[index] = value
        assert np.array_equal(read(column, 17), expected)
        column.close()


def test_memory_stays_at_the_buffer(tmp_path):
    """A far record makes a hole in the file, not an array in memory."""
    import tracemalloc

    column = DiskColumn(tmp_path / "s", np.uint8, 1)
    tracemalloc.start()
    column.put(np.array([10**9, 5]), np.array([2, 3], np.uint8))
    first = next(column.chunks(10))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert first.tolist() == [1, 1, 1, 1, 1, 3, 1, 1, 1, 1]
    assert peak < 5_000_000
    column.close()


@pytest.mark.parametrize("page_bytes", [32, 1 << 20])
def test_records_are_read_in_any_order(tmp_path, monkeypatch, page_bytes):
    monkeypatch.setattr(module, "PAGE_BYTES", page_bytes)
    kind = np.dtype([("x", "<f8"), ("code", "<i4")])
    rows = np.array([(n / 7, n) for n in range(1000)], kind)
    wanted = np.array([[990, 1, -1, 2, 500], [1000, 7, 8, 501, 1]])
    with DiskColumn(tmp_path / "rows", kind, (np.nan, -5)) as column:
        column.append(rows[:400])
        column.append(rows[400:])
        values = column.get(wanted)
    expected = np.where((wanted >= 0) & (wanted < 1000), wanted, -5)
    np.testing.assert_array_equal(values["code"], expected)
    np.testing.assert_array_equal(values["x"], np.where(expected < 0, np.nan, expected / 7))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "value, kept",
    [
        ("trajectory:/home/a/drive.csv", "trajectory:drive.csv"),
        ("/data/x.las", "x.las"),
        ("C:\\scans\\x.las", "x.las"),
        ("trajectory:C:\\scans\\drive.csv", "trajectory:drive.csv"),
        (Path("/data/t.csv"), "t.csv"),
        ("trajectory:drive.csv", "trajectory:drive.csv"),
        ("time:48", "time:48"),
        ("", ""),
    ],
)
def test_folders_are_left_out(value, kept):
    record = json.loads(run_record(config={"input": {"range": [value]}}).to_json())
    assert record["config"]["input"]["range"] == [kept]
