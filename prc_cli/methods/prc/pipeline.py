"""PRC, Algorithm 1 of Lehtola et al. (2019).

The stages in the paper's order, and the state that crosses blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from prc_cli.core.classes import Label
from prc_cli.core.errors import InputError
from prc_cli.core.loops import loops_of
from prc_cli.core.stream import CriticalZetas, LabelledBlock, ReadTally, ScanBlock
from prc_cli.core.types import F32, I64, U8, Mask
from prc_cli.methods.base import (
    WHERE,
    Classifier,
    MethodParams,
    Needs,
    Part,
    Turn,
    UsualLabels,
    Wanted,
    check_block,
)
from prc_cli.methods.prc import components_loops, support_loops, surfaces_loops
from prc_cli.methods.prc.components import Components, ComponentsParams, Joined, identify, join
from prc_cli.methods.prc.support import (
    BackgroundParams,
    SupportParams,
    background,
    critical_zetas,
    stream_window,
    support,
    tail_after,
    unusual,
    window_reach,
)
from prc_cli.methods.prc.surfaces import (
    Surfaces,
    SurfacesParams,
    area_threshold,
    find_small,
    smooth_last_line,
    surfaces,
    unusual_dilation,
)
from prc_cli.methods.prc.urban import (
    ForestParams,
    Totals,
    UrbanParams,
    count_smooth,
    find_ground,
    forest,
    urban,
)
from prc_cli.methods.reasons import LABEL_REASONS, reasons_of
from prc_cli.methods.returns import label_extra_returns

FOREST_NOISE_M = 0.012
"""Largest range noise for the thresholds of forests [m].

Scanners in forests have 2 to 3 mm; 10 mm cost 0.1 of F1.
"""
_EVERYWHERE = frozenset(
    {Label.MISSING, Label.UNCLASSIFIED, Label.NOISE, Label.GROUND, Label.VEGETATION}
)
LOOPS = loops_of(components_loops, support_loops, surfaces_loops)


class PrcParams(MethodParams):
    """Parameters of PRC (``[prc]``); the defaults are the published urban ones."""

    lines_per_block: int = Field(99, ge=1, le=100_000, description="k, scan lines in a block")
    environment: Literal["urban", "forest"] = Field(
        "urban",
        description=(
            'classes: "urban" ground, building, vegetation; "forest" ground, stem, vegetation'
        ),
    )
    support: SupportParams = SupportParams()
    background: BackgroundParams = BackgroundParams()
    components: ComponentsParams = ComponentsParams()
    surfaces: SurfacesParams = SurfacesParams()
    urban: UrbanParams = UrbanParams()
    forest: ForestParams = ForestParams()

    def method(self) -> Prc:
        """Return the method with these parameters."""
        return Prc(self)


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """State for the label votes and segment numbers of the next block."""

    last_line: I64
    """(M,) int64, segment ids of the last line where they are smooth, 0 elsewhere."""
    next_id: int
    """First segment id that is still free."""


@dataclass(frozen=True, slots=True, eq=False)
class PrcState:
    """State handed to the next block; its size depends only on M."""

    tail: F32
    """(max(M + 1, 4),) float32, last ranges seen [m]; NaN = missing, or before the stream."""
    link: Link
    """Segment ids of the last line."""
    totals: Totals
    """Smooth shots so far, by segment on the last line (urban)."""


TAIL = Part[F32]("tail")
LINK = Part[Link]("link")
TOTALS = Part[Totals]("totals")


@dataclass(frozen=True, slots=True, eq=False)
class PrcTrace:
    """A classified block with its intermediate images (the paper's Fig. 1)."""

    supported: Mask
    """(lines, M) bool, S."""
    background: Mask
    """(lines, M) bool, G, a part of S."""
    components: Components
    """H; ``components.to_segments()`` is the image of its ids."""
    surfaces: Surfaces
    """V and R; ``surfaces.to_patches()`` is the image of V's ids."""
    labels: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label`."""
    segments: I64 | None
    """(lines, M) int64, R: segment id of every supported shot, 0 elsewhere.

    None unless requested.
    """
    critical: CriticalZetas | None
    """Thresholds from which on every shot is supported; None unless requested."""


@dataclass(frozen=True, slots=True)
class Prc(Classifier[int, PrcState]):
    """PRC; its only constant per scanner is M."""

    params: PrcParams

    @property
    def needs(self) -> Needs:
        """Blocks of k lines; only ranges are used."""
        most_noise_m = FOREST_NOISE_M if self.params.environment == "forest" else math.inf
        return Needs(LOOPS, self.params.lines_per_block, beams=False, most_noise_m=most_noise_m)

    @property
    def usual(self) -> UsualLabels:
        """Some noise in streets, and much in forests, as published."""
        if self.params.environment == "forest":
            return UsualLabels(0.96, 0.99)
        return UsualLabels(0.5, 0.8)

    @property
    def gives(self) -> frozenset[Label]:
        """Stems in forests, buildings elsewhere (II-F)."""
        smooth = Label.STEM if self.params.environment == "forest" else Label.BUILDING
        return frozenset({*_EVERYWHERE, smooth})

    def scanner(self, first: ScanBlock) -> int:
        """Return M."""
        return first.points_per_line

    def initial_state(self, scanner: int) -> PrcState:
        """Return the state before the first block."""
        return initial_state(scanner)

    def label(
        self,
        block: ScanBlock,
        scanner: int,
        turn: Turn,
        wanted: Wanted,
    ) -> Sequence[LabelledBlock]:
        """Label a block, and its further returns by the support thresholds."""
        key = "prc.lines_per_block"
        check_block(
            block.range_m,
            block.next_m,
            scanner,
            self.params.lines_per_block,
            columns=" as the stream began",
            key=key,
        )
        if block.range_m.size >= 2**31:
            problem = f"found {block.n_lines} x {scanner} shots, expected fewer than 2^31"
            raise InputError(WHERE, problem, f"lower {key}")
        trace = classify_block(
            block.range_m,
            block.next_m,
            turn,
            self.params,
            segments=wanted.segments,
            critical=wanted.stages,
        )
        further = block.extra
        limits = self.params.support
        extra = label_extra_returns(
            block.range_m,
            trace.labels,
            further.line,
            further.column,
            further.range_m,
            limits.zeta_p,
            limits.zeta_s,
        )
        reasons = None
        if wanted.reasons:
            reasons = reasons_of(trace.labels, LABEL_REASONS[self.params.environment])
        measures = measures_of(trace) if wanted.measures else {}
        labelled = LabelledBlock(
            block, trace.labels, extra, trace.segments, critical=trace.critical
        )
        return (replace(labelled, reasons=reasons, measures=measures),)

    def notices(self, labels: I64, tally: ReadTally, *, segments: bool) -> tuple[str, ...]:
        """Report parameters that the paper advises against."""
        notices = (unusual(self.params.support), unusual_dilation(self.params.surfaces))
        return tuple(notice for notice in notices if notice is not None)


def measures_of(trace: PrcTrace) -> dict[str, NDArray[Any]]:
    """Return the measured quantities of every shot of a block, by names with their units."""
    assert trace.critical is not None
    h = trace.components
    v = trace.surfaces
    return {
        "supported in its line from zeta_p [m]": trace.critical.in_line_m,
        "supported by adjacent lines from zeta_s [m]": trace.critical.adjacent_m,
        "where two surfaces meet": trace.background,
        "segment": h.ids[h.image],
        "shots of its segment in the block": h.sum_by_id(h.pixels)[h.image],
        "smooth": v.smooth,
    }


def initial_state(points_per_line: int) -> PrcState:
    """Return the state before the first block of a stream with ``points_per_line`` shots a line."""
    tail = np.full(window_reach(points_per_line), np.nan, dtype=np.float32)
    return PrcState(tail, Link(np.zeros(points_per_line, dtype=np.int64), next_id=1), Totals.none())


def classify_block(
    range_m: F32,
    next_m: F32 | None,
    turn: Turn,
    params: PrcParams,
    *,
    segments: bool = False,
    critical: bool = False,
) -> PrcTrace:
    """Label a block of scan lines: Algorithm 1.

    ``range_m`` (lines, M) float32, metres; ``next_m`` (lines, M) float32, metres.

    A stray shot in front of a wall:

    >>> from prc_cli.methods.base import OneByOne
    >>> from prc_cli.core.classes import Label
    >>> image = np.full((6, 9), 20.0, dtype=np.float32)
    >>> image[3, 4] = 5.0
    >>> labels = classify_block(image, None, OneByOne(initial_state(9)), PrcParams()).labels
    >>> Label(labels[3, 4]).name, Label(labels[0, 0]).name
    ('NOISE', 'GROUND')
    """
    tail = turn.hand_on(TAIL, lambda before: (before, tail_after(before, range_m)))
    # steps 1 to 3: the block with the shots before and after it, S, G, and components of S without
    # G
    seen = see(stream_window(tail, range_m, next_m), range_m.shape[1], params)
    # step 3: H, components with the labels of the previous block; only smooth shots vote in the
    # next one
    connected = turn.hand_on(LINK, lambda before: connect(seen, before, params, segments=segments))
    # steps 4 and 5: V, the small segments of H, dilated and connected; R, H and V together
    v = grow(seen, connected, params)
    # step 6: classes
    smooth = count(v, params)
    ground = turn.hand_on(TOTALS, lambda before: choose_ground(connected, smooth, before, params))
    labels = draw(seen, v, ground, params)
    ids = v.to_segments() if segments else None
    zetas = critical_zetas(seen.window, range_m.shape[1], params.support) if critical else None
    return PrcTrace(seen.supported, seen.background, connected.components, v, labels, ids, zetas)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Results that need no state, only the last shots before the block."""

    window: F32
    supported: Mask
    background: Mask
    joined: Joined


@dataclass(frozen=True, slots=True, eq=False)
class Connected:
    """A block whose components have taken over the labels of earlier blocks."""

    components: Components
    small: Mask
    """(n + 1,) bool, components that are non-smooth."""
    surfaces: Surfaces | None
    """Computed early if segments are requested: the ids of the next block continue after them."""
    last_line: I64
    """(M,) int64, as handed to the next block (:class:`Link`)."""


def see(window: F32, points_per_line: int, params: PrcParams) -> Seen:
    """Find S, G and the components of a block: the expensive stages, which need no state."""
    supported = support(window, points_per_line, params.support)
    apart = background(window, supported, params.background)
    return Seen(window, supported, apart, join(supported, apart))


def connect(
    seen: Seen,
    before: Link,
    params: PrcParams,
    *,
    segments: bool,
) -> tuple[Connected, Link]:
    """Give components the labels of earlier blocks; also return the state for the next block."""
    s = seen.supported
    n_lines, points_per_line = s.shape
    h = identify(seen.joined, before.last_line, before.next_id, params.components)
    small = find_small(
        h, area_threshold(params.surfaces, n_lines, params.lines_per_block, points_per_line)
    )
    v = surfaces(s, h, small, params.surfaces, with_patches=True) if segments else None
    last_line = smooth_last_line(s, h, small, params.surfaces)
    return Connected(h, small, v, last_line), Link(last_line, h.next_id if v is None else v.next_id)


def grow(seen: Seen, connected: Connected, params: PrcParams) -> Surfaces:
    """Split a block into smooth and non-smooth surfaces."""
    if connected.surfaces is not None:
        return connected.surfaces
    return surfaces(seen.supported, connected.components, connected.small, params.surfaces)


def count(v: Surfaces, params: PrcParams) -> I64:
    """Count the smooth shots of every component, in environments that need them."""
    return count_smooth(v) if params.environment == "urban" else np.empty(0, np.int64)


def choose_ground(
    connected: Connected,
    smooth: I64,
    totals: Totals,
    params: PrcParams,
) -> tuple[int, Totals]:
    """Find the ground segment; also return the totals for the next block."""
    if params.environment == "forest":
        return 0, totals
    return find_ground(connected.components, smooth, connected.last_line, totals, params.urban)


def draw(
    seen: Seen,
    v: Surfaces,
    ground: int,
    params: PrcParams,
) -> U8:
    """Label the shots of a block."""
    if params.environment == "forest":
        return forest(seen.window, v, params.forest)
    return urban(seen.window, v, ground)
