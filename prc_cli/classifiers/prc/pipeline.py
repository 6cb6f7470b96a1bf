"""PRC, Algorithm 1 of Lehtola et al. (2019): the stages in the paper's order, and the state that crosses blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.classifiers.prc.background import BackgroundParams, background
from prc_cli.classifiers.prc.components import Components, ComponentsParams, components
from prc_cli.classifiers.prc.forest import ForestParams, forest
from prc_cli.classifiers.prc.support import SupportParams, stream_window, support, window_reach, window_tail
from prc_cli.classifiers.prc.surfaces import Surfaces, SurfacesParams, area_threshold, surfaces
from prc_cli.classifiers.prc.urban import Totals, UrbanParams, urban
from prc_cli.core.classes import Label
from prc_cli.core.config import Params
from prc_cli.core.errors import InputError
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
    segments: I64
    """(lines, M) int64, R: segment id of every supported shot, 0 elsewhere."""
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


def classify_block(range_m: F32, next_m: F32 | None, state: PrcState, params: PrcParams) -> PrcResult:
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

    >>> image = np.full((6, 9), 20.0, dtype=np.float32)
    >>> image[3, 4] = 5.0
    >>> result = classify_block(image, None, initial_state(9), PrcParams())
    >>> Label(result.labels[3, 4]).name, Label(result.labels[0, 0]).name
    ('NOISE', 'GROUND')
    """
    return trace_block(range_m, next_m, state, params).result


def trace_block(range_m: F32, next_m: F32 | None, state: PrcState, params: PrcParams) -> PrcTrace:
    """Label a block of scan lines and keep the images on the way; see :func:`classify_block`."""
    n_lines, points_per_line = _check_shapes(range_m, next_m, state, params)
    missing = np.isnan(range_m)
    # step 1: the block, between the shots before and after it
    window = stream_window(state.tail, range_m, next_m)
    # step 2: supported measurements S; the rest, F, is noise
    s = support(window, points_per_line, params.support)
    # step 3: H, components of S without G, with G filled in and labels carried over from the block before
    g = background(window, s, params.background)
    h = components(s, g, state.last_line, state.next_id, params.components)
    # steps 4 and 5: V, what is too small in H, grown together; R, both of them
    threshold = area_threshold(params.surfaces, n_lines, params.lines_per_block, points_per_line)
    v = surfaces(s, h, threshold, params.surfaces)
    # step 6: classes
    totals = state.totals
    if params.environment == "forest":
        labels = forest(missing, s, v.smooth, params.forest)
    else:
        labels, totals = urban(s, h, v, totals, params.urban)
    labels[missing] = Label.MISSING
    # step 7: on to the next block; only smooth shots vote there
    last_line = np.where(v.smooth[-1], v.segments[-1], 0)
    after = PrcState(window_tail(window, points_per_line), last_line, totals, v.next_id)
    return PrcTrace(s, g, h, v, PrcResult(labels, v.segments, after))


def _check_shapes(range_m: F32, next_m: F32 | None, state: PrcState, params: PrcParams) -> tuple[int, int]:
    """Refuse what cannot be the next block of the stream; return its shape."""
    where = "block of ranges"
    width = len(state.last_line)
    for array in (range_m,) if next_m is None else (range_m, next_m):
        if array.ndim != 2 or array.shape[1] != width:
            problem = f"found an array of shape {array.shape}, expected (lines, {width}) as the stream began"
            raise InputError(where, problem, "check points_per_line")
    n_lines = range_m.shape[0]
    if not 1 <= n_lines <= params.lines_per_block:
        problem = f"found {n_lines} lines, expected 1 to {params.lines_per_block}"
        raise InputError(where, problem, "cut the stream into blocks of prc.lines_per_block lines")
    if range_m.size >= 2**31:
        problem = f"found {n_lines} x {width} shots, expected fewer than 2^31"
        raise InputError(where, problem, "lower prc.lines_per_block")
    return n_lines, width
