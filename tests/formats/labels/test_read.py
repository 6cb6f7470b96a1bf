"""Label files, read and written."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from prc_cli.core.errors import InputError, PrcError
from prc_cli.formats.labels import open_codes

CODES = [2, 2, 7, 0, 64, 5]


def read(path: Path, dimension: str | None = None) -> list[int]:
    source = open_codes(path, dimension)
    assert source.path == str(path)
    chunks = list(source.codes())
    assert all(chunk.dtype == np.int64 and chunk.ndim == 1 for chunk in chunks)
    codes = np.concatenate(chunks)
    assert source.n_records in (None, len(codes))
    np.testing.assert_array_equal(np.concatenate(list(source.codes())), codes)
    return [int(code) for code in codes]


def refused(path: Path, dimension: str | None = None) -> str:
    with pytest.raises(PrcError) as caught:
        read(path, dimension)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(f"{path.parent}/", "")


def write_parquet(path: Path, **columns: Any) -> Path:
    parquet.write_table(pa.table(columns), path)
    return path


@pytest.mark.parametrize("packed", ["", ".gz"])
@pytest.mark.parametrize(
    "header, asked",
    [("record,class,name", None), ("record,Label,name", None), ("class,mine,name", "mine")],
)
def test_text(
    tmp_path,
    header,
    asked,
    packed,
):
    rows = "".join(f"{k},{code},GROUND\n" for k, code in enumerate(CODES))
    path = tmp_path / f"codes.csv{packed}"
    content = f"{header}\n{rows}".encode()
    path.write_bytes(gzip.compress(content, mtime=0) if packed else content)
    assert read(path, asked) == CODES


@pytest.mark.parametrize("kind", [pa.uint8(), pa.int64(), pa.uint64(), pa.float32()])
def test_parquet(tmp_path, kind):
    path = write_parquet(
        tmp_path / "codes.parquet", record=range(6), **{"class": pa.array(CODES, kind)}
    )
    assert open_codes(path).n_records == 6
    assert read(path) == CODES
    gaps = write_parquet(tmp_path / "gaps.parquet", mine=pa.array([2, None, 7], kind))
    assert read(gaps) == [2, -1, 7]


@pytest.mark.parametrize(
    "values, message",
    [
        ([1, 2.5], "record 1: found the class code 2.5, expected a whole number"),
        ([1, 2, np.nan], "record 2: found the class code nan, expected a whole number"),
        ([np.inf], "record 0: found the class code inf"),
        ([1e300], "record 0: found the class code 1e+300"),
        (np.array([3, 2**63], np.uint64), "record 1: found the class code 9223372036854775808"),
        (
            np.array([True]),
            "found an array of true/false values, expected class codes, whole numbers",
        ),
        (
            np.ones((1, 1, 1)),
            "found shape (1, 1, 1), expected (records,) or (lines, points per line)",
        ),
        (np.ones(0), "found shape (0,), expected (records,)"),
    ],
)
def test_arrays_that_are_no_codes(tmp_path, values, message):
    path = tmp_path / "codes.npy"
    np.save(path, np.asarray(values))
    assert refused(path).startswith(f"codes.npy: {message}")


def test_an_image_of_codes_is_read_line_by_line(tmp_path):
    np.save(tmp_path / "codes.npy", np.reshape(CODES, (2, 3)))
    assert read(tmp_path / "codes.npy") == CODES


def test_rows_of_a_label_file_must_be_in_record_order(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text("record,class,name\n0,2,ground\n1,6,building\n2,7,noise\n")
    assert np.concatenate(list(open_codes(path).codes())).tolist() == [2, 6, 7]
    path.write_text("record,class,name\n0,2,ground\n2,7,noise\n1,6,building\n")
    with pytest.raises(InputError, match="row 1 is record 2, expected 1; sort the rows by record"):
        list(open_codes(path).codes())


NAMED = ["ground", "Building", "car", "", "class 40", "low vegetation"]
NAMED_CODES = [2, 6, 65, -1, 40, 3]


@pytest.mark.parametrize("head", ["class", "record,x,class", "record;LABEL;y"])
def test_names_of_classes_in_text_are_codes(tmp_path, head):
    """The names stand in the column of the header that is no ``x``."""
    delimiter = ";" if ";" in head else ","
    kinds = head.split(delimiter)
    rows = [
        delimiter.join("7" if kind in "record,x,y" else name or '""' for kind in kinds)
        for name in NAMED
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    assert read(path) == NAMED_CODES


def test_names_of_classes_in_parquet_are_codes(tmp_path):
    names = pa.array([name or None for name in NAMED])
    for labels in (names, names.dictionary_encode()):
        assert read(write_parquet(tmp_path / "a.parquet", label=labels)) == NAMED_CODES


def test_unknown_names_of_classes_are_refused_with_the_known_ones(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("class\nground\nroof tile\n", encoding="utf-8")
    expected = (
        "a.csv: line 3: found the class name 'roof tile', expected a class code or one of: "
        "unclassified, ground"
    )
    assert refused(path).startswith(expected)
    assert refused(write_parquet(tmp_path / "b.parquet", label=["roof tile"])).startswith(
        "b.parquet: found the class name"
    )
