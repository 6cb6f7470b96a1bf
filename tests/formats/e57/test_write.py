"""Writing E57: our reader gives back the stream; failed runs leave no files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import OutputError
from prc_cli.core.stream import ExtraReturns, ScanBlock, StreamInfo
from prc_cli.formats.writing import open_stream_writer
from prc_cli.formats.writing.base import StreamItem, StreamShape
from prc_cli.formats.writing.record import Fingerprint, RunRecord
from prc_cli.jobs.classify import open_stream

M = 40


def block(first: int, seed: int, *, scanner: int = 0, further: bool = False) -> ScanBlock:
    rng = np.random.default_rng([seed, first])
    ranges = rng.uniform(1.0, 80.0, (6, M)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.3] = np.nan
    intensity = np.rint(rng.uniform(0.0, 65535.0, ranges.shape)).astype(np.float32)
    intensity[np.isnan(ranges)] = np.nan
    extra = ExtraReturns.none()
    if further:
        line, column = (index[::5].astype(np.int32) for index in np.nonzero(~np.isnan(ranges)))
        extra = ExtraReturns(line, column, ranges[line, column] * np.float32(0.75), np.full(len(line), -1))
    return ScanBlock(
        first,
        ranges,
        scanner=scanner,
        time_s=np.broadcast_to(np.arange(6.0)[:, None] + first, ranges.shape),
        angle_rad=np.linspace(-3.0, 3.0, M),
        intensity=intensity,
        extra=extra,
    )


def write(path: Path, blocks: list[ScanBlock], *, returns: bool = False) -> tuple[str, ...]:
    items = [StreamItem(each) for each in blocks]
    info = StreamInfo("made up", "test", M, None, None, down_rad=0.0)
    with open_stream_writer(path, StreamShape.of(items[0], info, scanners=False, returns=returns)) as writer:
        for item in items:
            writer.add_item(item)
        losses = writer.losses
        writer.finish(RunRecord({}, Fingerprint("made up", 0, ""), "test", M))
    return losses


def same(left: Any, right: Any) -> bool:
    return np.array_equal(left, right, equal_nan=True)


@pytest.mark.parametrize("further", [False, True])
def test_ranges_and_intensities_come_back_bit_for_bit(tmp_path: Path, further: bool) -> None:
    blocks = [block(first, 1, further=further) for first in (0, 6, 12)]
    assert write(tmp_path / "a.e57", blocks, returns=further) == ()
    before, after = join(blocks), join(list(open_stream(tmp_path / "a.e57").blocks()))
    assert same(before.range_m, after.range_m)
    assert same(before.intensity, after.intensity)
    assert same(np.sort(before.extra.range_m), np.sort(after.extra.range_m))
    assert len(after.extra) == (0 if not further else len(before.extra))
    # straight down is straight down
    assert after.xyz_m is not None
    assert before.angle_rad is not None
    height = -before.range_m * np.cos(before.angle_rad).astype(np.float32)
    assert same(np.isnan(after.xyz_m[..., 2]), np.isnan(before.range_m))
    assert np.nanmax(np.abs(after.xyz_m[..., 2] - height)) < 1e-4


def test_scanners_are_scans_and_their_numbers_a_loss(tmp_path: Path) -> None:
    blocks = [block(0, 4, scanner=3), block(6, 4, scanner=3), block(0, 5, scanner=9)]
    losses = write(tmp_path / "a.e57", blocks)
    assert losses == ("the numbers of the scanners (3, 9): scans are counted from 0",)
    after = list(open_stream(tmp_path / "a.e57").blocks())
    assert [each.scanner for each in after] == [0, 1]
    assert same(join(blocks[:2]).range_m, after[0].range_m)
    assert same(blocks[2].range_m, after[1].range_m)


def test_a_failed_run_leaves_nothing(tmp_path: Path) -> None:
    blocks = [block(0, 4, scanner=3), block(0, 5, scanner=9), block(6, 4, scanner=3)]
    with pytest.raises(OutputError, match="scanner 3 comes again after another"):
        write(tmp_path / "a.e57", blocks)
    assert list(tmp_path.iterdir()) == []
