"""Turns frames of multi-ring scanners into vertical lines (``input.lines = rings``).

A spinning scanner with one laser per ring writes frames of one ring after the other, each over the
whole turn, without missing shots; or in raw column order, a shot of every ring after the other,
with the ring as a dimension. Vertical lines are cells of azimuth, columns are rings from low to
high. Each shot of a ring takes a cell of its own: along every ring, cells rise strictly and follow
the azimuth as closely as possible (isotonic regression). This separates neighbours where the
rotation is uneven, and leaves cells empty where shots are missing.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.frame import SensorFrame
from prc_cli.core.stream import Assumption, ExtraReturns, ReadTally, ScanBlock, StreamInfo, cut
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import refuse_scale
from prc_cli.formats.records import Source
from prc_cli.formats.sensor_frame import NARROW_RAD, find_frame, spread_of_cones
from prc_cli.streams.columns import (
    INTENSITY,
    RANGE,
    RECORD,
    XYZ,
    Table,
    join,
    n_rows,
    table_of,
    take,
)
from prc_cli.streams.down import wrap
from prc_cli.streams.ranges import clean_measured, open_ranges

MOST_OF_COLUMNS = 1.5
"""Frames that turn less lie in column order, not ring after ring."""
MAX_RINGS = 4096
"""Most rings of a frame."""
BACKWARD_RAD = math.radians(20.0)
"""Steps back up to this are shots out of order.

Larger ones are steps forward over the rest of the turn.
"""
MAX_RING_NUMBER = 2.0**53
"""Numbers of rings from here on are not exact in float64."""
MAX_RING_ORDER_RAD = math.radians(0.5)
"""Tolerance for rings out of the order of elevation."""
MIN_RING = 0.01
"""Least size of the first and last ring, as a share of the median ring.

Smaller ones are shots across the border.
"""
WINDOW = 64
"""Number of neighbours over which the step of azimuth is measured."""
NEIGHBOUR = 1.5
"""Steps below this multiple of the median are between neighbours."""
CLEAR = 0.7
"""Another cut must leave less than this share of the spread of elevation within rings."""
DENSEST = 25.0
"""Percentile of the windows for the step: cells must be fine enough where shots are densest."""

_TURN = 2 * math.pi


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Rings of a frame."""

    ring: I64
    """(n,) int64, from 0 in file order."""
    along_rad: F64
    """(n,) float64, azimuth from the start of the ring as it rotates, 0 to a turn [rad]."""
    cut_rad: float
    """Azimuth where rings begin [rad]."""
    way: float
    """1 = anticlockwise seen from above."""


def _elevation(xyz_m: F32) -> F64:
    xyz = xyz_m.astype(np.float64)
    elevation: F64 = np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1]))
    return elevation


def find_turns(xyz_m: F32, path: str) -> Turns:
    """Find where rings begin: the azimuth with the least spread of elevation within rings."""
    azimuth = np.arctan2(xyz_m[:, 1].astype(np.float64), xyz_m[:, 0].astype(np.float64))
    step = wrap(np.diff(azimuth))
    way = math.copysign(1.0, float(np.sign(step).sum()))
    step *= way
    step[step < -BACKWARD_RAD] += _TURN
    along = way * azimuth[0] + np.concatenate([[0.0], np.cumsum(step)])
    n_turns = (along[-1] - along[0]) / _TURN
    if not 1.0 < n_turns < min(MAX_RINGS, len(along) / 2):
        problem = (
            f"the records turn {abs(n_turns):.1f} times around the scanner, "
            "expected ring after ring"
        )
        hint = "check x, y, z and their order, or find lines in another way: --lines"
        if abs(n_turns) < MOST_OF_COLUMNS:
            hint = (
                "column after column, a frame needs the ring of every point: "
                "give a PLY or PCD with the property ring"
            )
        raise InputError(path, problem, hint)
    ways = list(_ways(along, float(np.median(step[step > 0])), way))
    if not ways:
        raise InputError(path, "no ring begins", "check x, y, z")
    elevation = _elevation(xyz_m)
    best = min(ways, key=lambda turns: _square_spread(elevation, turns.ring))
    if spread_of_cones(xyz_m, best.ring, is_fitted=False) < NARROW_RAD:
        return best
    # on other axes than the scanner's own, a wrong cut may look better
    fitted = {k: spread_of_cones(xyz_m, turns.ring, is_fitted=True) for k, turns in enumerate(ways)}
    fitted_best = ways[min(fitted, key=fitted.__getitem__)]
    is_clear = min(fitted.values()) < CLEAR * fitted[ways.index(best)]
    return fitted_best if is_clear else best


def _ways(along: F64, step: float, way: float) -> Iterator[Turns]:
    for start in _cuts(along, step):
        ring, within = _cut_turns(along - start)
        yield Turns(ring, within, float(wrap(np.array([way * start]))[0]), way)


def _square_spread(elevation: F64, ring: I64) -> float:
    """Return the squares of the elevations less those of the means of their rings."""
    n = np.bincount(ring)
    total = np.bincount(ring, elevation)
    square = np.bincount(ring, elevation**2)
    return float((square - total**2 / np.maximum(n, 1)).sum())


def whole_rings(values: NDArray[Any], path: str) -> I64:
    """Return the numbers of rings as int64."""
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    with np.errstate(invalid="ignore"):
        whole = (np.abs(values) < MAX_RING_NUMBER) & (values == np.floor(values))
    if not whole.all():
        odd = values[int(np.argmin(whole))]
        raise InputError(
            path, f"found ring {odd:g}, expected whole numbers", "name the rings in a layout"
        )
    return values.astype(np.int64)


def turns_of_rings(frame: Table, path: str) -> tuple[Table, Turns]:
    """Return a frame sorted by ring and azimuth (rings may be staggered), and its rings."""
    xyz = frame[XYZ].astype(np.float64)
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    _, ring = np.unique(frame[RING], return_inverse=True)
    # the sense of rotation from neighbours in the same ring
    by_ring = np.argsort(ring, kind="stable")
    step = wrap(np.diff(azimuth[by_ring]))[np.diff(ring[by_ring]) == 0]
    way = math.copysign(1.0, float(np.sign(step).sum())) if len(step) else 1.0
    middle = np.bincount(ring, _elevation(frame[XYZ])) / np.bincount(ring)
    n_rings = len(middle)
    if n_rings > MAX_RINGS or 2 * n_rings > len(ring):
        problem = f"found {n_rings} rings in {len(ring)} records with a range"
        raise InputError(path, problem, "check that the dimension ring numbers the beams")
    rank = np.empty(n_rings, np.int64)
    rank[np.argsort(middle, kind="stable")] = np.arange(n_rings)
    along = np.remainder(way * azimuth, _TURN)
    along[along >= _TURN] = 0.0
    rank = rank[ring]
    order = np.lexsort((along, rank))
    return take(frame, order), Turns(rank[order], along[order], 0.0, way)


MOST_TURNS = 1.5
"""Turns of the scanner in a frame, at most: beyond it there are several."""
LEAST_ORDERED = 0.9
"""Least share of the steps of a ring that go one way, for records in the order of time."""


def turns_in_order(frame: Table) -> float:
    """Return how often the ring with most points turns around the scanner.

    0 if rings have no number or order.
    """
    if RING not in frame:
        return 0.0
    number, count = np.unique(frame[RING], return_counts=True)
    xyz = frame[XYZ][frame[RING] == number[np.argmax(count)]].astype(np.float64)
    step = wrap(np.diff(np.arctan2(xyz[:, 1], xyz[:, 0])))
    step *= math.copysign(1.0, float(np.sign(step).sum()))
    is_ordered = len(step) > 0 and np.mean(step > 0) >= LEAST_ORDERED
    return float(step.sum()) / _TURN if is_ordered else 0.0


def _several_turns(source: Source, n_turns: float, frame: Table) -> InputError:
    """Return the error of a file of several turns, with the rate of its columns if known."""
    problem = f"the file holds {n_turns:.1f} turns of the scanner, expected one"
    if RING in frame and not _rise(frame[RING], frame[XYZ]):
        # lasers numbered as they fire are no columns
        return InputError(source.path, problem, "save every turn (frame) as a file of its own")
    rate = "HZ (firing columns a second)"
    if "time" in source.dimensions:
        first = next(iter(source.chunks(("time", RING))))
        number, count = np.unique(first.values[RING], return_counts=True)
        of_ring = first.values[RING] == number[np.argmax(count)]
        step = np.diff(np.asarray(first.values["time"], np.float64)[of_ring])
        step = step[step > 0]
        rate = f"{1.0 / float(np.median(step)):.5g}" if len(step) else rate
    way = f"--lines time:{rate} --columns dimension:{RING} --range sensor-xyz"
    return InputError(source.path, problem, f"read them as a drive, {way}; or give one turn a file")


def _rise(ring: NDArray[Any], xyz_m: F32) -> bool:
    """Return whether the rings lie in the order of their numbers, upwards or downwards."""
    elevation = np.arctan2(xyz_m[:, 2], np.hypot(xyz_m[:, 0], xyz_m[:, 1]))
    numbers = np.unique(ring)
    steps = np.diff([float(np.median(elevation[ring == number])) for number in numbers])
    return bool((steps > 0).all() or (steps < 0).all())


def _cut_turns(along: F64) -> tuple[I64, F64]:
    """Return ring and azimuth within it of shots whose rings begin at multiples of a turn."""
    turn = np.floor(along / _TURN)
    # shots out of order around the cut belong to the new ring
    ring: I64 = np.maximum.accumulate(turn - turn[0]).astype(np.int64)
    within: F64 = np.remainder(along, _TURN)
    n = np.bincount(ring)
    few = MIN_RING * float(np.median(n))
    # the same at both ends of the frame, where no other ring exists
    if n[-1] < few:
        last = ring == len(n) - 1
        ring[last] = len(n) - 2
        within[last] = np.nextafter(_TURN, 0)
    if n[0] < few:
        within[ring == 0] = 0.0
        ring = np.maximum(ring - 1, 0)
    return ring, within


def _cuts(along: F64, step: float) -> Iterator[float]:
    """Yield azimuths where rings may start, as the scanner turns: axes, first shot, gaps."""
    yield from (0.0, math.pi, math.pi / 2, -math.pi / 2, along[0] - step / 2)
    n_bins = 360
    seen = (
        np.bincount(
            (np.remainder(along, _TURN) / _TURN * n_bins).astype(np.int64) % n_bins,
            minlength=n_bins,
        )
        > 0
    )
    empty = np.flatnonzero(~seen)
    if len(empty):
        # the middle of the longest gap
        doubled = np.flatnonzero(np.concatenate([seen, seen]))
        gap = int(np.argmax(np.diff(doubled)))
        yield float((doubled[gap] + doubled[gap + 1] + 1) / 2 / n_bins * _TURN)


def ring_columns(
    xyz_m: F32,
    turns: Turns,
    wanted: int | None,
    path: str,
) -> tuple[int, I64]:
    """Return the number of rings, and the ring of every record, counted from the lowest."""
    n_rings = int(turns.ring[-1]) + 1
    if wanted is not None and n_rings != wanted:
        problem = f"found {n_rings} rings, expected {wanted} as input.points_per_line says"
        raise InputError(
            path, problem, "leave input.points_per_line out, or check that every ring is there"
        )
    elevation = _elevation(xyz_m)
    borders = np.searchsorted(turns.ring, np.arange(n_rings + 1))
    middle = np.array([np.median(elevation[a:b]) for a, b in pairwise(borders)])
    way = 1 if middle[-1] >= middle[0] else -1
    back = way * np.diff(middle)
    if (back < -MAX_RING_ORDER_RAD).any():
        worst = int(np.argmin(back))
        problem = (
            f"ring {worst + 1} lies at {math.degrees(middle[worst + 1]):.2f} deg of elevation "
            f"after one at {math.degrees(middle[worst]):.2f} deg, "
            "expected rings from top to bottom or from bottom to top"
        )
        raise InputError(path, problem, "check that the file holds one frame, ring after ring")
    return n_rings, turns.ring if way > 0 else n_rings - 1 - turns.ring


def find_step(turns: Turns) -> float:
    """Return the step of azimuth between shots where they are densest [rad]."""
    step = np.diff(turns.along_rad)
    step[np.diff(turns.ring) > 0] = np.inf
    ahead = step[(step > 0) & np.isfinite(step)]
    if not len(ahead):
        return 0.0
    limit = NEIGHBOUR * float(np.median(ahead))
    near = (step >= 0) & (step < limit)
    total = np.cumsum(np.concatenate([[0.0], np.where(near, step, 0.0)]))
    count = np.cumsum(np.concatenate([[0], near]))
    whole = count[WINDOW:] - count[:-WINDOW] == WINDOW
    if not whole.any():
        return float(np.mean(ahead[ahead < limit]))
    return float(np.percentile((total[WINDOW:] - total[:-WINDOW])[whole] / WINDOW, DENSEST))


def ring_lines(turns: Turns, n_rings: int, n_lines: int) -> tuple[I64, Mask]:
    """Return the line of every record, and which records follow the azimuth of their ring."""
    from scipy.optimize import (
        isotonic_regression,
    )  # imported here: loading takes longer than classifying a small file

    place = turns.along_rad / _TURN * n_lines
    line = np.minimum(place.astype(np.int64), n_lines - 1)
    in_order: Mask = np.ones(len(place), np.bool_)
    borders = np.searchsorted(turns.ring, np.arange(n_rings + 1))
    for a, b in pairwise(borders):
        along = place[a:b]
        if np.any(along[1:] < along[:-1]):
            in_order[a:b] = _longest_rise(along)
        rows = a + np.flatnonzero(in_order[a:b])
        # strictly rising cells = ordinal plus a function that does not fall
        ordinal = np.arange(len(rows))
        line[rows] = (
            np.rint(isotonic_regression(place[rows] - 0.5 - ordinal).x).astype(np.int64) + ordinal
        )
    return np.clip(line, 0, n_lines - 1), in_order


def _longest_rise(values: F64) -> Mask:
    """Mark the longest non-decreasing subsequence (patience sorting)."""
    tops: list[float] = []
    tails: list[int] = []
    before = np.full(len(values), -1, np.int64)
    for i, value in enumerate(values.tolist()):
        pile = bisect_right(tops, value)
        if pile == len(tops):
            tops.append(value)
            tails.append(i)
        else:
            tops[pile] = value
            tails[pile] = i
        before[i] = tails[pile - 1] if pile else -1
    marked: Mask = np.zeros(len(values), np.bool_)
    i = tails[-1] if tails else -1
    while i >= 0:
        marked[i] = True
        i = int(before[i])
    return marked


MAX_RECORDS = 10_000_000
"""Most records of a frame, which is held in memory (about 130 bytes per record at most)."""
MAX_EMPTY = 64
"""Most cells per record: finer steps of azimuth give a frame of mostly missing shots."""
SPARE_CELLS = 1 << 20
"""Number of cells always allowed."""
RULED_OUT_OF_RINGS = frozenset(
    (
        "columns",
        "scanner",
        "trajectory",
        "order",
        "angle_start",
        "angle_step",
        "points_per_line",
        "range_scale",
        "lines",
    )
)
"""Keys that frames refuse, or that do nothing for them: rings are found in x, y, z."""
_ONE_FRAME = "give one frame of one scanner, x, y, z relative to it"
RING = "ring"
"""Dimension with the number of the ring.

With it, records may be in any order, as in raw column order.
"""
BLOCK_LINES = 512
"""Lines of a block."""
GIVEN = "x, y, z as given"
"""Coordinates of the input, beside those on the axes of the scanner."""


@dataclass(frozen=True, slots=True)
class RingStream:
    """A frame as a :class:`prc_cli.core.stream.ScanStream`; see :func:`open_rings`."""

    info: StreamInfo
    frame: ScanBlock

    def blocks(self) -> Iterator[ScanBlock]:
        """Yield the frame, lines in the order of azimuth."""
        n_lines = self.frame.n_lines
        for first in range(0, n_lines, BLOCK_LINES):
            yield cut(self.frame, first, min(first + BLOCK_LINES, n_lines))


def open_rings(source: Source, config: InputConfig) -> RingStream:
    """Read a whole frame and arrange it in vertical lines."""
    _check_rules(config)
    refuse_scale(config, source.path, "its ranges are lengths of x, y, z")
    frame, n_records, tally = _read(source, config)
    if n_rows(frame) < 2:
        raise InputError(
            source.path,
            f"{n_rows(frame)} records have a range, too few for rings",
            "check the layout",
        )
    if (n_turns := turns_in_order(frame)) > MOST_TURNS:
        raise _several_turns(source, n_turns, frame)
    frame, turns, sensor_frame = _in_own_frame(frame, source.path)
    n_rings, column = ring_columns(frame[XYZ], turns, config.points_per_line, source.path)
    step = (
        math.radians(config.azimuth_step) if config.azimuth_step is not None else find_step(turns)
    )
    n_lines = max(round(_TURN / step), 1) if step > 0 else 0
    if not n_lines or n_lines * n_rings > MAX_EMPTY * n_records + SPARE_CELLS:
        problem = (
            f"{n_rings} rings of one shot every {math.degrees(step):.3g} "
            "deg are far more cells than records"
        )
        raise InputError(source.path, problem, "give input.azimuth_step")
    line, in_order = ring_lines(turns, n_rings, n_lines)
    frame[XYZ] = frame.pop(GIVEN)
    block = replace(
        _fill(frame, line, column, in_order, (n_lines, n_rings), tally), frame=sensor_frame
    )
    info = StreamInfo(
        path=source.path,
        format=source.format,
        points_per_line=n_rings,
        n_records=source.n_records if source.n_records is not None else n_records,
        n_lines=n_lines,
        facts=replace(source.facts, refuses=RULED_OUT_OF_RINGS, remedy=_ONE_FRAME),
        assumptions=_assumptions(turns, n_rings, n_lines, config, int(np.count_nonzero(~in_order))),
    )
    return RingStream(info, block)


def _in_own_frame(frame: Table, path: str) -> tuple[Table, Turns, SensorFrame | None]:
    """Return a frame on the axes of its scanner, its rings, and these axes; None = x, y, z."""
    frame = {**frame, GIVEN: frame[XYZ]}
    if RING in frame:
        sensor_frame = find_frame(frame[XYZ], np.unique(frame[RING], return_inverse=True)[1])
        frame[XYZ] = frame[GIVEN] if sensor_frame is None else sensor_frame.own(frame[GIVEN])
        return *turns_of_rings(frame, path), sensor_frame
    turns = find_turns(frame[XYZ], path)
    sensor_frame = find_frame(frame[XYZ], turns.ring)
    if sensor_frame is not None:
        # rings begin elsewhere on these axes
        frame[XYZ] = sensor_frame.own(frame[GIVEN])
        turns = find_turns(frame[XYZ], path)
        sensor_frame = find_frame(frame[GIVEN], turns.ring) or sensor_frame
        frame[XYZ] = sensor_frame.own(frame[GIVEN])
        turns = find_turns(frame[XYZ], path)
    return frame, turns, sensor_frame


def _check_rules(config: InputConfig) -> None:
    allowed = (
        ("columns", config.columns in ("auto", "order"), "auto or order"),
        (
            "range",
            config.range in ("auto", "sensor-xyz") or config.range.startswith("origin:"),
            "sensor-xyz or origin:X,Y,Z",
        ),
        ("scanner", config.scanner == "none", "none"),
        ("order", config.order != "sort-time", "require or trust"),
    )
    for key, is_allowed, expected in allowed:
        if not is_allowed:
            problem = f"found {getattr(config, key)!r}, expected {expected} where lines = rings"
            raise ConfigError(f"input.{key}", problem, "leave the key out")


def _read(source: Source, config: InputConfig) -> tuple[Table, int, ReadTally]:
    rule = "sensor-xyz" if config.range == "auto" else config.range
    ranges = open_ranges(rule, source.dimensions, source.path, config, crs_wkt=None)
    beside = tuple(name for name in (INTENSITY, RING) if name in source.dimensions)
    names = (*ranges.names, *beside)
    parts: list[Table] = []
    tally = ReadTally()
    n_records = 0
    n_unplaced = 0
    for chunk in source.chunks(names):
        n_records += chunk.n
        if n_records > MAX_RECORDS:
            problem = f"more than {MAX_RECORDS} records, expected one frame: it is held in memory"
            raise InputError(source.path, problem, "cut the file into frames")
        range_m, xyz, cleaned = clean_measured(chunk.values, ranges)
        tally += cleaned
        if xyz is None:
            continue
        # no azimuth straight up or down
        there = np.isfinite(range_m)
        use = there & ((xyz[:, 0] != 0) | (xyz[:, 1] != 0))
        # with ring numbers, records without range are shots without return: their cells stay empty
        # so are records with a coordinate that is no number
        is_shot = there if RING in names else ~np.isnan(xyz).any(axis=1)
        n_unplaced += int(np.count_nonzero(is_shot & ~use))
        part: Table = {RECORD: table_of(chunk, ())[RECORD][use], RANGE: range_m[use], XYZ: xyz[use]}
        if INTENSITY in names:
            part[INTENSITY] = np.asarray(chunk.values[INTENSITY], np.float32)[use]
        if RING in names:
            part[RING] = whole_rings(chunk.values[RING][use], source.path)
        parts.append(part)
    if not parts:
        raise InputError(
            source.path, "no records, expected a frame", "copy it from the archive again"
        )
    return join(parts), n_records, tally + ReadTally(n_records=n_records, n_unplaced=n_unplaced)


def _fill(
    frame: Table,
    line: I64,
    column: I64,
    in_order: Mask,
    shape: tuple[int, int],
    tally: ReadTally,
) -> ScanBlock:
    """Put every record into its cell; records in ring order take precedence, then file order."""
    n_cells = shape[0] * shape[1]
    cell = line * shape[1] + column
    first = np.concatenate([np.flatnonzero(in_order), np.flatnonzero(~in_order)])
    _, where = np.unique(cell[first], return_index=True)
    winners = first[where]
    further = np.setdiff1d(np.arange(len(cell)), winners)
    further = further[np.argsort(line[further], kind="stable")]
    cells: Table = {
        name: np.full((n_cells, *frame[name].shape[1:]), np.nan, np.float32)
        for name in (RANGE, XYZ)
    }
    cells[RECORD] = np.full(n_cells, -1, np.int64)
    if INTENSITY in frame:
        cells[INTENSITY] = np.full(n_cells, np.nan, np.float32)
    for name, values in cells.items():
        values[cell[winners]] = frame[name][winners]
    return ScanBlock(
        first_line=0,
        range_m=cells[RANGE].reshape(shape),
        record=cells[RECORD].reshape(shape),
        xyz_m=cells[XYZ].reshape(*shape, 3),
        intensity=cells[INTENSITY].reshape(shape) if INTENSITY in cells else None,
        has_rings=True,
        extra=ExtraReturns(
            line[further].astype(np.int32),
            column[further].astype(np.int32),
            frame[RANGE][further],
            frame[RECORD][further],
            frame[INTENSITY][further] if INTENSITY in frame else None,
        ),
        tally=tally + ReadTally(n_collisions=len(further)),
    )


def _assumptions(
    turns: Turns,
    n_rings: int,
    n_lines: int,
    config: InputConfig,
    n_out_of_order: int,
) -> tuple[Assumption, ...]:
    sense = "anticlockwise" if turns.way > 0 else "clockwise"
    value = f"rings that begin at azimuth {math.degrees(turns.cut_rad):.2f} deg and turn {sense}"
    why = (
        "least spread of elevation within rings; "
        f"{n_out_of_order} records do not follow the azimuth of their ring"
    )
    taken = [Assumption("input.lines", value, why)]
    if config.range == "auto":
        taken.append(
            Assumption("input.range", "sensor-xyz", "rings turn around the origin of x, y, z")
        )
    if config.points_per_line is None:
        taken.append(
            Assumption(
                "input.points_per_line", str(n_rings), "turns of the records around the scanner"
            )
        )
    if config.azimuth_step is None:
        value = f"{360 / n_lines:.4f} deg ({n_lines} lines)"
        taken.append(
            Assumption(
                "input.azimuth_step", value, "from shot to shot where they are closest together"
            )
        )
    return tuple(taken)
