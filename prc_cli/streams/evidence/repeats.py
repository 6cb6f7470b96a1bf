"""Lines that come twice, shot by shot."""

from __future__ import annotations

import numpy as np

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import U64
from prc_cli.streams.evidence.table import verdict_of

COLUMNS = 64
"""Columns that represent a line, evenly spread."""
LEAST_VALUES = 32
"""Lines with fewer ranges, or fewer different ones, are not compared."""
MOST_KEPT = 1 << 15
"""Most lines that are kept; of longer streams every second, fourth … by its digest."""
MOST_TIMES = 4
"""Lines that repeat more often are those of a standing scanner without noise."""
LEAST_REPEATED = 8
"""Fewer repeated lines give no warning."""
_ODD = np.random.default_rng(20).integers(0, 1 << 62, COLUMNS).astype(np.uint64) * np.uint64(
    2
) + np.uint64(1)
_MIX = np.uint64(0x9E3779B97F4A7C15)


def digests(block: ScanBlock) -> U64:
    """Return a number for every line that has enough ranges, equal for equal lines, (n,) uint64."""
    step = max(block.points_per_line // COLUMNS, 1)
    values = np.ascontiguousarray(block.range_m[:, : step * COLUMNS : step])
    ordered = np.sort(values, axis=1)
    different = np.count_nonzero(
        np.diff(ordered, axis=1) > 0, axis=1
    )  # NaN sorts last and is never greater
    bits = values[different >= LEAST_VALUES - 1].view(np.uint32).astype(np.uint64)
    digest: U64 = (bits * _ODD[: bits.shape[1]]).sum(axis=1, dtype=np.uint64) + np.uint64(
        block.scanner
    )
    digest ^= digest >> np.uint64(31)
    digest *= _MIX
    digest ^= digest >> np.uint64(29)
    return digest


class LineRepeats:
    """Counts lines that come again, in bounded memory."""

    def __init__(self) -> None:
        self._times: dict[int, int] = {}
        self._mask = 0

    def add(self, block: ScanBlock) -> None:
        """Take the next lines."""
        if block.points_per_line < LEAST_VALUES:
            return
        line_digests = digests(block)
        for digest in line_digests[line_digests & np.uint64(self._mask) == 0].tolist():
            self._times[digest] = self._times.get(digest, 0) + 1
        while len(self._times) > MOST_KEPT:
            self._mask = 2 * self._mask + 1
            self._times = {
                digest: n for digest, n in self._times.items() if not digest & self._mask
            }

    @property
    def n_repeated(self) -> int:
        """Estimated number of lines that had been there before."""
        again = sum(n - 1 for n in self._times.values() if 1 < n <= MOST_TIMES)
        return again * (self._mask + 1)


def check_repeats(repeats: LineRepeats, of_recording: str = "") -> Finding:
    """Check whether lines come twice; ``of_recording`` names the repeats in the recording."""
    n = repeats.n_repeated
    if of_recording:
        hint = "only the first copy was classified; record every topic or port once"
        return Finding("repeated-lines", Verdict.DOUBTFUL, of_recording, "each once", hint)
    measured = f"{'about ' if n else ''}{n:,} lines are copies of earlier lines, shot by shot"
    hint = "remove the repeated part"
    return Finding(
        "repeated-lines",
        verdict_of(doubtful=n >= LEAST_REPEATED),
        measured,
        f"fewer than {LEAST_REPEATED}",
        hint,
    )
