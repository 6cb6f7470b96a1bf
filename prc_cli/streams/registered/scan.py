"""Puts every point of a registered cloud into its scan line and column, with its range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64
from prc_cli.streams.columns import spread_columns
from prc_cli.streams.registered.path import Knots
from prc_cli.streams.registered.rotation import Turning

TURN = 2.0 * math.pi
LEVEL_S = 10.0
"""Straight down is averaged over about this time: the platform rolls, the mirror drifts [s]."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Line, column and range of points."""

    line: I64
    """(n,) int64, scan line from the beginning of the path."""
    column: I64
    """(n,) int64, shot within the line, 0 to M - 1."""
    range_m: F64
    """(n,) float64, slant range [m]."""


@dataclass(frozen=True, slots=True)
class Scan:
    """Motion and rotation of one scanner during one pass."""

    knots: Knots
    turning: Turning
    shots_per_turn: float
    """Shots in a whole turn, not a whole number."""
    begin_rad: F64
    """(k,) float64, bearing at which lines begin, at every knot, slowly changing [rad]."""
    points_per_line: int
    """M."""
    angle_start_rad: float
    """Angle of column 0 from straight down [rad]."""
    cos_tilt: float
    """Cosine of the tilt of the scan plane from the vertical."""
    by_bearing: bool = False
    """Whether columns follow from measured bearings, because times are too coarse."""

    @property
    def step_rad(self) -> float:
        """Angle from column to column [rad]."""
        return TURN / self.shots_per_turn

    def stations(self, time_s: F64) -> F64:
        """Return the places of the scanner at times (n,), (n, 3) [m]."""
        columns = [
            np.interp(time_s, self.knots.time_s, self.knots.position_m[:, axis])
            for axis in range(3)
        ]
        return np.stack(columns, axis=1)

    def bearings(self, time_s: F64, offset_m: F64) -> F64:
        """Return the measured bearing of points in the frame of their time, (n,) [rad].

        Parameters
        ----------
        time_s
            (n,) float64 [s].
        offset_m
            (n, 3) float64, points less their stations [m].
        """
        knots = self.knots
        place = np.clip(np.searchsorted(knots.time_s, time_s) - 1, 0, len(knots.time_s) - 2)
        share = (time_s - knots.time_s[place]) / (knots.time_s[place + 1] - knots.time_s[place])
        part = np.clip(share, 0.0, 1.0)[:, None] * knots.relative_turns()[place]
        local = np.einsum("nji,nj->ni", knots.frame[place], offset_m)
        local = local - np.cross(part, local - 0.5 * np.cross(part, local))
        bearing: F64 = np.arctan2(local[:, 1], local[:, 0])
        return bearing

    def cells(self, time_s: F64, xyz_m: F64) -> Cells:
        """Return the cells of points of whole lines.

        Parameters
        ----------
        time_s
            (n,) float64, rising [s].
        xyz_m
            (n, 3) float64 [m].
        """
        offset = xyz_m - self.stations(time_s)
        range_m = np.sqrt(np.einsum("ni,ni->n", offset, offset))
        turns = self.phase(time_s)
        line = np.floor(turns).astype(np.int64)
        if not self.by_bearing:
            column = np.rint(self._shots_in_line(turns, line)).astype(np.int64)
            return Cells(line, column, range_m)
        begin_rad = np.interp(time_s, self.knots.time_s, self.begin_rad)
        measured = (self.bearings(time_s, offset) - begin_rad) / TURN
        # the turn of the measured bearing is that of the time
        turns = measured + np.rint(turns - measured)
        line = np.floor(turns).astype(np.int64)
        shot = ((turns - line) * self.shots_per_turn).astype(np.int64)
        column = np.minimum(shot, self.points_per_line - 1)
        # of two shots in one column, one moves to a free column beside it
        order = np.argsort(turns, kind="stable")
        column[order] = spread_columns(column[order], line[order])
        return Cells(line, column, range_m)

    def phase(self, time_s: F64) -> F64:
        """Return lines since the origin at times (n,), with their fraction."""
        turning = self.turning
        if turning.is_arc:
            return (time_s - turning.origin_s) * turning.line_hz
        begin_rad = np.interp(time_s, self.knots.time_s, self.begin_rad)
        return (turning.bearing(time_s) - begin_rad) / TURN

    def _shots_in_line(self, turns: F64, line: I64) -> F64:
        # shots are on a comb, wherever the line begins: near whole numbers after the shift
        turning = self.turning
        per_line = self.shots_per_turn * turning.hz / turning.line_hz
        shot = (turns - line) * per_line
        if not len(shot):
            return shot
        index = line - line[0]
        angle = TURN * shot
        cosine = np.bincount(index, np.cos(angle))
        sine = np.bincount(index, np.sin(angle))
        late = np.arctan2(sine, cosine) / TURN
        moved: F64 = shot - late[index]
        return moved


def down_bearings(knots: Knots) -> tuple[F64, float]:
    """Return the bearing of straight down at knots (k,) [rad], and the cosine of the tilt."""
    first = knots.frame[:, 2, 0]
    second = knots.frame[:, 2, 1]
    return np.unwrap(np.arctan2(-second, -first)), float(np.median(np.hypot(first, second)))


def slow_part(time_s: F64, angle_rad: F64) -> F64:
    """Return straight lines through the means of an angle over :data:`LEVEL_S`, (k,) [rad]."""
    duration_s = time_s[-1] - time_s[0]
    n_parts = max(round(duration_s / LEVEL_S), 1)
    if n_parts < 3:
        return np.full(len(time_s), float(np.mean(angle_rad)))
    share = (time_s - time_s[0]) / duration_s
    part = np.minimum((share * n_parts).astype(np.int64), n_parts - 1)
    count = np.bincount(part, minlength=n_parts)
    known = count > 0
    middle_s = np.bincount(part, time_s, n_parts)[known] / count[known]
    mean_rad = np.bincount(part, angle_rad, n_parts)[known] / count[known]
    slow: F64 = np.interp(time_s, middle_s, mean_rad)
    return slow


def make_scan(
    knots: Knots,
    turning: Turning,
    shots_per_turn: float,
    *,
    by_bearing: bool,
) -> Scan:
    """Choose the begin of lines, and M.

    Whole turns begin straight up, with the fewest returns. Arcs begin at their first shot.
    """
    down, cos_tilt = down_bearings(knots)
    level = slow_part(knots.time_s, down)
    if turning.is_arc:
        begin = np.zeros(len(level))
        n_shots = shots_per_turn * turning.hz / turning.line_hz
        start = -float(np.mean(level))
    else:
        begin = level + math.pi
        n_shots = shots_per_turn
        start = -math.pi
    points_per_line = max(math.ceil(n_shots - 0.01), 1)
    return Scan(knots, turning, shots_per_turn, begin, points_per_line, start, cos_tilt, by_bearing)
