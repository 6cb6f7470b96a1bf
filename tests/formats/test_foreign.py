"""Files of other programs: the message names the maker and an export that prc reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.formats.input import Input
from prc_cli.formats.outputs import stream_suffix


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.rxp", ("RIEGL", "RiSCAN PRO")),
        ("a.rdbx", ("RIEGL",)),
        ("a.zfs", ("Zoller+Fröhlich", "LaserControl", "E57")),
        ("a.fls", ("FARO", "SCENE", "E57")),
        ("a.LGS", ("Leica", "E57")),
        ("a.mat", ("MATLAB", "numpy.savez('a.npz'")),
        ("a b.feather", ("csv.write_csv(feather.read_table('a b.feather'), 'a b.csv')",)),
        ("scan000.3d", ("3DTK", "$1/100", "scan000.3d > scan000.csv")),
        ("a.xlsx", ("save the sheet as CSV",)),
        ("a b.zip", ("unzip", "'")),
        ("a.lvx2", ("Livox", "does not support")),
        ("a.sbet", ("--range trajectory:",)),
        ("a.osf", ("ouster-cli source",)),
        ("a.foo", ("rename the file or convert it",)),
    ],
)
def test_the_maker_and_the_export_are_named(
    tmp_path: Path, name: str, words: tuple[str, ...]
) -> None:
    path = tmp_path / name
    path.write_bytes(b"1234")
    with pytest.raises(InputError) as caught:
        Input.of(path).check()
    assert all(word in caught.value.hint for word in words)


def test_an_output_that_prc_no_longer_writes_has_a_hint() -> None:
    with pytest.raises(ConfigError, match=r"writes no E57: write \.laz for other programs"):
        stream_suffix(Path("station.e57"))
