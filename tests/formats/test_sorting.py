"""Records sorted by time."""

import tempfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.errors import InputError, OutputError
from prc_cli.formats.sorting import sorted_by_time
from tests.streams.record_lists import MemorySource


@given(
    times=st.lists(st.integers(0, 5), min_size=1, max_size=60),
    chunk=st.integers(1, 61),
    run=st.integers(1, 20),
    merge=st.integers(1, 30),
)
def test_equals_a_stable_argsort_for_any_run_and_merge_size(
    times,
    chunk,
    run,
    merge,
):
    time_s = np.array(times, np.float64)
    source = MemorySource({"time": time_s, "point": np.arange(len(times), dtype=np.uint16)}, chunk)
    parts = list(sorted_by_time(source, run_records=run, merge_records=merge).chunks(("point",)))
    assert [part.first_record for part in parts] == np.cumsum([0, *(part.n for part in parts)])[
        :-1
    ].tolist()
    point = np.concatenate([part.values["point"] for part in parts])
    record = np.concatenate([np.asarray(part.record) for part in parts])
    expected = np.argsort(time_s, kind="stable")
    np.testing.assert_array_equal(record, expected)
    np.testing.assert_array_equal(point, expected)
    assert point.dtype == np.uint16


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_time_that_is_no_number_is_named(bad):
    source = MemorySource({"time": np.array([1.0] * 9 + [bad])}, chunk_records=4)
    with pytest.raises(
        InputError, match=rf"drive.bin: record 9 has time {bad}, expected a finite time to sort by"
    ):
        list(sorted_by_time(source).chunks(("time",)))


def test_a_full_temporary_disk_is_one_line(monkeypatch):
    class FullDisk:
        def write(self, data: object) -> int:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: FullDisk())
    source = MemorySource({"time": np.arange(100.0)})
    with pytest.raises(
        OutputError, match=r"No space left on device\); free space there or point TMPDIR"
    ):
        list(sorted_by_time(source, run_records=10).chunks(("time",)))


def test_nothing_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    chunks = sorted_by_time(MemorySource({"time": np.arange(100.0)[::-1]}), run_records=10).chunks(
        ("time",)
    )
    next(chunks)
    del chunks
    assert list(tmp_path.iterdir()) == []


def test_no_records_are_sorted():
    assert list(sorted_by_time(MemorySource({"time": np.empty(0)})).chunks(("time",))) == []
