from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import OutputError
from prc_cli.core.stream import ExtraReturns
from prc_cli.formats.writing import base as base_module
from prc_cli.formats.writing.columns import OutputConfig
from tests.formats.common import (
    URBAN,
    labelled,
    random_labels,
    record_blocks,
    run_record,
    write,
)

SOURCE = Path("drive.bin")


def read(path: Path) -> np.ndarray:
    if path.suffix == ".npy":
        return np.asarray(np.load(path))
    if path.suffix == ".csv":
        with path.open(newline="") as handle:
            rows = list(csv.DictReader(handle))
        assert [int(row["record"]) for row in rows] == list(range(len(rows)))
        return np.array([int(row["class"]) for row in rows], np.uint8)
    table = pq.read_table(path)
    assert table["record"].to_pylist() == list(range(len(table)))
    return np.asarray(table["class"].to_numpy())


SUFFIXES = [".npy", ".csv", ".parquet"]


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_entry_a_record_in_record_order(
    tmp_path: Path, suffix: str, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base_module, "CHUNK_RECORDS", 64)
    labels = random_labels(990, (Label.MISSING, *URBAN, Label.STEM))
    order = np.random.default_rng(5).permutation(990)
    path = tmp_path / f"labels{suffix}"
    record = write(path, SOURCE, record_blocks(labels, order=order), n_records=990 if known else None)
    found = read(path)
    assert found.dtype == np.uint8
    assert np.array_equal(found, ClassCodes().lookup()[labels])
    assert {item.code: item.count for item in record.classes} == dict(
        zip(*np.unique(found, return_counts=True), strict=True)
    )


def test_names_and_segments(tmp_path: Path) -> None:
    labels = np.array([3, 6, 0, 2], np.uint8)
    options = OutputConfig(segment_ids=True)
    blocks = record_blocks(labels, 4, segments=np.array([8, 9, 0, 4_000_000_000]))
    for suffix in (".csv", ".parquet"):
        write(tmp_path / f"a{suffix}", SOURCE, blocks, options=options, n_records=4)
    assert (tmp_path / "a.csv").read_text() == (
        "record,class,name,segment\n0,2,ground,8\n1,64,stem,9\n2,0,missing,0\n3,7,noise,4000000000\n"
    )
    table = pq.read_table(tmp_path / "a.parquet").to_pydict()
    assert table["name"] == ["ground", "stem", "missing", "noise"]
    assert table["segment"] == [8, 9, 0, 4_000_000_000]


def test_extra_returns_get_their_own_label(tmp_path: Path) -> None:
    extra = ExtraReturns(
        np.array([0], np.int32), np.array([1], np.int32), np.array([12], np.float32), np.array([2], np.int64)
    )
    record = np.array([[0, 1, 3, -1]])
    labels = np.array([[3, 4, 5, 0]], np.uint8)
    write(
        tmp_path / "a.npy",
        SOURCE,
        [labelled(labels, record=record, extra=extra, extra_labels=np.array([2], np.uint8))],
    )
    assert np.load(tmp_path / "a.npy").tolist() == [2, 6, 7, 5]


def test_more_labels_than_records(tmp_path: Path) -> None:
    block = labelled(np.full((1, 8), 3, np.uint8))
    with pytest.raises(OutputError, match="found labels for 8 records, expected 5"):
        write(tmp_path / "a.npy", SOURCE, [block], run_record(n_records=5))
    with pytest.raises(OutputError, match="found a label for record 7, expected records below 5"):
        write(tmp_path / "a.npy", SOURCE, [block], n_records=5)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_same_run_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    blocks = record_blocks(random_labels(300))
    for name in ("a", "b"):
        write(tmp_path / f"{name}{suffix}", SOURCE, blocks)
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
