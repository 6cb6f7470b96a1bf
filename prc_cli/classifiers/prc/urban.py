"""Classes in the built environment (Lehtola et al. 2019, II-F): ground, buildings, vegetation, noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.classifiers.prc.components import Components
from prc_cli.classifiers.prc.surfaces import Surfaces, sum_by_id
from prc_cli.core.classes import Label
from prc_cli.core.config import Params
from prc_cli.core.types import I64, U8, Mask


class UrbanParams(Params):
    """Which smooth segment is the ground (``[prc.urban]``)."""

    ground: Literal["running-total", "block"] = Field(
        "running-total",
        description='the ground is the smooth segment with most shots: "running-total" counts them since the segment '
        'began, "block" in the block alone, where a large facade may win',
    )


@dataclass(frozen=True, slots=True, eq=False)
class Totals:
    """Smooth shots so far of the segments that may still go on; the others can never come back."""

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


def urban(
    supported: Mask, components: Components, surfaces: Surfaces, totals: Totals, params: UrbanParams
) -> tuple[U8, Totals]:
    """Label a block of the built environment.

    Parameters
    ----------
    supported : (lines, M) bool
        S.
    components : Components
        H.
    surfaces : Surfaces
        R and what is smooth in it.
    totals : Totals
        Of the blocks before.
    params : UrbanParams

    Returns
    -------
    labels : (lines, M) uint8
        The smooth segment with most shots so far (of equals the oldest) is GROUND, other smooth ones BUILDING,
        non-smooth shots VEGETATION, all else NOISE.
    totals : Totals
        Of the segments that are smooth on the block's last line.
    """
    smooth = surfaces.smooth
    component = components.image[smooth]
    ids, here, _ = sum_by_id(components.ids, np.bincount(component, minlength=len(components.ids)))
    ids, here = ids[here > 0], here[here > 0]
    running = here + totals.of(ids)

    labels = np.full(supported.shape, Label.NOISE, dtype=np.uint8)
    labels[supported] = Label.VEGETATION
    if len(ids):
        ground = ids[np.argmax(running if params.ground == "running-total" else here)]  # of equals the first: oldest
        of_component = np.where(components.ids == ground, np.uint8(Label.GROUND), np.uint8(Label.BUILDING))
        labels[smooth] = of_component[component]
    may_go_on = np.isin(ids, surfaces.segments[-1][smooth[-1]])
    return labels, Totals(ids[may_go_on], running[may_go_on])
