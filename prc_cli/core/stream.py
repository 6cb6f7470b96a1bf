"""Data types of the stream: blocks of scan lines in, labelled blocks out.

The stream is chronological: shot ``i = line * M + column``. Shots without return are included, with
range NaN ("missing"). Readers yield :class:`ScanBlock`, classifiers use its arrays, writers take
:class:`LabelledBlock`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from operator import add, attrgetter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.brief import Brief
from prc_cli.core.classes import Surface
from prc_cli.core.facts import SourceFacts
from prc_cli.core.frame import SensorFrame
from prc_cli.core.types import F32, F64, I32, I64, U8, U16, Mask

FAR_M = 20_000.0
"""Beyond the range of any terrestrial scanner [m]: origin, unit or coordinate system is wrong."""
MAX_RINGS = 256
"""Most rings of a spinning scanner."""


@dataclass(frozen=True, slots=True)
class Assumption:
    """One assumption of the reader, printed by ``prc info`` and kept in the run record."""

    key: str
    """Configuration key that changes it, for example ``input.lines``."""
    value: str
    """The value that was assumed."""
    why: str
    """The reason."""


@dataclass(frozen=True, slots=True, repr=False)
class StreamInfo(Brief):
    """Properties of a stream that are known before it is read."""

    path: str
    format: str
    """Reader name: ``raw binary``, ``text``, ``LAS``, ``array``."""
    points_per_line: int
    """M, shots in a scan line; the largest M if several scanners share the file."""
    n_records: int | None
    """Records in the input; None = not known before reading."""
    n_lines: int | None
    """Scan lines; None = not known before reading."""
    angle_rad: F64 | None = None
    """(M,) float64, scan angle of every column [rad]; None = unknown."""
    line_hz: float | None = None
    """Scan lines per second [Hz]; None = unknown."""
    line_rule: str = ""
    """How scan lines are found in records: dimension, fixed, angle-wrap or time; empty = no
    records."""
    down_rad: float | None = None
    """Scan angle of the beam that points straight down, on the scale of ``angle_rad`` [rad].

    None if unknown.
    """
    cos_tilt: float = 1.0
    """Cosine of the tilt of the scan plane from the vertical; height per metre of range there."""
    downs: dict[int, tuple[float, float]] = field(default_factory=dict)
    """Down angle [rad] and cosine by scanner; if not empty, unknown for all other scanners."""
    angles_off: float = 0.0
    """Relative uncertainty of scan angles that were measured from the ranges, 0 = given."""
    assumptions: tuple[Assumption, ...] = ()
    facts: SourceFacts = field(default_factory=SourceFacts)
    """Metadata of the file."""
    dimensions: tuple[str, ...] = ()
    """Names of the records' dimensions; empty for images and frames."""

    def down(self, scanner: int) -> tuple[float | None, float]:
        """Return the scan angle of straight down [rad] (None = unknown), and the tilt's cosine."""
        if self.downs:
            return self.downs.get(scanner, (None, 1.0))
        return self.down_rad, self.cos_tilt


@dataclass(frozen=True, slots=True)
class ReadTally:
    """Counts of shots that a reader set missing and of records that have no cell of their own."""

    n_not_finite: int = 0
    """Infinite ranges, taken as missing (NaN and empty cells are the usual codes for missing)."""
    n_not_positive: int = 0
    """Ranges of zero or below, taken as missing."""
    n_beyond: int = 0
    """Ranges outside ``min_range`` to ``max_range``, taken as missing."""
    n_collisions: int = 0
    """Records whose cell holds another shot; labelled like further returns of that shot."""
    n_extra_returns: int = 0
    """Further returns of a shot whose main return has the cell."""
    n_unplaced: int = 0
    """Records outside all cells (column not in 0..M-1); they stay unclassified."""
    n_time_steps_back: int = 0
    """Times that go back from one record to the next (tolerated when the order is trusted)."""
    n_records: int = 0
    """Records read from the input, placed or not."""

    def __add__(self, other: ReadTally) -> ReadTally:
        # most are empty, and tallies are added a dozen times per chunk
        if other == _NO_TALLY:
            return self
        if self == _NO_TALLY:
            return other
        return ReadTally(*map(add, _counts_of(self), _counts_of(other)))

    def counts(self, *, everything: bool = False) -> Iterator[tuple[str, int]]:
        """Yield every count but ``n_records`` by description; zeros with ``everything``."""
        for name in self.__dataclass_fields__:
            count = getattr(self, name)
            if name != "n_records" and (count or everything):
                yield name.removeprefix("n_").replace("_", " "), count


_NO_TALLY = ReadTally()
_counts_of = attrgetter(*(count.name for count in fields(ReadTally)))


@dataclass(frozen=True, slots=True, repr=False)
class ExtraReturns(Brief):
    """Further returns: all returns of a shot but the one in the range image."""

    line: I32
    """(n,) int32, line within the block."""
    column: I32
    """(n,) int32, column."""
    range_m: F32
    """(n,) float32, slant range [m]."""
    record: I64
    """(n,) int64, record index in the input."""
    intensity: F32 | None = None
    """(n,) float32, NaN = unknown; None where the reader keeps that of the main returns alone."""

    @classmethod
    def none(cls) -> ExtraReturns:
        """No further returns."""
        return cls(
            np.empty(0, np.int32),
            np.empty(0, np.int32),
            np.empty(0, np.float32),
            np.empty(0, np.int64),
        )

    def __len__(self) -> int:
        return len(self.line)


@dataclass(frozen=True, slots=True, repr=False)
class ScanBlock(Brief):
    """Consecutive scan lines of one scanner, at least one."""

    first_line: int
    """Index of the block's first line in the stream of its scanner."""
    range_m: F32
    """(lines, M) float32, C-contiguous, slant range [m]; NaN = missing, all else finite and > 0."""
    record: I64 | None = None
    """(lines, M) int64, record index in the input, -1 = none.

    None = ``line * M + column`` (dense input).
    """
    scanner: int = 0
    """Scanner id, 0 where the input is not split."""
    time_s: F64 | None = None
    """(lines, M) float64, time of every shot [s]; NaN = unknown."""
    xyz_m: F32 | None = None
    """(lines, M, 3) float32, sensor-centred, z up [m]; NaN = missing."""
    intensity: F32 | None = None
    """(lines, M) float32, NaN = missing.

    Raw units of the input, scaled to 0..65535 for formats that state their limits (PTX, E57)."""
    angle_rad: F64 | None = None
    """(M,) float64, scan angle per column [rad]."""
    beam_rad: F64 | None = None
    """(M,) float64, angle of every column's beam from straight down [rad], in (-pi, pi].

    The sign is the side of the scan plane. It turns one way with the column, by a turn at most;
    column 0 may be anywhere. None = unknown or not requested."""
    has_rings: bool = False
    """Whether columns are known to be the rings of a spinning scanner."""
    frame: SensorFrame | None = None
    """Frame of a spinning scanner in that of ``xyz_m``; None = the same, as far as is known."""
    extra: ExtraReturns = field(default_factory=ExtraReturns.none)
    tally: ReadTally = ReadTally()
    is_last: bool = False
    """The scanner has no more lines."""
    next_m: F32 | None = None
    """(lines <= look-ahead, M) float32, ranges of the lines after the block [m], if regrouped."""

    @property
    def n_lines(self) -> int:
        """Number of scan lines."""
        return int(self.range_m.shape[0])

    @property
    def points_per_line(self) -> int:
        """M, shots in a scan line."""
        return int(self.range_m.shape[1])

    def records(self) -> I64:
        """Record index of every cell, (lines, M) int64, -1 = none."""
        if self.record is not None:
            return self.record
        first = self.first_line * self.points_per_line
        return np.arange(first, first + self.range_m.size, dtype=np.int64).reshape(
            self.range_m.shape
        )


def cut(block: ScanBlock, start: int, stop: int) -> ScanBlock:
    """Return the lines ``start`` to ``stop`` of a block; the part from line 0 keeps the tally."""
    inside = (block.extra.line >= start) & (block.extra.line < stop)
    extra = ExtraReturns(
        block.extra.line[inside] - np.int32(start),
        block.extra.column[inside],
        block.extra.range_m[inside],
        block.extra.record[inside],
        None if block.extra.intensity is None else block.extra.intensity[inside],
    )
    lines = slice(start, stop)
    return replace(
        block,
        first_line=block.first_line + start,
        range_m=block.range_m[lines],
        record=None if block.record is None else block.record[lines],
        time_s=None if block.time_s is None else block.time_s[lines],
        xyz_m=None if block.xyz_m is None else block.xyz_m[lines],
        intensity=None if block.intensity is None else block.intensity[lines],
        extra=extra,
        tally=block.tally if start == 0 else ReadTally(),
        is_last=block.is_last and stop == block.n_lines,
    )


class ScanStream(Protocol):
    """Interface of all readers: the properties of a stream and its blocks, read repeatedly."""

    @property
    def info(self) -> StreamInfo:
        """Properties known before reading."""

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start, chronological for each scanner.

        Raises
        ------
        InputError
            The input is damaged.
        """


@dataclass(frozen=True, slots=True)
class StageLabels:
    """Intermediate results of the sequential-angle classifier (Stamos et al. 2012)."""

    surface: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Surface`: coarse classification (sec. 4)."""
    car_surface: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Surface`: T', H and V of cars (sec. 7.1)."""
    ground_height_m: F32
    """(lines, M) float32, z_g, ground height relative to the scanner [m]; NaN = unknown."""
    trigger: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.TriggerSide` (sec. 7.2)."""
    car_interval: U16
    """(lines, M) uint16, number p of the interval between dividers on the shot's half-line, from 1.

    0 = none (sec. 7.3, before anything is taken out of the interval)."""
    car_test: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.CarTest`."""

    @property
    def dense_vegetation(self) -> Mask:
        """T', vegetation by the less sensitive test (sec. 7.1), (lines, M) bool."""
        dense: Mask = self.car_surface == Surface.VEGETATION
        return dense

    def of_lines(self, lines: slice) -> StageLabels:
        """Return some of the lines; views."""
        return StageLabels(
            **{stage.name: getattr(self, stage.name)[lines] for stage in fields(self)}
        )


@dataclass(frozen=True, slots=True)
class CriticalZetas:
    """Least thresholds with which a shot has support (Lehtola et al. 2019, V-A)."""

    in_line_m: F32
    """(lines, M) float32, compared with zeta_p [m]; inf = too few neighbours, NaN = missing."""
    adjacent_m: F32
    """(lines, M) float32, compared with zeta_s [m]."""


@dataclass(frozen=True, slots=True, repr=False)
class LabelledBlock(Brief):
    """A block with one label per shot; input of the writers."""

    block: ScanBlock
    labels: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label`; MISSING where the range is NaN."""
    extra_labels: U8
    """(n,) uint8, labels of ``block.extra``, in its order."""
    segments: I64 | None = None
    """(lines, M) int64, segment id R_b (Lehtola et al. 2019, II-E); 0 = none."""
    stages: StageLabels | None = None
    """Intermediate results of the sequential-angle classifier."""
    above_m: F32 | None = None
    """(lines, M) float32, height above the ground [m]; NaN = missing, or no ground is known.

    None = the method has no ground, or it was not asked for."""
    critical: CriticalZetas | None = None
    """Critical thresholds of PRC."""
    confidence: U8 | None = None
    """(lines, M) uint8, per cent of such shots whose label is right; 0 = no return, or not known.

    None = the method has none, or it was not asked for."""
    extra_confidence: U8 | None = None
    """(n,) uint8, the same of ``block.extra``."""
    reasons: U8 | None = None
    """(lines, M) uint8, :class:`prc_cli.core.classes.Reason`; None unless asked for."""
    measures: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """(lines, M) arrays that the stages measured, by names with their units, for ``prc
    explain``."""
    is_up_assumed: bool = False
    """Whether there is a plane below and one above the scanner, and z is assumed to point up."""
