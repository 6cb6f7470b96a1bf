"""``prc evaluate`` on the command line: files of every format, folders, gates, errors."""

from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.cli.conftest import Result
from tests.formats.las.lasbytes import make_las

Prc = Callable[..., Result]


@pytest.fixture
def prc(prc):
    """Run ``prc evaluate``."""
    return lambda line, *arguments: prc(f"evaluate {line}", *arguments)


def test_lengths_are_compared_before_anything_is_read(prc, tmp_path, monkeypatch):
    """Equal labels take no bytes in a table: a small file may hold any number."""
    np.save(tmp_path / "r.npy", np.full(8, 2, np.uint8))
    pq.write_table(pa.table({"class": np.full(9, 2, np.uint8)}), tmp_path / "p.parquet")
    monkeypatch.setattr(
        "prc_cli.formats.tables.read.read_batches", lambda *arguments: pytest.fail("it is read")
    )
    code, _, err = prc(f"{tmp_path}/p.parquet {tmp_path}/r.npy --mapping prc")
    assert code == 1
    assert "9 records, but" in err


TREES = {
    "x,y,radius\nnan,1,1\n": "row 1: a number that is not finite",
    "x,y,radius\n1,1,1\n1,1,-2\n": "row 2: a number that is not finite, or a width below 0",
    'x,y,radius\n"' + "1" * 200_000 + '",1,1\n': "field larger than field limit",
}
AREAS = {
    "[" * 100_000: "no GeoJSON",
    '{"type":"Polygon","coordinates":[[[1' + "0" * 400 + ",0],[1,0],[1,1],[0,0]]]}": "no GeoJSON",
    '{"type":"Polygon","coordinates":[[[NaN,0],[1,0],[1,1],[NaN,0]]]}': "no GeoJSON",
}


@pytest.mark.parametrize(
    "option, name, text, message",
    [
        *(("--trees", "t.csv", text, message) for text, message in TREES.items()),
        *(("--inside", "a.geojson", text, message) for text, message in AREAS.items()),
    ],
)
def test_odd_trees_and_areas_are_refused_in_one_line(
    prc,
    tmp_path,
    option,
    name,
    text,
    message,
):
    make_las(tmp_path / "a.las", 6, n=20)
    (tmp_path / name).write_text(text)
    code, _, err = prc(
        f"{tmp_path}/a.las {tmp_path}/a.las --match nearest {option} {tmp_path}/{name}"
    )
    assert code == 1
    assert message in err
    assert err.count("\n") == 1
