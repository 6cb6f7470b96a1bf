"""The fused classifier: its stages in order, and the state between blocks.

From Lehtola et al. (2019, II-B): shots without support of their neighbours are noise; here
neighbours are compared in the scan plane instead of in range. From Stamos et al. (2012, sec. 4):
surfaces are classified by their direction in the scan plane; here over a chord instead of from shot
to shot. design/fused.md gives the equations and the reasons.

Only the range noise, the distance of lines and the ground depend on earlier blocks; these steps are
short, and run block after block. All others need the block and 21 lines before and after it, 35 for
the distance of lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from prc_cli.core.classes import LABELS_BY_REASON, VOTED, Label, Reason
from prc_cli.core.config import Params
from prc_cli.core.loops import loops_of
from prc_cli.core.stream import LabelledBlock, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64, I32, I64, U8, Mask
from prc_cli.methods.base import (
    LABELS_ALONE,
    Classifier,
    MethodParams,
    Needs,
    Part,
    Turn,
    UsualLabels,
    Wanted,
    beams_of,
    check_block,
)
from prc_cli.methods.forest import stems_loops
from prc_cli.methods.forest.classes import forest
from prc_cli.methods.forest.range_noise import forest_noise
from prc_cli.methods.forest.thresholds import FOREST, Forest
from prc_cli.methods.fused import (
    classes_loops,
    confidence_loops,
    curbs_loops,
    fans_loops,
    flanks_loops,
    ground_loops,
    neighbours_loops,
    noise_loops,
    spacing_loops,
    strips_loops,
    texture_loops,
    votes_loops,
)
from prc_cli.methods.fused.classes import (
    BESIDE_THIN_LINES,
    decide,
    find_cars,
    find_curbs,
    find_late_leaves,
    has_car_profiles,
    has_ceiling,
    is_room,
    no_profiles,
    texture_of,
    vote,
)
from prc_cli.methods.fused.confidence import (
    QUESTIONS,
    Evidence,
    cells_of,
    confidence_of,
    load_table,
    of_further_returns,
    true_heights,
)
from prc_cli.methods.fused.ground import Ground, follow_ground, no_memory
from prc_cli.methods.fused.interlace import align_columns
from prc_cli.methods.fused.neighbours import chords, near_neighbours, smooth_pairs
from prc_cli.methods.fused.plane import (
    AROUND_LINES,
    INNER_LINES,
    VOTE_LINES,
    WIDE_LINES,
    ScanPlane,
)
from prc_cli.methods.fused.range_noise import Noise, NoiseAlong, SensorParams
from prc_cli.methods.fused.records import FilledSlots, GroundMemory, Neighbours, Walls
from prc_cli.methods.fused.spacing import (
    BESIDE_LINES,
    SPACED_LINES,
    Spacing,
    count_repeated_leaves,
    spaced_pairs,
    strides_of,
)
from prc_cli.methods.fused.strips import Strips, measure_strips
from prc_cli.methods.fused.thresholds import NEVER, STREET, Limits, in_room
from prc_cli.methods.plane import MANY_RINGS, Plane
from prc_cli.methods.returns import label_extra_returns

FOREST_NOISE_M = 0.035
"""Greatest range noise with which stems are found [m].

Scanners in forests have 2 to 3 mm; 30 mm cost .03 of F1.
"""
OUTSIDE_LINES = SPACED_LINES - BESIDE_THIN_LINES - VOTE_LINES
"""Outermost lines of the window that no label depends on."""
FOLLOWING_LINES = SPACED_LINES + fans_loops.LINES
"""Lines after a block that its labels depend on, where cars are found by profiles."""
MARGIN_LINES = BESIDE_THIN_LINES + VOTE_LINES
"""Lines of a stream before and after a block that its labels depend on."""
EXTRA_RETURN_M = 0.3
"""Further returns take the label of a shot around that is this near in range [m]."""
ROOM_LINES = 4
"""Every fourth line is looked at to see whether a place is a room."""
MOST_APART = 8
"""Most lines from one line of a stream of close lines to the next.

For more, too few lines beside the block are known.
"""
FARTHEST_BESIDE = 4
"""Greatest distance of neighbours, in lines, for the lines of such a stream beside the block."""
FOREST_LABELS = frozenset(
    {Label.MISSING, Label.UNCLASSIFIED, Label.NOISE, Label.GROUND, Label.VEGETATION, Label.STEM}
)
LOOPS = loops_of(
    classes_loops,
    curbs_loops,
    flanks_loops,
    ground_loops,
    neighbours_loops,
    noise_loops,
    spacing_loops,
    strips_loops,
    texture_loops,
    votes_loops,
)
FOREST_LOOPS = loops_of(stems_loops)
CONFIDENCE_LOOPS = loops_of(
    confidence_loops, flanks_loops, neighbours_loops, strips_loops, texture_loops
)


class ForestParams(Params):
    """Definitions of the classes in a forest (``[fused.forest]``)."""

    stem_top_m: float = Field(
        1000.0,
        ge=0,
        le=1000,
        description="height over the ground, in the scan plane, up to which stems are stems and "
        "from which on they are other vegetation [m]",
    )

    def limits(self) -> Forest:
        """Return the limits of the forest."""
        return FOREST._replace(classes=FOREST.classes._replace(top_m=self.stem_top_m))


class FusedParams(MethodParams):
    """Parameters of the fused classifier (``[fused]``).

    Its limits are constants, in thresholds.py.
    """

    environment: Literal["urban", "forest"] = Field(
        "urban",
        description='classes: "urban" ground, building, vegetation; '
        '"forest" ground, stem, vegetation',
    )
    lines_per_block: int = Field(
        128, ge=1, le=100_000, description="scan lines that are labelled together"
    )
    sensor: SensorParams = SensorParams()
    forest: ForestParams = ForestParams()

    def method(self) -> Fused:
        """Return the method with these parameters."""
        return Fused(self)


@dataclass(frozen=True, slots=True, eq=False)
class FusedState:
    """State handed to the next block; its size depends only on M."""

    tail: F32
    """(SPACED_LINES, M) float32, the last lines [m]; NaN = missing, or before the stream."""
    noise: Noise
    """Range noise measured so far, in a forest."""
    noise_along: NoiseAlong
    """The same along a street."""
    line: int
    """Number of lines so far."""
    spacing: Spacing
    """Distance of the lines so far."""
    memory: GroundMemory
    """Ground before the last three lines of the tail."""
    profiles: U8
    """Marks of lines across cars, where shots are far apart."""


AnyArray = NDArray[Any]

TAIL = Part[F32]("tail")
NOISE = Part[Noise]("noise")
MEMORY = Part[GroundMemory]("memory")
NOISE_ALONG = Part[NoiseAlong]("noise_along")
LINE = Part[int]("line")
SPACING = Part[Spacing]("spacing")
PROFILES = Part[U8]("profiles")


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhoods:
    """Neighbours of the shots of a block and of three lines before and after it.

    Independent of earlier blocks.
    """

    window: F32
    """(lines + 10, M) float32, ranges [m]."""
    range_m: F32
    """(lines + 6, M) float32, ranges of the lines that ``neighbours`` covers."""
    neighbours: Neighbours


@dataclass(frozen=True, slots=True, eq=False)
class FusedScanner:
    """Beam directions of a scanner, and the limits for it in streets."""

    plane: Plane
    scan_plane: ScanPlane
    limits: Limits

    @classmethod
    def of(cls, beam_rad: F64) -> FusedScanner:
        """Return the scanner of beams.

        ``beam_rad`` (M,) float64.
        """
        plane = ScanPlane.of(beam_rad)
        limits = STREET
        is_coarse = float(plane.step_rad) >= limits.foliage.depth_step_rad
        if is_coarse and len(beam_rad) >= MANY_RINGS:
            # the few lines on a post show no radius; few rings are too far apart to follow it
            limits = limits._replace(
                columns=limits.columns._replace(reach=np.float32(2)),
                decision=limits.decision._replace(thick_m=np.float32(NEVER)),
            )
        return cls(Plane.of(beam_rad), plane, limits)

    @property
    def points_per_line(self) -> int:
        """M."""
        return len(self.plane.sine)


@dataclass(frozen=True, slots=True)
class Fused(Classifier[FusedScanner, FusedState]):
    """The fused classifier; its constants per scanner are the beam directions."""

    params: FusedParams

    @property
    def needs(self) -> Needs:
        """Blocks with beam angles, and look-ahead for all lines that labels depend on."""
        is_forest = self.params.environment == "forest"
        most_noise_m = FOREST_NOISE_M if is_forest else math.inf
        return Needs(
            FOREST_LOOPS if is_forest else LOOPS,
            self.params.lines_per_block,
            AROUND_LINES if is_forest else FOLLOWING_LINES,
            most_noise_m=most_noise_m,
            confidence_loops=CONFIDENCE_LOOPS,
        )

    @property
    def usual(self) -> UsualLabels:
        """Little noise, and level ground below the scanner; plants and hills tilt it in forests."""
        common = UsualLabels(0.2, 0.4, ground_share=0.1, below_share=0.2, vanished_share=0.3)
        if self.params.environment == "forest":
            return replace(common, level_share=0.35, lean_deg=12.0)
        return replace(common, level_share=0.6, lean_deg=5.5, reach_m=6.0)

    @property
    def gives(self) -> frozenset[Label]:
        """Stems only in forests; surfaces have no labels of their own."""
        every = frozenset(Label) - {Label.VERTICAL, Label.HORIZONTAL}
        if self.params.environment == "forest":
            return every & FOREST_LABELS
        return every - {Label.STEM}

    def scanner(self, first: ScanBlock) -> FusedScanner:
        """Return the beam directions."""
        return FusedScanner.of(beams_of(first))

    def initial_state(self, scanner: FusedScanner) -> FusedState:
        """Return the state before the first block."""
        return initial_state(scanner)

    def label(
        self,
        block: ScanBlock,
        scanner: FusedScanner,
        turn: Turn,
        wanted: Wanted,
    ) -> Sequence[LabelledBlock]:
        """Label a block, and its further returns by neighbouring shots of similar range."""
        check_block(
            block.range_m,
            block.next_m,
            scanner.points_per_line,
            self.params.lines_per_block,
            columns=", one column a beam",
            key="fused.lines_per_block",
        )
        decided = _classify(block.range_m, block.next_m, scanner, turn, self.params, wanted)
        further = block.extra
        limit_m = EXTRA_RETURN_M
        labels = decided.labels
        environment = self.params.environment
        extra = label_further_returns(
            block.range_m, labels, further.line, further.column, further.range_m, limit_m
        )
        labelled = LabelledBlock(block, labels, extra, reasons=decided.reasons)
        if wanted.stages:
            labelled = replace(labelled, above_m=true_heights(decided.above_m, block))
        if wanted.measures:
            labelled = replace(labelled, measures=measures_of(decided, block.range_m.shape))
        if wanted.confidence:
            evidence = decided.evidence or _forest_evidence(block.range_m, decided, scanner)
            cells = cells_of(
                labels, block.range_m, evidence, scanner.scan_plane, QUESTIONS[environment]
            )
            shots = confidence_of(labels, cells, load_table(environment))
            labelled = replace(
                labelled,
                confidence=shots,
                extra_confidence=of_further_returns(block, shots, limit_m),
            )
        return (labelled,)

    def limits(self, block: ScanBlock) -> Forest | Limits:
        """Return the limits that a block is labelled by."""
        if self.params.environment == "forest":
            return self.params.forest.limits()
        return self.scanner(block).limits

    def notices(self, labels: I64, tally: ReadTally, *, segments: bool) -> tuple[str, ...]:
        """Report that this method has no segments."""
        return ("the fused method has no segments: every segment id is 0",) if segments else ()


def initial_state(scanner: FusedScanner) -> FusedState:
    """Return the state before the first block."""
    tail = np.full((SPACED_LINES, scanner.points_per_line), np.nan, np.float32)
    return FusedState(tail, Noise(), NoiseAlong(), 0, Spacing.none(), no_memory(), no_profiles())


def classify_block(
    range_m: F32,
    next_m: F32 | None,
    scanner: FusedScanner,
    turn: Turn,
    params: FusedParams,
) -> U8:
    """Label a block of scan lines.

    ``range_m`` (lines, M) float32, metres; ``next_m`` (lines, M) float32, metres; returns (lines,
    M) uint8.

    A road, with a stray shot above it:

    >>> from prc_cli.methods.base import OneByOne
    >>> from prc_cli.core.classes import Label
    >>> beam = np.deg2rad(np.linspace(-60, 60, 241))
    >>> lines = np.tile(2.0 / np.cos(beam), (8, 1)).astype(np.float32)
    >>> lines[4, 100] = 1.0
    >>> scanner = FusedScanner.of(beam)
    >>> turns = OneByOne(initial_state(scanner))
    >>> labels = classify_block(lines, None, scanner, turns, FusedParams())
    >>> Label(labels[4, 100]).name, Label(labels[4, 120]).name
    ('NOISE', 'GROUND')
    """
    return _classify(range_m, next_m, scanner, turn, params, LABELS_ALONE).labels


@dataclass(frozen=True, slots=True, eq=False)
class DecidedBlock:
    """The labels of a block, and the measurements that decided; arrays are of its lines only."""

    labels: U8
    reasons: U8 | None
    """None unless wanted."""
    above_m: F32
    """Above the ground in the scan plane [m]."""
    noise_m: F64
    """(lines, 1) or (1, 1), range noise [m]; 0 = not known."""
    evidence: Evidence | None
    """None unless wanted, and in forests."""
    marked: Mask
    """Shots that the walk along the ground went over; in forests shots on a stem."""


@dataclass(frozen=True, slots=True, eq=False)
class DecidedLines:
    """Labels and reasons of the lines of a stream, and the evidence."""

    labels: U8
    reasons: U8
    evidence: Evidence


def _classify(
    range_m: F32,
    next_m: F32 | None,
    scanner: FusedScanner,
    turn: Turn,
    params: FusedParams,
    wanted: Wanted,
) -> DecidedBlock:
    """Label a block; see :func:`classify_block`."""
    if params.environment == "forest":
        return _classify_forest(range_m, scanner, turn, params)
    return _classify_street(range_m, next_m, scanner, turn, params, wanted)


def _classify_forest(
    range_m: F32, scanner: FusedScanner, turn: Turn, params: FusedParams
) -> DecidedBlock:
    """Label a block of a forest; only the range noise depends on earlier blocks."""
    noise_m = turn.hand_on(
        NOISE, lambda known: _measure_forest_noise(range_m, known, params.sensor)
    )
    woods = forest(range_m, scanner.plane, noise_m, params.forest.limits())
    return DecidedBlock(
        labels=LABELS_BY_REASON[woods.reasons],
        reasons=woods.reasons,
        above_m=woods.above_m,
        noise_m=np.full((1, 1), noise_m),
        evidence=None,
        marked=woods.on_stem,
    )


def _classify_street(
    range_m: F32,
    next_m: F32 | None,
    scanner: FusedScanner,
    turn: Turn,
    params: FusedParams,
    wanted: Wanted,
) -> DecidedBlock:
    """Label a block of a street, by the stages of design/fused.md in their order."""
    plane = scanner.scan_plane
    n_lines = len(range_m)

    # the lines around the block, its range noise, and the limits of the place; a copy of the last
    # lines, so that the block is not kept in memory
    tail = turn.hand_on(
        TAIL,
        lambda old: (old, np.concatenate([old, range_m[-SPACED_LINES:]])[-SPACED_LINES:].copy()),
    )
    measured = window_of(tail, range_m, next_m, lines_ahead(plane, scanner.limits))
    line = turn.hand_on(LINE, lambda first: (first, first + n_lines))
    noise_m = turn.hand_on(
        NOISE_ALONG, lambda known: _measure_noise(measured, line, plane, known, params.sensor)
    )
    limits = limits_of_place(scanner.limits, measured, plane)

    # interlace
    wide = align_columns(measured, plane, noise_m, scanner.limits)

    # spacing
    strides = _strides(wide, line, n_lines, plane, noise_m, turn, limits)
    apart = lines_apart(strides)

    # near neighbours, smoothness, directions
    streams = streams_of(wide, strides, plane, noise_m, limits)

    # ground
    grounds = turn.hand_on(
        MEMORY, lambda memory: _follow_streams(streams, apart, n_lines, plane, memory, limits)
    )

    # strips, texture, classes, votes, leaves amid noise, curbs
    decided = [
        _decide_stream(stream, ground, plane, limits, with_reasons=wanted.reasons)
        for stream, ground in zip(streams, grounds.parts, strict=True)
    ]
    labels = _merge_lines([lines.labels for lines in decided], streams, apart)
    reasons = None
    if wanted.reasons:
        reasons = _merge_lines([lines.reasons for lines in decided], streams, apart)
    evidence = None
    has_profiles = has_car_profiles(plane, limits)
    if wanted.confidence or wanted.measures or has_profiles:
        evidences = [lines.evidence for lines in decided]
        evidence = _merge_evidence(evidences, grounds.above_m, streams, apart)

    # profiles
    if evidence is not None and has_profiles:
        block = wide[SPACED_LINES : len(wide) - SPACED_LINES]
        before = labels[:n_lines]
        labels = _with_cars(labels, block, n_lines, grounds, evidence, turn, plane, limits)
        if reasons is not None:
            reasons = _where_changed(before, labels, reasons[:n_lines], Reason.PROFILE)

    lines = slice(grounds.margin, grounds.margin + n_lines)
    return DecidedBlock(
        labels=labels,
        reasons=reasons,
        above_m=grounds.above_m[lines],
        noise_m=noise_m[SPACED_LINES : SPACED_LINES + n_lines, None],
        evidence=evidence,
        marked=grounds.walked[lines],
    )


def measures_of(decided: DecidedBlock, shape: tuple[int, ...]) -> dict[str, AnyArray]:
    """Return what was measured of every shot of a block, by names with their units."""
    n_lines = shape[0]
    measures: dict[str, AnyArray] = {
        "range noise [m]": np.broadcast_to(decided.noise_m, shape),
        "height above the ground [m]": decided.above_m,
    }
    evidence = decided.evidence
    if evidence is None:
        return {**measures, "on a stem": decided.marked}
    lines = slice(evidence.margin, evidence.margin + n_lines)
    near, smooth, upright, level = evidence.neighbours.of_lines(lines)
    return {
        **measures,
        "walked over": decided.marked,
        "near neighbours, of 28": near,
        "smooth pairs, of 10": smooth,
        "upright chords, of 3": upright,
        "level chords, of 3": level,
        "smooth share around": evidence.texture[1 : 1 + n_lines],
    }


def _forest_evidence(range_m: F32, decided: DecidedBlock, scanner: FusedScanner) -> Evidence:
    """Measure a block of forest as if it were a street, without the lines around it."""
    plane = scanner.scan_plane
    limits = scanner.limits
    beyond = ((AROUND_LINES, AROUND_LINES), (0, 0))
    window = np.pad(range_m, beyond, constant_values=np.float32(np.nan))
    smooth = smooth_pairs(window, plane, decided.noise_m.item(), limits.smoothness)
    neighbourhoods = measure_neighbours(window, smooth, plane, limits)
    inner = slice(INNER_LINES, -INNER_LINES)
    above = np.pad(decided.above_m, beyond, constant_values=np.float32(np.nan))[inner]
    return evidence_of(neighbourhoods, window, above, plane, limits)


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Every so many lines of a block, as a stream of their own."""

    first: int
    """The first of its lines in the block."""
    every: int
    neighbourhoods: Neighbourhoods
    wide_m: F32
    """Ranges of its lines and of :data:`MARGIN_LINES` before and after them [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockGround(Ground):
    """The ground of the lines of a block, and of ``margin`` lines before and after it."""

    parts: tuple[Ground, ...]
    """The ground of the lines of every stream."""
    margin: int


def lines_apart(strides: I64) -> I64:
    """Return how far the lines of the streams are apart in which a block's lines are labelled.

    >>> lines_apart(np.array([1, 1, 1, 0, 1, 4, 16, 1, 1, 1])).tolist()
    [1, 1, 4, 8]
    """
    return np.clip(strides[BESIDE_LINES:-BESIDE_LINES], 1, MOST_APART)


def lines_ahead(plane: ScanPlane, limits: Limits) -> int:
    """Return how many lines after a block are labelled with it, to find a car in its last line."""
    return fans_loops.LINES if has_car_profiles(plane, limits) else 0


def streams_of(
    wide: F32,
    strides: I64,
    plane: ScanPlane,
    noise_m: F64,
    limits: Limits,
) -> list[Stream]:
    """Split the lines of a block into streams of lines that are far enough apart.

    If lines are close together, every 2nd, 4th or 8th line is a stream of its own, in which things
    are as many lines wide as usual. If the platform stands still, all lines are one stream.

    ``wide`` (lines + 2 SPACED_LINES, M) float32; ``strides`` (lines + 6,) int64; ``noise_m`` (lines
    + 2 SPACED_LINES,) float64.
    """
    apart = lines_apart(strides)
    around = MARGIN_LINES - AROUND_LINES
    streams = []
    for every in np.unique(apart).tolist():
        window, wide_strides, wide_noise_m = _widen_window(wide, strides, noise_m, every)
        smooth = spaced_pairs(window, wide_strides, plane, wide_noise_m, limits.smoothness)
        for first in range(min(every, len(apart))):
            lines_m = wide[OUTSIDE_LINES:-OUTSIDE_LINES]
            smooth_of_lines = smooth
            if every > 1:
                lines_m = wide[_rows_of_stream(first, every, len(apart))]
                n_smooth = len(lines_m) - 2 * (around + INNER_LINES)
                smooth_of_lines = np.ascontiguousarray(smooth[first::every][:n_smooth])
            neighbourhoods = measure_neighbours(
                lines_m[around:-around], smooth_of_lines, plane, limits
            )
            streams.append(Stream(first, every, neighbourhoods, lines_m))
    return streams


def _follow_streams(
    streams: Sequence[Stream],
    apart: I64,
    n_lines: int,
    plane: ScanPlane,
    memory: GroundMemory,
    limits: Limits,
) -> tuple[BlockGround, GroundMemory]:
    """Follow the ground of every stream, each from the memory of the block before."""
    last = int(apart[n_lines - 1])
    after = memory
    grounds = []
    for stream in streams:
        ground, memory_of_stream = follow_ground(
            stream.neighbourhoods.range_m,
            stream.neighbourhoods.neighbours,
            plane,
            memory,
            len(range(stream.first, n_lines, stream.every)),
            limits.walk,
        )
        grounds.append(ground)
        # the last stream with a line at the end of the block
        if stream.every == last and stream.first < n_lines:
            after = memory_of_stream
    parts = tuple(grounds)
    above = _merge_lines([ground.above_m for ground in parts], streams, apart)
    walked = _merge_lines([ground.walked for ground in parts], streams, apart)
    return BlockGround(above, walked, parts, (len(above) - len(apart)) // 2), after


def _rows_of_stream(first: int, every: int, n_lines: int) -> I64:
    """Return the rows of a stream in the wide window, with :data:`MARGIN_LINES` before and after.

    Rows beyond the window are replaced by the outermost ones of the stream.

    >>> _rows_of_stream(1, 2, 4)[[0, MARGIN_LINES, MARGIN_LINES + 1]].tolist()
    [0, 36, 38]
    """
    n = len(range(first, n_lines, every))
    rows = SPACED_LINES + first + every * np.arange(-MARGIN_LINES, n + MARGIN_LINES)
    end = n_lines + 2 * SPACED_LINES - 1
    last = end - (end - rows[0]) % every
    return np.clip(rows, rows[0] % every, last)


def _widen_window(
    wide: F32,
    strides: I64,
    noise_m: F64,
    every: int,
) -> tuple[F32, I64, F64]:
    """Return the window for a stream of every n-th line, with its strides and its range noise.

    It has more lines around. Lines beside the block have the strides of its outermost lines, but
    not more than :data:`FARTHEST_BESIDE`.
    """
    more = BESIDE_LINES * (every - 1)
    around = SPACED_LINES - BESIDE_LINES - more
    wide_noise_m = noise_m[around : len(noise_m) - around]
    if more == 0:
        return wide, strides, wide_noise_m
    first, last = (
        np.full(more, min(int(stride), FARTHEST_BESIDE)) for stride in (strides[0], strides[-1])
    )
    window = np.pad(wide, ((more, more), (0, 0)), constant_values=np.float32(np.nan))
    return window, np.concatenate([first, strides, last]), wide_noise_m


def _merge_lines(arrays: Sequence[AnyArray], streams: Sequence[Stream], apart: I64) -> AnyArray:
    """Put the lines of a block together: each from the stream whose distance ``apart`` gives."""
    if len(streams) == 1 and streams[0].every == 1:
        return arrays[0]
    merged = np.empty((len(apart), *arrays[0].shape[1:]), arrays[0].dtype)
    for array, stream in zip(arrays, streams, strict=True):
        lines = np.arange(stream.first, len(apart), stream.every)
        rows = array[(len(array) - len(lines)) // 2 :][: len(lines)]
        is_apart = apart[lines] == stream.every
        merged[lines[is_apart]] = rows[is_apart]
    return merged


def _merge_evidence(
    evidences: Sequence[Evidence],
    above_m: F32,
    streams: Sequence[Stream],
    apart: I64,
) -> Evidence:
    """Put the evidence of a block together; lines beside the block are left empty."""
    if len(streams) == 1 and streams[0].every == 1:
        return evidences[0]

    def merged(arrays: Sequence[AnyArray]) -> AnyArray:
        return _merge_lines(arrays, streams, apart)

    def padded(arrays: Sequence[AnyArray]) -> AnyArray:
        return np.pad(merged(arrays), ((VOTE_LINES, VOTE_LINES), (0, 0)))

    counts = zip(*(evidence.neighbours for evidence in evidences), strict=True)
    slots = zip(*(evidence.strips.slots for evidence in evidences), strict=True)
    walls = zip(*(evidence.strips.walls for evidence in evidences), strict=True)
    strips = Strips(
        FilledSlots(*(padded(arrays) for arrays in slots)),
        Walls(*(padded(arrays) for arrays in walls)),
        padded([evidence.strips.levels for evidence in evidences]),
        padded([evidence.strips.kinds for evidence in evidences]),
    )
    return Evidence(
        Neighbours(*(merged(arrays) for arrays in counts)),
        above_m,
        padded([evidence.texture for evidence in evidences]),
        strips,
        0,
    )


def limits_of_place(limits: Limits, wide: F32, plane: ScanPlane) -> Limits:
    """Return the limits for the place of a block: no cars in rooms, no curbs below a ceiling.

    ``wide`` (lines, M) float32, metres, the block with the lines around it.
    """
    every_fourth = wide[::ROOM_LINES]
    limits = in_room(limits) if is_room(every_fourth, limits) else limits
    return limits._replace(curbs=None) if has_ceiling(every_fourth, plane) else limits


def _measure_noise(
    wide: F32,
    line: int,
    plane: ScanPlane,
    known: NoiseAlong,
    params: SensorParams,
) -> tuple[F64, NoiseAlong]:
    """Measure the range noise at every line of the wide window of a block [m]."""
    noise = known.after(wide[SPACED_LINES:], line, plane, params)
    return noise.of_lines(line - SPACED_LINES, len(wide), params), noise


def _measure_forest_noise(range_m: F32, known: Noise, params: SensorParams) -> tuple[float, Noise]:
    """Measure the range noise in a forest [m], 0 until it is known.

    It is rounded to half octaves, so that labels hardly depend on the blocks that show it.
    """
    noise = known.after(forest_noise(range_m) if known.is_asked(params) else None)
    if params.range_noise_m != "auto":
        return noise.noise_m(params), noise
    rounded_m = 0.0
    if math.isfinite(noise.least_m) and noise.least_m > 0:
        rounded_m = 2.0 ** (round(2.0 * math.log2(noise.least_m)) / 2.0)
    return rounded_m, noise


def _strides(
    wide: F32,
    line: int,
    n_lines: int,
    plane: ScanPlane,
    noise_m: F64,
    turn: Turn,
    limits: Limits,
) -> I64:
    """Decide how many lines away neighbours are, also for three lines before and after the block.

    ``line`` is the number of the block's first line.
    """
    n_labelled = len(wide) - 2 * SPACED_LINES
    spaced = limits.spaced
    if spaced is None:
        return np.ones(n_labelled + 2 * BESIDE_LINES, np.int64)
    thresholds = partial(spaced.thresholds, limits.smoothness, step_rad=float(plane.step_rad))
    counts = count_repeated_leaves(wide, line, noise_m, thresholds)
    ahead = n_labelled - n_lines
    return turn.hand_on(
        SPACING, lambda known: strides_of(counts, known, line, n_lines, spaced, ahead)
    )


def measure_neighbours(
    window: F32,
    smooth: U8,
    plane: ScanPlane,
    limits: Limits,
) -> Neighbourhoods:
    """Measure every shot's neighbourhood: near neighbours, smoothness, direction of the surface.

    ``window`` (lines, M) float32; ``smooth`` (lines of the result, M) uint8.
    """
    near = near_neighbours(window, plane, limits.near)
    range_m = window[INNER_LINES:-INNER_LINES]
    upright, level = chords(range_m, smooth, plane, limits.chords)
    return Neighbourhoods(window, range_m, Neighbours(near, smooth, upright, level))


def evidence_of(
    neighbourhoods: Neighbourhoods,
    wide_m: F32,
    above_m: F32,
    plane: ScanPlane,
    limits: Limits,
) -> Evidence:
    """Measure how smooth places are, and find walls and cars above the ground.

    ``wide_m`` (lines + 2 n, M) float32; ``above_m`` (lines, M) float32.
    """
    neighbours = neighbourhoods.neighbours
    strips = measure_strips(wide_m, above_m, neighbours, plane, limits)
    texture = texture_of(neighbourhoods.range_m, neighbours, plane, limits)
    return Evidence(neighbours, above_m, texture, strips, AROUND_LINES - INNER_LINES)


def _decide_stream(
    stream: Stream, ground: Ground, plane: ScanPlane, limits: Limits, *, with_reasons: bool
) -> DecidedLines:
    """Label the shots of a stream; the reasons are the labels unless wanted."""
    range_m = stream.neighbourhoods.range_m
    above_m = ground.above_m
    neighbours = stream.neighbourhoods.neighbours

    # strips, texture
    evidence = evidence_of(stream.neighbourhoods, stream.wide_m, above_m, plane, limits)

    # classes
    strips = evidence.strips
    rules = decide(
        stream.wide_m, neighbours, ground, evidence.texture, strips, plane, limits.decision
    )
    decided = np.take(LABELS_BY_REASON, rules)

    # votes
    voted = vote(decided, range_m[WIDE_LINES:-WIDE_LINES], plane, limits.votes)

    # leaves amid noise
    late = find_late_leaves(decided, voted, range_m, above_m, plane, limits.late_leaves)

    # curbs
    inner = slice(INNER_LINES + 1, -INNER_LINES - 1)
    labels = find_curbs(late, range_m[inner], above_m[inner], plane, limits.curbs)

    if not with_reasons:
        return DecidedLines(labels, labels, evidence)
    lines = slice(VOTE_LINES, -VOTE_LINES)
    reasons = _where_changed(decided[lines], voted, rules[lines], voted + np.uint8(VOTED))
    reasons = _where_changed(voted, late, reasons, Reason.LEAF)
    reasons = _where_changed(late, labels, reasons, Reason.CURB_FACE)
    return DecidedLines(labels, reasons, evidence)


def _where_changed(before: U8, after: U8, reasons: U8, reason: U8 | Reason) -> U8:
    """Return the reasons after a stage: another one where it changed the label."""
    return np.where(before == after, reasons, np.asarray(reason, np.uint8))


def _with_cars(
    labels: U8,
    range_m: F32,
    n_lines: int,
    ground: BlockGround,
    evidence: Evidence,
    turn: Turn,
    plane: ScanPlane,
    limits: Limits,
) -> U8:
    """Label the cars of a block that profiles of single lines show.

    ``labels`` and ``range_m`` are also of the lines after it.
    """
    above_m = ground.above_m[ground.margin : ground.margin + len(labels)]
    texture = evidence.texture[1 : 1 + len(labels)]

    def find(before: U8) -> tuple[U8, U8]:
        return find_cars(labels, range_m, above_m, texture, n_lines, plane, before, limits.roofs)

    return turn.hand_on(PROFILES, find)


def window_of(
    tail: F32,
    range_m: F32,
    next_m: F32 | None,
    ahead: int,
) -> F32:
    """Return a block with lines around it, ``ahead`` more after it, NaN beyond the stream."""
    width = range_m.shape[1]
    following = np.full((SPACED_LINES + ahead, width), np.nan, np.float32)
    if next_m is not None:
        next_lines = next_m[: SPACED_LINES + ahead]
        following[: len(next_lines)] = next_lines
    return np.concatenate([tail, range_m, following])


def label_further_returns(
    range_m: F32,
    labels: U8,
    line: I32,
    column: I32,
    range_m_extra: F32,
    limit_m: float,
) -> U8:
    """Label the further returns of the shots.

    Light that passes a leaf meets other leaves, which may be isolated, as the first. Such returns
    are vegetation, and so are those that have leaves beside them.

    Returns (n,) uint8.

    >>> import numpy as np
    >>> image = np.array([[6.0, 20.0, 13.0]], np.float32)
    >>> labels = np.array([[Label.VEGETATION, Label.BUILDING, Label.NOISE]], np.uint8)
    >>> line, column = np.zeros(3, int), np.arange(3)
    >>> further = line, column, np.array([9, 30, 40], np.float32)
    >>> [Label(label).name for label in label_further_returns(image, labels, *further, 0.3)]
    ['VEGETATION', 'NOISE', 'VEGETATION']
    """
    if not len(line):
        return np.empty(0, np.uint8)
    further = label_extra_returns(range_m, labels, line, column, range_m_extra, limit_m, limit_m)
    known_m = np.where(labels == Label.NOISE, np.float32(np.nan), range_m)
    leaf_m = float(STREET.late_leaves.range_m)
    beside = label_extra_returns(known_m, labels, line, column, range_m_extra, leaf_m, leaf_m)
    is_leaf = np.isin(labels[line, column], (Label.VEGETATION, Label.NOISE))
    is_leaf |= beside == Label.VEGETATION
    further[is_leaf & (further == Label.NOISE)] = Label.VEGETATION
    return further
