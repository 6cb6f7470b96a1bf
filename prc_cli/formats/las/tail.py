"""What follows the points of a LAS file: which spans are copied, and where they come to lie."""

from __future__ import annotations

from dataclasses import dataclass

from prc_cli.formats.las.file import LasFile, damaged


@dataclass(frozen=True, slots=True)
class Tail:
    """Spans of the input that follow the points of the output."""

    spans: tuple[tuple[int, int], ...]
    """First byte and end of every span of the input, in order."""
    start: int
    """First byte behind the points of the output."""
    evlr_start: int
    """First EVLR of the output; 0 = none."""
    n_evlrs: int
    """EVLRs of the output."""

    def moved(self, position: int) -> int:
        """Return where a byte of the input lies in the output; the same number where it is not copied.

        >>> Tail(((100, 120), (150, 160)), 300, 0, 0).moved(155)
        325
        """
        at = self.start
        for first, stop in self.spans:
            if first <= position < stop:
                return at + position - first
            at += stop - first
        return position


def plan_tail(las: LasFile, bounds: tuple[int, int], start: int, drop: tuple[str, ...]) -> Tail:
    """Plan the copy of everything behind the points, without the EVLRs of some user ids.

    Parameters
    ----------
    las : LasFile
    bounds : (int, int)
        First byte behind the points of the input, and its end.
    start : int
        First byte behind the points of the output.
    drop : tuple of str
        User ids of EVLRs to leave out.

    Raises
    ------
    InputError
        When an EVLR begins inside the points.
    """
    cursor, end = bounds
    if las.evlrs and las.evlrs[0].start < cursor:
        problem = f"found the first EVLR at byte {las.evlrs[0].start}, expected it behind the points (byte {cursor})"
        raise damaged(las.path, "byte 235", problem)
    spans: list[tuple[int, int]] = []
    kept = [evlr for evlr in las.evlrs if evlr.key[0] not in drop]
    for evlr in las.evlrs:
        if evlr not in kept:
            _add(spans, cursor, evlr.start)
            cursor = evlr.start + evlr.size
    _add(spans, cursor, max(cursor, end))
    tail = Tail(tuple(spans), start, 0, len(kept))
    return Tail(tail.spans, start, tail.moved(kept[0].start) if kept else 0, len(kept))


def _add(spans: list[tuple[int, int]], first: int, stop: int) -> None:
    if stop > first:
        spans.append((first, stop))
