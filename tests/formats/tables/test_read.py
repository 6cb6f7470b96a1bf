"""Arrays and Parquet files as columns of records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, parquet

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64
from prc_cli.formats.input import Input
from prc_cli.formats.tables.read import open_table


def columns(path: Path, *names: str) -> dict[str, F64]:
    source = open_table(path)
    assert source is not None
    chunks = list(source.chunks(names))
    assert [chunk.first_record for chunk in chunks] == np.cumsum(
        [0] + [chunk.n for chunk in chunks]
    )[:-1].tolist()
    assert source.n_records == sum(chunk.n for chunk in chunks)
    return {name: np.concatenate([chunk.values[name] for chunk in chunks]) for name in names}


def test_parquet(tmp_path: Path) -> None:
    table = pa.table(
        {"line": [1, 2], "name": ["a", "b"], "range_m": [1.5, None], "range": [7.0, 8.0]}
    )
    parquet.write_table(table, tmp_path / "a.parquet")
    source = open_table(tmp_path / "a.parquet")
    assert source is not None
    assert set(source.dimensions) == {"scan_line", "range", "range_m"}
    values = columns(tmp_path / "a.parquet", "range", "scan_line")
    np.testing.assert_array_equal(values["range"], [7, 8])
    np.testing.assert_array_equal(values["scan_line"], [1, 2])
    table = pa.table({"azimuth [gon]": [100.0, 200.0], "Range_mm": [1500, None]})
    parquet.write_table(table, tmp_path / "b.parquet")
    values = columns(tmp_path / "b.parquet", "range", "angle")
    np.testing.assert_allclose(values["range"], [1.5, np.nan])
    np.testing.assert_allclose(values["angle"], [np.pi / 2, np.pi])


def test_what_cannot_be_read(tmp_path: Path) -> None:
    assert open_table(tmp_path / "a.label") is None
    (tmp_path / "a.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="no whole Parquet file"):
        open_table(tmp_path / "a.parquet")
    np.savez(tmp_path / "a.npz", range_m=np.ones((4, 6)))
    with pytest.raises(
        ConfigError, match="no dimension 'time' in the file; it has: scan_line, range"
    ):
        columns(tmp_path / "a.npz", "time")


@pytest.mark.parametrize("compression", ["uncompressed", "lz4"])
def test_columns_are_read_by_their_usual_names(tmp_path: Path, compression: str) -> None:
    n = 100_000
    x = np.arange(n, dtype=np.float16)
    table = {
        "x": x,
        "y": x,
        "z": x,
        "laser_number": np.arange(n) % 32,
        "offset_ns": np.arange(n) * 1000,
        "name": ["a"] * n,
    }
    path = tmp_path / "sweep.feather"
    feather.write_feather(pa.table(table), path, compression=compression, chunksize=30_000)
    source = Input.of(path).records()
    assert source is not None
    assert source.n_records == n
    assert set(source.dimensions) == {"x", "y", "z", "ring", "time"}
    rule = source.facts.rule("lines")
    assert rule is not None
    assert rule.value == "rings"
    chunks = list(source.chunks(("time", "ring")))
    assert [chunk.first_record for chunk in chunks] == [0, 30_000, 60_000, 90_000]
    np.testing.assert_allclose(
        np.concatenate([chunk.values["time"] for chunk in chunks]), np.arange(n) * 1e-6
    )
    np.testing.assert_array_equal(
        np.concatenate([chunk.values["ring"] for chunk in chunks]), np.arange(n) % 32
    )


@pytest.mark.parametrize("n_bytes", [7, 500])
def test_what_is_cut_short_is_said_in_one_line(tmp_path: Path, n_bytes: int) -> None:
    path = tmp_path / "sweep.feather"
    feather.write_feather(pa.table({"x": np.arange(1000.0)}), path)
    path.write_bytes(path.read_bytes()[:n_bytes])
    with pytest.raises(InputError, match="no whole Feather file"):
        Input.of(path).records()


def test_a_ring_of_a_dictionary_is_a_number(tmp_path: Path) -> None:
    ring = pa.array(np.arange(100, dtype=np.uint8) % 32).dictionary_encode()
    table = pa.table({"x": np.arange(100.0), "ring": ring, "name": pa.array(["a"] * 100)})
    path = tmp_path / "sweep.feather"
    feather.write_feather(table, path)
    source = Input.of(path).records()
    assert source is not None
    (chunk,) = source.chunks(("ring",))
    np.testing.assert_array_equal(chunk.values["ring"], np.arange(100) % 32)


def test_version_1_of_feather_is_named(tmp_path: Path) -> None:
    path = tmp_path / "old.feather"
    path.write_bytes(b"FEA1" + bytes(100) + b"FEA1")
    with pytest.raises(InputError, match="a Feather file of version 1; write it in version 2"):
        Input.of(path).records()
