"""Connected components (Lehtola et al. 2019, II-D): connect, fill holes, carry labels over the block boundary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import I32, I64, Mask


class ComponentsParams(Params):
    """How segments keep their label from block to block (``[prc.components]``)."""

    min_votes: int = Field(
        3, ge=1, le=1_000_000, description="shots of the block boundary that must vote for an older label"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """The segmentation H of a block, as an image of small numbers and the segment ids they stand for."""

    image: I32
    """(lines, M) int32, component of every shot after hole filling, 0 = none."""
    ids: I64
    """(n + 1,) int64, segment id of every component; ``ids[0]`` is 0. Several components may share an id."""
    next_id: int
    """First segment id that is still free."""

    def to_segments(self) -> I64:
        """Return H as segment ids, (lines, M) int64, 0 = none."""
        segments: I64 = self.ids[self.image]
        return segments


def components(supported: Mask, background: Mask, last_line: I64, next_id: int, params: ComponentsParams) -> Components:
    """Segment a block: connect, fill holes, then carry labels over from the block before.

    Parameters
    ----------
    supported, background : (lines, M) bool
        S and G.
    last_line : (M,) int64
        Segment ids of smooth shots of the last line before the block, 0 elsewhere.
    next_id : int
        First free segment id.
    params : ComponentsParams

    Returns
    -------
    Components
        H (eq. 10).

    Examples
    --------
    A wall keeps the id 7 that it had in the block before, what is new gets 8:

    >>> wall_and_pole = np.array([[1, 1, 1, 0, 1], [1, 1, 1, 0, 1]], dtype=bool)
    >>> before = np.array([7, 7, 7, 7, 0])
    >>> components(wall_and_pole, np.zeros((2, 5), dtype=bool), before, 8, ComponentsParams()).to_segments()
    array([[7, 7, 7, 0, 8],
           [7, 7, 7, 0, 8]])
    """
    image, n_components = kernels.label_components(supported & ~background)
    image = kernels.fill_holes(image, background)
    ids = carry_labels(image[0], last_line, n_components, params.min_votes)
    new = np.flatnonzero(ids[1:] == 0) + 1
    ids[new] = np.arange(next_id, next_id + len(new))
    return Components(image, ids, next_id + len(new))


def carry_labels(first_line: I32, last_line: I64, n_components: int, min_votes: int) -> I64:
    """Let the last line before a block vote for the labels of the block's components (II-D.2).

    Every column where both lines hold a label is a vote. A component takes the label that most of its shots vote for,
    given enough of them; of equals the oldest. Several components may take the same label.

    Parameters
    ----------
    first_line : (M,) int32
        Components in the first line of the block, 0 = none.
    last_line : (M,) int64
        Segment ids that may vote, 0 = none.
    n_components : int
        Components of the block.
    min_votes : int
        Votes needed.

    Returns
    -------
    (n_components + 1,) int64
        Segment id taken over by every component, 0 = none.
    """
    taken = np.zeros(n_components + 1, dtype=np.int64)
    voting = (first_line != 0) & (last_line != 0)
    if not voting.any():
        return taken
    pairs = np.stack([first_line[voting].astype(np.int64), last_line[voting]])
    (component, label), votes = np.unique(pairs, axis=1, return_counts=True)
    enough = votes >= min_votes
    component, label, votes = component[enough], label[enough], votes[enough]
    # worst candidate first, so that of several values for one component the last one written is the best
    order = np.lexsort((-label, votes))
    taken[component[order]] = label[order]
    return taken
