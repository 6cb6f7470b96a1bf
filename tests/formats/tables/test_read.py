"""Arrays and Parquet files as columns of records."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64
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


def test_parquet(tmp_path):
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


def test_what_cannot_be_read(tmp_path):
    assert open_table(tmp_path / "a.label") is None
    (tmp_path / "a.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="no whole Parquet file"):
        open_table(tmp_path / "a.parquet")
    np.savez(tmp_path / "a.npz", range_m=np.ones((4, 6)))
    with pytest.raises(
        ConfigError, match="no dimension 'time' in the file; it has: scan_line, range"
    ):
        columns(tmp_path / "a.npz", "time")
