"""A window of a stream: what it counts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.core.window import parse_window
from prc_cli.streams.open import WindowedStream


@dataclass
class ReadsAhead:
    """Two blocks of ten lines of eight shots; all records are read with the first one."""

    info: StreamInfo = field(default_factory=lambda: StreamInfo("d.npy", "array", 8, 160, 20))

    def blocks(self) -> Iterator[ScanBlock]:
        for first, n_read in ((0, 160), (10, 0)):
            tally = ReadTally(n_records=n_read)
            yield ScanBlock(first, np.ones((10, 8), np.float32), tally=tally, is_last=first > 0)


@pytest.mark.parametrize(("lines", "n_lines"), [("0:10", 10), ("0:12", 12), ("3:20", 17), (":", 20)])
def test_records_of_the_window_are_counted_and_no_others(lines: str, n_lines: int) -> None:
    window = parse_window(lines, None, None)
    assert window is not None
    blocks = list(WindowedStream(ReadsAhead(), window).blocks())
    assert sum(block.n_lines for block in blocks) == n_lines
    assert sum(block.tally.n_records for block in blocks) == 8 * n_lines
    assert [block.is_last for block in blocks] == [False] * (len(blocks) - 1) + [True]
