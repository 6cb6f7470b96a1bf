"""The fused classifier: its stages in their order, and the state between blocks.

Of both papers: noise is what is alone (Lehtola et al. 2019, II-B), but in space instead of range; and a surface is told
by its direction in the scan plane (Stamos et al. 2012, sec. 4), but over a chord instead of from shot to shot.
docs/fused.md has the equations and the reasons.

Of the stages only the range noise and the walk along the ground depend on the blocks before; both are short, and taken
in turns. All others need the block and five lines before and after it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.classifiers.blocks import check_block
from prc_cli.classifiers.fused.classes import (
    CarParams,
    LeavesParams,
    NoiseParams,
    PoleParams,
    VoteParams,
    decide,
    decision_thresholds,
    texture_of,
    vote,
)
from prc_cli.classifiers.fused.forest import ForestParams, forest
from prc_cli.classifiers.fused.ground import Ground, GroundMemory, GroundParams, follow_ground
from prc_cli.classifiers.fused.neighbours import (
    CompanyParams,
    DirectionParams,
    Neighbours,
    SmoothnessParams,
    chords,
    near_neighbours,
    smooth_pairs,
)
from prc_cli.classifiers.fused.plane import (
    AROUND_LINES,
    INNER_LINES,
    WIDE_LINES,
    Noise,
    Plane,
    ScanPlane,
    SensorParams,
)
from prc_cli.classifiers.fused.strips import StripsParams, WallParams, stand
from prc_cli.core.config import Params
from prc_cli.core.threads import Relay
from prc_cli.core.types import F32, F64, U8


class FusedParams(Params):
    """Parameters of the fused classifier (``[fused]``); lengths are those in the scan plane."""

    environment: Literal["urban", "forest"] = Field(
        "urban", description='classes: "urban" ground, building, vegetation; "forest" ground, stem, vegetation'
    )
    lines_per_block: int = Field(128, ge=1, le=100_000, description="scan lines that are labelled together")
    extra_return_m: float = Field(
        0.3, ge=0, le=100, description="further returns take the label of a shot around that is this near in range [m]"
    )
    sensor: SensorParams = SensorParams()
    company: CompanyParams = CompanyParams()
    smoothness: SmoothnessParams = SmoothnessParams()
    directions: DirectionParams = DirectionParams()
    ground: GroundParams = GroundParams()
    strips: StripsParams = StripsParams()
    walls: WallParams = WallParams()
    noise: NoiseParams = NoiseParams()
    leaves: LeavesParams = LeavesParams()
    cars: CarParams = CarParams()
    poles: PoleParams = PoleParams()
    votes: VoteParams = VoteParams()
    forest: ForestParams = ForestParams()


@dataclass(frozen=True, slots=True, eq=False)
class FusedState:
    """All that a block leaves to the next one; its size depends on M alone."""

    beam_rad: F64
    """(M,) float64, angle of every column's beam from straight down [rad]."""
    tail: F32
    """(5, M) float32, the last lines [m]; NaN = missing, or before the stream."""
    noise: Noise
    """What was measured of the range noise."""
    memory: GroundMemory
    """The ground before the last three lines of the tail."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedResult:
    """A classified block."""

    labels: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label`."""
    state: FusedState
    """What the next block needs."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What a block and three lines before and after it show by themselves."""

    window: F32
    """(lines + 10, M) float32, ranges [m]."""
    range_m: F32
    """(lines + 6, M) float32, those of the lines that are looked at."""
    neighbours: Neighbours


def initial_state(beam_rad: F64) -> FusedState:
    """Return the state before the first block.

    Parameters
    ----------
    beam_rad : (M,) float64
        Angle of every column's beam from straight down, in (-pi, pi], its sign the side of the scan plane [rad].
    """
    tail = np.full((AROUND_LINES, len(beam_rad)), np.nan, np.float32)
    return FusedState(beam_rad, tail, Noise(), GroundMemory.none())


def classify_block(range_m: F32, next_m: F32 | None, state: FusedState, params: FusedParams) -> FusedResult:
    """Label a block of scan lines.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        The block, chronological; NaN = missing, all else finite and positive. ``params.lines_per_block`` lines, fewer
        only at the end of the stream.
    next_m : (lines, M) float32, metres
        The lines that follow: five are enough, more do no harm; fewer or None only at the end of the stream.
    state : FusedState
        From the block before, or :func:`initial_state`.
    params : FusedParams

    Raises
    ------
    InputError
        When the block is empty, too long or not as wide as the beams.

    Examples
    --------
    A road, with a stray shot above it:

    >>> from prc_cli.core.classes import Label
    >>> beam = np.deg2rad(np.linspace(-60, 60, 241))
    >>> lines = np.tile(2.0 / np.cos(beam), (8, 1)).astype(np.float32)
    >>> lines[4, 100] = 1.0
    >>> labels = classify_block(lines, None, initial_state(beam), FusedParams()).labels
    >>> Label(labels[4, 100]).name, Label(labels[4, 120]).name
    ('NOISE', 'GROUND')
    """
    _check_shapes(range_m, next_m, len(state.beam_rad), params)
    window = _window(state.tail, range_m, next_m)
    after = replace(state, tail=window[len(range_m) : len(range_m) + AROUND_LINES])
    if params.environment == "forest":
        return FusedResult(forest(range_m, Plane.of(state.beam_rad), params.forest), after)
    plane = ScanPlane.of(state.beam_rad)
    noise, memory = state.noise.after(window, plane, params.sensor), state.memory

    def walk(seen: _Seen) -> Ground:
        nonlocal memory
        ground, memory = _follow(seen, plane, memory, params)
        return ground

    labels = _label(window, plane, noise, walk, params)
    return FusedResult(labels, replace(after, noise=noise, memory=memory))


def _label(window: F32, plane: ScanPlane, noise: Noise, walk: Callable[[_Seen], Ground], params: FusedParams) -> U8:
    """Take a block through the stages; the walk along the ground is the caller's, who knows what was before."""
    seen = _see(window, plane, noise.noise_m(params.sensor), params)
    return _decide(seen, walk(seen), plane, params)


def _see(window: F32, plane: ScanPlane, noise_m: float, params: FusedParams) -> _Seen:
    """Ask the neighbours: is a shot alone, on something smooth, and which way does that go."""
    near = near_neighbours(window, plane, params.company)
    smooth = smooth_pairs(window, plane, noise_m, params.smoothness)
    range_m = window[INNER_LINES:-INNER_LINES]
    upright, level = chords(range_m, smooth, plane, params.directions)
    return _Seen(window, range_m, Neighbours(near, smooth, upright, level))


def _follow(seen: _Seen, plane: ScanPlane, memory: GroundMemory, params: FusedParams) -> tuple[Ground, GroundMemory]:
    """Follow the ground; what is handed on is the memory before the last three lines of the block."""
    n_lines = len(seen.window) - 2 * AROUND_LINES
    return follow_ground(seen.range_m, seen.neighbours, plane, memory, params.company.least, n_lines, params.ground)


def _decide(seen: _Seen, ground: Ground, plane: ScanPlane, params: FusedParams) -> U8:
    """Put together what stands above the ground, and label every shot."""
    least = params.company.least
    texture = texture_of(seen.range_m, seen.neighbours, plane, least, params.leaves)
    standing = stand(
        seen.range_m, ground.above_m, seen.neighbours, plane, least, params.cars.top_m, params.strips, params.walls
    )
    thresholds = decision_thresholds(
        least, params.ground, params.walls, params.noise, params.leaves, params.cars, params.poles
    )
    labels = decide(seen.window, seen.neighbours, ground, texture, standing, plane, thresholds)
    return vote(labels, seen.range_m[WIDE_LINES:-WIDE_LINES], plane, params.votes)


class ParallelBlocks:
    """Blocks of one scanner, several of them at the same time in threads.

    The stages are those of :func:`classify_block`. Only the range noise and the walk along the ground need
    what was before; they take turns in the order of the stream, so labels do not depend on the number of threads.

    Parameters
    ----------
    beam_rad : (M,) float64
        As for :func:`initial_state`.
    params : FusedParams

    Examples
    --------
    >>> from prc_cli.core.threads import ordered
    >>> beam = np.deg2rad(np.linspace(-60, 60, 241))
    >>> lines = np.tile(2.0 / np.cos(beam), (40, 1)).astype(np.float32)
    >>> blocks = ParallelBlocks(beam, FusedParams(lines_per_block=10))
    >>> jobs = (blocks.begin(lines[i : i + 10], lines[i + 10 : i + 15]) for i in range(0, 40, 10))
    >>> [labels.shape for labels in ordered(blocks.classify, jobs, threads=2)]
    [(10, 241), (10, 241), (10, 241), (10, 241)]
    """

    def __init__(self, beam_rad: F64, params: FusedParams) -> None:
        state = initial_state(beam_rad)
        self._params, self._width = params, len(beam_rad)
        self._plane, self._scan_plane = Plane.of(beam_rad), ScanPlane.of(beam_rad)
        self._tail, self._turn = state.tail, 0
        self._noise = Relay(state.noise)
        self._ground = Relay(state.memory)

    def begin(self, range_m: F32, next_m: F32 | None) -> BlockJob:
        """Take the next block of the stream, as in :func:`classify_block`; call it in the order of the stream.

        Raises
        ------
        InputError
            When the block is empty, too long or not as wide as the beams.
        """
        _check_shapes(range_m, next_m, self._width, self._params)
        window = range_m
        # a block of forest is labelled by itself
        if self._params.environment != "forest":
            window = _window(self._tail, range_m, next_m)
            self._tail = window[len(range_m) : len(range_m) + AROUND_LINES]
        job = BlockJob(self._turn, window, range_m)
        self._turn += 1
        return job

    def classify(self, job: BlockJob) -> U8:
        """Label a block, in any thread; jobs must begin in order."""
        params, plane = self._params, self._scan_plane
        if params.environment == "forest":
            return forest(job.range_m, self._plane, params.forest)

        def measure(known: Noise) -> tuple[Noise, Noise]:
            noise = known.after(job.window, plane, params.sensor)
            return noise, noise

        def walk(seen: _Seen) -> Ground:
            return self._ground.take_turn(job.turn, lambda memory: _follow(seen, plane, memory, params))[0]

        try:
            return _label(job.window, plane, self._noise.take_turn(job.turn, measure)[0], walk, params)
        except BaseException:
            for relay in (self._noise, self._ground):
                relay.give_up(job.turn)
            raise


@dataclass(frozen=True, slots=True, eq=False)
class BlockJob:
    """A block on its way through :class:`ParallelBlocks`."""

    turn: int
    window: F32
    range_m: F32


def _window(tail: F32, range_m: F32, next_m: F32 | None) -> F32:
    """Put the five lines before and after a block around it, NaN where there are none."""
    width = range_m.shape[1]
    following = np.full((AROUND_LINES, width), np.nan, np.float32)
    if next_m is not None:
        given = next_m[:AROUND_LINES]
        following[: len(given)] = given
    return np.concatenate([tail, range_m, following])


def _check_shapes(range_m: F32, next_m: F32 | None, width: int, params: FusedParams) -> None:
    """Refuse what cannot be the next block of the stream."""
    key = "fused.lines_per_block"
    check_block(range_m, next_m, width, params.lines_per_block, columns=", one column a beam", key=key)
