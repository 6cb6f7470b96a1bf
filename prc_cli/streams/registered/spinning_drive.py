"""Reconstructs the scans of spinning scanners in a cloud, in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.facts import SourceFacts
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import Assumption
from prc_cli.core.types import F64
from prc_cli.formats.records import RecordChunk, Source, filtered
from prc_cli.streams.registered.drive import PASS, coordinates, find_passes, sample
from prc_cli.streams.registered.evidence import CHECK, CellCounts, Judged, PathFigures, judge
from prc_cli.streams.registered.path import SPEED_CHANGE_M_S2, ScannerPath, positions_at
from prc_cli.streams.registered.returns import count_returns
from prc_cli.streams.registered.spinning import (
    SpinningHead,
    SpinningScan,
    find_head,
    scan_piece,
)
from prc_cli.streams.registered.spinning_rate import NoScan
from prc_cli.streams.registered.spinning_rings import are_clear
from prc_cli.streams.registered.spool import Spool

PIECE_POINTS = 1 << 20
"""Points whose lines are found at once."""
NO_COLUMN = -1
LEAST_CLEAR = 0.9
WORST_CLEAR = 0.5
"""Share of points clearly on one ring, doubtful and refused below; half are by chance."""
LEAST_STATIONS = 5
COURSE_S = 1.0
STANDS_M_S = 0.2
"""The course is measured over this time [s]; slower platforms keep it [m/s]."""
_CELL = (
    ("scan_line", "i4"),
    ("column", "i4"),
    ("range", "f8"),
    (PASS, "i4"),
    ("return_number", "u1"),
    ("number_of_returns", "u1"),
)


@dataclass(frozen=True, slots=True)
class SpinningDrive(Judged):
    """All spinning scanners and passes of a cloud."""

    scans: tuple[Spool, ...]
    """Points of every scanner by line, with their cells and coordinates relative to the head."""
    heads: tuple[SpinningHead, ...]
    figures: tuple[PathFigures, ...]
    """Figures of each pass."""
    findings: tuple[Finding, ...]
    paths: tuple[ScannerPath, ...] = ()
    """The path of each pass."""
    n_unplaced: int = 0
    """Points of passes that no turn of the head fits."""

    @property
    def n_scanners(self) -> int:
        """Number of scanners."""
        return len(self.heads)

    @property
    def points_per_line(self) -> int:
        """M, the number of rings, the largest of all scanners."""
        return max(head.rings.n_rings for head in self.heads)

    def rules(self) -> dict[str, object]:
        """Return the keys of ``[input]`` that read the points."""
        return {
            "lines": "dimension:scan_line",
            "columns": "dimension:column",
            "range": "dimension:range",
            "order": "trust",
            "scanner": PASS if len(self.figures) > 1 else "none",
            "points_per_line": self.points_per_line,
        }

    def assumptions(self) -> tuple[Assumption, ...]:
        """Return the rates that were found, for ``prc info`` and the run record."""
        head = self.heads[0]
        figures = self.figures[0]
        firing_hz = 1.0 / head.firings.period_s
        off = f"points lie {figures.residual_m:.3f} m off their beams (median)"
        assumptions = [
            Assumption(
                "input.range",
                "points",
                f"a head that spins {head.rate.hz:.6g} times a second; {off}",
            ),
            Assumption(
                "input.lines", f"time:{firing_hz:.9g}", "the rings fire together this often"
            ),
            Assumption(
                "input.columns",
                f"{head.rings.n_rings} rings",
                "elevations at which the points crowd",
            ),
        ]
        if len(self.figures) > 1:
            assumptions.append(
                Assumption(
                    "input.scanner",
                    f"{len(self.figures)} passes",
                    "gaps in time, or other scanners",
                )
            )
        return tuple(assumptions)


@dataclass(slots=True)
class _PassCounts:
    """Windows and counts of one pass."""

    time_s: list[F64] = field(default_factory=list)
    station_m: list[F64] = field(default_factory=list)
    residual_m: list[F64] = field(default_factory=list)
    trusted: list[NDArray[np.bool_]] = field(default_factory=list)
    cos_tilt: list[F64] = field(default_factory=list)
    axis: list[F64] = field(default_factory=list)
    points_s: list[float] = field(default_factory=list)
    n_points: int = 0
    n_on_rings: int = 0
    n_clear: int = 0
    cells: CellCounts = field(default_factory=CellCounts)

    def add(self, scan: SpinningScan, head: SpinningHead) -> None:
        """Add a piece."""
        self.n_clear += int(np.count_nonzero(are_clear(scan.local_m, scan.ring, head.rings)))
        path = scan.path
        self.time_s.append(path.time_s)
        self.station_m.append(path.poses.station_m)
        self.residual_m.append(np.hypot(path.beside_m, path.cone_m))
        self.trusted.append(path.is_trusted)
        self.cos_tilt.append(np.abs(path.poses.frame[:, 2, 2]))
        self.axis.append(path.poses.frame[:, :, 2])
        self.n_points += len(scan.ring)
        known = np.flatnonzero(scan.ring >= 0)
        self.n_on_rings += len(known)
        # neighbours of a surface lie along the rings
        order = known[np.lexsort((scan.line[known], scan.ring[known]))]
        self.cells.add_cells(scan.ring[order], scan.line[order], scan.range_m[order])

    def path(self, scanner: int, number: int) -> ScannerPath:
        """Return the path from the first to the last point; its sigma is the scatter of windows."""
        known_s = np.concatenate(self.time_s)
        station = np.concatenate(self.station_m)
        axis = np.concatenate(self.axis)
        rising = np.flatnonzero(np.diff(known_s, prepend=-np.inf) > 0)
        known_s = known_s[rising]
        station = station[rising]
        axis = axis[rising]
        first_s = self.points_s[0]
        last_s = self.points_s[-1]
        inside = (known_s > first_s) & (known_s < last_s)
        time_s = np.concatenate([[first_s], known_s[inside], [last_s]])
        place = np.clip(np.searchsorted(known_s, time_s), 0, len(known_s) - 1)
        # beyond the last window the speed may change as usual
        before_s = known_s[0] - time_s
        after_s = time_s - known_s[-1]
        beyond_s = np.maximum(np.maximum(before_s, after_s), 0.0)[:, None]
        xyz = positions_at(known_s, station, time_s)
        return ScannerPath(
            scanner=scanner,
            time_s=time_s,
            xyz_m=xyz,
            sigma_m=scatter(station) + 0.5 * SPEED_CHANGE_M_S2 * beyond_s**2,
            frame=course_frames(time_s, xyz),
            axis=axis[place],
            number=np.full(len(time_s), number),
            forward="forward",
        )

    def figures(self, head: SpinningHead) -> PathFigures | None:
        """Return the figures; None without a fitted window."""
        time_s = np.concatenate(self.time_s)
        if len(time_s) < 2:
            return None
        station = np.concatenate(self.station_m)
        moved = np.linalg.norm(np.diff(station, axis=0), axis=1)
        speed = moved / np.maximum(np.diff(time_s), 0.2 / head.rate.hz)
        cos_tilt = float(np.median(np.concatenate(self.cos_tilt)))
        tilt = math.acos(min(cos_tilt, 1.0))
        return PathFigures(
            start_s=float(time_s[0]),
            duration_s=float(time_s[-1] - time_s[0]),
            length_m=float(moved.sum()),
            speed_m_s=float(np.median(speed)),
            top_speed_m_s=float(np.percentile(speed, 99.0)),
            residual_m=float(np.median(np.concatenate(self.residual_m))),
            share_on_beam=self.n_on_rings / max(self.n_points, 1),
            share_in_front=1.0,
            share_bridged=1.0 - float(np.mean(np.concatenate(self.trusted))),
            sigma_m=float(np.linalg.norm(scatter(station))),
            share_holes=self.cells.share_empty,
            turns_hz=head.rate.hz,
            lines_hz=1.0 / head.firings.period_s,
            shots_hz=head.rings.n_rings / head.firings.period_s,
            points_per_line=head.rings.n_rings,
            tilt_deg=math.degrees(tilt),
            points_s=(self.points_s[0], self.points_s[-1]),
        )


def scatter(station_m: F64) -> F64:
    """Return the standard deviations of stations (w, 3) about their neighbours, (3,) [m]."""
    if len(station_m) < LEAST_STATIONS:
        return np.full(3, math.nan)
    # of equal errors, a second difference has six times the variance
    bend = np.abs(np.diff(station_m, n=2, axis=0))
    deviation: F64 = 1.4826 * np.median(bend, axis=0) / math.sqrt(6.0)
    return deviation


def course_frames(time_s: F64, xyz_m: F64) -> F64:
    """Return axes forward, left, up of a path, (k, 3, 3); a platform that stands keeps its course.

    Parameters
    ----------
    time_s
        (k,) float64, rising [s].
    xyz_m
        (k, 3) float64 [m].
    """
    before_s = np.clip(time_s - 0.5 * COURSE_S, time_s[0], time_s[-1])
    after_s = np.clip(time_s + 0.5 * COURSE_S, time_s[0], time_s[-1])
    moved = np.empty((len(time_s), 2))
    for axis in range(2):
        before_m = np.interp(before_s, time_s, xyz_m[:, axis])
        after_m = np.interp(after_s, time_s, xyz_m[:, axis])
        moved[:, axis] = after_m - before_m
    length = np.linalg.norm(moved, axis=1)
    is_moving = length > STANDS_M_S * np.maximum(after_s - before_s, 1e-9)
    # a platform that stands keeps the course from before, or at first the one it starts with
    last_moving = np.maximum.accumulate(np.where(is_moving, np.arange(len(time_s)), -1))
    place = np.where(last_moving >= 0, last_moving, int(np.argmax(is_moving)))
    course = moved[place] / np.maximum(length[place], 1e-9)[:, None]
    frames = np.zeros((len(time_s), 3, 3))
    forward = frames[:, :, 0]
    forward[:, 0] = course[:, 0]
    forward[:, 1] = course[:, 1]
    left = frames[:, :, 1]
    left[:, 0] = -course[:, 1]
    left[:, 1] = course[:, 0]
    frames[:, 2, 2] = 1.0
    return frames


def reconstruct_spinning(path: str, spools: dict[int, Spool]) -> SpinningDrive | NoScan:
    """Find the rings, the path of every head, and the cell of every point.

    Parameters
    ----------
    path
        File name, for messages.
    spools
        Points in the order of their times, by scanner.

    Returns
    -------
    SpinningDrive or NoScan
        Why a scanner is no spinning head.
    """
    scans: list[Spool] = []
    heads: list[SpinningHead] = []
    figures: list[PathFigures] = []
    paths: list[ScannerPath] = []
    n_points = 0
    n_lost = 0
    n_clear = 0
    for scanner, points in sorted(spools.items()):
        head = find_head(*sample(points))
        if isinstance(head, NoScan):
            return head
        cell_names = {name for name, _ in _CELL}
        kept = [entry for entry in points.dtype.descr if entry[0] not in cell_names]
        placed = Spool(np.dtype([*kept, *_CELL]))
        head_of_pass = head
        for part in find_passes(points):
            counts = _PassCounts()
            for place in (part.start, part.stop - 1):
                counts.points_s.append(float(points.read(place, place + 1)["time"][0]))
            head_of_pass = _place(points, part, placed, head_of_pass, len(figures), counts)
            pass_figures = counts.figures(head)
            n_points += part.stop - part.start
            n_clear += counts.n_clear
            if pass_figures is None:
                n_lost += part.stop - part.start
            else:
                number = scanner if len(spools) > 1 else 0
                paths.append(counts.path(number, len(figures)))
                figures.append(replace(pass_figures, scanner=number))
        scans.append(placed)
        heads.append(head)
    if not figures:
        return NoScan("no turn of the head fits")
    findings = (*judge(path, figures, n_lost, n_points), judge_rings(n_clear / max(n_points, 1)))
    return SpinningDrive(tuple(scans), tuple(heads), tuple(figures), findings, tuple(paths), n_lost)


def judge_rings(share_clear: float) -> Finding:
    """Return the finding on the share of points that lie clearly on one ring."""
    verdict = Verdict.FINE
    if share_clear < LEAST_CLEAR:
        verdict = Verdict.DOUBTFUL if share_clear >= WORST_CLEAR else Verdict.AGAINST
    hint = (
        "the times may be rounded, or the points moved after the drive; "
        "give the path: --range trajectory:FILE"
    )
    problem = f"{1.0 - share_clear:.0%} of the points lie between the rings of the scanner"
    return Finding(CHECK, verdict, problem, f"at most {1.0 - LEAST_CLEAR:.0%}", hint)


def _place(
    points: Spool,
    part: slice,
    placed: Spool,
    head: SpinningHead,
    number: int,
    counts: _PassCounts,
) -> SpinningHead:
    """Write the points of a pass with their cells by line; return the head for the next pass."""
    latest = int(head.firings.late.max())
    waiting = np.empty(0, placed.dtype)
    first_line: int | None = None
    for records in points.chunks(part.start, part.stop, PIECE_POINTS):
        scan, head = scan_piece(np.ascontiguousarray(records["time"]), coordinates(records), head)
        counts.add(scan, head)
        known = scan.ring >= 0
        if first_line is None and known.any():
            first_line = int(scan.line[known].min()) - latest
        n_lines_before = first_line or 0
        rows = np.empty(len(records), placed.dtype)
        for name in set(points.dtype.names or ()) & set(rows.dtype.names or ()):
            rows[name] = records[name]
        for axis, values in zip(("x", "y", "z"), upright(scan).T, strict=True):
            rows[axis] = values
        # rings that look ahead fire later for a line: the line has the time of its first shots
        n_late = np.where(known, head.firings.late[scan.ring], 0)
        rows["time"] -= n_late * head.firings.period_s
        rows["range"] = scan.range_m
        rows[PASS] = number
        # points off every ring get the firing of the points around them
        firing = np.maximum.accumulate(np.where(known, scan.firing, 0))
        line = np.where(known, scan.line, firing - latest) - n_lines_before
        rows["scan_line"] = np.maximum(line, 0)
        rows["column"] = np.where(known, scan.column, NO_COLUMN)
        waiting = np.concatenate([waiting, rows])
        order = np.lexsort((waiting["range"], waiting["column"], waiting["scan_line"]))
        waiting = waiting[order]
        # later firings may add to these lines
        first_open = int(firing.max(initial=0)) - latest - n_lines_before
        is_open = waiting["scan_line"] >= first_open
        placed.append(with_returns(waiting[~is_open]))
        waiting = waiting[is_open]
    placed.append(with_returns(waiting))
    return head


def with_returns(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Return rows, sorted by line, column and range, with the numbers of their returns."""
    is_first = np.diff(rows["scan_line"], prepend=-1) != 0
    is_first |= np.diff(rows["column"], prepend=-2) != 0
    is_first |= rows["column"] == NO_COLUMN
    rows["return_number"], rows["number_of_returns"] = count_returns(is_first)
    return rows


def upright(scan: SpinningScan) -> F64:
    """Return points relative to the head along its own axes, z upwards, (n, 3) [m].

    The axis of the head and not the vertical: rings are level then, as the method for rings
    expects, however the head is mounted and however the platform nods.
    """
    if not len(scan.path.time_s):
        return scan.local_m
    up = 1.0 if float(np.median(scan.path.poses.frame[:, 2, 2])) > 0.0 else -1.0
    upright_m: F64 = scan.local_m * np.array([1.0, up, up])
    return upright_m


def spinning(source: Source, drive: SpinningDrive) -> Source:
    """Return a cloud in the order of the lines of its spinning scanners, one after the other."""

    def chunks(names: tuple[str, ...], _: Source) -> Iterator[RecordChunk]:
        first = 0
        for scan in drive.scans:
            for rows in scan.chunks():
                values = {name: np.ascontiguousarray(rows[name]) for name in names}
                yield RecordChunk(first, values, len(rows), rows["record"].copy())
                first += len(rows)

    def facts_of(facts: SourceFacts) -> SourceFacts:
        findings = (*facts.findings, *drive.findings)
        return replace(facts, points_per_line=None, rules=(), findings=findings, drive=drive)

    dimensions = tuple(name for name in drive.scans[0].dtype.names or () if name != "record")
    return filtered(source, chunks, dimensions=dimensions, facts_of=facts_of)
