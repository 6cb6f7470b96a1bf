"""Turns frames of multi-ring scanners (x, y, z, ring after ring) into vertical lines (``input.lines = rings``).

A spinning scanner with one laser per ring writes frames of one ring after the other, each over the whole turn, without
missing shots; or in raw column order, a shot of every ring after the other, with the ring as a dimension. Vertical
lines are cells of azimuth, columns are rings from low to high. Each shot of a ring takes a cell of its own: along every
ring, cells rise strictly and follow the azimuth as closely as possible (isotonic regression). This separates
neighbours where the rotation is uneven, and leaves cells empty where shots are missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import Assumption, ExtraReturns, ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F32, I64, Mask
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import refuse_scale
from prc_cli.formats.records import RecordSource
from prc_cli.streams.ranges import clean_measured, open_ranges
from prc_cli.streams.ring_turns import (
    Frame,
    Turns,
    find_step,
    find_turns,
    in_ring_order,
    ring_columns,
    ring_lines,
    turns_of_rings,
    whole_rings,
)

MAX_RECORDS = 10_000_000
"""Most records of a frame, which is held in memory (about 130 bytes per record at most)."""
MAX_EMPTY = 64
"""Most cells per record: finer steps of azimuth give a frame of mostly missing shots."""
SPARE_CELLS = 1 << 20
"""Number of cells always allowed."""
RING = "ring"
"""Dimension with the number of the ring; with it, records may be in any order, as in raw column order."""
BLOCK_LINES = 512
"""Lines of a block."""

_TURN = 2 * math.pi


@dataclass(frozen=True, slots=True)
class RingStream:
    """A frame as a :class:`prc_cli.core.stream.ScanStream`; see :func:`open_rings`."""

    info: StreamInfo
    image: _Image

    def blocks(self) -> Iterator[ScanBlock]:
        """Yield the frame, lines in the order of azimuth."""
        image = self.image
        n_lines = len(image.range_m)
        for first in range(0, n_lines, BLOCK_LINES):
            part = slice(first, min(first + BLOCK_LINES, n_lines))
            low, high = np.searchsorted(image.extra_line, (part.start, part.stop))
            mine = slice(int(low), int(high))
            yield ScanBlock(
                first_line=first,
                range_m=image.range_m[part].copy(),
                record=image.record[part].copy(),
                xyz_m=image.xyz_m[part].copy(),
                intensity=None if image.intensity is None else image.intensity[part].copy(),
                extra=ExtraReturns(
                    (image.extra_line[mine] - first).astype(np.int32),
                    image.extra_column[mine].astype(np.int32),
                    image.extra_range_m[mine],
                    image.extra_record[mine],
                ),
                tally=image.tally if first == 0 else ReadTally(),
            )


@dataclass(frozen=True, slots=True)
class _Image:
    """The whole frame."""

    range_m: F32
    record: I64
    xyz_m: F32
    intensity: F32 | None
    extra_line: I64
    extra_column: I64
    extra_range_m: F32
    extra_record: I64
    tally: ReadTally


def open_rings(source: RecordSource, config: InputConfig) -> RingStream:
    """Read a whole frame and arrange it in vertical lines."""
    _check_rules(config)
    refuse_scale(config, source.path, "its ranges are lengths of x, y, z")
    frame, n_records, tally = _read(source, config)
    if len(frame.record) < 2:
        raise InputError(
            source.path, f"{len(frame.record)} records have a range, too few for rings", "check the layout"
        )
    turns = find_turns(frame, source.path) if frame.ring is None else turns_of_rings(frame, source.path)
    if frame.ring is not None:
        frame = in_ring_order(frame)
    n_rings, column = ring_columns(frame, turns, config.points_per_line, source.path)
    step = math.radians(config.azimuth_step) if config.azimuth_step is not None else find_step(turns)
    n_lines = max(round(_TURN / step), 1) if step > 0 else 0
    if not n_lines or n_lines * n_rings > MAX_EMPTY * n_records + SPARE_CELLS:
        problem = f"{n_rings} rings of one shot every {math.degrees(step):.3g} deg are far more cells than records"
        raise InputError(source.path, problem, "give input.azimuth_step")
    line, in_order = ring_lines(turns, n_rings, n_lines)
    image = _fill(frame, line, column, in_order, (n_lines, n_rings), tally)
    info = StreamInfo(
        path=source.path,
        format=source.format,
        points_per_line=n_rings,
        n_records=source.n_records if source.n_records is not None else n_records,
        n_lines=n_lines,
        facts=source.facts,
        assumptions=_assumptions(turns, n_rings, n_lines, config, int(np.count_nonzero(~in_order))),
    )
    return RingStream(info, image)


def _check_rules(config: InputConfig) -> None:
    allowed = (
        ("columns", config.columns in ("auto", "order"), "auto or order"),
        ("range", config.range in ("auto", "sensor-xyz") or config.range.startswith("origin:"),
         "sensor-xyz or origin:X,Y,Z"),
        ("scanner", config.scanner == "none", "none"),
        ("order", config.order != "sort-time", "require or trust"),
    )  # fmt: skip
    for key, is_allowed, expected in allowed:
        if not is_allowed:
            problem = f"found {getattr(config, key)!r}, expected {expected} where lines = rings"
            raise ConfigError(f"input.{key}", problem, "leave the key out")


def _read(source: RecordSource, config: InputConfig) -> tuple[Frame, int, ReadTally]:
    """Read the records that have a range; count the others."""
    rule = "sensor-xyz" if config.range == "auto" else config.range
    ranges = open_ranges(rule, source.dimensions, source.path, config, crs_wkt=None)
    beside = tuple(name for name in ("intensity", RING) if name in source.dimensions)
    names = (*ranges.names, *beside)
    parts: list[Frame] = []
    tally, n_records, n_unplaced = ReadTally(), 0, 0
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
        n_unplaced += int(np.count_nonzero((there if RING in names else np.ones(chunk.n, np.bool_)) & ~use))
        record = chunk.first_record + np.flatnonzero(use) if chunk.record is None else chunk.record[use]
        intensity = np.asarray(chunk.values["intensity"], np.float32)[use] if "intensity" in names else None
        ring = whole_rings(chunk.values[RING][use], source.path) if RING in names else None
        parts.append(Frame(record, range_m[use], xyz[use], intensity, ring))
    if not parts:
        raise InputError(source.path, "no records, expected a frame", "copy it from the archive again")
    frame = Frame(
        np.concatenate([part.record for part in parts]),
        np.concatenate([part.range_m for part in parts]),
        np.concatenate([part.xyz_m for part in parts]),
        np.concatenate([part.intensity for part in parts if part.intensity is not None])
        if parts[0].intensity is not None
        else None,
        np.concatenate([part.ring for part in parts if part.ring is not None]) if parts[0].ring is not None else None,
    )
    tally += ReadTally(n_records=n_records, n_unplaced=n_unplaced)
    return frame, n_records, tally


def _fill(frame: Frame, line: I64, column: I64, in_order: Mask, shape: tuple[int, int], tally: ReadTally) -> _Image:
    """Put every record into its cell; records in ring order take precedence, then file order."""
    n_cells = shape[0] * shape[1]
    cell = line * shape[1] + column
    first = np.concatenate([np.flatnonzero(in_order), np.flatnonzero(~in_order)])
    _, where = np.unique(cell[first], return_index=True)
    own = first[where]
    other = np.setdiff1d(np.arange(len(cell)), own)
    other = other[np.argsort(line[other], kind="stable")]
    range_m: F32 = np.full(n_cells, np.nan, np.float32)
    record: I64 = np.full(n_cells, -1, np.int64)
    xyz_m: F32 = np.full((n_cells, 3), np.nan, np.float32)
    range_m[cell[own]], record[cell[own]], xyz_m[cell[own]] = frame.range_m[own], frame.record[own], frame.xyz_m[own]
    intensity: F32 | None = None
    if frame.intensity is not None:
        intensity = np.full(n_cells, np.nan, np.float32)
        intensity[cell[own]] = frame.intensity[own]
        intensity = intensity.reshape(shape)
    return _Image(
        range_m.reshape(shape),
        record.reshape(shape),
        xyz_m.reshape(*shape, 3),
        intensity,
        line[other],
        column[other],
        frame.range_m[other],
        frame.record[other],
        tally + ReadTally(n_collisions=len(other)),
    )


def _assumptions(
    turns: Turns, n_rings: int, n_lines: int, config: InputConfig, n_out_of_order: int
) -> tuple[Assumption, ...]:
    sense = "anticlockwise" if turns.way > 0 else "clockwise"
    value = f"rings that begin at azimuth {math.degrees(turns.cut_rad):.2f} deg and turn {sense}"
    why = f"least spread of elevation within rings; {n_out_of_order} records do not follow the azimuth of their ring"
    taken = [Assumption("input.lines", value, why)]
    if config.range == "auto":
        taken.append(Assumption("input.range", "sensor-xyz", "rings turn around the origin of x, y, z"))
    if config.points_per_line is None:
        taken.append(Assumption("input.points_per_line", str(n_rings), "turns of the records around the scanner"))
    if config.azimuth_step is None:
        value = f"{360 / n_lines:.4f} deg ({n_lines} lines)"
        taken.append(Assumption("input.azimuth_step", value, "from shot to shot where they are closest together"))
    return tuple(taken)
