"""Reports the progress of a run: finished lines, and the share of the input if it is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.window import Window


@runtime_checkable
class Reached(Protocol):
    """A listener that also wants the share of the input that is done."""

    def reached(self, share: float) -> None:
        """Receive the share, above 0 and at most 1."""


def advance(
    progress: Callable[[int], object] | None,
    block: ScanBlock,
    info: StreamInfo,
    window: Window | None = None,
) -> None:
    """Report that the lines of a block are finished."""
    if progress is None:
        return
    report_share(progress, share_done(block, info, window))
    progress(block.n_lines)


def report_share(progress: object, share: float | None) -> None:
    """Report the share to a listener that wants it; None = not known."""
    if isinstance(progress, Reached) and share is not None:
        progress.reached(share)


def share_done(block: ScanBlock, info: StreamInfo, window: Window | None = None) -> float | None:
    """Return the share of the input that is done after a block, above 0 and at most 1.

    None = not known.
    """
    done = block.first_line + block.n_lines
    if window is not None:
        if not window.in_lines or not math.isfinite(window.stop):
            return None
        return min((done - window.first) / (window.stop - window.first), 1.0)
    if not info.n_records:
        return None
    last = (
        done * block.points_per_line
        if block.record is None
        else int(block.record.max(initial=-1)) + 1
    )
    return min(last / info.n_records, 1.0) if last > 0 else None
