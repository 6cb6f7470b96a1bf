"""Feather files of points with a ring are frames of rings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather

from prc_cli.core.errors import InputError
from prc_cli.formats import open_source


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
    source = open_source(path)
    assert source is not None
    assert source.n_records == n
    assert set(source.dimensions) == {"x", "y", "z", "ring", "time"}
    rule = source.facts.rule("lines")
    assert rule is not None
    assert rule.value == "rings"
    chunks = list(source.chunks(("time", "ring")))
    assert [chunk.first_record for chunk in chunks] == [0, 30_000, 60_000, 90_000]
    np.testing.assert_allclose(np.concatenate([chunk.values["time"] for chunk in chunks]), np.arange(n) * 1e-6)
    np.testing.assert_array_equal(np.concatenate([chunk.values["ring"] for chunk in chunks]), np.arange(n) % 32)


@pytest.mark.parametrize("n_bytes", [7, 500])
def test_what_is_cut_short_is_said_in_one_line(tmp_path: Path, n_bytes: int) -> None:
    path = tmp_path / "sweep.feather"
    feather.write_feather(pa.table({"x": np.arange(1000.0)}), path)
    path.write_bytes(path.read_bytes()[:n_bytes])
    with pytest.raises(InputError, match="no whole Feather file"):
        open_source(path)
