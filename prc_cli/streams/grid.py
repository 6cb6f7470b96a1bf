"""Turns records into the stream of blocks, the same way for every format.

First the rules are resolved (:mod:`.rules`) and the scanners set up (:mod:`.setup`). Then chunks of records become
whole lines (:mod:`.reading`), and whole lines become cells of blocks (:mod:`.cells`). Memory holds a chunk of records
and the open lines of every scanner.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.brief import Brief
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.formats.options import InputConfig
from prc_cli.formats.records import RecordChunk, RecordSource
from prc_cli.streams.cells import MAX_BLOCK_CELLS, CellRules, blocks_of, dense_block, pad_line
from prc_cli.streams.order import WeekSource, times_of_trajectory, week_steps
from prc_cli.streams.probe import Estimates, given_timing, line_rules
from prc_cli.streams.ranges import RangeRule, clean_measured, open_ranges
from prc_cli.streams.reading import (
    check_partial_line,
    judge_first_records,
    nothing_placed,
    open_watch,
    see_times,
    table_of,
    whole_lines,
)
from prc_cli.streams.rules import GridRules, given_points_per_line, resolve_rules
from prc_cli.streams.setup import ScannerSetup, column_rule, find_setups, given_angles
from prc_cli.streams.sorting import sorted_by_time
from prc_cli.streams.table import INTENSITY, RANGE, XYZ, Table, take
from prc_cli.streams.whole_lines import LineRules, cell_limit
from prc_cli.streams.window import WindowEnd


def open_grid(
    source: RecordSource,
    config: InputConfig,
    *,
    line_hz: float | None = None,
    geometry: bool = True,
    only_ranges: bool = False,
) -> GridStream:
    """Turn a list of records into the stream."""
    records = sorted_by_time(source) if config.order == "sort-time" else source
    try:
        rules = resolve_rules(records, config)
    except InputError:
        # a file without lines is often a tile: then report its order instead
        if config.order == "require":
            judge_first_records(source)
        raise
    if rules.order == "trust" and (rules.line_hz is not None or rules.shot_hz is not None):
        records = WeekSource(records)
    facts, n_records = source.facts, source.n_records
    ranges = open_ranges(
        rules.range, records.dimensions, source.path, config, crs_wkt=facts.crs_wkt, sensor_xyz=rules.has_sensor_xyz
    )
    m, assumption = given_points_per_line(rules, facts.points_per_line)
    counts_records = rules.lines == "fixed" and not rules.has_returns and not rules.pads_last_line
    if counts_records and m is not None and n_records is not None and config.window is None:
        check_partial_line(source.path, n_records, m, source=records)
    end = None
    if config.window is not None and rules.scanner is None:
        end = WindowEnd(config.window, rules.line_hz if rules.line_hz is not None else line_hz)
    setups, n_lines, found = find_setups(records, rules, ranges, m, geometry=geometry, end=end)
    sizes = [setup.points_per_line for setup in setups.values()] or ([m] if m is not None else [])
    if not sizes:
        raise nothing_placed(source.path)
    if n_lines is None and rules.is_dense and n_records is not None:
        n_lines = -(-n_records // max(sizes))
    default = None
    if m is not None:
        default = ScannerSetup(m, Estimates(timing=given_timing(rules, m)), given_angles(rules, m))
    alone = next(iter(setups.values())) if len(setups) == 1 else None
    down_rad = None if alone is None else alone.down_rad
    if (told := facts.rule("nadir")) is not None and alone is not None and down_rad is None:
        down_rad = math.radians(float(told.value))
    info = StreamInfo(
        path=source.path,
        format=source.format,
        points_per_line=max(sizes),
        n_records=n_records,
        n_lines=n_lines,
        angle_rad=None if alone is None else alone.angle_rad,
        line_hz=rules.line_hz if rules.line_hz is not None else line_hz,
        down_rad=down_rad,
        cos_tilt=1.0 if alone is None else alone.cos_tilt,
        downs={one: (setup.down_rad, setup.cos_tilt) for one, setup in setups.items() if setup.down_rad is not None},
        assumptions=(*rules.assumptions, *ranges.assumptions, *([assumption] if assumption else []), *found),
        facts=facts,
        dimensions=records.dimensions,
    )
    if only_ranges and "intensity" not in (*rules.names, *ranges.names):
        facts.skip_intensity()
    return GridStream(info, records, rules, ranges, setups, default, only_ranges)


@dataclass(frozen=True, slots=True, repr=False)
class GridStream(Brief):
    """Records as a stream of blocks; see :func:`open_grid`."""

    info: StreamInfo
    source: RecordSource
    rules: GridRules
    ranges: RangeRule
    setups: dict[int, ScannerSetup]
    """By scanner."""
    default: ScannerSetup | None
    """For scanners not met before; None where all are known."""
    only_ranges: bool = False
    """Whether blocks have no times and intensities."""

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        if self.rules.is_dense:
            yield from self._dense_blocks()
            return
        for whole in whole_lines(self.source, self.rules, self._line_rules, self._carried(), self._prepare):
            yield from blocks_of(whole, self._cell_rules(whole.scanner))

    def _setup(self, scanner: int) -> ScannerSetup:
        setup = self.setups.get(scanner, self.default)
        if setup is None:
            problem = f"{self.rules.scanner} {scanner} was not there when the file was first read"
            raise InputError(self.source.path, problem, "the file changed while it was read: run again")
        return setup

    def _line_rules(self, scanner: int) -> LineRules:
        setup, rules = self._setup(scanner), self.rules
        m, cells = setup.points_per_line, None
        # fixed lines: every shot has a cell, no limit needed
        if rules.lines != "fixed":
            n_known = max(self.info.n_records or 0, sum(setup.n_shots for setup in self.setups.values()))
            cells = cell_limit(m, n_known, rules.max_gap_lines, is_alone=rules.scanner is None)
        return line_rules(rules, m, setup.found, cells=cells, spent=self._spent())

    def _cell_rules(self, scanner: int) -> CellRules:
        setup, rules = self._setup(scanner), self.rules
        return CellRules(
            points_per_line=setup.points_per_line,
            columns=column_rule(rules, setup.found.angle_grid),
            chosen_return=rules.chosen_return,
            angle_rad=setup.angle_rad,
            # times and intensities are not needed once returns are chosen
            with_time=rules.has_time and not self.only_ranges,
            with_intensity=rules.has_intensity and not self.only_ranges,
            with_xyz=self.ranges.gives_xyz,
            pads_last_line=rules.pads_last_line,
        )

    def _spent(self) -> tuple[str, ...]:
        """Return the dimensions needed only to find shots and lines, which are dropped afterwards to save copying."""
        rules = self.rules
        kept = {rules.column_dimension, "angle", "return_number"}
        # these may also be the dimension of lines or scanners
        if not self.only_ranges or rules.shot_hz is not None:
            kept.add("time")
        if self._needs_intensity:
            kept.add(INTENSITY)
        return tuple(name for name in rules.names if name not in kept)

    def _carried(self) -> tuple[str, ...]:
        """Return the dimensions needed beside those for the cells."""
        return (*self.ranges.names, *(("intensity",) if self._needs_intensity else ()))

    @property
    def _needs_intensity(self) -> bool:
        decides = self.rules.has_returns and self.rules.chosen_return == "strongest"
        return self.rules.has_intensity and (decides or not self.only_ranges)

    def _prepare(self, chunk: RecordChunk, table: Table) -> tuple[Table, ReadTally]:
        """Add ranges, coordinates and intensities to the table of a chunk."""
        values = chunk.values
        if self.ranges.trajectory is not None:
            values = {**values, "time": times_of_trajectory(chunk, self.ranges.trajectory.span[0])}
        table[RANGE], xyz, tally = clean_measured(values, self.ranges)
        # removed before the order check could count it
        tally += ReadTally(n_time_steps_back=week_steps(chunk))
        if xyz is not None:
            table[XYZ] = xyz
        if self._needs_intensity:
            table[INTENSITY] = chunk.values["intensity"]
        return table, tally

    def _dense_blocks(self) -> Iterator[ScanBlock]:
        """Yield blocks of dense records, one per cell, without moving any."""
        rules, cells = self.rules, self._cell_rules(0)
        m = cells.points_per_line
        watch = open_watch(self.source, rules.order) if rules.has_time else None
        needs_records = watch is not None or rules.pads_last_line
        rest: Table = {}
        n_records = first_line = 0
        tally = ReadTally()
        for chunk in self.source.chunks(tuple(dict.fromkeys((*rules.names, *self._carried())))):
            own = {name: chunk.values[name] for name in rules.names}
            table, cleaned = self._prepare(chunk, table_of(chunk, rules.names) if needs_records else own)
            tally += cleaned + ReadTally(n_records=chunk.n)
            if watch is not None:
                tally += see_times(watch, table)
            n_records += chunk.n
            if rest and len(rest[RANGE]):
                table = {name: np.concatenate([rest[name], table[name]]) for name in table}
            n_whole = len(table[RANGE]) // m
            for start in range(0, n_whole, max(MAX_BLOCK_CELLS // m, 1)):
                stop = min(start + max(MAX_BLOCK_CELLS // m, 1), n_whole)
                yield dense_block(take(table, slice(start * m, stop * m)), first_line, cells, tally)
                first_line, tally = first_line + stop - start, ReadTally()
            rest = {name: column[n_whole * m :].copy() for name, column in table.items()}
        if watch is not None:
            watch.finish()
        if not n_records:
            raise nothing_placed(self.source.path)
        if not rules.pads_last_line:
            check_partial_line(self.source.path, n_records, m)
        if n_records % m:
            yield dense_block(pad_line(rest, m), first_line, cells, tally)
