"""Lists of records to the stream of blocks, the same way for every format.

Which line, column and range a record has is decided here and nowhere else: rules (:mod:`.grid_rules`), what must
be known beforehand (:mod:`.grid_setup`), whole lines out of chunks (:mod:`.grid_lines`, :mod:`.grid_read`), cells
(:mod:`.grid_cells`). Memory stays at a chunk of records and the open lines of every scanner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import clean_ranges
from prc_cli.formats.raw_binary.read import RawBinarySource
from prc_cli.formats.records import RecordChunk, RecordSource
from prc_cli.stream.cells import (
    INTENSITY,
    MAX_BLOCK_CELLS,
    RANGE,
    XYZ,
    blocks_of,
)
from prc_cli.stream.gps_weeks import WeekSource, times_of_trajectory, week_steps
from prc_cli.stream.limits import cell_limit
from prc_cli.stream.ranges import RangeRule, measure_ranges, open_ranges
from prc_cli.stream.reading import (
    check_partial_line,
    judge_first_records,
    nothing_placed,
    open_watch,
    see_times,
    table_of,
    whole_lines,
)
from prc_cli.stream.rules import GridRules, given_points_per_line, resolve_rules
from prc_cli.stream.setup import (
    ScannerSetup,
    find_setups,
    given_angles,
    given_beat,
)
from prc_cli.stream.sorting import sorted_by_time
from prc_cli.stream.whole_lines import RECORD, LineRules, Table


def open_grid(
    source: RecordSource,
    config: InputConfig,
    *,
    line_hz: float | None = None,
    geometry: bool = True,
    only_ranges: bool = False,
) -> GridStream:
    """Turn a list of records into the stream.

    Parameters
    ----------
    source : RecordSource
        Decoded records; read once from the start, or twice where M must be found first.
    config : InputConfig
        How lines, columns and ranges are found; ``auto`` is resolved and reported in ``info.assumptions``.
    line_hz : float, optional
        Scan lines a second, where a layout says so [Hz].
    geometry : bool
        Find the angles of the columns, and where down is, where the lines do not need them.
    only_ranges : bool
        Leave times and intensities out of the blocks: what decides nothing then is not decoded.

    Returns
    -------
    ScanStream

    Raises
    ------
    InputError
        When the input does not hold what lines, columns or ranges could be found by.
    OrderError
        When that is so and its first records are not in the order they were fired either.
    ConfigError
        When the configuration names a dimension that is not there, or M is needed and not given.
    """
    records = sorted_by_time(source) if config.order == "sort-time" else source
    try:
        rules = resolve_rules(records, config)
    except InputError:
        # a file of no lines is often a tile: then its order is the better reason
        judge_first_records(source, config)
        raise
    if config.order == "trust" and (rules.line_hz is not None or rules.shot_hz is not None):
        records = WeekSource(records)
    ranges = open_ranges(rules.range, records.dimensions, source.path, config, crs_wkt=source.facts.crs_wkt)
    ranges = replace(ranges, sensor_xyz=rules.has_sensor_xyz)
    m, assumption = given_points_per_line(rules, source)
    if rules.lines == "fixed" and m is not None and not rules.has_returns and source.n_records is not None:
        check_partial_line(source.path, source.n_records, m, config)
    setups, n_lines, found = find_setups(records, rules, m, geometry=geometry)
    sizes = [setup.points_per_line for setup in setups.values()] or ([m] if m is not None else [])
    if not sizes:
        raise nothing_placed(source.path)
    if n_lines is None and rules.is_dense and source.n_records is not None:
        n_lines = -(-source.n_records // max(sizes))
    info = StreamInfo(
        path=source.path,
        format=source.format,
        points_per_line=max(sizes),
        n_records=source.n_records,
        n_lines=n_lines,
        angle_rad=next(iter(setups.values())).angle_rad if len(setups) == 1 else None,
        line_hz=rules.line_hz if rules.line_hz is not None else line_hz,
        nadir_rad=next(iter(setups.values())).nadir_rad if len(setups) == 1 else None,
        fall=next(iter(setups.values())).fall if len(setups) == 1 else 1.0,
        downs={
            scanner: (setup.nadir_rad, setup.fall) for scanner, setup in setups.items() if setup.nadir_rad is not None
        },
        assumptions=(*rules.assumptions, *ranges.assumptions, *([assumption] if assumption else []), *found),
        facts=source.facts,
        dimensions=records.dimensions,
    )
    default = None if m is None else ScannerSetup(m, None, None, given_angles(config, m), beat=given_beat(rules, m))
    stream = GridStream(info, records, rules, ranges, setups, default, only_ranges)
    if only_ranges and "intensity" not in (*rules.names, *ranges.names):
        source.facts.skip_intensity()
    return stream


@dataclass(frozen=True, slots=True)
class GridStream:
    """Records as a stream of blocks; see :func:`open_grid`."""

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

    @property
    def n_known(self) -> int:
        """Records as far as known, 0 if only reading can tell."""
        return max(self.info.n_records or 0, sum(setup.n_shots for setup in self.setups.values()))

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        return self._dense_blocks() if self.rules.is_dense else self._sparse_blocks()

    @property
    def can_seek(self) -> bool:
        """Whether :meth:`lines` gives any lines without reading those before them."""
        return self.rules.is_dense and isinstance(self.source, RawBinarySource)

    def lines(self, first_line: int, stop_line: int) -> Iterator[F32]:
        """Read the ranges of some lines alone, cleaned as in :meth:`blocks`; see :attr:`can_seek`.

        Yields
        ------
        (lines, M) float32, metres
        """
        assert isinstance(self.source, RawBinarySource)
        config, m = self.rules.config, self._setup(0).points_per_line
        rest: F32 = np.empty(0, np.float32)
        for chunk in self.source.chunks(self.ranges.names, first_line * m, stop_line * m):
            found, _ = measure_ranges(chunk.values, self.ranges)
            cleaned, _ = clean_ranges(found, config.min_range, config.max_range)
            cleaned = np.concatenate([rest, cleaned]) if len(rest) else cleaned
            n_whole = len(cleaned) // m * m
            yield cleaned[:n_whole].reshape(-1, m)
            rest = cleaned[n_whole:]
        if len(rest):  # the last line of the file, padded
            yield np.concatenate([rest, np.full(m - len(rest), np.nan, np.float32)])[None, :]

    def _setup(self, scanner: int) -> ScannerSetup:
        setup = self.setups.get(scanner, self.default)
        if setup is None:
            problem = f"{self.rules.scanner} {scanner} was not there when the file was first read"
            raise InputError(self.source.path, problem, "the file changed while it was read: run again")
        return setup

    def _line_rules(self, scanner: int) -> LineRules:
        setup = self._setup(scanner)
        m = setup.points_per_line
        # every shot of fixed lines has its cell
        cells = None if self.rules.lines == "fixed" else cell_limit(self.rules.config, m, self.n_known)
        return LineRules(self.rules, m, setup.sweep, setup.beat, cells, self._spent())

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

    def _sparse_blocks(self) -> Iterator[ScanBlock]:
        """Bring every record to its cell, whatever is missing between them."""
        for whole in whole_lines(self.source, self.rules, self._line_rules, self._carried(), self._prepare):
            yield from blocks_of(whole, self.rules, self._setup(whole.scanner), only_ranges=self.only_ranges)

    def _carried(self) -> tuple[str, ...]:
        """Return the dimensions that are needed beside those that decide the cells."""
        return (*self.ranges.names, *(("intensity",) if self._needs_intensity else ()))

    @property
    def _needs_intensity(self) -> bool:
        decides = self.rules.has_returns and self.rules.config.return_ == "strongest"
        return self.rules.has_intensity and (decides or not self.only_ranges)

    def _prepare(self, chunk: RecordChunk, table: Table) -> tuple[Table, ReadTally]:
        """Add ranges and what goes along with them to the table of a chunk."""
        values = chunk.values
        if self.ranges.trajectory is not None:
            values = {**values, "time": times_of_trajectory(chunk, self.ranges.trajectory.span[0])}
        found, xyz = measure_ranges(values, self.ranges)
        table[RANGE], tally = clean_ranges(found, self.rules.config.min_range, self.rules.config.max_range)
        # what was taken out before the watch could see it
        tally += ReadTally(n_time_steps_back=week_steps(chunk))
        if xyz is not None:
            table[XYZ] = xyz
        if self._needs_intensity:
            table[INTENSITY] = chunk.values["intensity"]
        return table, tally

    def _dense_blocks(self) -> Iterator[ScanBlock]:
        """Cut records that are the cells already into lines; nothing is moved."""
        setup, config = self._setup(0), self.rules.config
        m = setup.points_per_line
        watch = open_watch(self.source, config) if self.rules.has_time else None
        needs_records = watch is not None or config.partial_line == "pad"
        rest: Table = {}
        n_records = first_line = 0
        tally = ReadTally()
        names = tuple(dict.fromkeys((*self.rules.names, *self._carried())))
        for chunk in self.source.chunks(names):
            table = (
                table_of(chunk, self.rules.names)
                if needs_records
                else {name: chunk.values[name] for name in self.rules.names}
            )
            table, cleaned = self._prepare(chunk, table)
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
        check_partial_line(self.source.path, n_records, m, config)
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
        padded = self.rules.config.partial_line == "pad"
        record: I64 | None = table[RECORD][part].reshape(shape) if padded else None
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
