"""Opens an input file, or a window of it, as a stream of blocks, by the kind of its source.

Images have lines and columns and are blocks already. Records become blocks in
:mod:`prc_cli.streams.grid`, frames of rings in :mod:`prc_cli.streams.rings`. A window is some of
the lines, by number or by time, read no farther than to their end.
"""

from __future__ import annotations

from dataclasses import replace

from prc_cli.core.stream import Assumption
from prc_cli.formats.input import Input
from prc_cli.formats.joined import JoinedInput
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.ranges import refuse_scale
from prc_cli.formats.records import Reading, Source
from prc_cli.formats.systems import in_metres, refuse_degrees
from prc_cli.streams.filters import ordered, windowed
from prc_cli.streams.stream import Stream


def open_input(
    scan: Input | JoinedInput,
    config: InputConfig,
    *,
    lines_at_once: int = 1,
    geometry: bool = True,
    only_ranges: bool = False,
    with_intensity: bool = False,
    checks_layers: bool = False,
) -> Stream:
    """Open an input, or the files of one drive, as a stream of blocks.

    With ``only_ranges`` blocks of records have no times, and intensities only ``with_intensity``.
    With ``checks_layers`` all layers of LAZ are decoded, so that damage is found.
    """
    source = scan.records()
    layout = scan.layout
    config = with_layout(config, layout)
    # times say where a window is
    only_ranges = only_ranges and (config.window is None or config.window.in_lines)
    # imported here: images do not need it and start faster
    if source is None:
        images = scan.images(config, lines_at_once=lines_at_once)
        if images.info.format not in ("array", "bag"):
            refuse_scale(config, str(scan), "its ranges are metres")
        return windowed(ordered(Stream.of(images), config.order), config)
    implied = source.facts.rule("lines")
    if config.lines == "rings" or (
        config.lines == "auto" and implied is not None and implied.value == "rings"
    ):
        from prc_cli.streams.rings import open_rings

        return windowed(Stream.of(open_rings(source, config)), config)
    from prc_cli.formats.clock import with_clock
    from prc_cli.streams.grid import open_grid

    source = with_clock(source, config.time_unit)
    # the blocks of joined files go on from file to file
    if config.points_per_line is not None and isinstance(scan, Input):
        multiple_of = config.points_per_line * lines_at_once
        source = source.with_reading(Reading(multiple_of=multiple_of))
    if checks_layers:
        source = source.with_reading(Reading(checks_layers=True))
    of_points = config.range.partition(":")[0] in ("points", "trajectory", "origin", "sensor-xyz")
    if of_points:
        refuse_degrees(source)
    if not of_points or config.range_scale == 1.0:
        source = in_metres(source)
    line_hz = None if layout is None else layout.line_frequency
    source, config, assumptions = _with_lines(source, config)
    grid = open_grid(
        source,
        config,
        line_hz=line_hz,
        geometry=geometry,
        only_ranges=only_ranges,
        with_intensity=with_intensity,
        assumptions=assumptions,
    )
    return windowed(replace(Stream.of(grid), grid=grid), config)


def _with_lines(
    source: Source, config: InputConfig
) -> tuple[Source, InputConfig, tuple[Assumption, ...]]:
    """Add lines and columns found from points; return the source, its rules and assumptions."""
    if config.lines.startswith("elevation:"):
        from prc_cli.streams.rules import with_elevation

        return with_elevation(source, config)
    if config.range == "points":
        from prc_cli.streams.registered.source import with_points

        return with_points(source, config)
    if config.range.startswith(("trajectory:", "origin:")):
        from prc_cli.streams.registered.source import is_tile, with_path
        from prc_cli.streams.rules import with_sweeps

        if is_tile(source, config):
            return with_path(source, config)
        return source, *with_sweeps(source, config)
    return source, config, ()


def with_layout(config: InputConfig, layout: Layout | None) -> InputConfig:
    """Return the configuration with M from the layout, if it has none itself."""
    if layout is None or layout.points_per_line is None or config.points_per_line is not None:
        return config
    return config.model_copy(update={"points_per_line": layout.points_per_line})
