"""Reads a complete file with functions of the library, in a worker."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

from prc_cli.cli.batch import _read_command
from prc_cli.config import load_config
from prc_cli.core.config import build, read_toml
from prc_cli.core.errors import PrcError
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.formats.input import Input
from prc_cli.formats.labels import open_codes
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.tables.read import open_table
from prc_cli.jobs.batch.journal import read_entries, read_runs
from prc_cli.jobs.batch.lock import holders
from prc_cli.jobs.batch.outputs import own_folder
from prc_cli.jobs.evaluate.options import mapping_of_runs
from prc_cli.streams.open import open_input
from prc_cli.streams.trajectory import load_trajectory
from tests.fuzz.seeds import LAYOUT


def blocks(path: Path, layout: Layout | None = None, **options: object) -> None:
    """Read records, blocks and class codes of an archive file."""
    source = Input.of(path, layout).records()
    if source is not None:
        for chunk in source.chunks(source.dimensions):
            del chunk
    refused = []
    fixed = {"lines": "fixed", "columns": "order", "points_per_line": 24}
    for rules in ({}, fixed, {**fixed, "partial_line": "pad", "range": "origin:0,0,2"}):
        try:
            for block in open_input(
                Input.of(path, layout), InputConfig(order="trust", **options, **rules)
            ).blocks():
                del block
        except PrcError as error:
            refused.append(error)
    if len(refused) == 3:
        raise refused[0]


def _codes(path: Path) -> None:
    """Read a file as labels and as a table."""
    for codes in open_codes(path).codes():
        del codes
    if (table := open_table(path)) is not None:
        for chunk in table.chunks(table.dimensions):
            del chunk


def _raw(path: Path) -> None:
    blocks(path, Layout.model_validate(tomllib.loads(LAYOUT)["layout"]))


def _layout(path: Path) -> None:
    content = read_toml(path)
    layout = build(Layout, content.get("layout", content), str(path))
    blocks(path.parent / "seeds" / "a.bin", layout)


def _trajectory(path: Path) -> None:
    load_trajectory(path, crs="EPSG:32635", source_crs_wkt=None, time_offset=0.0)


def _state(out: Path) -> None:
    """Read what a run left behind, as ``status``, ``clean`` and ``retry`` do."""
    folder = own_folder(out)
    read_entries(folder)
    read_runs(folder)
    holders(folder)
    _read_command(folder / "command.json")


def _record(labels: Path) -> None:
    mapping_of_runs([labels])


def _ouster(capture: Path) -> None:
    blocks(capture, metadata=str(capture.parent / "seeds" / "ouster.json"))


READS: dict[str, Callable[[Path], None]] = {
    "raw": _raw,
    "labels": _codes,
    "trajectory": _trajectory,
    "layout": _layout,
    "config": lambda path: void(load_config(path)),
    "ouster": _ouster,
    "state": _state,
    "record": _record,
    "mapping": lambda path: void(load_mapping(path)),
}
"""What is done with a file of a target; others are read by :func:`blocks`."""


def void(_: object) -> None:
    """Forget a value."""
