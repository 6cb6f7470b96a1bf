"""Opens an input file as a stream of blocks, by the kind of its source.

Images hold lines and columns and are blocks already. Records become blocks in :mod:`prc_cli.streams.grid`, frames of
rings in :mod:`prc_cli.streams.rings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prc_cli.core.stream import Assumption, ScanStream
from prc_cli.formats import open_images, open_source
from prc_cli.formats.joined import open_joined
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.ranges import refuse_scale


def open_input(
    path: Path,
    config: InputConfig,
    layout: Layout | None = None,
    *,
    lines_at_once: int = 1,
    geometry: bool = True,
    only_ranges: bool = False,
    parts: Sequence[Path] = (),
) -> ScanStream:
    """Open an input file, or the files of one drive as ``parts``, as a stream of blocks."""
    if config.window is None:
        return _open(
            path, config, layout,
            lines_at_once=lines_at_once, geometry=geometry, only_ranges=only_ranges, parts=parts,
        )  # fmt: skip
    from prc_cli.streams.window import windowed

    # times say where the window is
    only_ranges = only_ranges and config.window.in_lines
    stream = _open(path, config, layout, lines_at_once=lines_at_once, geometry=geometry, only_ranges=only_ranges)
    return windowed(stream, config)


def _open(
    path: Path,
    config: InputConfig,
    layout: Layout | None,
    *,
    lines_at_once: int,
    geometry: bool,
    only_ranges: bool,
    parts: Sequence[Path] = (),
) -> ScanStream:
    """Open the whole input."""
    source = open_source(path, layout) if len(parts) < 2 else open_joined(parts, layout)
    config = with_layout(config, layout)
    # imported here: images do not need it and start faster
    if source is None:
        from prc_cli.streams.order import WatchedStream

        images = open_images(path, config, lines_at_once=lines_at_once)
        if images.info.format != "array":
            refuse_scale(config, str(path), "its ranges are metres")
        return WatchedStream(images, config.order)
    implied = source.facts.rule("lines")
    if config.lines == "rings" or (config.lines == "auto" and implied is not None and implied.value == "rings"):
        from prc_cli.streams.rings import open_rings

        return open_rings(source, config)
    from prc_cli.streams.grid import open_grid

    if config.points_per_line is not None:
        source.facts.align_chunks(config.points_per_line * lines_at_once)
    line_hz = None if layout is None else layout.line_frequency
    if not config.lines.startswith("elevation:"):
        told: tuple[Assumption, ...] = ()
        if config.range.startswith(("trajectory:", "origin:")):
            from prc_cli.streams.sweeps import tell_sweeps, with_sweeps

            config, told = with_sweeps(source, config)
        stream = open_grid(source, config, line_hz=line_hz, geometry=geometry, only_ranges=only_ranges)
        return tell_sweeps(stream, told) if told else stream
    from prc_cli.streams.elevation import tell_elevation, with_elevation

    risen, rules = with_elevation(source, config)
    stream = open_grid(risen, rules, line_hz=line_hz, geometry=geometry, only_ranges=only_ranges)
    return tell_elevation(stream, config.lines)


def with_layout(config: InputConfig, layout: Layout | None) -> InputConfig:
    """Return the configuration with M from the layout, if it has none itself."""
    if layout is None or layout.points_per_line is None or config.points_per_line is not None:
        return config
    return config.model_copy(update={"points_per_line": layout.points_per_line})
