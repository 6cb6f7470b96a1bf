"""PRC in parts: the stretches of a stream are worked on apart, in any order, and give the labels of one run.

Two things cross blocks beside ranges: the segment ids of the last line, which vote for those of the next block
(Lehtola et al. 2019, II-D.2), and the running totals of smooth shots. Neither can be guessed. Two walls may share an
id because they met a kilometre before, and then small pieces of both are one segment, large enough to be smooth. So
a part works on its blocks with the ids it knows, and keeps for every block what the others would have changed: its
first line, its last lines, the sizes of its components. That is enough to find the true ids of block after block, in
order, without the ranges (:class:`JoinedBlocks`). Where they leave the same components small, which is nearly
everywhere, the block was right but for the segment that is ground; where not, that block is drawn once more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli import kernels
from prc_cli.classifiers.prc.components import Joined, identify
from prc_cli.classifiers.prc.pipeline import (
    BlockJob,
    Connected,
    Link,
    PrcParams,
    Seen,
    choose_ground,
    connect,
    count,
    draw,
    grow,
    initial_state,
    see,
)
from prc_cli.classifiers.prc.support import stream_window, tail_after, window_reach
from prc_cli.classifiers.prc.surfaces import Surfaces, area_threshold, find_small, smooth_last_line
from prc_cli.core.bytewise import recode
from prc_cli.core.classes import Label
from prc_cli.core.errors import InputError
from prc_cli.core.threads import Relay
from prc_cli.core.types import F32, I32, I64, U8, Mask

WARM_UP_BLOCKS = 1
"""Blocks before a part that are worked on for their segment ids alone; more of them change no label."""
_OTHERS = np.array([Label.MISSING, Label.NOISE, Label.VEGETATION], dtype=np.uint8)
_N_OTHERS = len(_OTHERS)


@dataclass(frozen=True, slots=True, eq=False)
class BlockFacts:
    """A block, classified as far as it can be without the true ids and totals of the blocks before it."""

    first_line: I32
    """(M,) int32, component of every shot of the first line, 0 = none: who may vote."""
    pixels: I64
    """(n + 1,) int64, shots of every component."""
    last_supported: Mask
    """(reach, M) bool, S of the last lines, as far as the dilation reaches the last one from."""
    last_image: I32
    """(reach, M) int32, components of the same lines."""
    small: Mask
    """(n + 1,) bool, components taken as non-smooth."""
    smooth: I64
    """(n + 1,) int64, smooth shots of every component (urban; else empty)."""
    image: NDArray[Any]
    """(lines, M) unsigned: labels; in the urban environment missing, noise, vegetation, then places in ``drawn``."""
    drawn: I32
    """(m,) int32, smooth components by their value in ``image``, less the three (urban; else empty)."""

    @property
    def n_lines(self) -> int:
        """Scan lines."""
        return len(self.image)


class PartBlocks:
    """Consecutive blocks of a stream that begin anywhere in it, several at the same time in threads.

    Parameters
    ----------
    tail : (max(M + 1, 4),) float32, metres
        Shots before the first block; NaN = missing, or before the stream.
    points_per_line : int
        M.
    params : PrcParams

    Examples
    --------
    >>> lines = np.full((20, 9), 20.0, dtype=np.float32)
    >>> params = PrcParams(lines_per_block=10)
    >>> second = PartBlocks(lines[8:10].ravel()[-10:], 9, params)
    >>> second.classify(second.begin(lines[10:], None)).n_lines
    10
    """

    def __init__(self, tail: F32, points_per_line: int, params: PrcParams) -> None:
        if tail.shape != (window_reach(points_per_line),):
            problem = f"found {tail.shape} shots before the part, expected ({window_reach(points_per_line)},)"
            raise InputError("part of a stream", problem)
        start = initial_state(points_per_line)
        self._params = params
        self._width = points_per_line
        self._tail = tail
        self._turn = 0
        self._links = Relay(Link(start.last_line, start.next_id))

    def begin(self, range_m: F32, next_m: F32 | None) -> BlockJob:
        """Take the next block, as :meth:`prc_cli.classifiers.prc.pipeline.ParallelBlocks.begin` does."""
        job = BlockJob(self._turn, self._tail, range_m, next_m)
        self._turn, self._tail = self._turn + 1, tail_after(self._tail, range_m)
        return job

    def classify(self, job: BlockJob) -> BlockFacts:
        """Classify a block as far as possible, in any thread; jobs must begin in order."""
        params = self._params
        try:
            seen = see(stream_window(job.tail, job.range_m, job.next_m), self._width, params)
            connected, _ = self._links.take_turn(job.turn, lambda before: connect(seen, before, params, segments=False))
            return _facts(seen, connected, grow(seen, connected, params), params)
        except BaseException:
            self._links.give_up(job.turn)
            raise


class JoinedBlocks:
    """All blocks of a stream, in order, from what the parts found out: the labels of a run that was never split.

    Parameters
    ----------
    points_per_line : int
        M.
    params : PrcParams

    Attributes
    ----------
    n_redrawn : int
        Blocks so far that had to be worked on again.
    """

    def __init__(self, points_per_line: int, params: PrcParams) -> None:
        start = initial_state(points_per_line)
        self.n_redrawn = 0
        self._params = params
        self._width = points_per_line
        self._tail = start.tail
        self._turn = 0
        self._links = Relay(Link(start.last_line, start.next_id))
        self._totals = Relay(start.totals)

    def begin(self, range_m: F32, next_m: F32 | None, facts: BlockFacts) -> JoinJob:
        """Take the next block of the stream with what its part found; call it in the order of the stream.

        Raises
        ------
        InputError
            When the part was made of other lines.
        """
        if facts.image.shape != range_m.shape:
            problem = f"found a block of {facts.image.shape} in a part, expected {range_m.shape}"
            raise InputError("part of a stream", problem, "the input has changed since: run again")
        block = BlockJob(self._turn, self._tail, range_m, next_m)
        self._turn, self._tail = self._turn + 1, tail_after(self._tail, range_m)
        return JoinJob(block, facts)

    def classify(self, job: JoinJob) -> U8:
        """Label a block, in any thread; jobs must begin in order."""
        params, facts, block = self._params, job.facts, job.block
        try:
            connected, link = self._links.take_turn(block.turn, lambda before: follow(facts, before, params))
            again = not np.array_equal(connected.small, facts.small)
            if again:
                seen, v = self._grow_again(block, connected)
                smooth = count(v, params)
            else:
                smooth = facts.smooth
            ground, _ = self._totals.take_turn(
                block.turn, lambda before: choose_ground(connected, smooth, link, before, params)
            )
            return draw(seen, v, ground, params) if again else paint(facts, connected, ground, params)
        except BaseException:
            for relay in (self._links, self._totals):
                relay.give_up(block.turn)
            raise

    def _grow_again(self, block: BlockJob, connected: Connected) -> tuple[Seen, Surfaces]:
        self.n_redrawn += 1
        seen = see(stream_window(block.tail, block.range_m, block.next_m), self._width, self._params)
        if not np.array_equal(seen.joined.pixels, connected.components.pixels):
            problem = "found other components in a block than its part did"
            raise InputError("part of a stream", problem, "the input has changed since: run again")
        h = replace(connected.components, image=seen.joined.image)
        return seen, grow(seen, replace(connected, components=h), self._params)


@dataclass(frozen=True, slots=True, eq=False)
class JoinJob:
    """A block on its way through :class:`JoinedBlocks`."""

    block: BlockJob
    facts: BlockFacts


def follow(facts: BlockFacts, before: Link, params: PrcParams) -> tuple[Connected, Link]:
    """Find the ids of a block as :func:`prc_cli.classifiers.prc.pipeline.connect` does, without its ranges.

    The image of the components that are returned is that of the last lines.
    """
    h = identify(Joined(facts.first_line[None, :], facts.pixels), before.last_line, before.next_id, params.components)
    h = replace(h, image=facts.last_image)
    width = len(facts.first_line)
    small = find_small(h, area_threshold(params.surfaces, facts.n_lines, params.lines_per_block, width))
    last_line = smooth_last_line(facts.last_supported, h, small, params.surfaces)
    return Connected(h, small, None), Link(last_line, h.next_id)


def paint(facts: BlockFacts, connected: Connected, ground: int, params: PrcParams) -> U8:
    """Give the shots of a block their labels, now that the ground is known, (lines, M) uint8."""
    if params.environment == "forest":
        return facts.image
    ids = connected.components.ids[facts.drawn]
    labels_of = np.where(ids == ground, np.uint8(Label.GROUND), np.uint8(Label.BUILDING))
    table = np.zeros(max(_N_OTHERS + len(ids), 256), np.uint8)
    table[:_N_OTHERS] = _OTHERS
    table[_N_OTHERS : _N_OTHERS + len(ids)] = labels_of
    labels: U8 = recode(facts.image, table) if facts.image.dtype == np.uint8 else table[facts.image]
    return labels


def _facts(seen: Seen, connected: Connected, v: Surfaces, params: PrcParams) -> BlockFacts:
    joined = seen.joined
    reach = slice(-min(params.surfaces.gamma + 1, len(seen.supported)), None)
    smooth = count(v, params)
    drawn = np.flatnonzero(smooth).astype(np.int32)
    return BlockFacts(
        first_line=joined.image[0].copy(),
        pixels=joined.pixels,
        last_supported=seen.supported[reach].copy(),
        last_image=joined.image[reach].copy(),
        small=connected.small,
        smooth=smooth,
        image=draw(seen, v, 0, params) if params.environment == "forest" else _image(seen, v, drawn),
        drawn=drawn,
    )


def _image(seen: Seen, v: Surfaces, drawn: I32) -> NDArray[Any]:
    """Draw the smooth components by their place in ``drawn``, and what is not smooth as it is."""
    h = v.components
    place = np.zeros(len(h.pixels), np.uint32)
    place[drawn] = np.arange(_N_OTHERS, _N_OTHERS + len(drawn), dtype=np.uint32)
    kinds = np.arange(_N_OTHERS, dtype=np.uint8)
    low = kernels.draw_components(seen.window, v.supported, v.covered, h.image, place.astype(np.uint8), kinds)
    if _N_OTHERS + len(drawn) <= 1 << 8:
        return low
    dtype = np.uint16 if _N_OTHERS + len(drawn) <= 1 << 16 else np.uint32
    return np.where(v.smooth, place[h.image], low).astype(dtype)
