"""Options shared by several commands, and the configuration tables built from them.

``stream_options``  how a stream is read from an input, and with which parameters it is classified
``input_options``   only how a stream is read
``window_options``  which part of it
``output_options``  ``--json --quiet --verbose``
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import click

from prc_cli.cli.completing import complete_assignment
from prc_cli.config import PRESETS, LoadedConfig, load_config, parse_assignment
from prc_cli.core.config import merge, read_toml
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.samples import or_sample
from prc_cli.methods.methods import METHODS

CommandT = TypeVar("CommandT", bound=Callable[..., Any])

_CLASSIFIER_OPTIONS = [
    click.option("--method", type=click.Choice(METHODS),
                 help="Classifier; default: what the preset or the configuration says, else what labels IN best."),
    click.option("--preset", type=click.Choice(list(PRESETS)),
                 help="Parameters to start from. urban, forest: PRC; street-scan: sequential-angle, for static scans; "
                 "fused, fused-forest: both combined. Default: what labels IN best."),
]  # fmt: skip

_INPUT_OPTIONS = [
    click.option("--config", "config_file", type=click.Path(path_type=Path), metavar="FILE.toml",
                 help="Configuration, or the name of a sample: prc config presets lists them."),
    click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", shell_complete=complete_assignment,
                 help="Any key, e.g. prc.support.zeta_p=0.1."),
    click.option("--layout", "layout_file", type=click.Path(path_type=Path), metavar="FILE.toml",
                 help="Record layout of a raw dump or a text file."),
    click.option("--lines", help="dimension:NAME, fixed, angle-wrap, time:HZ, elevation:DEG or rings."),
    click.option("--columns", help="dimension:NAME, angle, time:HZ or order."),
    click.option("--range", "range_", help="dimension:NAME, trajectory:FILE, origin:X,Y,Z or sensor-xyz."),
    click.option("--scanner", help="none, scanner_channel, point_source_id or user_data."),
    click.option("--topic", help="Bags: topics to read; captures: ADDRESS:PORT. Several with commas."),
    click.option("--metadata", metavar="FILE.json", help="Captures: metadata of an Ouster sensor."),
    click.option("--return", "return_", help="strongest, first or last."),
    click.option("-M", "--points-per-line", type=click.IntRange(min=1), help="Shots in a scan line."),
    click.option("--max-range", type=float, metavar="METRES", help="Ranges beyond are missing."),
    click.option("--accept-doubt", "accept_doubts", multiple=True, metavar="NAME", type=click.Choice(CHECK_NAMES),
                 help="Go on in spite of a check (prc info names them); it is recorded. Repeat for several."),
    click.option("--trust-order", "trust_order", is_flag=True, help="Take the order of the records as it is."),
]  # fmt: skip

_SORT_OPTION = click.option("--sort-by-time", "sort_by_time", is_flag=True, help="Sort the records by time first.")

_WINDOW_OPTIONS = [
    click.option("--only-lines", "window_lines", metavar="A:B", help="Take lines A to B - 1 alone, from 0."),
    click.option("--only-time", "window_time", metavar="A:B",
                 help="Take the lines of these times alone [s]; +A:+B = since the first one."),
    click.option("--first", "window_first", metavar="LENGTH", help="Take the first 30s, 2min or 500lines alone."),
]  # fmt: skip

_OUTPUT_OPTIONS = [
    click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout."),
    click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors and warnings (and --json)."),
    click.option("-v", "--verbose", is_flag=True, help="Print every assumption and count."),
]


def stream_options(command: CommandT) -> CommandT:
    """Add the options for reading and classifying a stream."""
    return live_options(_SORT_OPTION(command))


def live_options(command: CommandT) -> CommandT:
    """Add the options for classifying a stream as it arrives, which cannot be sorted."""
    for option in reversed([*_CLASSIFIER_OPTIONS, *_INPUT_OPTIONS]):
        command = option(command)
    return command


def input_options(command: CommandT) -> CommandT:
    """Add the options for reading a stream, for commands that do not classify."""
    for option in reversed([*_INPUT_OPTIONS, _SORT_OPTION]):
        command = option(command)
    return command


def window_options(command: CommandT) -> CommandT:
    """Add the options for reading a part of a stream, to try settings."""
    for option in reversed(_WINDOW_OPTIONS):
        command = option(command)
    return command


def output_options(command: CommandT) -> CommandT:
    """Add ``--json``, ``--quiet`` and ``--verbose``."""
    for option in reversed(_OUTPUT_OPTIONS):
        command = option(command)
    return command


@dataclass(frozen=True, slots=True)
class Layers:
    """Layers of the configuration; later ones win."""

    path: Path | None
    """``--config``."""
    preset: str | None
    """``--preset``; the file may also name one."""
    table: dict[str, Any]
    """All other options, nested."""
    files: tuple[Path, ...]
    """Other files that were read."""


def config_from(options: dict[str, Any]) -> LoadedConfig:
    """Build the configuration from the values of :func:`stream_options` (given as keyword arguments)."""
    layers = layers_from(options)
    loaded = load_config(layers.path, layers.preset, layers.table)
    return replace(loaded, files=(*loaded.files, *layers.files))


def layers_from(options: dict[str, Any]) -> Layers:
    """Read the values of :func:`stream_options` as separate layers, without merging them."""
    sort_by_time = options.get("sort_by_time", False)
    if sort_by_time and options["trust_order"]:
        message = "--sort-by-time and --trust-order contradict each other"
        raise click.UsageError(message)
    order = "sort-time" if sort_by_time else "trust" if options["trust_order"] else None
    table: dict[str, Any] = {}
    layout_file: Path | None = options["layout_file"]
    if layout_file is not None:
        layout_file = or_sample(layout_file)
        content = read_toml(layout_file)
        table["layout"] = content.get("layout", content)
    for assignment in options["assignments"]:
        table = merge(table, parse_assignment(assignment))
    given = {
        "lines": options["lines"],
        "columns": options["columns"],
        "range": options["range_"],
        "scanner": options["scanner"],
        "topic": options["topic"],
        "metadata": options["metadata"],
        "return": options["return_"],
        "points_per_line": options["points_per_line"],
        "max_range": options["max_range"],
        "order": order,
        "accept_doubts": list(options["accept_doubts"]) or None,
        "only_lines": options.get("window_lines"),
        "only_time": options.get("window_time"),
        "first": options.get("window_first"),
    }
    inputs = {key: value for key, value in given.items() if value is not None}
    if inputs:
        table = merge(table, {"input": inputs})
    method, preset = options.get("method"), options.get("preset")
    if method is not None:
        of_preset = load_config(preset=preset).config.method if preset is not None else method
        if of_preset != method:
            message = f"--preset {preset} is for --method {of_preset}, not {method}"
            raise click.UsageError(message)
        table = merge(table, {"method": method})
    config_file: Path | None = options["config_file"]
    if config_file is not None:
        config_file = or_sample(config_file)
    return Layers(config_file, preset, table, () if layout_file is None else (layout_file,))
