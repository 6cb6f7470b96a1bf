"""Outputs keep what the input says of its points.

Place, intensity, number; what cannot be kept is told.
"""

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import plyfile

from tests.formats import cloud_files
from tests.formats.organised_files import grid_points, ptx_scan, turn_x
from tests.street import angles, street

IMAGE = street(80)
LINE, COLUMN = np.nonzero(np.isfinite(IMAGE))
RANGE = IMAGE[LINE, COLUMN]


ANGLE = angles()[COLUMN]
POINTS = {
    "x": 0.2 * LINE,
    "y": RANGE * np.sin(ANGLE),
    "z": -RANGE * np.cos(ANGLE),
    "range": RANGE,
    "scan_line": LINE.astype(np.uint32),
    "column": COLUMN.astype(np.uint32),
}


def ply(path: Path, **changes: Any) -> Path:
    intensity = np.linspace(0, 1, len(LINE))
    path.write_bytes(cloud_files.ply({**POINTS, "intensity": intensity, **changes}))
    return path


OPTIONS = "--preset fused --set input.angle_start=0 --set input.angle_step=2 --set input.nadir=0"


def test_points_of_static_scans_keep_their_place(prc, tmp_path):
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


def test_other_elements_of_a_ply_are_told(prc, tmp_path):
    cloud = plyfile.PlyData.read(ply(tmp_path / "points.ply"))
    source = tmp_path / "a.ply"
    camera = plyfile.PlyElement.describe(np.array([(1.0,)], [("focal", "f4")]), "camera")
    plyfile.PlyData([*cloud.elements, camera]).write(source)
    result = prc(f"classify {source} {tmp_path}/b.ply {OPTIONS}")
    assert "not kept: element camera" in result.err


def test_intensities_keep_their_steps_and_damage_costs_one_place(prc, tmp_path):
    x = 0.2 * LINE
    x[5] = 1e9
    assert prc(f"classify {ply(tmp_path / 'a.ply', x=x)} {tmp_path}/a.las {OPTIONS}").code in (0, 4)
    written = laspy.read(tmp_path / "a.las")
    np.testing.assert_allclose(written.intensity / 65535, np.linspace(0, 1, len(LINE)), atol=1e-5)
    np.testing.assert_allclose(np.delete(written.x, 5), np.delete(x, 5), atol=1e-3)
