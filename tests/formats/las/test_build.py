from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.stream import ExtraReturns, LabelledBlock
from prc_cli.formats.las import laz as codec_module
from prc_cli.formats.writing.columns import OutputConfig
from prc_cli.formats.writing.coordinates import SPACING_M
from tests.formats.common import (
    FOREST,
    labelled,
    random_labels,
    write,
)

SOURCE = Path("drive.bin")
LINES, M = 12, 30


def stream(seed: int = 0, **fields: Any) -> tuple[list[LabelledBlock], np.ndarray, np.ndarray]:
    """Blocks of five lines (the last shorter), their ranges and labels."""
    rng = np.random.default_rng(seed)
    ranges = (rng.random((LINES, M)) * 80 + 0.1).astype(np.float32)
    ranges[rng.random((LINES, M)) < 0.3] = np.nan
    labels = random_labels(LINES * M, FOREST).reshape(LINES, M)
    labels[np.isnan(ranges)] = Label.MISSING
    blocks = []
    for first in range(0, LINES, 5):
        rows = slice(first, first + 5)
        own = {name: value if name in ("angle_rad", "scanner") else value[rows] for name, value in fields.items()}
        blocks.append(labelled(labels[rows], first_line=first, range_m=ranges[rows], **own))
    return blocks, ranges, labels


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_record_for_every_return_in_order(tmp_path: Path, suffix: str) -> None:
    angle = np.linspace(-np.pi, np.pi, M, endpoint=False)
    blocks, ranges, labels = stream(angle_rad=angle)
    record = write(tmp_path / f"a{suffix}", SOURCE, blocks)
    las = laspy.read(tmp_path / f"a{suffix}")
    line, column = np.nonzero(~np.isnan(ranges))
    own = ranges[line, column]
    assert (las.header.version.minor, las.point_format.id) == (4, 6)
    assert las["range"].tobytes() == own.tobytes()
    assert np.array_equal(las["scan_line"], line)
    assert np.array_equal(las["column"], column)
    assert np.array_equal(las.classification, ClassCodes().lookup()[labels[line, column]])
    assert np.allclose(las.x, own * np.cos(angle[column]), atol=0.0005001)
    assert np.allclose(las.y, own * np.sin(angle[column]), atol=0.0005001)
    assert np.allclose(
        las.z, line * SPACING_M, atol=0.0005001
    )  # lines that nobody knows upright lie one above the other
    assert np.allclose(las.scan_angle * 0.006, np.rad2deg(angle[column]), atol=0.0031)
    assert np.all(las.return_number == 1)
    assert np.all(las.number_of_returns == 1)
    assert any("r cos(angle)" in text for text in record.notices)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_header_counts_bounds_and_record(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    blocks, ranges, _ = stream()
    write(path, SOURCE, blocks)
    las = laspy.read(path)
    assert las.header.point_count == np.count_nonzero(~np.isnan(ranges)) == las.header.number_of_points_by_return[0]
    for number in range(3):
        assert las.header.mins[number] == pytest.approx(las.xyz[:, number].min(), abs=1e-9)
        assert las.header.maxs[number] == pytest.approx(las.xyz[:, number].max(), abs=1e-9)
    assert las.header.global_encoding.wkt
    assert [(item.user_id, item.record_id) for item in las.evlrs] == [("prc-cli", 1)]
    beside = json.loads((tmp_path / f"a{suffix}.prc.json").read_bytes())
    assert beside.pop("output")["size"] == path.stat().st_size
    assert json.loads(las.evlrs[0].record_data) == beside


def test_xyz_time_intensity_and_scanner(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    xyz = rng.normal(0, 50, (LINES, M, 3)).astype(np.float32)
    time = rng.random((LINES, M)) * 1e9
    time[0, :] = np.nan
    intensity = rng.random((LINES, M)).astype(np.float32) * 80_000 - 100
    blocks, ranges, _ = stream(xyz_m=xyz, time_s=time, intensity=intensity, scanner=3)
    record = write(tmp_path / "a.laz", SOURCE, blocks)
    las = laspy.read(tmp_path / "a.laz")
    at = np.nonzero(~np.isnan(ranges))
    assert np.allclose(las.xyz, xyz[at], atol=0.00051)
    assert np.array_equal(las.gps_time, np.nan_to_num(time[at]))
    assert np.array_equal(las.intensity, np.clip(np.rint(intensity[at]), 0, 65535))
    assert np.all(las.point_source_id == 3)
    n_first = np.count_nonzero(at[0] == 0)
    assert f"{n_first} records have no time; their gps_time is 0" in record.notices
    assert any("intensities lie outside 0 to 65535 and were clipped" in text for text in record.notices)


def test_further_returns_stand_with_their_shot_by_range(tmp_path: Path) -> None:
    ranges = np.array([[10, 20, np.nan], [30, np.nan, 40]], np.float32)
    labels = np.where(np.isnan(ranges), 0, 3).astype(np.uint8)
    extra = ExtraReturns(
        np.array([1, 0, 0], np.int32),
        np.array([0, 1, 1], np.int32),
        np.array([35, 25, 5], np.float32),
        np.array([9, 8, 7], np.int64),
    )
    xyz = np.zeros((2, 3, 3), np.float32)
    xyz[..., 2] = -ranges
    block = labelled(
        labels, range_m=ranges, extra=extra, extra_labels=np.array([2, 4, 5], np.uint8), first_line=4, xyz_m=xyz
    )
    write(tmp_path / "a.las", SOURCE, [block], options=OutputConfig(segment_ids=True))
    las = laspy.read(tmp_path / "a.las")
    assert las["range"].tolist() == [10, 5, 20, 25, 30, 35, 40]
    assert las["scan_line"].tolist() == [4, 4, 4, 4, 5, 5, 5]
    assert np.asarray(las.return_number).tolist() == [1, 1, 2, 3, 1, 2, 1]
    assert np.asarray(las.number_of_returns).tolist() == [1, 3, 3, 3, 2, 2, 1]
    assert np.asarray(las.classification).tolist() == [2, 5, 2, 6, 2, 7, 2]
    assert np.asarray(las.z).tolist() == [-10, -5, -20, -25, -30, -35, -40]
    assert las.header.number_of_points_by_return[:3].tolist() == [4, 2, 1]


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_bytes_do_not_depend_on_blocks_or_batches(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks, ranges, labels = stream()
    write(tmp_path / f"a{suffix}", SOURCE, blocks)
    monkeypatch.setattr(codec_module, "_BATCH_RECORDS", M)
    write(tmp_path / f"b{suffix}", SOURCE, [labelled(labels, range_m=ranges)])
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
