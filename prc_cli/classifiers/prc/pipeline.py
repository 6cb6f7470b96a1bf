"""PRC, Algorithm 1 of Lehtola et al. (2019): the stages in the paper's order, and the state that crosses blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.classifiers.blocks import WHERE, check_block
from prc_cli.classifiers.prc.background import BackgroundParams, background
from prc_cli.classifiers.prc.components import Components, ComponentsParams, Joined, identify, join
from prc_cli.classifiers.prc.forest import ForestParams, forest
from prc_cli.classifiers.prc.support import SupportParams, stream_window, support, tail_after, window_reach
from prc_cli.classifiers.prc.surfaces import (
    Surfaces,
    SurfacesParams,
    area_threshold,
    find_small,
    smooth_last_line,
    surfaces,
)
from prc_cli.classifiers.prc.urban import Totals, UrbanParams, count_smooth, find_ground, urban
from prc_cli.core.config import Params
from prc_cli.core.errors import InputError
from prc_cli.core.threads import Relay
from prc_cli.core.types import F32, I64, U8, Mask


class PrcParams(Params):
    """Parameters of PRC (``[prc]``); the defaults are the published urban ones."""

    lines_per_block: int = Field(99, ge=1, le=100_000, description="k, scan lines in a block")
    environment: Literal["urban", "forest"] = Field(
        "urban", description='classes: "urban" ground, building, vegetation; "forest" ground, stem, vegetation'
    )
    support: SupportParams = SupportParams()
    background: BackgroundParams = BackgroundParams()
    components: ComponentsParams = ComponentsParams()
    surfaces: SurfacesParams = SurfacesParams()
    urban: UrbanParams = UrbanParams()
    forest: ForestParams = ForestParams()


@dataclass(frozen=True, slots=True, eq=False)
class PrcState:
    """All that a block leaves to the next one; its size depends on M alone."""

    tail: F32
    """(max(M + 1, 4),) float32, last ranges seen [m]; NaN = missing, or before the stream."""
    last_line: I64
    """(M,) int64, segment ids of the last line where they are smooth, 0 elsewhere."""
    totals: Totals
    """Smooth shots so far of the segments on the last line (urban)."""
    next_id: int
    """First segment id that is still free."""


@dataclass(frozen=True, slots=True, eq=False)
class PrcResult:
    """A classified block."""

    labels: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label`."""
    segments: I64 | None
    """(lines, M) int64, R: segment id of every supported shot, 0 elsewhere; None where nobody asks."""
    state: PrcState
    """What the next block needs."""


@dataclass(frozen=True, slots=True, eq=False)
class PrcTrace:
    """A classified block with the images on the way (the paper's Fig. 1)."""

    supported: Mask
    """(lines, M) bool, S."""
    background: Mask
    """(lines, M) bool, G, a part of S."""
    components: Components
    """H; ``components.to_segments()`` is the image of its ids."""
    surfaces: Surfaces
    """V and R; ``surfaces.to_patches()`` is the image of V's ids."""
    result: PrcResult
    """Labels, segments and state."""


def initial_state(points_per_line: int) -> PrcState:
    """Return the state before the first block of a stream with ``points_per_line`` shots a line."""
    tail = np.full(window_reach(points_per_line), np.nan, dtype=np.float32)
    return PrcState(tail, np.zeros(points_per_line, dtype=np.int64), Totals.none(), next_id=1)


def classify_block(
    range_m: F32, next_m: F32 | None, state: PrcState, params: PrcParams, *, segments: bool = False
) -> PrcResult:
    """Label a block of scan lines.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        The block, chronological; NaN = missing, all else finite and positive. ``params.lines_per_block`` lines, fewer
        only at the end of the stream.
    next_m : (lines, M) float32, metres
        The lines that follow: two are enough for M > 2, more do no harm; empty or None at the end of the stream.
    state : PrcState
        From the block before, or :func:`initial_state`.
    params : PrcParams
    segments : bool
        Give segment ids too. The numbers differ if this changes within a stream, the labels do not.

    Returns
    -------
    PrcResult

    Raises
    ------
    InputError
        When the block is empty, too long or not as wide as the lines before it.

    Examples
    --------
    A stray shot in front of a wall:

    >>> from prc_cli.core.classes import Label
    >>> image = np.full((6, 9), 20.0, dtype=np.float32)
    >>> image[3, 4] = 5.0
    >>> result = classify_block(image, None, initial_state(9), PrcParams())
    >>> Label(result.labels[3, 4]).name, Label(result.labels[0, 0]).name
    ('NOISE', 'GROUND')
    """
    return trace_block(range_m, next_m, state, params, segments=segments).result


def trace_block(
    range_m: F32, next_m: F32 | None, state: PrcState, params: PrcParams, *, segments: bool = True
) -> PrcTrace:
    """Label a block of scan lines and keep the images on the way; see :func:`classify_block`."""
    _check_shapes(range_m, next_m, len(state.last_line), params)
    # steps 1 to 3: the block between the shots before and after it, S, G, and components of S without G
    seen = see(stream_window(state.tail, range_m, next_m), range_m.shape[1], params)
    # step 3: H, components with the labels of the block before
    connected, link = connect(seen, Link(state.last_line, state.next_id), params, segments=segments)
    # steps 4 and 5: V, what is too small in H, grown together; R, both of them
    v = grow(seen, connected, params)
    # step 6: classes
    ground, totals = choose_ground(connected, count(v, params), link, state.totals, params)
    labels = draw(seen, v, ground, params)
    # step 7: on to the next block; only smooth shots vote there
    after = PrcState(tail_after(state.tail, range_m), link.last_line, totals, link.next_id)
    result = PrcResult(labels, v.to_segments() if segments else None, after)
    return PrcTrace(seen.supported, seen.background, connected.components, v, result)


class ParallelBlocks:
    """Blocks of one scanner, several of them at the same time in threads.

    The stages are those of :func:`trace_block`. Nearly all of them need nothing of the blocks before; the two that do
    are short and take turns in the order of the stream, so results do not depend on the number of threads.

    Parameters
    ----------
    points_per_line : int
        M.
    params : PrcParams
    segments : bool
        Give segment ids too.

    Examples
    --------
    >>> from prc_cli.core.threads import ordered
    >>> lines = np.full((40, 9), 20.0, dtype=np.float32)
    >>> params = PrcParams(lines_per_block=10)
    >>> blocks = ParallelBlocks(9, params)
    >>> jobs = (blocks.begin(lines[i : i + 10], lines[i + 10 : i + 12]) for i in range(0, 40, 10))
    >>> [labels.shape for labels, _ in ordered(blocks.classify, jobs, threads=2)]
    [(10, 9), (10, 9), (10, 9), (10, 9)]
    """

    def __init__(self, points_per_line: int, params: PrcParams, *, segments: bool = False) -> None:
        state = initial_state(points_per_line)
        self._params = params
        self._segments = segments
        self._width = points_per_line
        self._tail = state.tail
        self._turn = 0
        self._links = Relay(Link(state.last_line, state.next_id))
        self._totals = Relay(state.totals)

    def begin(self, range_m: F32, next_m: F32 | None) -> BlockJob:
        """Take the next block of the stream, as in :func:`classify_block`; call it in the order of the stream.

        Raises
        ------
        InputError
            When the block is empty, too long or not as wide as the lines before it.
        """
        _check_shapes(range_m, next_m, self._width, self._params)
        job = BlockJob(self._turn, self._tail, range_m, next_m)
        self._turn, self._tail = self._turn + 1, tail_after(self._tail, range_m)
        return job

    def classify(self, job: BlockJob) -> tuple[U8, I64 | None]:
        """Label a block, in any thread; jobs must begin in order. Returns labels and, where asked for, segment ids."""
        params = self._params
        try:
            seen = see(stream_window(job.tail, job.range_m, job.next_m), self._width, params)
            connected, link = self._links.take_turn(
                job.turn, lambda before: connect(seen, before, params, segments=self._segments)
            )
            v = grow(seen, connected, params)
            counts = count(v, params)
            ground, _ = self._totals.take_turn(
                job.turn, lambda before: choose_ground(connected, counts, link, before, params)
            )
            return draw(seen, v, ground, params), v.to_segments() if self._segments else None
        except BaseException:
            for relay in (self._links, self._totals):
                relay.give_up(job.turn)
            raise


@dataclass(frozen=True, slots=True, eq=False)
class BlockJob:
    """A block on its way through :class:`ParallelBlocks`."""

    turn: int
    tail: F32
    range_m: F32
    next_m: F32 | None


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a block shows without the blocks before it but for their last shots."""

    window: F32
    supported: Mask
    background: Mask
    joined: Joined


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """What a block leaves to the votes and the numbering of the next one; as in :class:`PrcState`."""

    last_line: I64
    next_id: int


@dataclass(frozen=True, slots=True, eq=False)
class Connected:
    """A block with the labels of the blocks before it."""

    components: Components
    small: Mask
    """(n + 1,) bool, components that are non-smooth."""
    surfaces: Surfaces | None
    """Found early where segments are asked for, because the numbers of the next block follow them."""


def see(window: F32, points_per_line: int, params: PrcParams) -> Seen:
    """Find S, G and the components of a block: the expensive stages, which need nothing of the blocks before."""
    supported = support(window, points_per_line, params.support)
    apart = background(window, supported, params.background)
    return Seen(window, supported, apart, join(supported, apart))


def connect(seen: Seen, before: Link, params: PrcParams, *, segments: bool) -> tuple[Connected, Link]:
    """Give components the labels of the blocks before; return what the next block needs."""
    s = seen.supported
    n_lines, points_per_line = s.shape
    h = identify(seen.joined, before.last_line, before.next_id, params.components)
    small = find_small(h, area_threshold(params.surfaces, n_lines, params.lines_per_block, points_per_line))
    v = surfaces(s, h, small, params.surfaces, with_patches=True) if segments else None
    link = Link(smooth_last_line(s, h, small, params.surfaces), h.next_id if v is None else v.next_id)
    return Connected(h, small, v), link


def grow(seen: Seen, connected: Connected, params: PrcParams) -> Surfaces:
    """Split a block into smooth and non-smooth surfaces."""
    if connected.surfaces is not None:
        return connected.surfaces
    return surfaces(seen.supported, connected.components, connected.small, params.surfaces)


def count(v: Surfaces, params: PrcParams) -> I64:
    """Count the smooth shots of every component, where the environment asks for them."""
    return count_smooth(v) if params.environment == "urban" else np.empty(0, np.int64)


def choose_ground(
    connected: Connected, smooth: I64, link: Link, totals: Totals, params: PrcParams
) -> tuple[int, Totals]:
    """Find the segment that is ground; return the totals that the next block needs."""
    if params.environment == "forest":
        return 0, totals
    return find_ground(connected.components, smooth, link.last_line, totals, params.urban)


def draw(seen: Seen, v: Surfaces, ground: int, params: PrcParams) -> U8:
    """Give the shots of a block their labels."""
    if params.environment == "forest":
        return forest(seen.window, v, params.forest)
    return urban(seen.window, v, ground)


def _check_shapes(range_m: F32, next_m: F32 | None, width: int, params: PrcParams) -> None:
    """Refuse what cannot be the next block of the stream."""
    key = "prc.lines_per_block"
    check_block(range_m, next_m, width, params.lines_per_block, columns=" as the stream began", key=key)
    if range_m.size >= 2**31:
        problem = f"found {len(range_m)} x {width} shots, expected fewer than 2^31"
        raise InputError(WHERE, problem, f"lower {key}")
