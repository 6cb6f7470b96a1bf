"""A LAZ file that is cut short between opening and reading."""

from __future__ import annotations

from pathlib import Path

import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.las.read import LasSource
from tests.formats.las.lasbytes import make_las


@pytest.mark.parametrize("left", [1.0 / 2, 0.99, 0.999])
def test_it_is_refused_in_one_line(tmp_path: Path, left: float) -> None:
    path = tmp_path / "drive.laz"
    make_las(path, 6, n=3000, raw_points=True)
    source = LasSource(path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * left)])
    with pytest.raises(InputError, match=r"drive\.laz"):
        for _ in source.chunks(("x",)):
            pass


def test_the_table_itself_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "drive.laz"
    make_las(path, 6, n=3000, raw_points=True)
    whole, source = path.read_bytes(), LasSource(path)
    for n_bytes in range(len(whole) - 20, len(whole)):
        path.write_bytes(whole[:n_bytes])
        with pytest.raises(InputError, match=r"drive\.laz"):
            list(source.chunks(("x",)))
