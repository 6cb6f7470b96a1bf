from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.stream import LabelledBlock
from prc_cli.formats.las import laz as codec_module
from prc_cli.formats.writing.columns import SPACING_M
from tests.formats.common import FOREST, labelled, random_labels, write

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


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_bytes_do_not_depend_on_blocks_or_batches(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks, ranges, labels = stream()
    write(tmp_path / f"a{suffix}", SOURCE, blocks)
    monkeypatch.setattr(codec_module, "_BATCH_RECORDS", M)
    write(tmp_path / f"b{suffix}", SOURCE, [labelled(labels, range_m=ranges)])
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
