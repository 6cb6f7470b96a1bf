"""Round trips: a stream written in another format and read back is the same stream, as far as the
format holds it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.blocks import join
from prc_cli.core.errors import OutputError
from prc_cli.core.stream import ScanBlock
from prc_cli.jobs.classify import open_stream
from prc_cli.jobs.convert import convert
from tests.clouds import write_las

BY_SOURCE = load_config(options={"input": {"scanner": "point_source_id"}})


def scans(path: Path) -> dict[int, ScanBlock]:
    """Every scanner's lines as one block."""
    parts: dict[int, list[ScanBlock]] = {}
    for block in open_stream(path, BY_SOURCE).blocks():
        parts.setdefault(block.scanner, []).append(block)
    return {scanner: join(blocks) for scanner, blocks in parts.items()}


def same_bits(left: Any, right: Any) -> bool:
    kind = {4: np.uint32, 8: np.uint64}[left.dtype.itemsize]
    gone = np.isnan(left)
    same = (left.view(kind) == right.view(kind)) | gone
    return bool(np.array_equal(gone, np.isnan(right)) and same.all())


def two_scanners(path: Path) -> Path:
    """Two scanners of different M, a missing line, gaps, and shots of several returns.

    Interleaved in the file.
    """
    rng = np.random.default_rng(7)
    rows = []
    for line in range(12):
        for scanner, m in ((3, 20), (8, 33)):
            if line == 5:
                continue
            for column in range(m):
                time = 100.0 + line + column / 64
                n = int(rng.integers(0, 4)) if 0 < column < m - 1 else 1
                distances = np.sort(rng.uniform(2.0, 60.0, n).astype(np.float32))
                for number, distance in enumerate(distances, 1):
                    strength = int(rng.integers(1, 60_000))
                    rows.append(
                        (time, line, column, distance, scanner, number, n, strength, column % 7)
                    )
    time_s, *cells, source, number, n_returns, intensity, code = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    line, column, range_m = (
        values.astype(kind) for values, kind in zip(cells, ("u4", "u4", "f4"), strict=True)
    )
    xyz = np.stack([500_000.0 + range_m, 6_860_000.0 + column, -range_m / 3], axis=1)
    return write_las(
        path,
        xyz,
        code,
        extra={"range": range_m, "scan_line": line, "column": column},
        gps_time=time_s,
        point_source_id=source,
        return_number=number,
        number_of_returns=n_returns,
        intensity=intensity,
    )


@pytest.mark.parametrize("suffix", [".csv", ".laz"])
def test_scanners_missing_lines_and_further_returns(tmp_path: Path, suffix: str) -> None:
    source = two_scanners(tmp_path / "two.las")
    out = tmp_path / f"out{suffix}"
    if suffix == ".laz":  # through a table, since LAS to LAS copies bytes
        convert(source, tmp_path / "two.csv", BY_SOURCE)
        source = tmp_path / "two.csv"
    summary = convert(source, out, BY_SOURCE)
    assert any("--scanner point_source_id" in notice for notice in summary.record.notices)
    before = scans(source)
    after = scans(out)
    assert sorted(before) == sorted(after) == [3, 8]
    for scanner, block in before.items():
        m = block.points_per_line
        again = after[scanner].range_m[:, :m]
        assert same_bits(block.range_m, np.ascontiguousarray(again))
        assert np.isnan(again[5]).all()
        assert np.isnan(after[scanner].range_m[:, m:]).all()
        for name in ("line", "column", "range_m"):
            order = [
                np.lexsort((b.extra.range_m, b.extra.column, b.extra.line))
                for b in (block, after[scanner])
            ]
            left = getattr(block.extra, name)
            right = getattr(after[scanner].extra, name)
            assert np.array_equal(left[order[0]], right[order[1]])
        assert after[scanner].points_per_line == m
    is_reported = any("scanner 3: 20, scanner 8: 33" in loss for loss in summary.losses)
    assert is_reported == (suffix == ".laz")


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".bin"])
def test_several_scanners_need_a_format_that_tells_them_apart(tmp_path: Path, suffix: str) -> None:
    source = two_scanners(tmp_path / "two.las")
    with pytest.raises(
        OutputError, match="found scanners 3 and 8, expected one: .* write .csv, .laz or .parquet"
    ):
        convert(source, tmp_path / f"out{suffix}", BY_SOURCE)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["two.las"]
