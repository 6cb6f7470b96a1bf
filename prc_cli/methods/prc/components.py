"""Connected components: connect, fill holes, keep labels from block to block.

Lehtola et al. (2019), II-D.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import I32, I64, Mask
from prc_cli.methods.prc.components_loops import carry_labels, join_and_fill


class ComponentsParams(Params):
    """How segments keep their label from block to block (``[prc.components]``)."""

    min_votes: int = Field(
        3,
        ge=1,
        le=1_000_000,
        description="shots of the block boundary that must vote for an older label",
    )
    forks: Literal["all", "largest"] = Field(
        "all",
        description=(
            "which pieces of a segment that splits at the block boundary keep its label: "
            '"all" of them, as published, or the "largest" piece only'
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Components of a block after hole filling, before they get labels of the previous block."""

    image: I32
    """(lines, M) int32, component of every shot, 0 = none.

    Numbered in the order of their first shots.
    """
    pixels: I64
    """(n + 1,) int64, shots of every component; ``pixels[0]`` is 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """The segmentation H of a block: an image of component numbers, and the segment id of each."""

    image: I32
    """(lines, M) int32, component of every shot after hole filling, 0 = none."""
    pixels: I64
    """(n + 1,) int64, shots of every component; ``pixels[0]`` is 0."""
    ids: I64
    """(n + 1,) int64, segment id of every component; ``ids[0]`` is 0.

    Several components may share an id.
    """
    first_new_id: int
    """Ids below this one come from the previous block; only these can be shared."""
    next_id: int
    """First segment id that is still free."""

    def to_segments(self) -> I64:
        """Return H as segment ids, (lines, M) int64, 0 = none."""
        segments: I64 = self.ids[self.image]
        return segments

    def sum_by_id(self, counts: I64) -> I64:
        """Return the sum of the counts of the whole segment for every component.

        ``counts`` (n + 1,) int64; returns (n + 1,) int64.
        """
        sums = counts.copy()
        shared = np.flatnonzero((self.ids > 0) & (self.ids < self.first_new_id))
        _, position = np.unique(self.ids[shared], return_inverse=True)
        together = np.zeros(len(shared), dtype=np.int64)
        np.add.at(together, position, counts[shared])
        sums[shared] = together[position]
        return sums


@stage("components")
def join(supported: Mask, background: Mask) -> Joined:
    """Find the 4-connected components of S without G, then fill the holes that G left (II-D.1).

    ``supported, background`` (lines, M) bool.

    >>> join(np.array([[1, 1, 1, 0, 1]], dtype=bool), np.array([[0, 0, 1, 0, 0]], dtype=bool)).image
    array([[1, 1, 1, 0, 2]], dtype=int32)
    """
    return Joined(*join_and_fill(supported, background))


@stage("votes")
def identify(
    joined: Joined,
    last_line: I64,
    next_id: int,
    params: ComponentsParams,
) -> Components:
    """Give components the segment ids of the last line before the block, by vote (II-D.2).

    Every column where both lines have a label is one vote. A component gets the label with most
    votes, if there are enough; on ties the oldest. Several components may get the same label: a
    segment forks. With ``params.forks = "largest"`` only its piece with the most shots keeps the
    label, on ties the first one. The other components get new ids.

    ``last_line`` (M,) int64.

    A wall keeps the id 7 of the previous block, a new component gets 8:

    >>> wall_and_pole = np.array([[1, 1, 1, 0, 1], [1, 1, 1, 0, 1]], dtype=bool)
    >>> before = np.array([7, 7, 7, 7, 0])
    >>> joined = join(wall_and_pole, np.zeros((2, 5), dtype=bool))
    >>> identify(joined, before, 8, ComponentsParams()).to_segments()
    array([[7, 7, 7, 0, 8],
           [7, 7, 7, 0, 8]])
    """
    n_components = len(joined.pixels) - 1
    ids = carry_labels(joined.image[0], last_line.copy(), n_components, params.min_votes)
    if params.forks == "largest":
        ids = _keep_largest_pieces(ids, joined.pixels)
    new = np.flatnonzero(ids[1:] == 0) + 1
    ids[new] = np.arange(next_id, next_id + len(new))
    return Components(joined.image, joined.pixels, ids, next_id, next_id + len(new))


def _keep_largest_pieces(ids: I64, pixels: I64) -> I64:
    """Return the ids (n + 1,), with 0 for all components of an id but the one of most pixels."""
    largest_first = np.argsort(-pixels, kind="stable")
    _, place_of_largest = np.unique(ids[largest_first], return_index=True)
    kept = np.zeros_like(ids)
    largest = largest_first[place_of_largest]
    kept[largest] = ids[largest]
    return kept
