"""Shared parts of PTX and E57: memory independent of file size, poses."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised import e57_read, ptx
from prc_cli.streams.open import open_input
from tests.formats.organised_files import (
    Scan,
    e57_fields,
    grid_points,
    ptx_scan,
    reordered,
    turn_x,
    write_e57,
    write_text,
)


def peak_bytes(path: Path) -> int:
    """Most memory held while a file is opened and read."""
    tracemalloc.start()
    try:
        assert sum(block.n_lines for block in open_input(path, InputConfig()).blocks()) > 0
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", ["ptx", "e57", "e57 row by row"])
def test_memory_does_not_grow_with_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setattr("prc_cli.formats.organised.scans.CHUNK_SHOTS", 2048)
    monkeypatch.setattr(e57_read, "CHUNK_POINTS", 1024)
    monkeypatch.setattr(ptx, "BLOCK_BYTES", 1 << 15)
    peaks = []
    for n_lines in (100, 100, 1000):  # the first one imports
        points = grid_points(n_lines, 64)
        fields = e57_fields(points)
        if kind == "ptx":
            path = write_text(tmp_path / "a.ptx", ptx_scan(points, rotation=turn_x(2)))
        elif kind == "e57":
            path = write_e57(tmp_path / "a.e57", [Scan(fields)])
        else:
            order = np.lexsort((fields["columnIndex"], fields["rowIndex"]))
            path = write_e57(tmp_path / "a.e57", [Scan(reordered(fields, order))])
        peaks.append(peak_bytes(path))
    assert peaks[2] < 1.3 * peaks[1] + 50_000
