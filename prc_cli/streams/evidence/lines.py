"""Checks of shots and lines by their ranges alone.

In firing order, lines as long as they are said to be.

PRC compares a shot with its neighbours in the line and in the lines before and after (Lehtola et
al. 2019, section II). All that follows asks whether these neighbours are alike, as consecutive
shots of a scanner are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from prc_cli.core.files import open_to_read
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, U64
from prc_cli.formats.registry import is_dump
from prc_cli.streams.evidence.figures import (
    LEAST_PAIRS,
    SMOOTH,
    TURNED,
    Figures,
    Seen,
    Turned,
    fold,
    lag_likeness,
    likeness,
)
from prc_cli.streams.evidence.periods import WEAK_PERIOD, estimate_points_per_line
from prc_cli.streams.evidence.table import verdict_of

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
    """Ask whether lines come twice; ``of_recording`` is what the recording itself holds twice."""
    n = repeats.n_repeated
    if of_recording:
        hint = "the first of each was classified, the others have no class: record every topic or port once"
        return Finding("repeated-lines", Verdict.DOUBTFUL, of_recording, "each once", hint)
    measured = f"{'about ' if n else ''}{n:,} lines are copies of earlier lines, shot by shot"
    hint = "leave out the part that is there twice"
    return Finding(
        "repeated-lines",
        verdict_of(doubtful=n >= LEAST_REPEATED),
        measured,
        f"fewer than {LEAST_REPEATED}",
        hint,
    )


MISREAD_CHECKS = ("ranges", "shot-order")
"""Checks that a wrong reading fails."""
SAMPLE_BYTES = 1 << 18
"""Read from the middle, where a scanner surely stands in its scene."""
TYPES = ("f4", "f8", "u2", "u4", "i4")
SCALES_M = (1.0, 0.001, 0.01)
"""Metres, millimetres, centimetres."""
MEDIAN_M = 8.0
USUAL_M = (0.5, 80.0)
FARTHEST_M = 5000.0
"""The median range of streets and forests, about; that of any scan; the farthest range of any."""
MOST_ODD = 0.01
"""Share of numbers that are no range, nor stand for a missing one (0 or NaN)."""
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
    """Whether zeros stand for missing shots."""

    def options(self) -> str:
        """Return what to type; what every dump is taken for is left out.

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
    """Return the unit in which numbers would be ranges, and their likeness, infinite where they are none."""
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

    Else those before the first number.
    """
    if points_per_line is not None:
        over = size % (item_bytes * points_per_line)
        if over % item_bytes == phase and over <= MOST_HEADER_BYTES:
            return over
    return phase


def with_other_reading(finding: Finding, path: str, points_per_line: int | None) -> Finding:
    """Say in a finding against a dump how to read it, if there is a way."""
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


LEAST_LINES = 24
"""Shorter streams are not judged."""
ORDER_DOUBTFUL = 0.3
ORDER_AGAINST = 0.7
"""Likeness of neighbouring shots, as a share of that of random shots.

At most 0.05 in all scans at hand, 1 in shuffled
ones and in misread numbers."""
LINE_DOUBTFUL = 0.12
LINE_AGAINST = 0.4
"""The same of neighbouring lines: at most 0.03 in all scans at hand."""
SECOND = 0.5
"""A second neighbour this much more like a shot than the first.

Every other shot or line is of something else. In scans
the second is less alike than the first."""
ALIKE = 0.005
"""Neighbouring lines this much alike are no lines of different scanners.

Where a turn has a number of shots and a half,
every second line has the same angles, and differs by less than the others even while standing
(0.001)."""
HALF = 2.0
"""The next line turned round is as alike as the line after it, within this factor.

Every second line runs back.
"""
FAR_OFF = 1.5
"""A period so many times longer or shorter than M makes lines of several turns, or of a part of one."""
AS_ALIKE = 1.25
"""Shots a period apart must be as alike as those M apart within this factor.

At most 1.05 in 32 scans read with 2 to
100 times their M, or a half to a tenth of it; in a room half a turn is a period, and not as
alike."""
MOST_UNLIKE = 0.06
"""Likeness of the lines of a period where M cannot be compared: at most 0.02 in the same scans."""
PERIOD_SHOTS = 1 << 17
"""Shots in which a period is looked for."""
FOLD_DOUBTFUL = 1.05
FOLD_AGAINST = 1.2
"""How much better another line length must agree along the stream.

At most 0.9 in all scans at hand, with M off by one
1.16 to 7."""
SHIFTS = 400
"""A scene that shifts from line to line moves the period by a share of it up to this."""
FOLD_REACH = 4
"""Line lengths tried on either side of M."""
TURNED_AGAINST = 0.45
"""Where a buffer of shots was lost, places along the stream mostly differ by less with the right shift."""
SHIFT_NEAR = 0.012
"""A shift is known to this share of a line."""
NEXT_CLEAR = 0.8
"""Neighbouring lines of the right length differ by so much less than those of any other.

0.004 to 0.63 in 22 frames of
spinning scanners and 6 drives."""
FRAME_SHOTS = 160
"""Lines of at most so many shots may be those of a spinning scanner, of 128 rings at most."""
FAN_DEG = 60.0
"""Beams of a spinning scanner lie closer.

Its lines far apart look other ways, and have nothing in common.
"""
FOLD_SHORT = 1.25
"""The first limit for streams of fewer lines than a twelfth of M."""
FOLD_LONG = 12
"""Lines of a stream, as a part of M.

With M off by one all columns turn by 30 deg in so many, and before that moving
things shift as much."""
FOLD_RANDOM = 0.8
FOLD_NOTHING = 0.97
"""Places along the stream that differ more than this have nothing in common, not even the ground.

At most 0.6 in all
scans at hand, 0.5 to 1 where lines and columns are exchanged."""
MOVED_SAME = 1.6
MOVED_AGAINST = 1.4
"""Lines far apart must differ by so much more than neighbours.

At least 2.1 in all scans at hand, 0.8 to 1.2 with
shuffled lines and while standing."""
MOVED_NOISE = 15.0
"""Changes of less than so many times the roughness of surfaces, in the tenth that changes most, may be noise and stray
shots: at least 18 with shuffled lines, at most 2 while standing."""
SEEN_AGAIN = 0.85
"""Of leaves and edges the next line sees .27 to .53 again in real scans, .7 at 1 cm a line with columns 1.3 degrees
apart, and .97 where each line comes 20 times."""
STANDING_LINES = 200
"""Lines of a stream before standing is told: a stop at a light is none."""
LONELY = 0.085
"""Share of missing shots amid smooth surfaces.

At most 0.06 in all scans at hand, 0.1 if a tenth of them is lost.
"""

_ORDER_HINT = (
    "check the layout (byte order, types, header bytes), or sort the shots as they were fired"
)


def _share_of_random(difference: float, figures: Figures) -> float:
    """Return a difference beside that of random shots.

    NaN where all shots see one surface at one distance.
    """
    return difference / figures.random if figures.random >= SMOOTH else math.nan


def check_shot_order(figures: Figures) -> Finding | None:
    """Ask whether consecutive shots see the same surfaces."""
    ratio = _share_of_random(figures.shot[0], figures)
    if not np.isfinite(ratio):
        return None
    name = "shot-order"
    times = "" if f"{ratio:.2g}" == "1" else f"{ratio:.2g} times "
    measured = f"ranges of neighbouring shots differ {times}as much as those of random shots"
    expected = f"below {ORDER_DOUBTFUL:g}"
    if figures.shot[1] < SECOND * figures.shot[0]:
        measured = f"every second shot is more like a shot ({figures.shot[1]:.2g}) than the next ({figures.shot[0]:.2g})"
        hint = "two scanners or several returns alternate: split them with --scanner, or give the return number"
        return Finding(name, Verdict.AGAINST, measured, "neighbours more alike than others", hint)
    verdict = verdict_of(doubtful=ratio >= ORDER_DOUBTFUL, against=ratio >= ORDER_AGAINST)
    return Finding(name, verdict, measured, expected, _ORDER_HINT)


def check_line_length(seen: Seen, figures: Figures, turned: Turned | None) -> Finding | None:
    """Ask whether lines repeat after M shots.

    Where all columns ``turned`` at one place, M is right.
    """
    m = seen.points_per_line
    first = figures.line[0]
    if figures.random < SMOOTH:
        return None
    ratio = _share_of_random(first, figures) if seen.n_lines >= LEAST_LINES else math.nan
    if ratio >= ALIKE and (step := _step_alike(figures)):
        return _alternating(seen, figures, step)
    period = _period(seen)
    true = (
        _exact(seen, period) if period is not None and max(m / period, period / m) > FAR_OFF else m
    )
    if true != m and _is_as_alike(seen, true):
        return _repeating(seen, true)
    if not np.isfinite(ratio):
        return None
    name = "line-length"
    expected = f"lines of M = {m} shots that are alike"
    near = [m + off for off in range(-FOLD_REACH, FOLD_REACH + 1) if m + off > 1]
    next_length = _next_alike(seen, near) if m <= FRAME_SHOTS else None
    if next_length is not None and next_length != m:
        measured = f"the next line is {next_length} shots later, not {m}"
        return Finding(name, Verdict.AGAINST, measured, expected, *_remedy(seen, next_length))
    if is_shifted(turned, m) or (next_length == m and _is_fan(seen)):
        measured = f"neighbouring lines differ {ratio:.2g} times as much as random shots"
        return Finding(name, Verdict.FINE, measured, f"below {LINE_DOUBTFUL:g}")
    folded = {length: fold(seen.windows, length) for length in near}
    is_unlike = ratio >= LINE_DOUBTFUL or not folded[m] < FOLD_RANDOM
    if is_unlike and period is not None and abs(period - m) > FOLD_REACH:
        return _repeating(seen, period)
    others = (length for length in folded if length != m)
    better = min(others, key=lambda length: _or_inf(folded[length]))
    gain = folded[m] / folded[better] if np.isfinite(folded[m]) and folded[better] > 0 else math.nan
    is_long = seen.n_lines * FOLD_LONG >= m
    if gain >= (FOLD_DOUBTFUL if is_long else FOLD_SHORT):
        better = _next_alike(seen, list(folded)) or better
    if better != m and gain >= (FOLD_DOUBTFUL if is_long else FOLD_SHORT):
        measured = f"along the stream lines of {better} shots agree {gain:.2g} times better than lines of {m}"
        verdict = verdict_of(doubtful=True, against=gain >= FOLD_AGAINST and is_long)
        expected = f"no length that agrees better by {FOLD_DOUBTFUL:g}"
        return Finding(name, verdict, measured, expected, *_remedy(seen, better))
    hint = "check -M and --lines, and whether lines and columns are exchanged"
    if folded[m] > FOLD_RANDOM:
        measured = f"lines far apart have nothing in common, not even the ground: they differ by {folded[m]:.2g}"
        verdict = verdict_of(doubtful=True, against=folded[m] > FOLD_NOTHING)
        return Finding(name, verdict, measured, f"at most {FOLD_RANDOM:g}", hint)
    measured = f"neighbouring lines differ {ratio:.2g} times as much as random shots"
    expected = f"below {LINE_DOUBTFUL:g}"
    verdict = verdict_of(doubtful=ratio >= LINE_DOUBTFUL, against=ratio >= LINE_AGAINST)
    return Finding(name, verdict, measured, expected, hint if verdict else "")


def _is_fan(seen: Seen) -> bool:
    """Return whether the beams are known to be the rings of a spinning scanner."""
    if seen.has_rings:
        return True
    angle_rad = seen.angle_rad if seen.angle_rad is not None else seen.beam_rad
    return angle_rad is not None and float(np.ptp(np.unwrap(angle_rad))) < math.radians(FAN_DEG)


def _next_alike(seen: Seen, lengths: list[int]) -> int | None:
    """Return the length at which lines are clearly more like the next one than at all others, if one is."""
    off = {length: lag_likeness(seen.windows, length) for length in lengths}
    first, second = sorted(off, key=lambda length: _or_inf(off[length]))[:2]
    return first if off[first] < NEXT_CLEAR * off[second] else None


def is_shifted(turned: Turned | None, points_per_line: int) -> bool:
    """Tell whether all columns shift at a single place.

    a wrong M shifts them from every line to the next.
    """
    if turned is None or turned.gain >= TURNED or turned.n_places > 1:
        return False
    n_shots = abs(turned.share) * points_per_line
    near = SHIFT_NEAR * points_per_line
    return all(abs(n_shots - wrong * turned.distance) > near for wrong in range(1, FOLD_REACH + 1))


def check_columns_along(seen: Seen, turned: Turned | None) -> Finding | None:
    """Ask whether all columns keep their place along the stream."""
    if turned is None:
        return None
    expected = f"at least {TURNED:g} times"
    if not is_shifted(turned, seen.points_per_line):
        measured = f"no single shift of all columns makes places along the stream differ less than {turned.gain:.2g} times"
        return Finding("columns-along", Verdict.FINE, measured, expected)
    n_shots = round(abs(turned.share) * seen.points_per_line)
    measured = f"before line {turned.line} all columns shift by {n_shots} shots ({turned.gain:.2g} times the difference)"
    hint = "shots were lost or added there: split the file, or restore them"
    verdict = verdict_of(doubtful=True, against=turned.gain < TURNED_AGAINST)
    return Finding("columns-along", verdict, measured, expected, hint)


def check_noise(seen: Seen, figures: Figures) -> Finding | None:
    """Ask whether the range noise is one that the method stands."""
    if not np.isfinite(seen.most_noise_m) or not np.isfinite(figures.noise_m):
        return None
    measured = f"ranges have noise of about {figures.noise_m:.3f} m"
    hint = "the thresholds of this method are for less: widen them (prc calibrate), or take another method"
    verdict = verdict_of(doubtful=figures.noise_m > seen.most_noise_m)
    return Finding("range-noise", verdict, measured, f"at most {seen.most_noise_m:g} m", hint)


def _remedy(seen: Seen, points_per_line: int) -> tuple[str, str]:
    """Return the hint and the option that give lines another length."""
    info = seen.info
    if info.line_rule == "time" and info.line_hz is not None:
        line_hz = info.line_hz * seen.points_per_line / points_per_line
        option = f"--lines time:{line_hz:.9g} -M {points_per_line}"
        return f"give {option}", option
    if info.line_rule in ("dimension", "angle-wrap"):
        option = f"--lines fixed --columns order -M {points_per_line}"
        return f"number whole lines; if no shot is left out: {option}", option
    option = f"-M {points_per_line}"
    return f"give {option}", option


def _repeating(seen: Seen, period: int) -> Finding:
    m = seen.points_per_line
    measured = f"the ranges repeat after {period} shots, not after {m}"
    expected = f"lines of M = {m} shots that are alike"
    return Finding("line-length", Verdict.AGAINST, measured, expected, *_remedy(seen, period))


def _step_alike(figures: Figures) -> int:
    """Return how many lines later comes one that is far more alike than the next.

    0 where none is.
    """
    steps = (
        step
        for step in range(2, len(figures.line) + 1)
        if figures.line[step - 1] < SECOND * figures.line[0]
    )
    return next(steps, 0)


def _alternating(seen: Seen, figures: Figures, step: int) -> Finding:
    """Tell lines that alternate: scanned to and fro, of several scanners, or M too small."""
    if step == 2 and figures.reversed_line <= HALF * figures.line[1]:
        measured = "every second line runs the other way"
        return Finding(
            "line-length",
            Verdict.AGAINST,
            measured,
            "lines scanned the same way",
            "reverse every second line",
        )
    measured = f"a line is like the {step}{'nd' if step == 2 else 'rd' if step == 3 else 'th'} line after it, not the next"
    m = seen.points_per_line
    hint, option = _remedy(seen, m * step)
    hint = f"{hint}; split several scanners with --scanner DIMENSION"
    expected = f"lines of M = {m} shots that are alike"
    return Finding("line-length", Verdict.AGAINST, measured, expected, hint, option)


def _or_inf(value: float) -> float:
    return value if np.isfinite(value) else math.inf


def _period(seen: Seen) -> int | None:
    """Return the period of the ranges in the longest window, None if it is weak."""
    if not seen.windows:
        return None
    estimate = estimate_points_per_line(_longest(seen))
    return estimate.points_per_line if estimate.strength >= WEAK_PERIOD else None


def _longest(seen: Seen) -> F32:
    """Return shots of the longest window, (n,) float32 [m]."""
    rows = max(seen.windows, key=lambda window: len(window.range_m)).range_m
    return rows[: -(-PERIOD_SHOTS // rows.shape[1])].ravel()[:PERIOD_SHOTS]


def _is_as_alike(seen: Seen, period: int) -> bool:
    """Return whether shots a period apart are as alike as those M apart.

    Where these are too few, alike at all.
    """
    logs = np.log(_longest(seen))
    m = seen.points_per_line
    of_period, of_m = (likeness(logs[:-lag], logs[lag:]) for lag in (period, m))
    return of_period <= (AS_ALIKE * of_m if np.isfinite(of_m) else MOST_UNLIKE)


def _exact(seen: Seen, period: int) -> int:
    """Return the multiple or part of M that a period is, else the length near it that agrees best all along."""
    m = seen.points_per_line
    times = round(max(m / period, period / m))
    for length in (m // times, m * times):
        if (
            abs(length - period) <= max(FOLD_REACH, period // SHIFTS)
            and max(length, m) % min(length, m) == 0
        ):
            return length
    near = range(max(period - FOLD_REACH, 2), period + FOLD_REACH + 1)
    off = {
        length: period if period <= FRAME_SHOTS else _or_inf(fold(seen.windows, length))
        for length in near
    }
    return min(near, key=lambda length: (off[length], abs(length - period)))


def check_line_order(seen: Seen, figures: Figures) -> Finding | None:
    """Ask whether the scene changes along the stream, but not from line to line."""
    near, far = figures.moved
    if figures.again > SEEN_AGAIN and seen.n_lines >= STANDING_LINES and not _is_fan(seen):
        measured = (
            f"{figures.again:.0%} of the shots unlike their neighbours come again in the next line"
        )
        hint = "the platform stands again and again, or lines are copies: cut such stretches out, or accept them"
        return Finding("standing", Verdict.DOUBTFUL, measured, f"at most {SEEN_AGAIN:.0%}", hint)
    if seen.n_lines < LEAST_LINES or not near > 0 or not np.isfinite(far):
        return None
    ratio = far / near
    measured = f"lines far apart differ {ratio:.2g} times as much as neighbouring lines"
    expected = f"at least {MOVED_SAME:g}"
    is_standing = not near >= MOVED_NOISE * figures.roughness
    if is_standing:
        doubtful = ratio < MOVED_SAME and seen.n_lines >= STANDING_LINES
        expected = f"{expected} in {STANDING_LINES} lines or more"
        hint = "the platform stands: cut such stretches out, or accept them"
        return Finding("standing", verdict_of(doubtful=doubtful), measured, expected, hint)
    hint = "put the lines into the order in which they were scanned; in dense snow or fog accept it"
    verdict = verdict_of(doubtful=ratio < MOVED_SAME, against=ratio < MOVED_AGAINST)
    return Finding("line-order", verdict, measured, expected, hint)


def check_dropouts(figures: Figures) -> Finding | None:
    """Ask whether shots are lost where surfaces are smooth."""
    if figures.n_between < LEAST_PAIRS:
        return None
    measured = f"{figures.lonely_missing:.1%} of the shots amid smooth surfaces are missing"
    hint = (
        "check whether records were lost or filtered out; isolated gaps cost classes at their edges"
    )
    verdict = verdict_of(doubtful=figures.lonely_missing > LONELY)
    return Finding("dropouts", verdict, measured, f"at most {LONELY:.1%}", hint)
