"""Records to blocks, the same way for every format: chunks, whole lines, cells.

Which line, column and range a record has is decided by rules that are resolved before (:mod:`.rules`, :mod:`.setup`).
Memory stays at a chunk of records and the open lines of every scanner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.records import RecordChunk, RecordSource
from prc_cli.stream.cells import MAX_BLOCK_CELLS, CellRules, blocks_of
from prc_cli.stream.gps_weeks import times_of_trajectory, week_steps
from prc_cli.stream.limits import cell_limit
from prc_cli.stream.probe import line_rules
from prc_cli.stream.ranges import RangeRule, clean_measured
from prc_cli.stream.reading import check_partial_line, nothing_placed, open_watch, see_times, table_of, whole_lines
from prc_cli.stream.rules import GridRules
from prc_cli.stream.setup import ScannerSetup, column_rule
from prc_cli.stream.table import INTENSITY, RANGE, RECORD, XYZ, Table
from prc_cli.stream.whole_lines import LineRules


@dataclass(frozen=True, slots=True)
class GridStream:
    """Records as a stream of blocks; see :func:`prc_cli.stream.open.open_grid`."""

    info: StreamInfo
    source: RecordSource
    rules: GridRules
    ranges: RangeRule
    setups: dict[int, ScannerSetup]
    """By scanner."""
    default: ScannerSetup | None
    """For scanners that were not met beforehand; None where that cannot be."""
    only_ranges: bool = False
    """Whether blocks hold neither times nor intensities."""

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
        # every shot of fixed lines has its cell
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
            # times and intensities have done their work once the returns are chosen
            with_time=rules.has_time and not self.only_ranges,
            with_intensity=rules.has_intensity and not self.only_ranges,
            with_xyz=self.ranges.gives_xyz,
        )

    def _spent(self) -> tuple[str, ...]:
        """Return the dimensions that only find the shots and their lines: fewer columns are cut and joined then."""
        rules = self.rules
        kept = {rules.column_dimension, "angle", "return_number"}
        # a line or a scanner may be told by one of these, too
        if not self.only_ranges or rules.shot_hz is not None:
            kept.add("time")
        if self._needs_intensity:
            kept.add(INTENSITY)
        return tuple(name for name in rules.names if name not in kept)

    def _carried(self) -> tuple[str, ...]:
        """Return the dimensions that are needed beside those that decide the cells."""
        return (*self.ranges.names, *(("intensity",) if self._needs_intensity else ()))

    @property
    def _needs_intensity(self) -> bool:
        decides = self.rules.has_returns and self.rules.chosen_return == "strongest"
        return self.rules.has_intensity and (decides or not self.only_ranges)

    def _prepare(self, chunk: RecordChunk, table: Table) -> tuple[Table, ReadTally]:
        """Add ranges and what goes along with them to the table of a chunk."""
        values = chunk.values
        if self.ranges.trajectory is not None:
            values = {**values, "time": times_of_trajectory(chunk, self.ranges.trajectory.span[0])}
        table[RANGE], xyz, tally = clean_measured(values, self.ranges)
        # what was taken out before the watch could see it
        tally += ReadTally(n_time_steps_back=week_steps(chunk))
        if xyz is not None:
            table[XYZ] = xyz
        if self._needs_intensity:
            table[INTENSITY] = chunk.values["intensity"]
        return table, tally

    def _dense_blocks(self) -> Iterator[ScanBlock]:
        """Cut records that are the cells already into lines; nothing is moved."""
        setup, rules = self._setup(0), self.rules
        m = setup.points_per_line
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
                yield self._dense_block(table, slice(start * m, stop * m), first_line, setup, tally)
                first_line, tally = first_line + stop - start, ReadTally()
            rest = {name: column[n_whole * m :].copy() for name, column in table.items()}
        if watch is not None:
            watch.finish()
        if not n_records:
            raise nothing_placed(self.source.path)
        if not rules.pads_last_line:
            check_partial_line(self.source.path, n_records, m)
        if n_records % m:
            yield self._dense_block(_pad(rest, m), slice(0, m), first_line, setup, tally)

    def _dense_block(
        self, table: Table, part: slice, first_line: int, setup: ScannerSetup, tally: ReadTally
    ) -> ScanBlock:
        shape = (-1, setup.points_per_line)
        time_s: F64 | None = None
        if "time" in table and not self.only_ranges:
            time_s = np.asarray(table["time"][part], np.float64).reshape(shape)
        intensity: F32 | None = None
        if INTENSITY in table:
            intensity = table[INTENSITY][part].astype(np.float32).reshape(shape)
        # cells that were padded have no record, so the short form would be wrong
        record: I64 | None = table[RECORD][part].reshape(shape) if self.rules.pads_last_line else None
        return ScanBlock(
            first_line=first_line,
            range_m=table[RANGE][part].reshape(shape),
            record=record,
            time_s=time_s,
            intensity=intensity,
            angle_rad=setup.angle_rad,
            tally=tally,
        )


def _pad(rest: Table, m: int) -> Table:
    """Fill the last line up with missing shots."""
    padded: Table = {}
    for name, column in rest.items():
        filler = np.full(m - len(column), -1 if name == RECORD else np.nan)
        padded[name] = np.concatenate([column, filler.astype(column.dtype if name == RECORD else np.float64)])
    padded[RANGE] = padded[RANGE].astype(np.float32)
    return padded
