"""How far a run is."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.cli.report import LineBar
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.window import Window
from prc_cli.jobs.progress import advance, share_done

INFO = StreamInfo("d.npy", "array", 8, 640, 80)


class Bar:
    """As a bar of tqdm."""

    def __init__(self) -> None:
        self.n = 0
        self.total: int | None = None

    def update(self, n: int) -> None:
        self.n += n


def block(first: int, n_lines: int = 20) -> ScanBlock:
    return ScanBlock(first, np.zeros((n_lines, 8), np.float32))


def test_the_end_follows_from_the_share() -> None:
    bar = Bar()
    listener = LineBar(bar)
    for first in (0, 20, 40, 60):
        advance(listener, block(first), INFO)
        assert bar.total == 80
    assert bar.n == 80
    # a second pass: the end is not known
    advance(listener, block(0), INFO)
    assert bar.total is None
    assert bar.n == 100


def test_listeners_that_count_lines_alone() -> None:
    heard: list[int] = []
    advance(heard.append, block(0), INFO)
    advance(None, block(0), INFO)
    assert heard == [20]


@pytest.mark.parametrize(
    ("window", "share"),
    [(Window("", True, 10, 50), 0.75), (Window("", True, 10), None), (Window("", False, 1.0, 2.0), None)],
)
def test_the_share_of_a_window(window: Window, share: float | None) -> None:
    assert share_done(block(20), INFO, window) == share


def test_what_is_not_known() -> None:
    assert share_done(block(20), StreamInfo("d.csv", "text", 8, None, None)) is None
    empty = ScanBlock(0, np.zeros((1, 8), np.float32), np.full((1, 8), -1))
    assert share_done(empty, INFO) is None
