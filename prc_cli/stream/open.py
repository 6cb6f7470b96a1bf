"""An archive becomes a stream: open the source, resolve the rules, set up the scanners; lines, cells and blocks follow.

Images, whose lines and columns are in the file, are blocks of the stream already; frames of rings have a way of their
own. All other files are records, whose blocks :class:`prc_cli.stream.grid.GridStream` makes.
"""

from __future__ import annotations

from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanStream, StreamInfo
from prc_cli.formats import open_images, open_source
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import RecordSource
from prc_cli.stream.elevation import has_lines_by_elevation, tell_elevation, with_elevation
from prc_cli.stream.gps_weeks import WeekSource
from prc_cli.stream.grid import GridStream
from prc_cli.stream.order import WatchedStream
from prc_cli.stream.probe import Estimates, given_beat
from prc_cli.stream.ranges import open_ranges
from prc_cli.stream.reading import check_partial_line, judge_first_records, nothing_placed
from prc_cli.stream.rules import given_points_per_line, resolve_rules
from prc_cli.stream.setup import ScannerSetup, find_setups, given_angles
from prc_cli.stream.sorting import sorted_by_time


def open_input(
    path: Path,
    config: InputConfig,
    layout: Layout | None = None,
    *,
    lines_at_once: int = 1,
    geometry: bool = True,
    only_ranges: bool = False,
) -> ScanStream:
    """Open an input file as a stream of blocks.

    Parameters
    ----------
    path : Path
        Input file.
    config : InputConfig
        How lines, columns and ranges are found.
    layout : Layout, optional
        Records of a raw dump or a text file; raw dumps without one are float32 ranges alone.
    lines_at_once : int
        Lines that are used together: files whose lines are known beforehand are best read in multiples of them.
    geometry : bool
        Find the angles of the columns and where down is; who needs nothing but ranges saves reading the first records
        for them.
    only_ranges : bool
        Times and intensities of the shots may be left out of the blocks; coordinates stay.

    Raises
    ------
    InputError
        When the file is damaged or does not hold what the configuration asks for.
    """
    source = open_source(path, layout)
    config = with_layout(config, layout)
    if source is None:
        return WatchedStream(open_images(path, config, lines_at_once=lines_at_once), config.order)
    if config.lines == "rings":
        from prc_cli.stream.rings import open_rings

        return open_rings(source, config)
    if config.points_per_line is not None:
        source.facts.align_chunks(config.points_per_line * lines_at_once)
    line_hz = None if layout is None else layout.line_frequency
    if not has_lines_by_elevation(config):
        return open_grid(source, config, line_hz=line_hz, geometry=geometry, only_ranges=only_ranges)
    risen, found = with_elevation(source, config)
    stream = open_grid(risen, found, line_hz=line_hz, geometry=geometry, only_ranges=only_ranges)
    return tell_elevation(stream, config.lines)


def with_layout(config: InputConfig, layout: Layout | None) -> InputConfig:
    """Return the configuration with M of the layout, where it gives none itself."""
    if layout is None or layout.points_per_line is None or config.points_per_line is not None:
        return config
    return config.model_copy(update={"points_per_line": layout.points_per_line})


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
    if counts_records and m is not None and n_records is not None:
        check_partial_line(source.path, n_records, m)
    setups, n_lines, found = find_setups(records, rules, ranges, m, geometry=geometry)
    sizes = [setup.points_per_line for setup in setups.values()] or ([m] if m is not None else [])
    if not sizes:
        raise nothing_placed(source.path)
    if n_lines is None and rules.is_dense and n_records is not None:
        n_lines = -(-n_records // max(sizes))
    default = None
    if m is not None:
        default = ScannerSetup(m, Estimates(beat=given_beat(rules, m)), given_angles(rules, m))
    alone = next(iter(setups.values())) if len(setups) == 1 else None
    info = StreamInfo(
        path=source.path,
        format=source.format,
        points_per_line=max(sizes),
        n_records=n_records,
        n_lines=n_lines,
        angle_rad=None if alone is None else alone.angle_rad,
        line_hz=rules.line_hz if rules.line_hz is not None else line_hz,
        nadir_rad=None if alone is None else alone.nadir_rad,
        fall=1.0 if alone is None else alone.fall,
        downs={one: (setup.nadir_rad, setup.fall) for one, setup in setups.items() if setup.nadir_rad is not None},
        assumptions=(*rules.assumptions, *ranges.assumptions, *([assumption] if assumption else []), *found),
        facts=facts,
        dimensions=records.dimensions,
    )
    if only_ranges and "intensity" not in (*rules.names, *ranges.names):
        facts.skip_intensity()
    return GridStream(info, records, rules, ranges, setups, default, only_ranges)
