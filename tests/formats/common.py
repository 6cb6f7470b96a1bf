"""Blocks and run records for tests of writers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.stream import (
    Assumption,
    ExtraReturns,
    LabelledBlock,
    ReadTally,
    ScanBlock,
    StageLabels,
)
from prc_cli.core.types import F32, I64, U8
from prc_cli.formats.input import Input
from prc_cli.formats.outputs import open_writer
from prc_cli.formats.writing.base import StagedWriter
from prc_cli.formats.writing.columns import LabelOutput
from prc_cli.formats.writing.record import Fingerprint, RunRecord

URBAN = (Label.UNCLASSIFIED, Label.NOISE, Label.GROUND, Label.BUILDING, Label.VEGETATION)
FOREST = (*URBAN, Label.STEM)


def run_record(**changes: Any) -> RunRecord:
    values: dict[str, Any] = {
        "config": {"prc": {"A": 12}, "input": {"range": "dimension:range"}},
        "input": Fingerprint("drive.bin", 17, "00ff"),
        "format": "raw binary",
        "points_per_line": 20,
        "assumptions": (Assumption("input.lines", "fixed", "told so"),),
        "tally": ReadTally(n_not_finite=3),
    }
    return RunRecord(**(values | changes))


def labelled(
    labels: U8,
    *,
    first_line: int = 0,
    record: I64 | None = None,
    range_m: F32 | None = None,
    segments: I64 | None = None,
    extra: ExtraReturns | None = None,
    extra_labels: U8 | None = None,
    stages: StageLabels | None = None,
    **fields: Any,
) -> LabelledBlock:
    """A block; ranges are 10 m where the label is not MISSING unless given."""
    if range_m is None:
        range_m = np.where(labels == Label.MISSING, np.nan, 10.0).astype(np.float32)
    block = ScanBlock(
        first_line=first_line,
        range_m=range_m,
        record=record,
        extra=extra or ExtraReturns.none(),
        **fields,
    )
    extra_labels = np.empty(0, np.uint8) if extra_labels is None else extra_labels
    return LabelledBlock(block, labels, extra_labels, segments, stages)


def record_blocks(
    labels: U8, m: int = 20, *, order: I64 | None = None, **fields: Any
) -> list[LabelledBlock]:
    """Blocks of two lines that give record i the label i.

    ``order`` is the scan order of the records.
    """
    order = np.arange(len(labels)) if order is None else order
    cells = np.full(-(-len(labels) // (2 * m)) * 2 * m, -1, np.int64)
    cells[: len(order)] = order
    blocks = []
    for first in range(0, len(cells), 2 * m):
        record = cells[first : first + 2 * m].reshape(2, m)
        values = np.where(record >= 0, labels[record], Label.MISSING).astype(np.uint8)
        cell_values: dict[str, Any] = {
            name: np.where(record >= 0, field[record], 0) for name, field in fields.items()
        }
        if "range_m" in cell_values:
            cell_values["range_m"] = np.where(record >= 0, cell_values["range_m"], np.nan).astype(
                np.float32
            )
        blocks.append(labelled(values, first_line=first // m, record=record, **cell_values))
    return blocks


def writer(path: Path, source: Path, *, overwrite: bool = False, **changes: Any) -> StagedWriter:
    output = LabelOutput(
        path=path, source=Input.of(source), n_records=None, points_per_line=20, codes=ClassCodes()
    )
    return open_writer(replace(output, **changes), overwrite=overwrite)


def write(
    path: Path,
    source: Path,
    blocks: list[LabelledBlock],
    record: RunRecord | None = None,
    **changes: Any,
) -> RunRecord:
    """Write a whole output."""
    with writer(path, source, **changes) as opened:
        for block in blocks:
            opened.add(block)
        return opened.finish(record or run_record())


def random_labels(n: int, of: tuple[Label, ...] = URBAN, seed: int = 1) -> U8:
    return np.random.default_rng(seed).choice(np.array(of, np.uint8), n)
