"""Tests of what the records of a file hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import main
from prc_cli.formats import open_source
from prc_cli.formats.records import Contents, watched_contents


def counted(path: Path) -> Contents:
    source, found = open_source(path), Contents()
    assert source is not None
    for _ in watched_contents(source, found):
        pass
    return found


def test_counts_agree_with_laspy(real_data: Path) -> None:
    """Three strips of an airborne scan, as laspy reads them."""
    laspy = pytest.importorskip("laspy")
    path = real_data / "las" / "three_strips_edge_flags.laz"
    las, found = laspy.read(path), counted(path)
    for axis in "xyz":
        assert found.bounds_m[axis] == pytest.approx((las[axis].min(), las[axis].max()))
    assert found.time_s == pytest.approx((las.gps_time.min(), las.gps_time.max()))
    for told, values in ((found.classes, las.classification), (found.sources, las.point_source_id)):
        assert told == dict(
            zip(*map(np.ndarray.tolist, np.unique(np.asarray(values), return_counts=True)), strict=True)
        )
    both = (np.asarray(las.return_number) == 2) & (np.asarray(las.number_of_returns) == 3)
    assert found.returns["2 of 3"] == np.count_nonzero(both)
    assert found.is_registered


def test_text_with_gaps(tmp_path: Path) -> None:
    """Empty cells count nowhere; the first name of a class that is there counts."""
    path = tmp_path / "a.csv"
    path.write_text(
        "line,column,range,x,y,z,time,label\n0,0,5,1,-2,3,10,2\n0,1,5,,,,11,\n1,0,5,4,2,1,12,2\n1,1,5,0,0,0,13,6\n"
    )
    found = counted(path)
    assert found.bounds_m == {"x": (0, 4), "y": (-2, 2), "z": (0, 3)}
    assert (found.time_s, found.classes, found.returns, found.sources) == ((10, 13), {2: 2, 6: 1}, {}, {})
    assert found.is_registered is False


@pytest.mark.parametrize(
    ("x", "y", "is_registered"),
    [
        ([0, 300], [0, 0], False),
        ([0, 301], [0, 0], True),
        ([0, 0], [-2001, -1990], True),
        ([1900, 2000], [0, 1], False),
    ],
)
def test_coordinates_beyond_a_scanner_are_registered(x: list[float], y: list[float], is_registered: bool) -> None:
    found = Contents()
    assert found.is_registered is None
    found.see({"x": np.array(x, float), "y": np.array(y, float)})
    assert found.is_registered is is_registered


def test_info_tells_them(real_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = real_data / "las" / "three_strips_edge_flags.laz"
    with pytest.raises(SystemExit):
        main(["info", str(path)])
    told = " ".join(capsys.readouterr().out.split())
    assert "CRS EPSG:3005" in told
    assert "x 885,022.37 to 885,210.15, y 629,157.18 to 629,399.99, z 325.83 to 358.28 m: registered" in told
    assert "1 unclassified: 482,933, 2 ground: 48,729" in told
    assert "66: 90,936, 67: 190,270, 68: 250,456" in told
    with pytest.raises(SystemExit):
        main(["info", str(path), "--json"])
    assert json.loads(capsys.readouterr().out)["contents"]["point_source_ids"]["66"] == 90_936


def test_info_names_codes_as_the_file_does_and_sorts_returns_by_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=6, file_version="1.4")
    las.x, las.y, las.z = (np.arange(12.0),) * 3
    las.classification = np.array([2, 65] * 6)
    las.return_number, las.number_of_returns = np.array([2, 10] * 6), np.full(12, 10)
    names = b"".join(bytes([code]) + name.ljust(15, b"\0") for code, name in ((65, b"lorry"), (2, b"not this")))
    las.vlrs.append(laspy.VLR("LASF_Spec", 0, "", names))
    las.write(tmp_path / "a.las")
    with pytest.raises(SystemExit):
        main(["info", str(tmp_path / "a.las")])
    told = " ".join(capsys.readouterr().out.split())
    assert "2 ground: 6, 65 lorry: 6" in told
    assert "2 of 10: 6, 10 of 10: 6" in told
