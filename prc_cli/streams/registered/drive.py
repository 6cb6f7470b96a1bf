"""Reconstructs all passes of all scanners of a cloud, in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.findings import Finding
from prc_cli.core.stream import Assumption
from prc_cli.core.types import F64, I64
from prc_cli.streams.registered.along import Places, track_along, turning_along
from prc_cli.streams.registered.evidence import (
    CellCounts,
    Judged,
    PathFigures,
    figures_of,
    judge,
    no_clock,
    no_rotation,
    no_stations,
    too_many_passes,
)
from prc_cli.streams.registered.fit import (
    KNOT_S,
    Clock,
    PassPieces,
    Track,
    are_shots_of_one_time,
    find_turning,
    fit_track,
    read_clock,
)
from prc_cli.streams.registered.returns import returns_of
from prc_cli.streams.registered.rotation import Turning, find_rotation
from prc_cli.streams.registered.scan import Scan, make_scan
from prc_cli.streams.registered.spool import Spool

GAP_S = 1.0
"""A longer time without a point ends a pass [s]."""
MOST_PASSES = 256
"""Passes of one cloud: each is a stream, whose state is kept to the end."""
LEAST_PASS_POINTS = 2000
"""Passes of fewer points are not placed."""
SAMPLE_BLOCKS = 96
"""Blocks of consecutive points that the rate of turns is found in."""
BLOCK_POINTS = 1 << 14
CONTIGUOUS_POINTS = 1 << 20
"""Consecutive points in which the rate is refined."""
POINTS_PER_KNOT = 320
"""Points that are kept between two knots, about."""
NEAR_DOWN_RAD = math.radians(15.0)
"""Shots within this angle of straight down give the height of the scanner [rad]."""
SAME_STEP = 1e-4
"""Scans whose shots in a turn differ by less have the same columns."""
SAME_START_RAD = 0.02
"""Arcs of one scanner begin within this of each other in all passes: the platform rolls [rad]."""
PASS = "pass"
"""Dimension with the number of the pass, over all scanners."""
CELL = np.dtype(
    [
        ("scan_line", "i4"),
        ("column", "i4"),
        ("range", "f8"),
        (PASS, "i4"),
        ("angle", "f8"),
        ("return_number", "u1"),
        ("number_of_returns", "u1"),
    ]
)
"""Cell of a point: scan line, column, range [m], pass, scan angle [rad], returns."""


@dataclass(frozen=True, slots=True)
class ScannerPoints:
    """The points of one scanner, in the order of their times, with their cells."""

    points: Spool
    cells: Spool

    def pieces(self) -> Iterator[tuple[NDArray[np.void], NDArray[np.void]]]:
        """Yield points and their cells."""
        yield from zip(self.points.chunks(), self.cells.chunks(), strict=True)


@dataclass(frozen=True, slots=True)
class Drive(Judged):
    """All scanners and passes of a cloud."""

    scanners: tuple[ScannerPoints, ...]
    scans: tuple[Scan, ...]
    """By number of the pass, over all scanners."""
    tracks: tuple[Track, ...]
    """The path of each pass, with its uncertainty."""
    figures: tuple[PathFigures, ...]
    """Figures of each pass."""
    findings: tuple[Finding, ...]
    n_unplaced: int
    """Points of passes that are too short or that no path fits."""
    split: str = ""
    """Dimension with the number of the scanner; empty = one scanner."""

    @property
    def n_scanners(self) -> int:
        """Number of scanners."""
        return len(self.scanners)

    @property
    def is_even(self) -> bool:
        """Whether all scans have the same columns: passes of one scanner."""
        first = self.scans[0]
        return all(
            abs(scan.shots_per_turn / first.shots_per_turn - 1.0) < SAME_STEP
            and abs(scan.angle_start_rad - first.angle_start_rad) < SAME_START_RAD
            for scan in self.scans
        )

    @property
    def points_per_line(self) -> int:
        """M, the largest of all passes."""
        return max(scan.points_per_line for scan in self.scans)

    @property
    def angle_start_rad(self) -> float:
        """Angle of column 0 from straight down [rad]."""
        return self.scans[0].angle_start_rad

    @property
    def step_rad(self) -> float:
        """Angle from column to column [rad]."""
        return self.scans[0].step_rad

    def assumptions(self) -> tuple[Assumption, ...]:
        """Return the rates that were found, for ``prc info`` and the run record."""
        scan = self.scans[0]
        figures = self.figures[0]
        turning = scan.turning
        why = "the rotation, the path and the ranges that fit the points and their times"
        assumptions = [
            Assumption("input.range", "points", why),
            Assumption(
                "input.lines",
                f"time:{turning.line_hz:.9g}",
                f"points lie {figures.residual_m:.3f} m off their beams (median) "
                "at this many lines a second",
            ),
            Assumption(
                "input.columns",
                f"time:{scan.shots_per_turn * turning.hz:.10g}",
                "measured bearings, since times are coarse"
                if scan.by_bearing
                else "the steps of the times",
            ),
        ]
        if len(self.scans) > 1:
            value = f"{len(self.scans)} streams"
            apart = f"{self.split} tells scanners apart; " if self.split else ""
            assumptions.append(
                Assumption(
                    "input.scanner", value, f"{apart}a gap of more than {GAP_S:g} s ends a pass"
                )
            )
        return tuple(assumptions)


def reconstruct(
    path: str,
    spools: dict[int, Spool],
    *,
    split: str = "",
    places: Places | None = None,
) -> Drive:
    """Find the path of every scanner and pass, and the cell of every point.

    Parameters
    ----------
    path
        File name, for messages.
    spools
        Points in the order of their times, by scanner.
    split
        Dimension with the number of the scanner.
    places
        The path, if it is given: then only rates and frames are found.

    Raises
    ------
    InputError
        No rotation fits the points of a scanner.
    """
    scanners: list[ScannerPoints] = []
    passes = _Passes()
    for number, points in sorted(spools.items()):
        scanners.append(
            _reconstruct_scanner(path, points, passes, number if len(spools) > 1 else 0, places)
        )
    if len(passes.scans) > MOST_PASSES:
        raise too_many_passes(path, len(passes.scans), MOST_PASSES)
    findings = judge(
        path, passes.figures, passes.n_unplaced, sum(len(spool) for spool in spools.values())
    )
    scans = tuple(passes.scans)
    tracks = tuple(passes.tracks)
    figures = tuple(passes.figures)
    return Drive(tuple(scanners), scans, tracks, figures, findings, passes.n_unplaced, split)


@dataclass(slots=True)
class _Passes:
    """The passes that were reconstructed."""

    scans: list[Scan] = field(default_factory=list)
    tracks: list[Track] = field(default_factory=list)
    figures: list[PathFigures] = field(default_factory=list)
    n_unplaced: int = 0

    def add(self, scan: Scan, track: Track, figures: PathFigures) -> None:
        self.scans.append(scan)
        self.tracks.append(track)
        self.figures.append(figures)


@dataclass(frozen=True, slots=True)
class _Rates:
    """Rates of turns and of shots of a scanner."""

    turning: Turning
    clock: Clock


def _rates(
    path: str,
    points: Spool,
    longest: slice,
    places: Places | None,
) -> _Rates:
    rotation = None
    if places is None:
        rotation = find_rotation(*sample(points))
        if rotation is None or not rotation.is_possible:
            raise no_rotation(path, rotation)
    part = points.read(longest.start, min(longest.stop, longest.start + CONTIGUOUS_POINTS))
    clock = read_clock(part["time"])
    if clock is None:
        raise no_clock(path)
    if rotation is not None:
        return _Rates(find_turning(part["time"], coordinates(part), rotation), clock)
    assert places is not None
    turning = turning_along(part["time"], coordinates(part), places)
    if turning is None:
        raise no_rotation(path, None)
    return _Rates(turning, clock)


def _reconstruct_scanner(
    path: str,
    points: Spool,
    reconstructed: _Passes,
    number: int,
    places: Places | None,
) -> ScannerPoints:
    cells = Spool(CELL)
    if len(points) < LEAST_PASS_POINTS and number > 0:
        # stray points with the number of another scanner
        reconstructed.n_unplaced += len(points)
        _leave_out(points, cells, slice(0, len(points)))
        return ScannerPoints(points, cells)
    passes = find_passes(points)
    longest = max(passes, key=lambda records: records.stop - records.start)
    rates = _rates(path, points, longest, places)
    n_before = len(reconstructed.scans)
    for part in passes:
        track = None
        if part.stop - part.start >= LEAST_PASS_POINTS:
            pieces = _thinned(points, part, rates.turning)
            duration_s = _duration(points, part)
            if places is None:
                track = fit_track(pieces, rates.turning, duration_s)
            else:
                track = track_along(pieces, rates.turning, duration_s, places)
        if track is None:
            reconstructed.n_unplaced += part.stop - part.start
            _leave_out(points, cells, part)
            continue
        scan = _scan_of(points, part, track, rates)
        counts = _place(points, cells, part, scan, len(reconstructed.scans))
        if rates.turning.is_arc:
            # times do not show the end of an arc, its last shot does
            scan = replace(scan, points_per_line=min(counts.last_column + 1, scan.points_per_line))
        reconstructed.add(scan, track, replace(figures_of(track, scan, counts), scanner=number))
    if len(reconstructed.scans) == n_before:
        raise no_stations(path, rates.turning)
    return ScannerPoints(points, cells)


def _scan_of(
    points: Spool,
    part: slice,
    track: Track,
    rates: _Rates,
) -> Scan:
    # columns follow from the times, if these are fine enough
    turning = rates.turning
    clock = rates.clock
    first = points.read(part.start, min(part.stop, part.start + BLOCK_POINTS))
    fine = make_scan(
        track.knots, turning, clock.shots_per_turn(turning, coarse=False), by_bearing=False
    )
    if not are_shots_of_one_time(fine, first["time"], coordinates(first)):
        return fine
    return make_scan(
        track.knots, turning, clock.shots_per_turn(turning, coarse=True), by_bearing=True
    )


def sample(points: Spool) -> tuple[F64, F64]:
    """Return times and points of blocks that are spread over all points."""
    starts = np.linspace(0, max(len(points) - BLOCK_POINTS, 0), SAMPLE_BLOCKS).astype(np.int64)
    if len(points) <= SAMPLE_BLOCKS * BLOCK_POINTS:
        records = points.read(0, len(points))
    else:
        records = np.concatenate(
            [points.read(int(start), int(start) + BLOCK_POINTS) for start in starts]
        )
    return np.ascontiguousarray(records["time"]), coordinates(records)


def coordinates(records: NDArray[np.void]) -> F64:
    """Return the coordinates of records, (n, 3) float64 [m]."""
    return np.stack([records[axis] for axis in ("x", "y", "z")], axis=1)


def find_passes(points: Spool) -> list[slice]:
    """Return the records of every pass; a gap of :data:`GAP_S` divides passes."""
    borders = [0]
    last = math.nan
    first = 0
    for records in points.chunks():
        time_s = records["time"]
        jumps = np.flatnonzero(np.diff(time_s, prepend=last) > GAP_S)
        borders += (first + jumps).tolist()
        first += len(records)
        last = float(time_s[-1])
    borders.append(len(points))
    return [slice(start, stop) for start, stop in pairwise(borders) if stop > start]


def _thinned(points: Spool, part: slice, turning: Turning) -> PassPieces:
    # every n-th point, so that enough lie between two knots
    between = (
        (part.stop - part.start) / _duration(points, part) * max(1.0 / turning.line_hz, KNOT_S)
    )
    every = max(int(between / POINTS_PER_KNOT), 1)

    def pieces() -> Iterator[tuple[F64, F64]]:
        skip = 0
        for records in points.chunks(part.start, part.stop):
            chosen = records[skip::every]
            skip = (skip - len(records)) % every
            if len(chosen):
                yield np.ascontiguousarray(chosen["time"]), coordinates(chosen)

    return pieces


def _duration(points: Spool, part: slice) -> float:
    first, last = (float(points.read(i, i + 1)["time"][0]) for i in (part.start, part.stop - 1))
    return max(last - first, 1e-3)


def _leave_out(points: Spool, cells: Spool, part: slice) -> None:
    for records in points.chunks(part.start, part.stop):
        empty = np.zeros(len(records), CELL)
        empty["column"] = -1
        cells.append(empty)


def _place(
    points: Spool,
    cells: Spool,
    part: slice,
    scan: Scan,
    number: int,
) -> CellCounts:
    counts = CellCounts()
    waiting = np.empty(0, points.dtype)
    for records in points.chunks(part.start, part.stop):
        records = np.concatenate([waiting, records])
        line = np.floor(scan.phase(records["time"])).astype(np.int64)
        # columns are found in whole lines
        cut = int(np.searchsorted(line, line[-1]))
        if cut:
            _put(cells, records[:cut], scan, number, counts)
        waiting = records[cut:]
    _put(cells, waiting, scan, number, counts)
    return counts


def _put(
    cells: Spool,
    records: NDArray[np.void],
    scan: Scan,
    number: int,
    counts: CellCounts,
) -> None:
    cell = scan.cells(records["time"], coordinates(records))
    row = np.empty(len(records), CELL)
    row["scan_line"] = cell.line
    row["column"] = cell.column
    row["range"] = cell.range_m
    row[PASS] = number
    row["angle"] = scan.angle_start_rad + scan.step_rad * cell.column
    row["return_number"], row["number_of_returns"] = returns_of(
        records, cell.range_m, by_time=not scan.by_bearing
    )
    cells.append(row)
    counts.add_cells(cell.line, cell.column, cell.range_m)
    counts.add_times(records["time"])
    counts.add_heights(_heights_above(records, cell.column, scan))


def _heights_above(records: NDArray[np.void], column: I64, scan: Scan) -> F64:
    angle = scan.angle_start_rad + column * scan.step_rad
    beside = np.abs(np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi)
    below = records[beside < NEAR_DOWN_RAD]
    height: F64 = scan.stations(below["time"])[:, 2] - below["z"]
    return height
