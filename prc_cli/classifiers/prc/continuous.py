"""Continuous processing: a sliding block of k lines, labels every few lines (Lehtola et al. 2019, V).

The paper suggests it for a higher update rate, without details. Here the block of k lines moves on by ``hop`` lines,
and the new lines are labelled within it. The lines before the block take the role of the previous block in
Algorithm 1: the last one votes for labels, and their smooth shots count for the ground. With ``hop = k`` this is
Algorithm 1, except that a shorter last block is filled up with lines before it. Support and background do not depend
on blocks, so noise is the same for every hop, except in forest, where ground columns include noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.classifiers.base import Classifier, Needs, Part, Turn, Wanted
from prc_cli.classifiers.prc.background import background
from prc_cli.classifiers.prc.components import identify, join
from prc_cli.classifiers.prc.forest import forest
from prc_cli.classifiers.prc.pipeline import KERNELS, PrcParams
from prc_cli.classifiers.prc.support import stream_window, support, tail_after, window_reach
from prc_cli.classifiers.prc.surfaces import Surfaces, area_threshold, find_small, surfaces
from prc_cli.classifiers.prc.urban import Totals, count_smooth, find_ground, urban
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F32, I64, U8, Mask


@dataclass(frozen=True, slots=True, eq=False)
class ContinuousState:
    """State after the lines so far; its size depends only on k and M."""

    range_m: F32
    """(lines <= k, M) float32, the block that ends at the newest line [m]."""
    background: Mask
    """(lines, M) bool, G of the block."""
    surfaces: Surfaces | None
    """The block's S, H and V; None before the first line."""
    tail: F32
    """(max(M + 1, 4),) float32, the shots before the next line [m]."""
    before: Before


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """What a block needs of the lines before it."""

    last_line: I64
    """(M,) int64, segment ids of the line before the block where it is smooth, 0 elsewhere."""
    totals: Totals
    """Smooth shots before the block, by segment on that line (urban)."""
    next_id: int
    """First segment id that is still free."""


@dataclass(frozen=True, slots=True, eq=False)
class SoFar:
    """State of :class:`ContinuousPrc`, in one part: every step depends on earlier lines."""

    lines: ContinuousState


LINES = Part[ContinuousState]("lines")


@dataclass(frozen=True, slots=True)
class ContinuousPrc(Classifier[int, SoFar]):
    """PRC that labels a few lines at a time; its only constant per scanner is M."""

    params: PrcParams
    hop: int
    """Lines labelled together, 1 to k."""

    @property
    def needs(self) -> Needs:
        """Blocks of ``hop`` lines; only ranges are used."""
        return Needs(KERNELS, self.hop, beams=False)

    def scanner(self, first: ScanBlock) -> int:
        """Return M."""
        return first.points_per_line

    def initial_state(self, scanner: int) -> SoFar:
        """Return the state before the first line."""
        return SoFar(initial_state(scanner))

    def label(self, block: ScanBlock, scanner: int, turn: Turn, wanted: Wanted) -> Sequence[LabelledBlock]:
        """Label new lines; their further returns have no labels."""
        labels = turn.hand_on(LINES, lambda state: classify_lines(block.range_m, block.next_m, state, self.params))
        return (LabelledBlock(block, labels, np.empty(0, np.uint8)),)


def initial_state(points_per_line: int) -> ContinuousState:
    """Return the state before the first line of a stream with ``points_per_line`` shots a line."""
    shape = (0, points_per_line)
    tail = np.full(window_reach(points_per_line), np.nan, dtype=np.float32)
    before = Before(np.zeros(points_per_line, np.int64), Totals.none(), next_id=1)
    return ContinuousState(np.empty(shape, np.float32), np.empty(shape, bool), None, tail, before)


def classify_lines(
    range_m: F32, next_m: F32 | None, state: ContinuousState, params: PrcParams
) -> tuple[U8, ContinuousState]:
    """Label new lines in the block of k lines that ends with them.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        The new lines, at most k; NaN = missing, all else finite and positive.
    next_m : (lines, M) float32, metres
        The lines that follow, as for :func:`prc_cli.classifiers.prc.pipeline.classify_block`.
    state : ContinuousState
        After the lines before, or :func:`initial_state`.
    params : PrcParams

    Returns
    -------
    labels : (lines, M) uint8
        :class:`prc_cli.core.classes.Label`.
    state : ContinuousState
        For the lines after.

    Examples
    --------
    >>> from prc_cli.core.classes import Label
    >>> wall = np.full((1, 9), 20.0, dtype=np.float32)
    >>> state = initial_state(9)
    >>> for _ in range(8):
    ...     labels, state = classify_lines(wall, np.concatenate([wall, wall]), state, PrcParams(lines_per_block=6))
    >>> Label(labels[0, 0]).name, len(state.range_m)
    ('GROUND', 6)
    """
    n_new, points_per_line = range_m.shape
    # S and G of the new lines only: they do not depend on blocks
    window = stream_window(state.tail, range_m, next_m)
    seen = support(window, points_per_line, params.support)
    apart = background(window, seen, params.background)
    # the block moves on
    n_leaving = max(len(state.range_m) + n_new - params.lines_per_block, 0)
    before = _leave(state, n_leaving, params)
    supported = seen if state.surfaces is None else np.concatenate([state.surfaces.supported[n_leaving:], seen])
    block = np.concatenate([state.range_m[n_leaving:], range_m])
    g = np.concatenate([state.background[n_leaving:], apart])
    # H, V and the classes, as in Algorithm 1
    h = identify(join(supported, g), before.last_line, before.next_id, params.components)
    small = find_small(h, area_threshold(params.surfaces, len(block), params.lines_per_block, points_per_line))
    v = surfaces(supported, h, small, params.surfaces)
    labels = _draw(block, v, before, params)[-n_new:]
    return labels, ContinuousState(block, g, v, tail_after(state.tail, range_m), before)


def _leave(state: ContinuousState, n_leaving: int, params: PrcParams) -> Before:
    """Remove the first lines from the block; return what the lines after them need."""
    before, v = state.before, state.surfaces
    if v is None or not n_leaving:
        return before
    h, rows = v.components, slice(0, n_leaving)
    image = h.image[rows]
    last_line = np.where(v.supported[n_leaving - 1] & ~v.covered[n_leaving - 1], h.ids[image[-1]], 0)
    totals = before.totals
    if params.environment == "urban":
        pixels = np.bincount(image.ravel(), minlength=len(h.ids))
        part = Surfaces(v.supported[rows], replace(h, image=image, pixels=pixels), v.covered[rows], None, 0)
        _, totals = find_ground(part.components, count_smooth(part), last_line, totals, params.urban)
    return Before(last_line, totals, h.next_id)


def _draw(range_m: F32, v: Surfaces, before: Before, params: PrcParams) -> U8:
    """Label the shots of a block."""
    points_per_line = range_m.shape[1]
    window = stream_window(np.full(window_reach(points_per_line), np.nan, dtype=np.float32), range_m, None)
    if params.environment == "forest":
        return forest(window, v, params.forest)
    nothing = np.zeros(points_per_line, np.int64)  # totals are not needed, and the line before may hold other segments
    ground, _ = find_ground(v.components, count_smooth(v), nothing, before.totals, params.urban)
    return urban(window, v, ground)
