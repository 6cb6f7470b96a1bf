"""Check of lines that come twice, as where two copies of a part of a recording were joined.

Ranges carry noise, so two lines of a real scan are never equal bit for bit.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import U64

COLUMNS = 64
"""Columns that stand for a line, even over it."""
LEAST_VALUES = 32
"""Fewer ranges, or fewer different ones, do not stand for a line."""
MOST_KEPT = 1 << 15
"""Lines that are remembered; of longer streams only each second, fourth, ... as its digits say."""
MOST_TIMES = 4
"""Lines that are equal more often belong to a standing scanner without noise, as in a simulation."""
LEAST_REPEATED = 8
"""Fewer repeated lines are not told."""
_ODD = np.random.default_rng(20).integers(0, 1 << 62, COLUMNS).astype(np.uint64) * np.uint64(2) + np.uint64(1)
_MIX = np.uint64(0x9E3779B97F4A7C15)


def digests(block: ScanBlock) -> U64:
    """Return a number for every line that has enough ranges, equal for equal lines, (n,) uint64."""
    step = max(block.points_per_line // COLUMNS, 1)
    values = np.ascontiguousarray(block.range_m[:, : step * COLUMNS : step])
    ordered = np.sort(values, axis=1)
    different = np.count_nonzero(np.diff(ordered, axis=1) > 0, axis=1)  # NaN sorts last and is never greater
    bits = values[different >= LEAST_VALUES - 1].view(np.uint32).astype(np.uint64)
    found: U64 = (bits * _ODD[: bits.shape[1]]).sum(axis=1, dtype=np.uint64) + np.uint64(block.scanner)
    found ^= found >> np.uint64(31)
    found *= _MIX
    found ^= found >> np.uint64(29)
    return found


class LineRepeats:
    """Counts lines that come again, in bounded memory.

    >>> repeats, lines = LineRepeats(), np.random.default_rng(1).random((40, 100), np.float32)
    >>> repeats.add(ScanBlock(0, lines))
    >>> repeats.add(ScanBlock(40, lines[:10]))
    >>> repeats.n_repeated
    10
    """

    def __init__(self) -> None:
        self._times: dict[int, int] = {}
        self._mask = 0

    def add(self, block: ScanBlock) -> None:
        """Take the next lines."""
        if block.points_per_line < LEAST_VALUES:
            return
        found = digests(block)
        for digest in found[found & np.uint64(self._mask) == 0].tolist():
            self._times[digest] = self._times.get(digest, 0) + 1
        while len(self._times) > MOST_KEPT:
            self._mask = 2 * self._mask + 1
            self._times = {digest: n for digest, n in self._times.items() if not digest & self._mask}

    @property
    def n_repeated(self) -> int:
        """Estimated number of lines that had been there before."""
        again = sum(n - 1 for n in self._times.values() if 1 < n <= MOST_TIMES)
        return again * (self._mask + 1)


def check_repeats(repeats: LineRepeats) -> Finding:
    """Ask whether lines come twice."""
    n = repeats.n_repeated
    verdict = Verdict.DOUBTFUL if n >= LEAST_REPEATED else Verdict.FINE
    found = f"{'about ' if n else ''}{n:,} lines are copies of earlier lines, shot by shot"
    hint = "leave out the part that is there twice"
    return Finding("repeated-lines", verdict, found, f"fewer than {LEAST_REPEATED}", hint)
