"""Turns records into the stream of blocks, the same way for every format, in three steps.

Rules are resolved (:mod:`.rules`), the scanners set up (:mod:`.setup`), and chunks of records
become whole lines (:mod:`.lines`), whole lines blocks: one return per cell, the rest as further
returns or counted. Memory contains a chunk of records and the open lines of every scanner.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.brief import Brief
from prc_cli.core.errors import InputError
from prc_cli.core.stream import Assumption, ExtraReturns, ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import choose_returns
from prc_cli.formats.records import Reading, RecordChunk, Source
from prc_cli.formats.sorting import sorted_by_time
from prc_cli.streams.columns import (
    INTENSITY,
    LINE,
    RANGE,
    RECORD,
    START,
    XYZ,
    Table,
    find_columns,
    is_within,
    n_rows,
    table_of,
    take,
)
from prc_cli.streams.head import Head, head_of
from prc_cli.streams.lines import (
    WholeLines,
    check_partial_line,
    nothing_placed,
    scanners_in_turns,
    whole_lines,
)
from prc_cli.streams.order import (
    OrderWatch,
    over_weeks,
    times_of_trajectory,
    week_steps,
)
from prc_cli.streams.ranges import clean_measured
from prc_cli.streams.rules import GridRules, resolve_rules
from prc_cli.streams.setup import ScannerSetup, Setup, WindowEnd, set_up, setup_notes

MAX_BLOCK_CELLS = 1 << 21
"""Most cells of a block (at least a line): long gaps are cut into several blocks."""
_COLUMN = "column index"
_CHOSEN = "chosen return"


def open_grid(
    source: Source,
    config: InputConfig,
    *,
    line_hz: float | None = None,
    geometry: bool = True,
    only_ranges: bool = False,
    with_intensity: bool = False,
    assumptions: tuple[Assumption, ...] = (),
) -> GridStream:
    """Turn a list of records into the stream; ``assumptions`` are those made before."""
    records = sorted_by_time(source) if config.order == "sort-time" else source
    head = head_of(records, config, geometry=geometry)
    rules = resolve_rules(
        head, config, geometry=geometry, only_ranges=only_ranges, with_intensity=with_intensity
    )
    by_time = rules.line_hz is not None or rules.shot_hz is not None
    if config.order == "trust" and by_time:
        records = over_weeks(records)
        head = Head(records, head.expected)
    _check_last_line(records, rules)
    recorded_hz = source.facts.line_hz if line_hz is None else line_hz
    line_hz = recorded_hz if rules.line_hz is None else rules.line_hz
    end = None
    if config.window is not None and rules.scanner is None:
        end = WindowEnd(config.window, line_hz)
    setup = set_up(head, rules, end)
    info = _info_of(records, rules, setup, line_hz)
    info = replace(info, assumptions=(*assumptions, *info.assumptions))
    if "intensity" not in (*rules.names, *rules.carried):
        head = head.with_reading(Reading(spares_intensity=True))
    return GridStream(info, head, rules, setup)


def _check_last_line(records: Source, rules: GridRules) -> None:
    """Refuse a last line that is cut short where the number of records alone shows it."""
    m = rules.points_per_line
    n_records = records.n_records
    counts_records = rules.lines == "fixed" and not rules.has_returns and not rules.pads_last_line
    if counts_records and m is not None and n_records is not None and rules.config.window is None:
        check_partial_line(rules.path, n_records, m, source=records)


def _info_of(records: Source, rules: GridRules, setup: Setup, line_hz: float | None) -> StreamInfo:
    facts = records.facts
    n_lines = setup.n_lines
    m = max(
        (scanner.points_per_line for scanner in setup.scanners.values()),
        default=rules.points_per_line or 0,
    )
    if n_lines is None and rules.is_dense and records.n_records is not None:
        n_lines = -(-records.n_records // m)
    info = StreamInfo(
        path=records.path,
        format=records.format,
        points_per_line=m,
        n_records=records.n_records,
        n_lines=n_lines,
        line_hz=line_hz,
        line_rule=rules.lines,
        downs={
            scanner: (scanner_setup.down_rad, scanner_setup.cos_tilt)
            for scanner, scanner_setup in setup.scanners.items()
            if scanner_setup.down_rad is not None
        },
        assumptions=(*rules.assumptions, *setup.assumptions),
        facts=replace(facts, notes=(*facts.notes, *setup_notes(setup.assumptions))),
        dimensions=records.dimensions,
    )
    if len(setup.scanners) != 1:
        return info
    (alone,) = setup.scanners.values()
    down_rad = alone.down_rad
    nadir = facts.rule("nadir")
    if nadir is not None and down_rad is None:
        down_rad = math.radians(float(nadir.value))
    return replace(info, angle_rad=alone.angle_rad, down_rad=down_rad, cos_tilt=alone.cos_tilt)


@dataclass(slots=True, repr=False)
class GridStream(Brief):
    """Records as a stream of blocks; see :func:`open_grid`."""

    info: StreamInfo
    head: Head
    rules: GridRules
    setup: Setup
    _in_turns: frozenset[int] | None = None

    @property
    def source(self) -> Source:
        """The records, in the order of the blocks."""
        return self.head.source

    def find_turns(self) -> frozenset[int]:
        """Return the scanners whose rings fire in another order than they lie."""
        if self._in_turns is None:
            self._in_turns = scanners_in_turns(self.head, self.rules)
            # nothing else is needed from the head
            self.head.forget()
        return self._in_turns

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        if self.rules.is_dense:
            yield from self._dense_blocks()
            return
        lines = whole_lines(
            self.source,
            self.rules,
            lambda scanner: self._setup(scanner).lines,
            self.find_turns(),
            self._prepare,
        )
        for whole in lines:
            yield from self._blocks_of(whole, self._setup(whole.scanner))

    def _setup(self, scanner: int) -> ScannerSetup:
        setup = self.setup.scanners.get(scanner, self.setup.default)
        if setup is None:
            problem = f"{self.rules.scanner} {scanner} was not there when the file was first read"
            raise InputError(
                self.source.path, problem, "the file changed while it was read: run again"
            )
        return setup

    def _prepare(self, chunk: RecordChunk, table: Table) -> tuple[Table, ReadTally]:
        values = chunk.values
        if self.rules.ranges.trajectory is not None:
            values = {
                **values,
                "time": times_of_trajectory(chunk, self.rules.ranges.trajectory.span[0]),
            }
        table[RANGE], xyz, tally = clean_measured(values, self.rules.ranges)
        # removed before the order check could count it
        tally += ReadTally(n_time_steps_back=week_steps(chunk))
        if xyz is not None:
            table[XYZ] = xyz
        if self.rules.needs_intensity:
            table[INTENSITY] = chunk.values["intensity"]
        return table, tally

    def _dense_blocks(self) -> Iterator[ScanBlock]:
        rules = self.rules
        self.head.forget()
        setup = self._setup(0)
        m = setup.points_per_line
        watch = OrderWatch.of(self.source, rules.config.order) if rules.has("time") else None
        needs_records = watch is not None or rules.pads_last_line
        rest: Table = {}
        n_records = first_line = 0
        tally = ReadTally()
        for chunk in self.source.chunks(tuple(dict.fromkeys((*rules.names, *rules.carried)))):
            columns = {name: chunk.values[name] for name in rules.names}
            table, cleaned = self._prepare(
                chunk, table_of(chunk, rules.names) if needs_records else columns
            )
            tally += cleaned + ReadTally(n_records=chunk.n)
            if watch is not None:
                tally += watch.count(table["time"], table[RECORD])
            n_records += chunk.n
            if rest and len(rest[RANGE]):
                table = {name: np.concatenate([rest[name], table[name]]) for name in table}
            n_whole = len(table[RANGE]) // m
            for start in range(0, n_whole, max(MAX_BLOCK_CELLS // m, 1)):
                stop = min(start + max(MAX_BLOCK_CELLS // m, 1), n_whole)
                yield dense_block(
                    take(table, slice(start * m, stop * m)), first_line, rules, setup, tally
                )
                first_line = first_line + stop - start
                tally = ReadTally()
            rest = {name: column[n_whole * m :].copy() for name, column in table.items()}
        if watch is not None:
            watch.finish()
        if not n_records:
            raise nothing_placed(self.source.path)
        if not rules.pads_last_line:
            check_partial_line(self.source.path, n_records, m)
        if n_records % m:
            yield dense_block(pad_line(rest, m), first_line, rules, setup, tally)

    def _blocks_of(self, whole: WholeLines, setup: ScannerSetup) -> Iterator[ScanBlock]:
        records, n_unplaced = self._place(whole, setup)
        tally = whole.tally + ReadTally(n_unplaced=n_unplaced)
        n_lines = max(MAX_BLOCK_CELLS // setup.points_per_line, 1)
        for first in range(whole.first_line, whole.stop_line, n_lines):
            stop = min(first + n_lines, whole.stop_line)
            part = records
            if n_rows(records):
                low, high = np.searchsorted(records[LINE], (first, stop))
                part = take(records, slice(int(low), int(high)))
            block = self._fill(part, first, stop - first, setup)
            yield replace(block, scanner=whole.scanner, tally=block.tally + tally)
            tally = ReadTally()

    def _place(self, whole: WholeLines, setup: ScannerSetup) -> tuple[Table, int]:
        """Find the cell of every record and choose the returns.

        Records outside the image are dropped and counted.
        """
        records = whole.records
        if not n_rows(records):
            return records, 0
        starts = records[START]
        column = find_columns(records, setup.columns, whole.origin_s)
        if not starts.all():
            column = column[np.cumsum(starts) - 1]
        intensity = records.get(INTENSITY)
        number = records.get("return_number")
        is_chosen = choose_returns(
            starts, records[RANGE], intensity, number, self.rules.config.return_
        )
        records = {**records, _COLUMN: column, _CHOSEN: is_chosen}
        if is_within(column, setup.points_per_line):
            return records, 0
        inside = (column >= 0) & (column < setup.points_per_line)
        return take(records, inside), len(inside) - int(np.count_nonzero(inside))

    def _fill(
        self,
        records: Table,
        first_line: int,
        n_lines: int,
        setup: ScannerSetup,
    ) -> ScanBlock:
        """Make the block of lines ``first_line`` on.

        The first shot with a range in a cell is kept.
        """
        m = setup.points_per_line
        rules = self.rules
        n_cells = n_lines * m
        shape = (n_lines, m)
        cells: Table = {
            RANGE: np.full(n_cells, np.nan, np.float32),
            RECORD: np.full(n_cells, -1, np.int64),
        }
        # times and intensities are not needed once returns are chosen
        if rules.has("time") and not rules.only_ranges:
            cells["time"] = np.full(n_cells, np.nan)
        if rules.holds_intensity:
            cells[INTENSITY] = np.full(n_cells, np.nan, np.float32)
        if (
            rules.ranges.sensor_xyz or rules.ranges.dimension is None
        ):  # ranges come with coordinates
            cells[XYZ] = np.full((n_cells, 3), np.nan, np.float32)
        extra = ExtraReturns.none()
        tally = ReadTally()
        if n_rows(records):
            line = records[LINE]
            column = records[_COLUMN]
            is_chosen = records[_CHOSEN]
            cell = line - first_line
            cell *= m
            cell += column
            # no choice needed where every record has its own cell
            alone = bool(is_chosen.all()) and bool(np.all(cell[1:] > cell[:-1]))
            winners = slice(None) if alone else _winners(cell, is_chosen, records[RANGE], n_cells)
            filled = cell[winners]
            for name, values in cells.items():
                values[filled] = records[name][winners]
            if len(filled) < len(cell):
                is_further = np.ones(len(cell), np.bool_)
                is_further[winners] = False
                extra = ExtraReturns(
                    (line[is_further] - first_line).astype(np.int32),
                    column[is_further].astype(np.int32),
                    records[RANGE][is_further],
                    records[RECORD][is_further],
                )
                n_collisions = int(np.count_nonzero(is_further & is_chosen))
                tally = ReadTally(
                    n_collisions=n_collisions, n_extra_returns=len(extra) - n_collisions
                )
        return ScanBlock(
            first_line=first_line,
            range_m=cells[RANGE].reshape(shape),
            record=cells[RECORD].reshape(shape),
            time_s=cells["time"].reshape(shape) if "time" in cells else None,
            xyz_m=cells[XYZ].reshape(*shape, 3) if XYZ in cells else None,
            intensity=cells[INTENSITY].reshape(shape) if INTENSITY in cells else None,
            angle_rad=setup.angle_rad,
            extra=extra,
            tally=tally,
        )


def _winners(
    cell: I64,
    is_chosen: np.ndarray,
    range_m: F32,
    n_cells: int,
) -> np.ndarray:
    """Mark the record that every cell shows.

    That is the first chosen return with a range, else the first chosen one.
    """
    winner = np.full(n_cells, -1, np.int64)
    position = np.flatnonzero(is_chosen)
    valid = ~np.isnan(range_m[position])
    for chosen in (position[~valid][::-1], position[valid][::-1]):
        # the last assignment to a cell wins, so assign backwards to keep the first record
        winner[cell[chosen]] = chosen
    is_winner = np.zeros(len(cell), np.bool_)
    is_winner[winner[winner >= 0]] = True
    return is_winner


def dense_block(
    table: Table,
    first_line: int,
    rules: GridRules,
    setup: ScannerSetup,
    tally: ReadTally,
) -> ScanBlock:
    """Make a block of dense records, one per cell in order, by reshaping."""
    shape = (-1, setup.points_per_line)
    full = not rules.only_ranges
    time_s: F64 | None = (
        np.asarray(table["time"], np.float64).reshape(shape) if full and rules.has("time") else None
    )
    intensity: F32 | None = None
    if rules.holds_intensity:
        intensity = table[INTENSITY].astype(np.float32).reshape(shape)
    return ScanBlock(
        first_line=first_line,
        range_m=table[RANGE].reshape(shape),
        # padded cells have no record, so the short form would be wrong
        record=table[RECORD].reshape(shape) if rules.pads_last_line else None,
        time_s=time_s,
        intensity=intensity,
        angle_rad=setup.angle_rad,
        tally=tally,
    )


def pad_line(rest: Table, m: int) -> Table:
    """Pad the last line with missing shots."""
    padded: Table = {}
    for name, column in rest.items():
        filler = np.full(m - len(column), -1 if name == RECORD else np.nan)
        padded[name] = np.concatenate(
            [column, filler.astype(column.dtype if name == RECORD else np.float64)]
        )
    padded[RANGE] = padded[RANGE].astype(np.float32)
    return padded
