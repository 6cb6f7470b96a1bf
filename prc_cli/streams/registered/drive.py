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
from prc_cli.core.types import F64
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
"""Blocks of :data:`BLOCK_POINTS` consecutive points, in which the rate of turns is found."""
BLOCK_POINTS = 1 << 14
CONTIGUOUS_POINTS = 1 << 20
"""Consecutive points of the longest pass, in which the rate is refined."""
POINTS_PER_KNOT = 320
"""Points that are kept between two knots, about."""
NEAR_DOWN_RAD = math.radians(15.0)
"""Shots within this angle of straight down give the height of the scanner [rad]."""
SAME_STEP = 1e-4
"""Scans whose shots per turn differ by a smaller share have the same columns."""
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
        Known path, as positions at given times; None = the path is found from the points.

    Raises
    ------
    InputError
        No rotation fits the points of a scanner.
    """
    scanners: list[ScannerPoints] = []
    passes = _Passes()
    for number, points in sorted(spools.items()):
        scanner = number if len(spools) > 1 else 0
        scanners.append(_reconstruct_scanner(path, points, passes, scanner, places))
    if len(passes.scans) > MOST_PASSES:
        raise too_many_passes(path, len(passes.scans), MOST_PASSES)
    n_points = sum(len(spool) for spool in spools.values())
    findings = judge(path, passes.figures, passes.n_unplaced, n_points)
    return Drive(
        scanners=tuple(scanners),
        scans=tuple(passes.scans),
        tracks=tuple(passes.tracks),
        figures=tuple(passes.figures),
        findings=findings,
        n_unplaced=passes.n_unplaced,
        split=split,
    )


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


def _find_rates(
    path: str,
    points: Spool,
    longest_pass: slice,
    places: Places | None,
) -> _Rates:
    rotation = None
    if places is None:
        rotation = find_rotation(*sample(points))
        if rotation is None or not rotation.is_possible:
            raise no_rotation(path, rotation)
    stop = min(longest_pass.stop, longest_pass.start + CONTIGUOUS_POINTS)
    records = points.read(longest_pass.start, stop)
    clock = read_clock(records["time"])
    if clock is None:
        raise no_clock(path)
    if rotation is not None:
        return _Rates(find_turning(records["time"], coordinates(records), rotation), clock)
    assert places is not None
    turning = turning_along(records["time"], coordinates(records), places)
    if turning is None:
        raise no_rotation(path, None)
    return _Rates(turning, clock)


def _reconstruct_scanner(
    path: str,
    points: Spool,
    passes: _Passes,
    scanner: int,
    places: Places | None,
) -> ScannerPoints:
    """Find the path and the cells of one scanner, and add its passes to ``passes``."""
    cells = Spool(CELL)
    if len(points) < LEAST_PASS_POINTS and scanner > 0:
        # stray points with the number of another scanner
        passes.n_unplaced += len(points)
        _append_empty_cells(points, cells, slice(0, len(points)))
        return ScannerPoints(points, cells)
    spans = find_passes(points)
    longest_pass = max(spans, key=lambda span: span.stop - span.start)
    rates = _find_rates(path, points, longest_pass, places)
    n_before = len(passes.scans)
    for span in spans:
        track = None
        if span.stop - span.start >= LEAST_PASS_POINTS:
            pieces = _thinned(points, span, rates.turning)
            duration_s = _duration(points, span)
            if places is None:
                track = fit_track(pieces, rates.turning, duration_s)
            else:
                track = track_along(pieces, rates.turning, duration_s, places)
        if track is None:
            passes.n_unplaced += span.stop - span.start
            _append_empty_cells(points, cells, span)
            continue
        scan = _scan_of(points, span, track, rates)
        counts = _append_cells_of_pass(points, cells, span, scan, len(passes.scans))
        if rates.turning.is_arc:
            # times do not show how long an arc is: its last column with a point ends the line
            scan = replace(scan, points_per_line=min(counts.last_column + 1, scan.points_per_line))
        passes.add(scan, track, replace(figures_of(track, scan, counts), scanner=scanner))
    if len(passes.scans) == n_before:
        raise no_stations(path, rates.turning)
    return ScannerPoints(points, cells)


def _scan_of(
    points: Spool,
    span: slice,
    track: Track,
    rates: _Rates,
) -> Scan:
    turning = rates.turning
    clock = rates.clock
    by_time = make_scan(
        track.knots, turning, clock.shots_per_turn(turning, coarse=False), by_bearing=False
    )
    first = points.read(span.start, min(span.stop, span.start + BLOCK_POINTS))
    if not are_shots_of_one_time(by_time, first["time"], coordinates(first)):
        return by_time
    # times are too coarse: several shots share one, and only their bearings give the columns
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


def _thinned(points: Spool, span: slice, turning: Turning) -> PassPieces:
    """Return pieces with every n-th point of a pass, about :data:`POINTS_PER_KNOT` a knot."""
    points_per_s = (span.stop - span.start) / _duration(points, span)
    points_per_knot = points_per_s * max(1.0 / turning.line_hz, KNOT_S)
    step = max(int(points_per_knot / POINTS_PER_KNOT), 1)

    def pieces() -> Iterator[tuple[F64, F64]]:
        n_skipped = 0  # at the start of a chunk
        for records in points.chunks(span.start, span.stop):
            kept = records[n_skipped::step]
            n_skipped = (n_skipped - len(records)) % step
            if len(kept):
                yield np.ascontiguousarray(kept["time"]), coordinates(kept)

    return pieces


def _duration(points: Spool, span: slice) -> float:
    first, last = (float(points.read(i, i + 1)["time"][0]) for i in (span.start, span.stop - 1))
    return max(last - first, 1e-3)


def _append_empty_cells(points: Spool, cells: Spool, span: slice) -> None:
    """Append a cell of column -1 for every point: the point has no cell."""
    for records in points.chunks(span.start, span.stop):
        empty = np.zeros(len(records), CELL)
        empty["column"] = -1
        cells.append(empty)


def _append_cells_of_pass(
    points: Spool,
    cells: Spool,
    span: slice,
    scan: Scan,
    pass_number: int,
) -> CellCounts:
    counts = CellCounts()
    waiting = np.empty(0, points.dtype)
    for records in points.chunks(span.start, span.stop):
        records = np.concatenate([waiting, records])
        line = np.floor(scan.phase(records["time"])).astype(np.int64)
        # the last line may continue in the next chunk, and columns need complete lines
        n_complete = int(np.searchsorted(line, line[-1]))
        if n_complete:
            _append_cells_of_lines(cells, records[:n_complete], scan, pass_number, counts)
        waiting = records[n_complete:]
    _append_cells_of_lines(cells, waiting, scan, pass_number, counts)
    return counts


def _append_cells_of_lines(
    cells: Spool,
    records: NDArray[np.void],
    scan: Scan,
    pass_number: int,
    counts: CellCounts,
) -> None:
    cell = scan.cells(records["time"], coordinates(records))
    rows = np.empty(len(records), CELL)
    rows["scan_line"] = cell.line
    rows["column"] = cell.column
    rows["range"] = cell.range_m
    rows[PASS] = pass_number
    rows["angle"] = scan.angle_start_rad + scan.step_rad * cell.column
    rows["return_number"], rows["number_of_returns"] = returns_of(
        records, cell.range_m, by_time=not scan.by_bearing
    )
    cells.append(rows)
    counts.add_cells(cell.line, cell.column, cell.range_m)
    counts.add_times(records["time"])
    # the height of the scanner above every point nearly below it
    from_down = np.abs(np.remainder(rows["angle"] + math.pi, 2.0 * math.pi) - math.pi)
    points_below = records[from_down < NEAR_DOWN_RAD]
    counts.add_heights(scan.stations(points_below["time"])[:, 2] - points_below["z"])
