"""Other ways to read the bytes of a dump of ranges that looks misread."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from prc_cli.core.files import open_to_read
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.types import F32
from prc_cli.formats.registry import is_dump
from prc_cli.streams.evidence.figures import SMOOTH, likeness

MISREAD_CHECKS = ("ranges", "shot-order")
"""Checks that a wrong reading fails."""
SAMPLE_BYTES = 1 << 18
"""Bytes read from the middle of the file, where the scanner is in its scene."""
TYPES = ("f4", "f8", "u2", "u4", "i4")
SCALES_M = (1.0, 0.001, 0.01)
"""Metres, millimetres, centimetres."""
MEDIAN_M = 8.0
USUAL_M = (0.5, 80.0)
FARTHEST_M = 5000.0
"""The median range of streets and forests, about; that of any scan; the farthest range of any."""
MOST_ODD = 0.01
"""Largest share of numbers that are neither a range nor missing (0 or NaN)."""
LEAST_RANGES = 2000
READABLE = 0.1
"""Likeness of neighbouring shots, as a share of that of random shots.

At most 0.05 in all scans at hand.
"""
MOST_HEADER_BYTES = 4096
_SEED = 7


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read the bytes of a dump of ranges."""

    type: str
    endian: str
    header_bytes: int
    scale: float
    has_zeros: bool
    """Whether zeros are missing shots."""

    def options(self) -> str:
        """Return the options to type, without the defaults of dumps.

        >>> Reading("f4", "big", 0, 1.0, False).options()
        '--set layout.endian=big'
        """
        named = self.type != "f4" or self.scale != 1
        scale = f",scale={self.scale:g}" if self.scale != 1 else ""
        missing = ",missing=0" if self.has_zeros else ""
        keys = (
            [f'\'layout.fields=[{{name="range",type="{self.type}"{scale}{missing}}}]\'']
            if named
            else []
        )
        keys += [f"layout.endian={self.endian}"] if self.endian != "little" else []
        keys += [f"layout.header_bytes={self.header_bytes}"] if self.header_bytes else []
        return " ".join(f"--set {key}" for key in keys)


def other_reading(path: Path, points_per_line: int | None = None) -> Reading | None:
    """Find how the bytes of a dump make ranges of a scan."""
    with open_to_read(path) as handle:
        size = handle.seek(0, 2)
        first = max(size // 2 - SAMPLE_BYTES // 2, 0) // 8 * 8
        handle.seek(first)
        data = handle.read(SAMPLE_BYTES + 8)
    best = None
    least = READABLE
    for kind, endian in product(TYPES, ("little", "big")):
        stored = np.dtype(kind).newbyteorder("<" if endian == "little" else ">")
        for phase in range(stored.itemsize):
            values = np.frombuffer(data, stored, (len(data) - phase) // stored.itemsize, phase)
            scale, share = _as_ranges(values)
            if share < least:
                header = _header_bytes(size, stored.itemsize, phase, points_per_line)
                best = Reading(kind, endian, header, scale, bool((values == 0).any()))
                least = share
    return best


def _as_ranges(values: np.ndarray) -> tuple[float, float]:
    """Return the unit of numbers as ranges, and their likeness; infinite if they are none."""
    with np.errstate(all="ignore"):  # nearly every reading is wrong
        numbers = values.astype(np.float64)
        there = (numbers != 0) & ~np.isnan(numbers)
        middle = float(np.median(numbers[there])) if there.any() else math.nan
        if not 0 < middle < math.inf:
            return 1.0, math.inf
        scale = min(
            SCALES_M, key=lambda unit_m: abs(math.log(unit_m / MEDIAN_M) + math.log(middle))
        )
        range_m: F32 = (numbers * scale).astype(np.float32)
    good = there & (range_m > SMOOTH) & (range_m < FARTHEST_M)
    n_good = np.count_nonzero(good)
    is_odd = np.count_nonzero(there) - n_good > MOST_ODD * len(range_m)
    if n_good < LEAST_RANGES or is_odd or not USUAL_M[0] <= scale * middle <= USUAL_M[1]:
        return scale, math.inf
    logs = np.log(np.where(good, range_m, np.float32(np.nan)))
    known = logs[good]
    random = likeness(known, np.random.default_rng(_SEED).permutation(known))
    return scale, likeness(logs[:-1], logs[1:]) / random if random >= SMOOTH else math.inf


def _header_bytes(
    size: int,
    item_bytes: int,
    phase: int,
    points_per_line: int | None,
) -> int:
    """Return the bytes before the first whole line, if they can be a header.

    Else the bytes before the first number.
    """
    if points_per_line is not None:
        over = size % (item_bytes * points_per_line)
        if over % item_bytes == phase and over <= MOST_HEADER_BYTES:
            return over
    return phase


def with_other_reading(finding: Finding, path: str, points_per_line: int | None) -> Finding:
    """Add to the refusal of a dump how to read it, if there is a way."""
    dump = Path(path)
    if finding.verdict is not Verdict.AGAINST or finding.check not in MISREAD_CHECKS:
        return finding
    if not is_dump(dump) or not dump.is_file():
        return finding
    reading = other_reading(dump, points_per_line)
    if reading is None or not reading.options():
        return finding
    return replace(
        finding,
        hint=f"its bytes are ranges of a scan with {reading.options()}",
        option=reading.options(),
    )
