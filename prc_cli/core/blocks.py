"""Regroups blocks of any size into blocks of k lines with look-ahead; one buffer per scanner."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ExtraReturns, ReadTally, ScanBlock, cut

LOOK_AHEAD_SHOTS = 1
"""Shots needed beyond the next line: i + M + 1 of a line's last shot is in the line after it."""

MOST_WAITING = 1 << 26
"""Most shots buffered for one block; 255 lines of 250,000 shots need fewer."""


def look_ahead_lines(points_per_line: int) -> int:
    """Return the lines after a block with neighbours i + M + 1 and i + 4 (2019, eqs. 7, 8)."""
    reach = max(points_per_line + LOOK_AHEAD_SHOTS, 4)
    return -(-reach // points_per_line)


def regroup(
    blocks: Iterator[ScanBlock],
    lines_per_block: int | None = None,
    *,
    shots_per_block: int = 1 << 18,
    look_ahead: int | None = None,
) -> Iterator[ScanBlock]:
    """Cut a stream into blocks of ``lines_per_block`` lines, each with the lines that follow it."""

    def lines_of(points_per_line: int) -> tuple[int, int]:
        """Return the lines of a block, and the lines that follow it."""
        n_lines = lines_per_block
        if n_lines is None:
            n_lines = max(1, shots_per_block // points_per_line)
        return n_lines, look_ahead_lines(points_per_line) if look_ahead is None else look_ahead

    buffers: dict[int, LineBuffer] = {}
    for block in blocks:
        buffer = buffers.setdefault(block.scanner, LineBuffer())
        buffer.add(block)
        n_lines, ahead = lines_of(block.points_per_line)
        is_waiting = buffer.n_lines < n_lines + ahead
        if is_waiting and buffer.n_lines * block.points_per_line > MOST_WAITING:
            raise _too_wide(block.points_per_line, n_lines)
        while buffer.n_lines >= n_lines + ahead:
            yield buffer.take(n_lines, ahead)
        if block.is_last:
            yield from _rest(buffers.pop(block.scanner), n_lines, ahead)
    for scanner in sorted(buffers):
        buffer = buffers[scanner]
        yield from _rest(buffer, *lines_of(buffer.parts[0].points_per_line))


def _too_wide(points_per_line: int, lines_per_block: int) -> InputError:
    problem = (
        f"{lines_per_block} lines of {points_per_line} shots, expected at most {MOST_WAITING} "
        "shots in a block: a few kilobytes can claim as many"
    )
    hint = (
        "check the shots in a scan line (-M); if they are right, set fewer lines a block "
        "(prc.lines_per_block)"
    )
    return InputError("block of scan lines", problem, hint)


def _rest(buffer: LineBuffer, lines_per_block: int, ahead: int) -> Iterator[ScanBlock]:
    """Yield the remaining lines of a scanner; the last block has ``is_last`` set."""
    while buffer.n_lines:
        block = buffer.take(min(lines_per_block, buffer.n_lines), ahead)
        yield replace(block, is_last=not buffer.n_lines)


@dataclass(slots=True)
class LineBuffer:
    """Queue of lines of one scanner, waiting for a full block or for their labels."""

    parts: list[ScanBlock] = field(default_factory=list)
    n_lines: int = 0

    def add(self, block: ScanBlock) -> None:
        """Append lines."""
        if block.n_lines:
            self.parts.append(block)
            self.n_lines += block.n_lines

    def take(self, n_lines: int, ahead: int = 0) -> ScanBlock:
        """Remove ``n_lines`` lines; copy the ``ahead`` lines after them into ``next_m``."""
        block = join(self.take_parts(n_lines))
        following: list[NDArray[np.float32]] = []
        missing = ahead
        for part in self.parts:
            if not missing:
                break
            following.append(part.range_m[:missing])
            missing -= len(following[-1])
        empty = np.empty((0, block.points_per_line), np.float32)
        return replace(block, next_m=np.concatenate(following) if following else empty)

    def take_parts(self, n_lines: int) -> list[ScanBlock]:
        """Remove ``n_lines`` lines as a list of blocks; arrays are not joined."""
        taken: list[ScanBlock] = []
        left = n_lines
        while left:
            part = self.parts.pop(0)
            if part.n_lines > left:
                self.parts.insert(0, cut(part, left, part.n_lines))
                part = cut(part, 0, left)
            taken.append(part)
            left -= part.n_lines
        self.n_lines -= n_lines
        return taken


def join(parts: list[ScanBlock]) -> ScanBlock:
    """Join consecutive blocks of one scanner into one."""
    if len(parts) == 1:
        return parts[0]
    first_lines = np.cumsum([0] + [part.n_lines for part in parts[:-1]])
    extra = ExtraReturns(
        np.concatenate(
            [part.extra.line + np.int32(n) for part, n in zip(parts, first_lines, strict=True)]
        ),
        np.concatenate([part.extra.column for part in parts]),
        np.concatenate([part.extra.range_m for part in parts]),
        np.concatenate([part.extra.record for part in parts]),
        _join_field([part.extra.intensity for part in parts]),
    )
    tally = ReadTally()
    for part in parts:
        tally = tally + part.tally
    record = None
    # None means dense; one part with explicit indices makes all of them explicit
    if any(part.record is not None for part in parts):
        record = np.concatenate([part.records() for part in parts])
    return replace(
        parts[0],
        range_m=np.concatenate([part.range_m for part in parts]),
        record=record,
        time_s=_join_field([part.time_s for part in parts]),
        xyz_m=_join_field([part.xyz_m for part in parts]),
        intensity=_join_field([part.intensity for part in parts]),
        extra=extra,
        tally=tally,
        is_last=parts[-1].is_last,
    )


ArrayT = TypeVar("ArrayT", bound=NDArray[np.generic])


def _join_field(arrays: list[ArrayT | None]) -> ArrayT | None:
    # None unless every part has the field
    present = [array for array in arrays if array is not None]
    return np.concatenate(present) if len(present) == len(arrays) else None  # type: ignore[return-value]
