"""Checks a reconstruction: whether its path can be that of a vehicle or a person."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from prc_cli.core.errors import EvidenceError
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.types import F64, I64
from prc_cli.streams.registered.fit import Track
from prc_cli.streams.registered.rotation import Rotation, Turning
from prc_cli.streams.registered.scan import Scan

CHECK = "path"
"""Name of the check."""
MOST_RESIDUAL_M = 0.03
WORST_RESIDUAL_M = 0.15
"""Median distance of points from their beams: doubtful, refused [m]."""
LEAST_ON_BEAM = 0.8
WORST_ON_BEAM = 0.4
LEAST_IN_FRONT = 0.97
MOST_BRIDGED = 0.2
BRIDGED_M = 0.1
"""Share of lines whose station is less certain than this; their neighbours hold them [m]."""
MOST_SPEED_M_S = 45.0
WORST_SPEED_M_S = 90.0
MOST_HOLES = 0.15
WORST_HOLES = 0.75
"""Share of cells that are empty between two neighbouring points of one surface."""
MOST_UNPLACED = 0.01
STATION_STEPS_S = 0.5
"""Speeds are measured over this time [s]."""
HOLE_CELLS = 8
"""Longer gaps are no holes of a surface."""
HOLE_M = 0.1
HOLE_SHARE = 0.02
"""Points on both sides of a hole differ in range by at most this [m], and this share of it for
every cell."""


class Judged:
    """Base of reconstructed drives with the answers of their checks."""

    __slots__ = ()
    findings: tuple[Finding, ...]

    @property
    def is_sure(self) -> bool:
        """Whether no check doubts the paths."""
        return all(finding.verdict is Verdict.FINE for finding in self.findings)


@dataclass(slots=True)
class CellCounts:
    """Counts of the cells of a pass, with its times and heights."""

    n_empty: int = 0
    """Cells that are empty between two neighbouring points of one surface."""
    n_filled: int = 0
    last_column: int = 0
    first_s: float = math.inf
    last_s: float = -math.inf
    """Times of the first and the last point [s]."""
    heights_m: list[float] = field(default_factory=list)
    """Height of the scanner above points near straight down, the median of every piece [m]."""

    def add_cells(self, line: I64, column: I64, range_m: F64) -> None:
        """Add the cells of points of whole lines, in the order of their times."""
        self.last_column = max(self.last_column, int(column.max(initial=0)))
        step = np.diff(column)
        near = np.minimum(range_m[1:], range_m[:-1])
        smooth = np.abs(np.diff(range_m)) < HOLE_M + HOLE_SHARE * near
        inside = (np.diff(line) == 0) & (step >= 1) & (step <= HOLE_CELLS) & smooth
        self.n_filled += int(np.count_nonzero(inside))
        self.n_empty += int(step[inside].sum()) - int(np.count_nonzero(inside))

    def add_times(self, time_s: F64) -> None:
        """Add the rising times of points."""
        if len(time_s):
            self.first_s = min(self.first_s, float(time_s[0]))
            self.last_s = max(self.last_s, float(time_s[-1]))

    def add_heights(self, height_m: F64) -> None:
        """Add heights of the scanner above points near straight down [m]."""
        if len(height_m):
            self.heights_m.append(float(np.median(height_m)))

    @property
    def height_m(self) -> float:
        """Return the height of the scanner above the ground [m]; NaN without points near down."""
        return float(np.median(self.heights_m)) if self.heights_m else math.nan

    @property
    def share_empty(self) -> float:
        """Return the share of empty cells within surfaces."""
        n = self.n_empty + self.n_filled
        return self.n_empty / n if n else 0.0


@dataclass(frozen=True, slots=True)
class PathFigures:
    """Figures of one pass, for ``prc info`` and the checks."""

    start_s: float
    """First time of the path [s]."""
    duration_s: float
    length_m: float
    speed_m_s: float
    """Median speed [m/s]."""
    top_speed_m_s: float
    residual_m: float
    share_on_beam: float
    share_in_front: float
    share_bridged: float
    """Share of the lines whose station only their neighbours hold."""
    sigma_m: float
    """Median standard deviation of the stations [m]."""
    share_holes: float
    turns_hz: float
    lines_hz: float
    shots_hz: float
    points_per_line: int
    tilt_deg: float
    """Tilt of the scan plane from the vertical [deg]."""
    points_s: tuple[float, float]
    """Times of the first and the last point [s]."""
    height_m: float = math.nan
    """Height of the scanner above the ground, median over points near down [m]; NaN = unknown."""
    scanner: int = 0
    """Number of the scanner that made the pass; 0 where there is one."""


def figures_of(track: Track, scan: Scan, counts: CellCounts) -> PathFigures:
    """Measure the path of a pass."""
    knots = track.knots
    hop = max(round(STATION_STEPS_S / float(np.median(np.diff(knots.time_s)))), 1)
    places = np.arange(0, len(knots.time_s), hop)
    if len(places) < 2:
        places = np.array([0, len(knots.time_s) - 1])
    moved = np.linalg.norm(np.diff(knots.position_m[places], axis=0), axis=1)
    speed = moved / np.diff(knots.time_s[places])
    sigma = np.sqrt((track.sigma_m**2).sum(axis=1))
    turning = scan.turning
    return PathFigures(
        start_s=float(knots.time_s[0]),
        points_s=(counts.first_s, counts.last_s),
        duration_s=float(knots.time_s[-1] - knots.time_s[0]),
        length_m=float(moved.sum()),
        speed_m_s=float(np.median(speed)),
        top_speed_m_s=float(speed.max()),
        residual_m=track.residual_m,
        share_on_beam=track.share_on_beam,
        share_in_front=track.share_in_front,
        share_bridged=float(np.mean(sigma > BRIDGED_M)),
        sigma_m=float(np.median(sigma)),
        share_holes=counts.share_empty,
        turns_hz=turning.hz,
        lines_hz=turning.line_hz,
        shots_hz=scan.shots_per_turn * turning.hz,
        points_per_line=scan.points_per_line,
        tilt_deg=math.degrees(math.acos(min(scan.cos_tilt, 1.0))),
        height_m=counts.height_m,
    )


@dataclass(slots=True)
class _Worst:
    """The worst answer of several questions."""

    finding: Finding | None = None

    def ask(
        self,
        figure: float,
        doubtful: float,
        against: float,
        problem: str,
        expected: str,
        hint: str,
    ) -> None:
        verdict = Verdict.FINE
        if figure > doubtful:
            verdict = Verdict.AGAINST if figure > against else Verdict.DOUBTFUL
        if self.finding is None or verdict > self.finding.verdict:
            self.finding = Finding(CHECK, verdict, problem, expected, hint)


_HINT_TRAJECTORY = "give the scanner's path instead: --range trajectory:FILE"


def judge(
    path: str,
    figures: list[PathFigures],
    n_unplaced: int,
    n_points: int,
) -> tuple[Finding, ...]:
    """Return the worst answer of all passes.

    Raises
    ------
    EvidenceError
        The path cannot be that of a scanner.
    """
    worst = _Worst()
    for passed in figures:
        when = f"{passed.start_s:.1f} s: " if len(figures) > 1 else ""
        worst.ask(
            passed.residual_m,
            MOST_RESIDUAL_M,
            WORST_RESIDUAL_M,
            f"{when}points are {passed.residual_m:.3f} m off their beams (median)",
            f"at most {MOST_RESIDUAL_M} m",
            f"the times may be rounded, or the points moved after the drive; {_HINT_TRAJECTORY}",
        )
        worst.ask(
            1.0 - passed.share_on_beam,
            1.0 - LEAST_ON_BEAM,
            1.0 - WORST_ON_BEAM,
            f"{when}{1.0 - passed.share_on_beam:.0%} of the points are on no beam of the scanner",
            f"at most {1.0 - LEAST_ON_BEAM:.0%}",
            "if several scanners are merged: --scanner DIMENSION; else " + _HINT_TRAJECTORY,
        )
        worst.ask(
            1.0 - passed.share_in_front,
            1.0 - LEAST_IN_FRONT,
            0.3,
            f"{when}{1.0 - passed.share_in_front:.0%} of the points are behind the scanner",
            f"at most {1.0 - LEAST_IN_FRONT:.0%}",
            _HINT_TRAJECTORY,
        )
        worst.ask(
            passed.top_speed_m_s,
            MOST_SPEED_M_S,
            WORST_SPEED_M_S,
            f"{when}the scanner moves at {passed.top_speed_m_s:.0f} m/s",
            f"at most {MOST_SPEED_M_S:.0f} m/s",
            "check the coordinates: their unit, and parts that were moved; " + _HINT_TRAJECTORY,
        )
        worst.ask(
            passed.share_bridged,
            MOST_BRIDGED,
            0.9,
            f"{when}{passed.share_bridged:.0%} of the lines do not show the place of the scanner "
            f"(within {BRIDGED_M} m)",
            f"at most {MOST_BRIDGED:.0%}",
            "open ground has too few objects; " + _HINT_TRAJECTORY,
        )
        worst.ask(
            passed.share_holes,
            MOST_HOLES,
            WORST_HOLES,
            f"{when}{passed.share_holes:.0%} of the cells on surfaces are empty",
            f"at most {MOST_HOLES:.0%}",
            "the cloud was thinned or filtered: classify the original cloud",
        )
    share = n_unplaced / max(n_points, 1)
    worst.ask(
        share,
        MOST_UNPLACED,
        0.5,
        f"{share:.1%} of the points belong to passes that no path fits",
        f"at most {MOST_UNPLACED:.0%}",
        "give a larger tile, or several tiles of the drive together",
    )
    finding = worst.finding
    assert finding is not None
    return (finding,)


def no_stations(path: str, turning: Turning) -> EvidenceError:
    """Return the error of points whose scan lines do not place the scanner."""
    problem = (
        f"the beam turns {turning.hz:.5g} times a second, "
        "but its lines are too short or too few to place the scanner"
    )
    hint = f"check the unit of x, y, z; give a larger part of the drive; or {_HINT_TRAJECTORY}"
    return EvidenceError(path, problem, hint)


def no_rotation(path: str, rotation: Rotation | None) -> EvidenceError:
    """Return the error of points that fit no turning beam."""
    reason = "too few points follow each other in time"
    if rotation is not None:
        reason = f"at the best rate, {rotation.hz:.4g} turns a second, points lie "
        reason += f"{rotation.residual_m:.2f} m off their beams, and "
        reason += f"{1 - rotation.in_front:.0%} of them behind the scanner"
    problem = f"no rotation of a scanner fits the points and their times: {reason}"
    hint = (
        "for several scanners: --scanner DIMENSION; "
        "for airborne scanners or coarse times: --range trajectory:FILE"
    )
    return EvidenceError(path, problem, hint)


def no_clock(path: str) -> EvidenceError:
    """Return the error of times without steps."""
    problem = "the times show no steps from shot to shot"
    return EvidenceError(path, problem, "give the points with the times of their shots")


def too_many_passes(path: str, n_passes: int, most: int) -> EvidenceError:
    """Return the error of a cloud with too many passes for one run."""
    problem = f"the times have gaps that part them into {n_passes} passes, expected at most {most}"
    return EvidenceError(path, problem, "classify fewer tiles together, or every tile by itself")
