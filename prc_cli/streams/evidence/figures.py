"""A sample of the lines of a stream, and how alike neighbouring shots and lines are.

Likeness is the median difference of the logarithms of two ranges, so that near and far surfaces
count alike: 0 = equal, about 0.5 to 1 for ranges picked at random from a street or a forest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, Mask

N_WINDOWS = 8
"""Windows kept; half of them is the least once a stream is long."""
WINDOW_SHOTS = 1 << 17
"""Approximate shots of a window."""
LEAST_LINES = 32
MOST_LINES = 4096
"""Lines of a window: enough to see a period, and not the whole of a stream of short lines."""
MOST_SHOTS = 1 << 22
"""Most shots of a window; longer lines give smaller windows."""


@dataclass(frozen=True, slots=True)
class Window:
    """Consecutive lines of a scanner."""

    first_line: int
    range_m: F32
    """(lines, M) float32, ranges [m]; NaN = missing."""


class LineSample:
    """Collects the windows of one scanner."""

    def __init__(self, points_per_line: int) -> None:
        self._points_per_line = points_per_line
        usual = min(max(WINDOW_SHOTS // points_per_line, LEAST_LINES), MOST_LINES)
        self._n_lines = max(min(usual, MOST_SHOTS // points_per_line), 1)
        """Lines of a window."""
        self._stride = 1
        """Windows from one that is kept to the next."""
        self._first: int | None = None
        """Number of the first line of the stream."""
        self._rows: dict[int, F32] = {}
        """Ranges by number of the window."""
        self._n_filled: dict[int, int] = {}
        """Lines of every window that were read."""
        self.n_full = 0
        """Times that the sample has been full."""

    def add(self, block: ScanBlock) -> None:
        """Add the next lines of the scanner."""
        if self._first is None:
            self._first = block.first_line
        first = block.first_line - self._first
        stop = first + block.n_lines
        line = first
        while line < stop:
            number = line // self._n_lines
            if number % self._stride == 0:
                end = min((number + 1) * self._n_lines, stop)
                self._add_rows(number, line, block.range_m[line - first : end - first])
            else:
                next_kept = -(-number // self._stride) * self._stride
                end = min(next_kept * self._n_lines, stop)
            line = end

    def _add_rows(self, number: int, line: int, rows: F32) -> None:
        """Add lines of a window; a full sample keeps every other window."""
        if number not in self._rows:
            if len(self._rows) == N_WINDOWS:
                self._stride *= 2
                for dropped in [kept for kept in self._rows if kept % self._stride]:
                    del self._rows[dropped], self._n_filled[dropped]
                if number % self._stride:
                    return
            self._rows[number] = np.empty((self._n_lines, self._points_per_line), np.float32)
        first_row = line - number * self._n_lines
        self._rows[number][first_row : first_row + len(rows)] = rows
        self._n_filled[number] = first_row + len(rows)
        if len(self._rows) == N_WINDOWS and self._n_filled[number] == self._n_lines:
            self.n_full += 1

    def windows(self) -> tuple[Window, ...]:
        """Return the windows in the order of the stream; the last may be shorter."""
        first = self._first or 0
        return tuple(
            Window(first + number * self._n_lines, rows[: self._n_filled[number]])
            for number, rows in sorted(self._rows.items())
        )


SHOTS_EACH = 1 << 15
"""Approximate shots of a window that are compared at a lag."""
MOST_RUNS = 4
"""Runs of lines that are compared."""
LEAST_PAIRS = 1000
"""Fewer pairs of ranges tell nothing."""
LINE_LAGS = 4
"""Lines compared with the 1st to the 4th line after them."""
MOVED = 0.9
"""Share of the pairs that are more alike than those that tell whether anything moves."""
SMOOTH = 0.01
"""Ranges that differ by less than a hundredth lie on the same surface."""
ROUGH = 0.05
AS_FAR = 0.2
LEAST_ROUGH = 100
"""Shots that are this much off the mean of their neighbours are leaves or edges.

They are seen again where the next line is nearer than so much of that; fewer tell nothing."""
LIKE = 0.02
"""Shots are as far as one another within this share."""
MOST_ALONE = 0.5
"""Flakes are fewer than this share of all shots."""
AROUND_SHOT = tuple(
    (line, column) for line in (-1, 0, 1) for column in (-1, 0, 1) if line or column
)
"""Lines and columns of the shots around one."""
_SEED = 7


@dataclass(frozen=True, slots=True)
class Figures:
    """How alike shots are, by their distance in the stream; NaN = too few pairs."""

    random: float
    """Of ranges picked at random."""
    shot: tuple[float, float]
    """Of a shot and the next, and of a shot and the one after that."""
    line: tuple[float, ...]
    """Of a line and the 1st to 4th line after it, in the same column."""
    reversed_line: float
    """Of a line and the next one, turned round."""
    moved: tuple[float, float]
    """Of neighbouring lines and of lines far apart: the least of the tenth that is least alike."""
    noise_m: float
    """Range noise [m]; larger if hardly any surface is smooth.

    From the twentieth of the shots that lie nearest to
    the middle of their neighbours."""
    roughness: float
    """Median distance of a range from the middle of its two neighbours in the line."""
    again: float
    """Share of the shots unlike their neighbours in the line that the next line sees again."""
    lonely_missing: float
    """Share of missing shots among those between two equal ranges on either side."""
    n_between: int
    """Number of such shots."""


def likeness(first: NDArray[Any], second: NDArray[Any], share: float = 0.5) -> float:
    """Return the median difference of two arrays of logarithms, or another quantile.

    NaN with too few pairs.
    """
    off = np.abs(first - second).ravel()
    off = off[np.isfinite(off)]
    if len(off) < LEAST_PAIRS:
        return float("nan")
    rank = int(share * (len(off) - 1))
    return float(np.partition(off, rank)[rank])


def middle(values: Iterable[float]) -> float:
    """Return the median of the values that are known, NaN if none is."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def figures_of(windows: tuple[Window, ...]) -> Figures:
    """Measure a sample of lines."""
    ranges = spread(windows)
    logs = [np.log(rows) for rows in ranges]
    by_lag = [
        middle(likeness(rows[:-lag], rows[lag:]) for rows in logs)
        for lag in range(1, LINE_LAGS + 1)
    ]
    # runs of the first half of the stream, each with one of the second half
    half = len(logs) // 2
    far_apart = []
    for early, late in zip(logs[: len(logs) - half], logs[half:], strict=True):
        if early is not late:
            far_apart.append(likeness(early[: len(late)], late[: len(early)], MOVED))
    between = [_between_smooth(rows) for rows in logs]
    n_between = sum(counts.n for counts in between)
    lonely_missing = float("nan")
    if n_between:
        lonely_missing = sum(counts.n_missing for counts in between) / n_between
    return Figures(
        random=middle(_random_likeness(rows) for rows in logs),
        shot=(
            middle(_shot_likeness(rows, 1) for rows in logs),
            middle(_shot_likeness(rows, 2) for rows in logs),
        ),
        line=tuple(by_lag),
        reversed_line=middle(likeness(rows[:-1], rows[1:, ::-1]) for rows in logs),
        moved=(
            middle(likeness(rows[:-1], rows[1:], MOVED) for rows in logs),
            middle(far_apart),
        ),
        noise_m=middle(
            likeness(rows[:, 1:-1], _neighbours_mean(rows), LEAST_OFF) / LEAST_OFF_SIGMA
            for rows in ranges
        ),
        roughness=middle(likeness(rows[:, 1:-1], _neighbours_mean(rows)) for rows in logs),
        again=middle(_share_again(rows) for rows in logs),
        lonely_missing=lonely_missing,
        n_between=n_between,
    )


def _neighbours_mean(rows: NDArray[Any]) -> NDArray[Any]:
    """Return the mean of the two neighbours in the line, (lines, M - 2)."""
    mean: NDArray[Any] = (rows[:, :-2] + rows[:, 2:]) / 2
    return mean


def without_lonely(windows: tuple[Window, ...]) -> tuple[Window, ...] | None:
    """Return windows without shots that are unlike all eight around.

    None if these are many.

    Where shots are shuffled, or numbers misread, most shots are alone: there is nothing to leave
    out.
    """
    cleared = []
    n_lonely = 0
    n_known = 0
    for window in windows:
        logs = np.pad(np.log(window.range_m), 1, constant_values=np.nan)
        n_lines, m = window.range_m.shape
        has_like = np.zeros((n_lines, m), np.bool_)
        for line, column in AROUND_SHOT:
            neighbours = logs[1 + line : 1 + line + n_lines, 1 + column : 1 + column + m]
            has_like |= np.abs(neighbours - logs[1:-1, 1:-1]) < LIKE
        is_known = np.isfinite(window.range_m)
        is_lonely = is_known & ~has_like
        n_lonely += int(np.count_nonzero(is_lonely))
        n_known += int(np.count_nonzero(is_known))
        range_m = np.where(is_lonely, np.float32(np.nan), window.range_m)
        cleared.append(replace(window, range_m=range_m))
    return tuple(cleared) if n_lonely < MOST_ALONE * n_known else None


def spread(windows: tuple[Window, ...]) -> list[F32]:
    """Return the ranges of a few runs of lines, even over the stream.

    A short stream is cut into as many.
    """
    n = min(len(windows), MOST_RUNS)
    n_runs_each = -(-MOST_RUNS // max(n, 1))
    runs = []
    for i in range(n):
        rows = windows[round(i * (len(windows) - 1) / max(n - 1, 1))].range_m
        step = max(len(rows) // n_runs_each, 2 * LINE_LAGS)
        n_lines = max(SHOTS_EACH // rows.shape[1], LINE_LAGS) + LINE_LAGS
        for first in range(0, len(rows), step):
            run = rows[first : first + min(step, n_lines)]
            if len(run) > LINE_LAGS:
                runs.append(run)
    return runs


def _shot_likeness(rows: F32, lag: int) -> float:
    flat = rows.ravel()
    return likeness(flat[:-lag], flat[lag:])


def lag_likeness(windows: tuple[Window, ...], lag: int) -> float:
    """Return the likeness of shots that are ``lag`` shots apart; NaN with too few pairs.

    >>> saw = np.tile(np.linspace(5, 50, 100, dtype=np.float32), 64).reshape(64, 100)
    >>> lag_likeness((Window(0, saw),), 100) < lag_likeness((Window(0, saw),), 99)
    True
    """
    return middle(_shot_likeness(np.log(rows), lag) for rows in spread(windows))


def _random_likeness(rows: F32) -> float:
    known = rows[np.isfinite(rows)]
    if len(known) < LEAST_PAIRS:
        return float("nan")
    return likeness(known, np.random.default_rng(_SEED).permutation(known))


def _share_again(rows: F32) -> float:
    """Return the share of the rough shots whose next line is as far."""
    rough = np.abs(rows[:-1, 1:-1] - _neighbours_mean(rows[:-1]))
    off = np.abs(rows[1:, 1:-1] - rows[:-1, 1:-1])
    with np.errstate(invalid="ignore"):
        is_counted = (rough > ROUGH) & np.isfinite(off)
        n_again = np.count_nonzero(is_counted & (off < AS_FAR * rough))
    n_counted = np.count_nonzero(is_counted)
    return n_again / n_counted if n_counted >= LEAST_ROUGH else float("nan")


LEAST_OFF = 0.05
LEAST_OFF_SIGMA = 0.0627 * 1.5**0.5
"""A twentieth of normal deviations is within 0.0627 standard deviations.

The middle of two neighbours has noise too.
"""


class _BetweenSmooth(NamedTuple):
    """Counts of shots between two smooth neighbours on either side."""

    n: int
    n_missing: int


def _between_smooth(rows: F32) -> _BetweenSmooth:
    # a shot and two on either side
    if rows.shape[1] < 5:
        return _BetweenSmooth(0, 0)
    left = rows[:, :-4]
    near_left = rows[:, 1:-3]
    shot = rows[:, 2:-2]
    near_right = rows[:, 3:-1]
    right = rows[:, 4:]
    with np.errstate(invalid="ignore"):
        is_smooth: Mask = np.abs(near_left - near_right) < SMOOTH
        is_smooth &= np.abs(left - near_left) < SMOOTH
        is_smooth &= np.abs(right - near_right) < SMOOTH
    n_missing = int(np.count_nonzero(is_smooth & np.isnan(shot)))
    return _BetweenSmooth(int(np.count_nonzero(is_smooth)), n_missing)


def fold(windows: tuple[Window, ...], points_per_line: int) -> float:
    """Return how alike lines far apart are if lines had another length, NaN if there are too few.

    The stream behind each window is cut into lines of the given length, counted from the start of
    the stream. With the right length, what moves with the scanner (its dead angle, the ground)
    keeps its columns all along; with a length that is off by one it turns through all of them.
    """
    step = max(points_per_line // FOLD_COLUMNS, 1)
    profiles: list[F64] = []
    for window in pieces(windows):
        flat = window.range_m.ravel()
        first = -(window.first_line * window.range_m.shape[1]) % points_per_line
        n_lines = min((len(flat) - first) // points_per_line, FOLD_LINES)
        if n_lines < FOLD_LINES // 2:
            continue
        lines = flat[first : first + n_lines * points_per_line].reshape(n_lines, points_per_line)
        profiles.append(_profile(lines[:, ::step]))
    pairs = itertools.combinations(profiles, 2)
    return middle(_profile_off(early, late) for early, late in pairs)


def pieces(windows: tuple[Window, ...]) -> list[Window]:
    """Cut a few lines at uneven distances.

    At even ones a wrong length may shift them by whole turns.
    """
    n_each = -(-FOLD_PIECES // max(len(windows), 1))
    n_piece = FOLD_LINES + 1
    places: list[Window] = []
    for window in windows:
        n_lines = len(window.range_m) // n_each
        spare = max(n_lines - n_piece, 0)
        for i in range(n_each):
            start = i * n_lines + int(spare * (GOLDEN * (len(places) + 1) % 1.0))
            rows = window.range_m[start : start + n_piece]
            if len(rows) == n_piece:
                places.append(Window(window.first_line + start, rows))
    return places


GOLDEN = (5**0.5 - 1) / 2
"""Multiples of the golden ratio spread unevenly and never meet."""
FOLD_PIECES = 8
"""Places along the stream that are compared, if it is long enough."""
FOLD_LINES = 8
"""Lines of a window that are folded."""
FOLD_COLUMNS = 512
"""Approximate columns that are compared."""
LEAST_KNOWN = 32
"""Columns with a range in either of two profiles, to compare them."""
MISSING_OFF = 1.0
"""Difference of a column that is missing in one of two profiles."""


@dataclass(frozen=True, slots=True)
class Turned:
    """A place of the stream from which on all columns are shifted."""

    line: int
    """First line of the piece behind it."""
    share: float
    """Shift, as a share of a line, -0.5 to 0.5."""
    gain: float
    """Difference of the pieces with that shift, as a share of that without."""
    distance: int
    """Lines from the piece before to the one behind."""
    n_places: int = 1
    """Number of places where a shift helps as much."""


def most_turned(windows: tuple[Window, ...]) -> Turned | None:
    """Return the place along the stream where a shift of all columns helps most.

    None for short streams.
    """
    places = pieces(windows)
    if not places:
        return None
    turns: list[Turned] = []
    step = max(places[0].range_m.shape[1] // TURN_COLUMNS, 1)
    profiles = [_profile(place.range_m[:FOLD_LINES, ::step]) for place in places]
    n = len(profiles[0])
    for i in range(len(places) - 1):
        offs = _offs_of_shifts(profiles[i], profiles[i + 1])
        if not offs[0] > 0:
            continue
        best = int(np.nanargmin(offs))
        shift = best if best <= n // 2 else best - n
        if abs(shift / n) < LEAST_TURN:
            continue
        line = places[i + 1].first_line
        turn = Turned(
            line=line,
            share=-(shift / n),
            gain=float(offs[best] / offs[0]),
            distance=line - places[i].first_line,
        )
        turns.append(turn)
    if not turns:
        return None
    clearest = min(turns, key=lambda turn: turn.gain)
    return replace(clearest, n_places=sum(turn.gain < TURNED for turn in turns))


def _offs_of_shifts(first: F64, second: F64) -> F64:
    """Return the difference of two profiles, the second shifted by every number of columns.

    NaN with too few ranges.
    """
    column = np.arange(len(first))
    shifted = second[(column - column[:, None]) % len(first)]
    known = np.isfinite(first) | np.isfinite(shifted)
    n_known = np.count_nonzero(known, axis=1)
    total: F64 = np.where(known, _column_offs(first, shifted), 0.0).sum(axis=1)
    return np.where(n_known >= LEAST_KNOWN, total / np.maximum(n_known, 1), np.nan)


def _column_offs(first: F64, second: F64) -> F64:
    """Return the difference of every column, at most :data:`MISSING_OFF`."""
    off = np.abs(first - second)
    return np.minimum(np.where(np.isfinite(off), off, MISSING_OFF), MISSING_OFF)


TURN_COLUMNS = 256
"""Approximate columns that are compared."""
TURNED = 0.65
"""With the right shift places along the stream differ by less than this part.

At least 0.8 in all scans at hand, 0.07
to 0.55 where a buffer of shots was lost."""
LEAST_TURN = 0.03
"""Smaller shifts, as a share of a line: surfaces that pass by shift as much."""


def _profile(lines: F32) -> F64:
    """Return the logarithm of the median range of every column, NaN where most lines miss it."""
    n_known = np.count_nonzero(np.isfinite(lines), axis=0)
    ordered = np.sort(lines, axis=0)  # NaN sorts last
    middle_row = np.maximum(n_known - 1, 0) // 2
    median: F64 = ordered[middle_row, np.arange(lines.shape[1])].astype(np.float64)
    return np.where(2 * n_known > len(lines), np.log(median), np.nan)


def _profile_off(first: F64, second: F64) -> float:
    """Return the mean difference of two profiles; NaN with too few columns."""
    known = np.isfinite(first) | np.isfinite(second)
    if np.count_nonzero(known) < LEAST_KNOWN:
        return float("nan")
    return float(_column_offs(first[known], second[known]).mean())


@dataclass(frozen=True, slots=True)
class Seen:
    """One scanner of a stream, as far as it was read."""

    info: StreamInfo
    scanner: int
    windows: tuple[Window, ...]
    """Lines spread over what was read, in order."""
    n_lines: int = 0
    n_shots: int = 0
    """Cells read of all scanners, missing shots included."""
    n_missing: int = 0
    """Of all scanners."""
    tally: ReadTally = field(default_factory=ReadTally)
    """Counts of the reader, of all scanners."""
    angle_rad: F64 | None = None
    """(M,) float64, scan angle of every column [rad]; None = unknown."""
    beam_rad: F64 | None = None
    """(M,) float64, angle of every column from straight down as it is used [rad].

    None = unknown or not needed.
    """
    most_noise_m: float = math.inf
    """Most range noise that the method tolerates [m]."""
    has_rings: bool = False
    """Whether columns are known to be the rings of a spinning scanner."""
    least_rings: int = 0
    """With fewer rings the method labels less well."""
    cone_spread_rad: tuple[float, float] | None = None
    """Spread of elevation within rings, as used and in the best frame [rad]."""

    @property
    def points_per_line(self) -> int:
        """M, shots in a scan line."""
        return self.windows[0].range_m.shape[1] if self.windows else self.info.points_per_line
