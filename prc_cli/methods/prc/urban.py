"""Classes in the built environment and in forests (Lehtola et al. 2019, II-F)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.core.classes import Label
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, I64, U8, Mask
from prc_cli.methods.prc.components import Components
from prc_cli.methods.prc.surfaces import Surfaces
from prc_cli.methods.prc.surfaces_loops import count_covered, draw_columns, draw_components

_OTHERS = np.array([Label.MISSING, Label.NOISE, Label.VEGETATION], dtype=np.uint8)


class UrbanParams(Params):
    """Which smooth segment is the ground (``[prc.urban]``)."""

    ground: Literal["running-total", "block"] = Field(
        "running-total",
        description=(
            "the ground is the smooth segment with most shots: "
            '"running-total" counts them since the segment began, '
            '"block" in the block alone, where a large facade may win'
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Totals:
    """Smooth shots so far, by segment that may continue in the next block.

    Ended segments are dropped.
    """

    ids: I64
    """(n,) int64, segment ids, ascending."""
    counts: I64
    """(n,) int64, smooth shots."""

    @classmethod
    def none(cls) -> Totals:
        """Return the totals before the first block."""
        return cls(np.empty(0, np.int64), np.empty(0, np.int64))

    def of(self, ids: I64) -> I64:
        """Return the counts of the given ids, 0 where one is unknown, (len(ids),) int64."""
        if not len(self.ids):
            return np.zeros(len(ids), dtype=np.int64)
        place = np.minimum(np.searchsorted(self.ids, ids), len(self.ids) - 1)
        counts: I64 = np.where(self.ids[place] == ids, self.counts[place], 0)
        return counts


@stage("classes")
def count_smooth(surfaces: Surfaces) -> I64:
    """Count the smooth shots of every component, (n + 1,) int64."""
    h = surfaces.components
    counts = h.pixels - count_covered(
        surfaces.supported, surfaces.covered, h.image, len(h.pixels) - 1
    )
    counts[0] = 0
    return counts


@stage("classes")
def find_ground(
    components: Components,
    smooth: I64,
    last_line: I64,
    totals: Totals,
    params: UrbanParams,
) -> tuple[int, Totals]:
    """Find the smooth segment with most shots so far, on ties the oldest.

    ``smooth`` (n + 1,) int64; ``last_line`` (M,) int64.
    """
    present = np.flatnonzero(smooth)
    ids, position = np.unique(components.ids[present], return_inverse=True)
    if not len(ids):
        return 0, Totals.none()
    in_block = np.zeros(len(ids), dtype=np.int64)
    np.add.at(in_block, position, smooth[present])
    running = in_block + totals.of(ids)
    # on ties the first, which is the oldest
    ground = ids[np.argmax(running if params.ground == "running-total" else in_block)]
    # the last shot of every stretch of equal ids; the last stretch follows below
    last_ids = last_line[np.flatnonzero(last_line[1:] != last_line[:-1])]
    may_continue = np.zeros(len(ids), dtype=bool)
    may_continue[np.searchsorted(ids, last_ids[last_ids > 0])] = True
    may_continue |= ids == last_line[-1]
    return int(ground), Totals(ids[may_continue], running[may_continue])


@stage("classes")
def urban(window: F32, surfaces: Surfaces, ground: int) -> U8:
    """Label a block of the built environment.

    ``window`` (reach + lines * M + reach,) float32, metres; returns (lines, M) uint8.
    """
    h = surfaces.components
    label_of = np.where(h.ids == ground, np.uint8(Label.GROUND), np.uint8(Label.BUILDING))
    return draw_components(window, surfaces.supported, surfaces.covered, h.image, label_of, _OTHERS)


class ForestParams(Params):
    """Which columns of a block are ground (``[prc.forest]``)."""

    column_step: int = Field(
        10,
        ge=1,
        le=1_000_000,
        description="columns that are ground, or not, together; the first one of them decides",
    )
    density: float = Field(
        1 / 3,
        ge=0,
        le=1,
        description="share of smooth shots in a column above which it is ground, of all k lines",
    )
    noise_in_ground_columns: bool = Field(
        True, description="noise in ground columns becomes ground, as printed; false keeps it noise"
    )


@stage("classes")
def forest(window: F32, surfaces: Surfaces, params: ForestParams) -> U8:
    """Label a block of forest.

    ``window`` (reach + lines * M + reach,) float32, metres; returns (lines, M) uint8.
    """
    dense = is_dense(surfaces.smooth, params)
    columns = np.repeat(dense, params.column_step)[: surfaces.supported.shape[1]]
    labels_of = np.array(
        [Label.MISSING, Label.NOISE, Label.GROUND, Label.VEGETATION, Label.STEM], dtype=np.uint8
    )
    return draw_columns(
        window,
        surfaces.supported,
        surfaces.covered,
        columns,
        params.noise_in_ground_columns,
        labels_of,
    )


def is_dense(smooth: Mask, params: ForestParams) -> Mask:
    """Return for every group of columns whether its first column is dense (eq. 12).

    A column is dense if the share of smooth shots is high enough. Noise and missing shots count in
    the denominator.

    >>> is_dense(np.zeros((255, 4270), dtype=bool), ForestParams()).shape
    (427,)
    """
    dense: Mask = (
        np.count_nonzero(smooth[:, :: params.column_step], axis=0) / len(smooth) > params.density
    )
    return dense
