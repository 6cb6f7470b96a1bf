"""Optional values per record that ``[output]`` can ask for: one table for all writers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.stream import CriticalZetas, LabelledBlock, StageLabels
from prc_cli.core.types import U8
from prc_cli.formats.writing.options import OutputConfig

Values: TypeAlias = NDArray[Any]


@dataclass(frozen=True, slots=True)
class ExtraDimension:
    """A dimension in the extra bytes of LAS and LAZ files."""

    name: str
    dtype: np.dtype[Any]
    """Type of a value, little-endian."""
    description: str
    """At most 32 characters."""


RANGE = ExtraDimension("range", np.dtype("<f4"), "slant range [m]")


@dataclass(frozen=True, slots=True)
class OptionalColumn:
    """A value per record that is written only if requested."""

    dimension: ExtraDimension
    """Dimension in LAS and LAZ."""
    heading: str | None
    """Column in label tables; None = not written there."""
    option: str
    """Key of ``[output]`` that requests it."""
    what: str
    """Name in messages."""
    fill: float
    """Value of records outside all blocks, and of further returns where ``of_extra`` is None."""
    of_shots: Callable[[LabelledBlock], Values | None]
    """Values of the cells of a block, (lines, M); None if the method of the run has none."""
    of_extra: Callable[[LabelledBlock], Values] | None = None
    """Values of the further returns of a block, (n,)."""
    keep: bool = False
    """Whether values of a LAS input under this name stay; else they are replaced."""
    needs: str = ""
    """Method that finds it; empty if all do."""

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return self.dimension.name

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a value, little-endian."""
        return self.dimension.dtype


def _segments(block: LabelledBlock) -> Values:
    return np.zeros(block.labels.shape, np.uint32) if block.segments is None else block.segments


def _stage(found: Callable[[StageLabels], Values]) -> Callable[[LabelledBlock], Values | None]:
    return lambda block: None if block.stages is None else found(block.stages)


def _critical(found: Callable[[CriticalZetas], Values]) -> Callable[[LabelledBlock], Values | None]:
    return lambda block: None if block.critical is None else found(block.critical)


def _extra_confidence(block: LabelledBlock) -> U8:
    return np.zeros(len(block.extra_labels), np.uint8) if block.extra_confidence is None else block.extra_confidence


def _of_stages(
    name: str, dtype: str, text: str, fill: float, found: Callable[[LabelledBlock], Values | None]
) -> OptionalColumn:
    """Return a column of ``output.stages``."""
    dimension = ExtraDimension(name, np.dtype(dtype), text)
    needs = "fused, prc or sequential-angle method"
    return OptionalColumn(dimension, name, "stages", "stage", fill, found, needs=needs)


OPTIONAL_COLUMNS = (
    OptionalColumn(
        ExtraDimension("segment_id", np.dtype("<u4"), "segment R_b, 0 = none"),
        "segment",
        "segment_ids",
        "segment id",
        0,
        _segments,
    ),
    OptionalColumn(
        RANGE,
        None,
        "range",
        "range",
        np.nan,
        lambda block: block.block.range_m,
        lambda block: block.block.extra.range_m,
        keep=True,
    ),
    _of_stages("surface", "u1", "T 1, H 2, V 3, undecided 4", 0, _stage(lambda stages: stages.surface)),
    _of_stages(
        "dense_vegetation",
        "u1",
        "less sensitive test T', 1 = yes",
        0,
        _stage(lambda stages: stages.dense_vegetation.view(np.uint8)),
    ),
    _of_stages(
        "ground_height", "<f4", "z_g, 0 = height of scanner [m]", np.nan, _stage(lambda stages: stages.ground_height_m)
    ),
    _of_stages("height_above_ground", "<f4", "above ground [m], NaN unknown", np.nan, lambda block: block.above_m),
    _of_stages("trigger", "u1", "0 none, 1 before, 2 it, 3 after", 0, _stage(lambda stages: stages.trigger)),
    _of_stages("car_interval", "<u2", "divided interval, 0 = none", 0, _stage(lambda stages: stages.car_interval)),
    _of_stages("car_test", "u1", "1 V 2 T 3 wall 4 low 5 curb 6 C", 0, _stage(lambda stages: stages.car_test)),
    _of_stages(
        "critical_zeta_p", "<f4", "supported if below zeta_p [m]", np.nan, _critical(lambda zetas: zetas.in_line_m)
    ),
    _of_stages(
        "critical_zeta_s", "<f4", "supported if below zeta_s [m]", np.nan, _critical(lambda zetas: zetas.adjacent_m)
    ),
    OptionalColumn(
        ExtraDimension("confidence", np.dtype("u1"), "label is right [%], 0 unknown"),
        "confidence",
        "confidence",
        "confidence",
        0,
        lambda block: block.confidence,
        _extra_confidence,
        needs="fused method",
    ),
)
"""All optional columns, in the order of outputs."""


def asked_columns(options: OutputConfig) -> tuple[OptionalColumn, ...]:
    """Return the columns that ``[output]`` requests, in order.

    >>> [column.name for column in asked_columns(OutputConfig(segment_ids=True, range=True))]
    ['segment_id', 'range']
    """
    return tuple(column for column in OPTIONAL_COLUMNS if getattr(options, column.option))
