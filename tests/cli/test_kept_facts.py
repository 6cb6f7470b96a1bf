"""Outputs keep what the input says of its points.

Place, intensity, number; what cannot be kept is told.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import plyfile
import pytest

from tests.cli.conftest import Prc
from tests.formats.organised_files import grid_points, ptx_scan, turn_x
from tests.street import angles, street

IMAGE = street(80)
LINE, COLUMN = np.nonzero(np.isfinite(IMAGE))
RANGE = IMAGE[LINE, COLUMN]


def las(path: Path, version: str = "1.4") -> Path:
    header = laspy.LasHeader(point_format=6, version=version)
    header.scales = [0.001] * 3
    for name, kind in (("range", "f4"), ("scan_line", "u4"), ("column", "u4")):
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    points = laspy.LasData(header)
    angle = angles()[COLUMN]
    points.x = 0.2 * LINE
    points.y = RANGE * np.sin(angle)
    points.z = -RANGE * np.cos(angle)
    points["range"] = RANGE
    points["scan_line"] = LINE
    points["column"] = COLUMN
    points.return_number[:] = points.number_of_returns[:] = 1
    points.write(path)
    return path


def ply(path: Path, **changes: Any) -> Path:
    angle = angles()[COLUMN]
    values = {
        "x": 0.2 * LINE,
        "y": RANGE * np.sin(angle),
        "z": -RANGE * np.cos(angle),
        "range": RANGE,
    }
    values |= {
        "scan_line": LINE,
        "column": COLUMN,
        "intensity": np.linspace(0, 1, len(LINE)),
        **changes,
    }
    table = np.empty(
        len(LINE), [(name, "u4" if name in ("scan_line", "column") else "f8") for name in values]
    )
    for name, column in values.items():
        table[name] = column
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")]).write(path)
    return path


OPTIONS = (
    "--preset",
    "fused",
    "--set",
    "input.angle_start=0",
    "--set",
    "input.angle_step=2",
    "--set",
    "input.nadir=0",
)


def test_records_behind_the_count_of_the_header_are_a_warning(prc: Prc, tmp_path: Path) -> None:
    source = las(tmp_path / "few.las")
    data = bytearray(source.read_bytes())
    struct.pack_into("<Q", data, 247, 8000)
    source.write_bytes(data)
    result = prc(f"classify {source} {tmp_path}/o.npy -q", *OPTIONS)
    assert result.code == 4
    assert f"unread: {len(LINE) - 8000:,} whole records follow the 8,000" in result.err
    source.write_bytes(bytes(data[: -(len(LINE) - 8000) * 42]) + bytes(42 * 100))
    assert "unread" not in prc(f"classify {source} {tmp_path}/p.npy -q", *OPTIONS).err


@pytest.mark.parametrize(("version", "is_read"), [("1.5", True), ("1.9", False)])
def test_las_1_5_is_read_and_written(
    prc: Prc,
    tmp_path: Path,
    version: str,
    is_read: bool,
) -> None:
    source = las(tmp_path / "new.las", "1.5")
    output = tmp_path / "o.las"
    data = bytearray(source.read_bytes())
    data[25] = int(version[-1])
    source.write_bytes(data)
    result = prc(f"classify {source} {output} -q", *OPTIONS)
    if is_read:
        assert result.code in (0, 4), result.err
        assert str(laspy.read(output).header.version) == "1.5"
    else:
        assert "save it as LAS 1.4" in result.err


def test_intensities_from_0_to_1_keep_their_steps(prc: Prc, tmp_path: Path) -> None:
    result = prc("classify", ply(tmp_path / "a.ply"), tmp_path / "a.las", *OPTIONS)
    assert "intensities from 0 to 1 are written as 0 to 65535" in result.err
    written = np.asarray(laspy.read(tmp_path / "a.las").intensity)
    np.testing.assert_allclose(written / 65535, np.linspace(0, 1, len(LINE)), atol=1e-5)
    prc(
        "classify",
        ply(tmp_path / "b.ply", intensity=np.arange(len(LINE)) % 2),
        tmp_path / "b.las",
        "-q",
        *OPTIONS,
    )
    assert set(np.asarray(laspy.read(tmp_path / "b.las").intensity)) == {0, 1}


@pytest.mark.parametrize("value", [np.nan, 1e9])
def test_a_single_damaged_coordinate_is_counted(prc: Prc, tmp_path: Path, value: float) -> None:
    x = 0.2 * LINE
    x[5] = value
    result = prc("classify", ply(tmp_path / "a.ply", x=x), tmp_path / "a.las", *OPTIONS)
    assert result.code in (0, 4)
    assert "1 records have no usable x, y, z" in result.err
    points = laspy.read(tmp_path / "a.las")
    np.testing.assert_allclose(np.delete(np.asarray(points.x), 5), np.delete(x, 5), atol=1e-3)
    x[: len(x) // 2] = value
    result = prc("classify", ply(tmp_path / "b.ply", x=x), tmp_path / "b.las", "-q", *OPTIONS)
    assert result.code == 1


def test_points_of_static_scans_keep_their_place(prc: Prc, tmp_path: Path) -> None:
    points = grid_points(12, 30)
    turn = turn_x(180)
    text = ptx_scan(points, shift=(6500, 4500, 120)) + ptx_scan(
        points, rotation=turn, shift=(6540, 4500, 120)
    )
    (tmp_path / "two.ptx").write_text(text)
    result = prc(f"classify {tmp_path}/two.ptx {tmp_path}/two.las -q --preset prc-2019-urban")
    assert result.code in (0, 4), result.err
    written = laspy.read(tmp_path / "two.las")
    first = np.array([6500, 4500, 120])
    second = np.array([6540, 4500, 120])
    known = points[points[..., :3].any(axis=-1)][:, :3]
    expected = np.concatenate([known + first, known @ turn.T + second])
    np.testing.assert_allclose(np.asarray(written.xyz), expected, atol=2e-3)
    result = prc(f"convert {tmp_path}/two.ptx {tmp_path}/points.laz")
    assert "positions of the scans (6500, 4500, 120 m for the first)" in result.out + result.err


def test_clouds_keep_their_header_or_tell(prc: Prc, tmp_path: Path) -> None:
    shape = np.arange(IMAGE.size).reshape(IMAGE.shape)
    rows = np.full(
        IMAGE.size,
        np.nan,
        [("x", "f4"), ("y", "f4"), ("z", "f4"), ("range", "f4"), ("normal", "f4", 2)],
    )
    rows["x"] = 0.2 * (shape // IMAGE.shape[1]).ravel()
    rows["range"] = IMAGE.ravel()
    rows["y"] = (IMAGE * np.sin(angles())).ravel()
    rows["z"] = (-IMAGE * np.cos(angles())).ravel()
    head = (
        "VERSION 0.7\nFIELDS x y z range normal\nSIZE 4 4 4 4 4\nTYPE F F F F F\nCOUNT 1 1 1 1 2\n"
    )
    head += (
        f"WIDTH {IMAGE.shape[1]}\nHEIGHT {len(IMAGE)}\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS "
        f"{IMAGE.size}\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(head.encode() + rows.tobytes())
    result = prc(f"classify {tmp_path}/a.pcd {tmp_path}/b.pcd", *OPTIONS)
    assert result.code in (0, 4), result.err
    written = (tmp_path / "b.pcd").read_bytes()[:900].decode("latin-1").splitlines()
    assert {f"WIDTH {IMAGE.shape[1]}", f"HEIGHT {len(IMAGE)}", "VIEWPOINT 1 2 3 1 0 0 0"} <= set(
        written
    )
    assert "not kept: field normal as one field" in result.err


def test_other_elements_of_a_ply_are_told(prc: Prc, tmp_path: Path) -> None:
    cloud = plyfile.PlyData.read(ply(tmp_path / "points.ply"))
    source = tmp_path / "a.ply"
    camera = plyfile.PlyElement.describe(np.array([(1.0,)], [("focal", "f4")]), "camera")
    plyfile.PlyData([*cloud.elements, camera]).write(source)
    result = prc(f"classify {source} {tmp_path}/b.ply", *OPTIONS)
    assert "not kept: element camera" in result.err
