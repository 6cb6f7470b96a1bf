"""Raw dumps: any layout, any chunks, and every way a file can be cut short."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import RANGES_ONLY, Layout, LayoutField
from prc_cli.formats.raw_binary.read import RawBinarySource

WIDE = Layout(
    header_bytes=5,
    endian="big",
    record_bytes=24,
    fields=(
        LayoutField(name="flags", type="u1"),
        LayoutField(name="range", type="u4", scale=0.001, missing=0),
        LayoutField(name="angle", type="f4", unit="deg"),
        LayoutField(name="time", type="f8"),
        LayoutField(name="column", type="u2"),
    ),
)


def wide_records(n: int) -> np.ndarray[Any, Any]:
    """Records of the layout WIDE, written field by field, with rubbish in the padding."""
    rng = np.random.default_rng(4)
    fields = [
        ("flags", "u1"),
        ("range", ">u4"),
        ("angle", ">f4"),
        ("time", ">f8"),
        ("column", ">u2"),
        ("pad", "S5"),
    ]
    records = np.zeros(n, fields)
    records["flags"] = rng.integers(0, 255, n)
    records["range"] = rng.integers(0, 3, n) * 1500
    records["angle"] = rng.uniform(-90, 90, n)
    records["time"] = np.arange(n) * 0.25
    records["column"] = np.arange(n) % 7
    records["pad"] = b"\xff\xff\xff\xff\xff"
    return records


def read(source: RawBinarySource, *names: str) -> dict[str, np.ndarray[Any, Any]]:
    chunks = list(source.chunks(names))
    assert [chunk.first_record for chunk in chunks] == list(
        np.cumsum([0] + [c.n for c in chunks])[:-1]
    )
    assert all(chunk.record is None and set(chunk.values) == set(names) for chunk in chunks)
    assert all(len(array) == chunk.n for chunk in chunks for array in chunk.values.values())
    return {name: np.concatenate([chunk.values[name] for chunk in chunks]) for name in names}


@pytest.mark.parametrize("chunk", [1, 3, 50, 1000])
def test_every_field_of_a_layout_in_chunks_of_any_size(tmp_path: Path, chunk: int) -> None:
    path = tmp_path / "wide.raw"
    records = wide_records(50)
    path.write_bytes(b"HEAD\n" + records.tobytes())
    source = RawBinarySource(path, WIDE, chunk)
    assert source.n_records == 50
    assert source.dimensions == ("range", "column", "angle", "time", "flags")
    assert source.format == "raw binary"
    values = read(source, "time", "range", "angle", "column", "flags")
    stored = records["range"].astype(np.float64)
    np.testing.assert_array_equal(values["range"], np.where(stored == 0, np.nan, stored * 0.001))
    np.testing.assert_array_equal(values["angle"], np.deg2rad(records["angle"].astype(np.float64)))
    np.testing.assert_array_equal(values["time"], records["time"])
    np.testing.assert_array_equal(values["column"], records["column"])
    np.testing.assert_array_equal(values["flags"], records["flags"])


def test_fat_records_make_short_chunks(tmp_path: Path) -> None:
    path = tmp_path / "fat.raw"
    path.write_bytes(b"\0" * (3 << 20))
    layout = Layout(record_bytes=1 << 20, fields=(LayoutField(name="range"),))
    source = RawBinarySource(path, layout)
    assert source.body.n_at_once == 16
    assert source.n_records == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty (0 bytes), expected records of 24 bytes"),
        (b"HEA", "found 3 bytes, fewer than the header of 5 bytes; check layout.header_bytes"),
        (b"HEAD\n", "no bytes follow the header of 5 bytes, expected records of 24 bytes"),
        (b"HEAD\n" + bytes(23), "byte 5 (record 0): found 23 bytes, expected a record of 24 bytes"),
        (
            b"HEAD\n" + bytes(24 * 3 + 1),
            "byte 77 (record 3): found 1 bytes, expected a record of 24 bytes",
        ),
    ],
)
def test_short_files_are_refused_when_opened(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "short.raw"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        RawBinarySource(path, WIDE)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)


def test_a_file_that_shrinks_while_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "shrinks.bin"
    np.arange(1, 11, dtype=np.float32).tofile(path)
    source = RawBinarySource(path, RANGES_ONLY, 4)
    chunks = source.chunks(("range",))
    next(chunks)
    path.write_bytes(path.read_bytes()[:25])
    with pytest.raises(InputError) as caught:
        list(chunks)
    assert "byte 24 (record 6): the file ends, expected 10 records as when opened" in str(
        caught.value
    )
