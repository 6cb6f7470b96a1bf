"""Records sorted by time."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.facts import SourceFacts
from prc_cli.formats.records import Reading, RecordChunk
from prc_cli.formats.sorting import sorted_by_time


@dataclass
class ArraySource:
    """Records from arrays, in chunks of a given size."""

    values: dict[str, np.ndarray[Any, Any]]
    chunk: int = 7
    path: str = "drive.las"
    format: str = "array"
    facts: SourceFacts = field(default_factory=SourceFacts)
    asked: list[tuple[str, ...]] = field(default_factory=list)

    @property
    def n_records(self) -> int:
        return len(next(iter(self.values.values())))

    @property
    def dimensions(self) -> tuple[str, ...]:
        return tuple(self.values)

    def with_reading(self, reading: Reading) -> ArraySource:
        return self

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        self.asked.append(names)
        for start in range(0, self.n_records, self.chunk):
            part = {name: self.values[name][start : start + self.chunk] for name in names}
            yield RecordChunk(start, part, len(part[names[0]]))


def collect(
    chunks: Iterator[RecordChunk], name: str
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    parts = list(chunks)
    firsts = [chunk.first_record for chunk in parts]
    assert firsts == list(np.cumsum([0] + [chunk.n for chunk in parts])[:-1])
    assert all(chunk.record is not None and len(chunk.record) == chunk.n for chunk in parts)
    return (
        np.concatenate([chunk.values[name] for chunk in parts]),
        np.concatenate([chunk.record for chunk in parts if chunk.record is not None]),
    )


@given(
    times=st.lists(st.integers(0, 5), min_size=1, max_size=60),
    chunk=st.integers(1, 61),
    run=st.integers(1, 20),
    merge=st.integers(1, 30),
)
def test_equals_a_stable_argsort_for_any_run_and_merge_size(
    times: list[int],
    chunk: int,
    run: int,
    merge: int,
) -> None:
    time_s = np.array(times, np.float64)
    source = ArraySource({"time": time_s, "point": np.arange(len(times), dtype=np.uint16)}, chunk)
    point, record = collect(
        sorted_by_time(source, run_records=run, merge_records=merge).chunks(("point",)), "point"
    )
    expected = np.argsort(time_s, kind="stable")
    np.testing.assert_array_equal(record, expected)
    np.testing.assert_array_equal(point, expected)
    assert point.dtype == np.uint16


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_time_that_is_no_number_is_named(bad: float) -> None:
    source = ArraySource({"time": np.array([1.0] * 9 + [bad])}, chunk=4)
    with pytest.raises(
        InputError, match=rf"drive.las: record 9 has time {bad}, expected a finite time to sort by"
    ):
        list(sorted_by_time(source).chunks(("time",)))


def test_a_full_temporary_disk_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    class FullDisk:
        def write(self, data: object) -> int:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: FullDisk())
    source = ArraySource({"time": np.arange(100.0)})
    with pytest.raises(
        OutputError, match=r"No space left on device\); free space there or point TMPDIR"
    ):
        list(sorted_by_time(source, run_records=10).chunks(("time",)))


def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    chunks = sorted_by_time(ArraySource({"time": np.arange(100.0)[::-1]}), run_records=10).chunks(
        ("time",)
    )
    next(chunks)
    del chunks
    assert list(tmp_path.iterdir()) == []
