"""The order of the algorithms within a line and across lines, and the state between blocks.

Stamos et al. (2012), sec. 8. All processing is online. Most stages need only their own line. The
ground height needs the lines before it, and curbs need all lines of their component. So a line
becomes final once the ground height is known and all components of vertical points on it are
decided. Labels do not depend on how the stream was cut into blocks.

:func:`classify_block` is the whole method. Two of its steps (:func:`follow_ground` and
:func:`decide_curbs`) pass a state from block to block, the others need only their own block.
``turn.hand_on(part, step)`` calls such a step with the state that the previous block left; the step
returns its result and the state for the next block.

A row is one half-line: one side of the scan plane in one scan line. R rows of n beams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.blocks import LineBuffer
from prc_cli.core.classes import LABEL_OF_SURFACE, CarTest, Label, Reason, Surface
from prc_cli.core.errors import InputError
from prc_cli.core.loops import loops_of
from prc_cli.core.profile import stage
from prc_cli.core.stream import LabelledBlock, ReadTally, ScanBlock, StageLabels
from prc_cli.core.types import F32, F64, I32, I64, U8, U16, Mask
from prc_cli.methods.base import (
    Classifier,
    MethodParams,
    Needs,
    Part,
    Turn,
    UsualLabels,
    Wanted,
    beams_of,
)
from prc_cli.methods.keys import table_of, thresholds_of
from prc_cli.methods.reasons import LABEL_REASONS, reasons_of
from prc_cli.methods.returns import label_extra_returns
from prc_cli.methods.sequential_angle import (
    angles_loops,
    car_loops,
    coarse_loops,
    curb_loops,
    ground_loops,
    labels_loops,
)
from prc_cli.methods.sequential_angle.angles import angle_differences, line_angles, signed_angles
from prc_cli.methods.sequential_angle.car import CarSearch, car_search, cars
from prc_cli.methods.sequential_angle.coarse import (
    car_surface,
    coarse,
    dense_vegetation,
)
from prc_cli.methods.sequential_angle.curb import CurbState, curbs, possible_curbs
from prc_cli.methods.sequential_angle.ground import ground, initial_ground, potential_ground
from prc_cli.methods.sequential_angle.labels_loops import combine_classes, mark_beyond
from prc_cli.methods.sequential_angle.lines import (
    Sides,
    VerticalLines,
    split_sides,
    to_columns,
    vertical_lines,
)
from prc_cli.methods.sequential_angle.thresholds import (
    GroundState,
    GroundThresholds,
    PotentialGround,
    SequentialAngleThresholds,
)

LOOPS = loops_of(angles_loops, car_loops, coarse_loops, curb_loops, ground_loops, labels_loops)


class _SequentialAngleTable(MethodParams):
    """Parameters of the sequential-angle classifier (``[sequential_angle]``)."""

    def method(self) -> SequentialAngle:
        """Return the method with these parameters."""
        return SequentialAngle(thresholds_of(SequentialAngleThresholds(), self).at_noise())


if TYPE_CHECKING:
    # the fields of the table are made at run time
    SequentialAngleParams: TypeAlias = Any
else:
    SequentialAngleParams = table_of(
        SequentialAngleThresholds(), "sequential_angle", _SequentialAngleTable
    )


@dataclass(frozen=True, slots=True, eq=False)
class LineResults:
    """Results that depend on single half-lines only."""

    lines: VerticalLines
    signed_deg: F32
    """(R, n) float32, signed angle [deg]."""
    ahead: I32
    """(R, n) int32, beam at the other end of the chord, -1 = none."""
    surface: U8
    """(R, n) uint8, coarse layer {T, H, V}."""
    car_surface: U8
    """(R, n) uint8, car layer {T', H, V}."""
    line_angle_deg: F32
    """(R, n) float32, line angle of horizontal points [deg]."""
    potential: PotentialGround


@dataclass(frozen=True, slots=True, eq=False)
class RowsWithGround:
    """Rows whose ground is known."""

    rows: LineResults
    ground: Mask
    """(R, n) bool, G."""
    height_m: F32
    """(R,) float32, z_g [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class RowsBeforeCurbs:
    """Rows whose cars are known and whose curbs may not be."""

    surface: U8
    """(R, n) uint8, coarse layer."""
    car_surface: U8
    """(R, n) uint8, car layer, for T'."""
    ground: Mask
    """(R, n) bool, G."""
    car: Mask
    """(R, n) bool, C before cars behind curbs are removed."""
    horizontal_m: F32
    """(R, n) float32, horizontal distance [m]."""
    ground_height_m: F32
    """(R,) float32, z_g [m]."""
    trigger: U8
    """(R, n) uint8, as in :class:`~prc_cli.methods.sequential_angle.car.CarSearch`; n = 0 if not
    wanted."""
    car_interval: U16
    """(R, n) uint16, likewise."""
    car_test: U8
    """(R, n) uint8, likewise."""


@dataclass(frozen=True, slots=True, eq=False)
class RowsWithCars:
    """Rows whose cars and possible curbs are known."""

    lines: VerticalLines
    signed_deg: F32
    """(R, n) float32, signed angle [deg]."""
    possible_curb: I32
    """(R,) int32, beam of the possible curb point, -1 = none."""
    before_curbs: RowsBeforeCurbs


@dataclass(frozen=True, slots=True, eq=False)
class GroundQueue:
    """State of the ground estimate between two blocks."""

    waiting: tuple[LineResults, ...]
    """Rows waiting for the first ground height, in order."""
    heights_m: F64
    """(waiting rows,) float64, their z_i [m], NaN = none."""
    max_rows: int
    """Largest number of waiting rows."""
    estimate: GroundState | None
    """None until the first ground height is known; then no row waits."""


@dataclass(frozen=True, slots=True, eq=False)
class CurbQueue:
    """State of the curb search between two blocks."""

    regions: CurbState
    waiting: tuple[RowsBeforeCurbs, ...]
    """Rows waiting for their curbs, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class SequentialAngleState:
    """State handed to the next block; size limited by M, ``start_lines`` and ``curb.max_lines``."""

    ground: GroundQueue
    curbs: CurbQueue
    waiting: tuple[ScanBlock, ...] = ()
    """Lines waiting for their labels, in order."""


GROUND = Part[GroundQueue]("ground")
CURBS = Part[CurbQueue]("curbs")
WAITING = Part[tuple[ScanBlock, ...]]("waiting")
"""Fields of :class:`SequentialAngleState`; each is handed on by a step of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Beam directions of a scanner."""

    beam_rad: F64
    """(M,) float64, angle of every column's beam from straight down, in (-pi, pi]; the sign is the
    side of the scan plane [rad]."""
    sides: Sides

    @classmethod
    def of(cls, beam_rad: F64) -> Beams:
        """Split the beams of a scan line, (M,) float64 [rad], into half-lines."""
        return cls(beam_rad, split_sides(beam_rad))


@dataclass(frozen=True, slots=True, eq=False)
class FinalLines:
    """Lines that became final, in order; may be empty."""

    labels: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label`."""
    rows: Sequence[RowsBeforeCurbs]
    """Intermediate results, for :func:`stages_in_columns`."""


@dataclass(frozen=True, slots=True)
class SequentialAngle(Classifier[Beams, SequentialAngleState]):
    """The sequential-angle classifier; its constants per scanner are the beam directions."""

    thresholds: SequentialAngleThresholds

    @property
    def needs(self) -> Needs:
        """Blocks of any number of lines, with beam angles."""
        return Needs(LOOPS)

    @property
    def usual(self) -> UsualLabels:
        """A class for nearly every return, and level surfaces below the scanner."""
        level = (Label.GROUND, Label.CURB, Label.HORIZONTAL)
        return UsualLabels(
            unclassified_share=0.1,
            level=level,
            level_share=0.5,
            ground_share=0.1,
            below_share=0.2,
            lean_deg=5.0,
            vanished_share=0.3,
        )

    @property
    def gives(self) -> frozenset[Label]:
        """All classes except noise, building and stem."""
        return frozenset(Label) - {Label.NOISE, Label.BUILDING, Label.STEM}

    def scanner(self, first: ScanBlock) -> Beams:
        """Return the beam directions."""
        return Beams.of(beams_of(first))

    def initial_state(self, scanner: Beams) -> SequentialAngleState:
        """Return the state before the first block."""
        return initial_state(scanner, self.thresholds)

    def label(
        self,
        block: ScanBlock,
        scanner: Beams,
        turn: Turn,
        wanted: Wanted,
    ) -> Sequence[LabelledBlock]:
        """Add the next lines, and label those that become final."""
        _check_shape(block.range_m, block.xyz_m, scanner)
        final = classify_block(
            block.range_m,
            block.xyz_m,
            scanner,
            turn,
            self.thresholds,
            last=block.is_last,
            stages=wanted.stages,
        )
        stages = stages_in_columns(final.rows, final.labels, scanner) if wanted.stages else None
        # final labels belong to the oldest lines, which may have come with previous blocks
        final_blocks = turn.hand_on(
            WAITING, lambda waiting: _split_lines((*waiting, block), len(final.labels))
        )
        labelled_blocks = []
        first_line = 0
        for final_block in final_blocks:
            lines = slice(first_line, first_line + final_block.n_lines)
            first_line = lines.stop
            labels = final.labels[lines]
            block_stages = None if stages is None else stages.of_lines(lines)
            labelled = _labelled(final_block, labels, block_stages, self.thresholds)
            if block_stages is not None:
                if final_block.xyz_m is None:
                    up_m = final_block.range_m * -np.cos(scanner.beam_rad).astype(np.float32)
                else:
                    up_m = np.where(
                        np.isnan(final_block.range_m), np.float32(np.nan), final_block.xyz_m[..., 2]
                    )
                above: F32 = (up_m - block_stages.ground_height_m).astype(np.float32, copy=False)
                labelled = replace(labelled, above_m=above)
            if wanted.reasons:
                reasons = reasons_of(labelled.labels, LABEL_REASONS["sequential-angle"])
                # labels differ where a return is beyond the reach of the method
                reasons[labelled.labels != labels] = Reason.BEYOND_REACH
                labelled = replace(labelled, reasons=reasons)
            if wanted.measures:
                labelled = replace(labelled, measures=measures_of(labelled))
            labelled_blocks.append(labelled)
        return labelled_blocks

    def notices(self, labels: I64, tally: ReadTally, *, segments: bool) -> tuple[str, ...]:
        """Report steps without result, and why."""
        notices: list[str] = []
        if not labels[Label.GROUND]:
            notices.append(
                "no ground was found, and without its height neither curbs nor cars are looked for"
            )
        if tally.n_beyond:
            notices.append(
                f"{tally.n_beyond} ranges lie beyond "
                f"sequential_angle.max_range_m = {self.thresholds.max_range_m:g} m "
                "or the limits of [input]: they are missing to the method, and unclassified"
            )
        if segments:
            notices.append("the sequential-angle method has no segments: every segment id is 0")
        return tuple(notices)


def measures_of(labelled: LabelledBlock) -> dict[str, NDArray[Any]]:
    """Return the measured quantities of every shot of final lines, by names with their units."""
    stages = labelled.stages
    assert stages is not None
    assert labelled.above_m is not None
    surfaces = np.array([surface.name.lower() for surface in Surface])
    return {
        "coarse class": surfaces[stages.surface],
        "dense vegetation": stages.dense_vegetation,
        "ground, from the scanner [m]": stages.ground_height_m,
        "height above the ground [m]": labelled.above_m,
        "interval between dividers": stages.car_interval,
    }


def initial_state(beams: Beams, thresholds: SequentialAngleThresholds) -> SequentialAngleState:
    """Return the state before the first block."""
    sides = beams.sides
    n_lines = max(1, min(thresholds.start_lines, thresholds.start_shots // len(beams.beam_rad)))
    regions = CurbState.start(sides.n_sides, sides.columns.shape[1], thresholds.curb)
    ground_queue = GroundQueue((), np.empty(0), max_rows=n_lines * sides.n_sides, estimate=None)
    return SequentialAngleState(ground_queue, CurbQueue(regions, ()))


def classify_block(
    range_m: F32,
    xyz_m: F32 | None,
    beams: Beams,
    turn: Turn,
    thresholds: SequentialAngleThresholds,
    *,
    last: bool = False,
    stages: bool = False,
) -> FinalLines:
    """Add the next lines of a stream, any number, and label those that become final.

    ``range_m`` (lines, M) float32; ``xyz_m`` (lines, M, 3) float32 or None.
    """
    rows = within_lines(range_m, xyz_m, beams, thresholds)
    # rows come out of both steps later than they go in, and some of previous blocks with them
    with_ground = turn.hand_on(
        GROUND, lambda state: follow_ground(rows, state, thresholds, last=last)
    )
    with_cars = [find_cars(part, thresholds, stages=stages) for part in with_ground]
    final_rows, curb = turn.hand_on(
        CURBS, lambda state: decide_curbs(with_cars, state, thresholds, last=last)
    )
    return FinalLines(in_columns(final_rows, curb, beams), final_rows)


def _split_lines(
    waiting: tuple[ScanBlock, ...], n_lines: int
) -> tuple[list[ScanBlock], tuple[ScanBlock, ...]]:
    """Return the first ``n_lines`` waiting lines, and the lines that still wait."""
    buffer = LineBuffer()
    for block in waiting:
        buffer.add(block)
    return buffer.take_parts(n_lines), tuple(buffer.parts)


def _labelled(
    block: ScanBlock,
    labels: U8,
    stages: StageLabels | None,
    thresholds: SequentialAngleThresholds,
) -> LabelledBlock:
    """Combine final lines with their labels, and label their further returns."""
    # ranges beyond the scanner's reach are missing to the method, but they are returns
    labels, n_beyond = mark_beyond(block.range_m, labels)
    block = replace(block, next_m=None, tally=block.tally + ReadTally(n_beyond=n_beyond))
    further = block.extra
    extra_labels = label_extra_returns(
        block.range_m,
        labels,
        further.line,
        further.column,
        further.range_m,
        zeta_p=thresholds.extra_return_m,
        # 0 = no adjacent lines: which of them are final, too, depends on the cut into blocks
        zeta_s=0.0,
        alone=Label.UNCLASSIFIED,
    )
    return LabelledBlock(block, labels, extra_labels, stages=stages)


@stage("angles")
def within_lines(
    range_m: F32,
    xyz_m: F32 | None,
    beams: Beams,
    thresholds: SequentialAngleThresholds,
) -> LineResults:
    """Run the stages that need only one half-line: coarse layer, car layer, potential ground."""
    lines = vertical_lines(range_m, xyz_m, beams.beam_rad, beams.sides, thresholds.max_range_m)
    angles = signed_angles(lines, thresholds.angles)
    surface = coarse(angles.signed_deg, lines, thresholds.coarse)
    dense = dense_vegetation(angle_differences(angles.signed_deg))
    car_layer = car_surface(angles.signed_deg, dense, lines, thresholds.coarse.surfaces)
    line_angle_deg = line_angles(lines, angles.ahead, surface)
    return LineResults(
        lines=lines,
        signed_deg=angles.signed_deg,
        ahead=angles.ahead,
        surface=surface,
        car_surface=car_layer,
        line_angle_deg=line_angle_deg,
        potential=potential_ground(lines, surface, line_angle_deg, angles.ahead, thresholds.ground),
    )


@stage("ground")
def follow_ground(
    rows: LineResults,
    state: GroundQueue,
    thresholds: SequentialAngleThresholds,
    *,
    last: bool,
) -> tuple[list[RowsWithGround], GroundQueue]:
    """Find the ground of the next rows, in order (sec. 5); the first rows wait for its height."""
    parts, state = _start_ground(rows, state, thresholds.ground, last=last)
    with_ground = []
    for part in parts:
        assert state.estimate is not None
        is_ground, height_m, estimate = ground(
            part.lines,
            part.surface,
            part.line_angle_deg,
            part.ahead,
            part.potential,
            state.estimate,
            thresholds.ground,
        )
        state = replace(state, estimate=estimate)
        with_ground.append(RowsWithGround(part, is_ground, height_m))
    return with_ground, state


def _start_ground(
    rows: LineResults,
    state: GroundQueue,
    thresholds: GroundThresholds,
    *,
    last: bool,
) -> tuple[list[LineResults], GroundQueue]:
    """Queue rows until the first ground height is known (sec. 5, part b); return the ready ones."""
    if state.estimate is not None:
        return [rows], state
    waiting = (*state.waiting, rows)
    heights_m = np.concatenate([state.heights_m, rows.potential.height_m])
    # rows beyond the limit do not count, so that the labels do not depend on the cut into blocks
    first_heights_m = heights_m[: state.max_rows]
    n_heights = int(np.count_nonzero(np.isfinite(first_heights_m)))
    must_wait = n_heights < thresholds.start_heights and len(heights_m) < state.max_rows
    if must_wait and not last:
        return [], replace(state, waiting=waiting, heights_m=heights_m)
    estimate = initial_ground(first_heights_m, thresholds)
    return list(waiting), replace(state, waiting=(), heights_m=np.empty(0), estimate=estimate)


@stage("cars")
def find_cars(
    part: RowsWithGround, thresholds: SequentialAngleThresholds, *, stages: bool = False
) -> RowsWithCars:
    """Find cars and possible curb points by the ground height of their row."""
    rows = part.rows
    z_g = part.height_m
    lines = rows.lines
    surface = rows.surface
    possible = possible_curbs(lines, surface, part.ground, z_g, thresholds.curb)
    cars_found = cars(lines, surface, rows.car_surface, rows.signed_deg, z_g, thresholds.car)
    search = car_search(cars_found, lines) if stages else CarSearch.none(len(z_g))
    before_curbs = RowsBeforeCurbs(
        surface=surface,
        car_surface=rows.car_surface,
        ground=part.ground,
        car=cars_found.car,
        horizontal_m=lines.horizontal_m,
        ground_height_m=z_g,
        trigger=search.trigger,
        car_interval=search.interval,
        car_test=search.test,
    )
    return RowsWithCars(lines, rows.signed_deg, possible, before_curbs)


@stage("curbs")
def decide_curbs(
    parts: Sequence[RowsWithCars],
    state: CurbQueue,
    thresholds: SequentialAngleThresholds,
    *,
    last: bool,
) -> tuple[tuple[list[RowsBeforeCurbs], list[Mask]], CurbQueue]:
    """Verify curbs across the next rows, in order (sec. 6).

    Return the rows that became final with their curbs, (rows, n) bool in pieces, and the state.
    The pieces of rows and of curbs have different lengths.
    """
    final_rows: list[RowsBeforeCurbs] = []
    final_curbs: list[Mask] = []
    for number, part in enumerate(parts):
        curb, regions = curbs(
            part.lines,
            part.before_curbs.surface,
            part.signed_deg,
            part.possible_curb,
            state.regions,
            thresholds.curb,
            last=last and number == len(parts) - 1,
        )
        decided, waiting = _split((*state.waiting, part.before_curbs), len(curb))
        state = CurbQueue(regions, waiting)
        final_rows += decided
        final_curbs.append(curb)
    return (final_rows, final_curbs), state


def combine(rows: RowsBeforeCurbs, curb: Mask) -> U8:
    """Give every beam its class; cars behind a curb go back to the coarse classification (sec. 8).

    ``curb`` (R, n) bool; returns (R, n) uint8.
    """
    labels: U8 = combine_classes(
        rows.surface,
        rows.ground,
        rows.car,
        rows.horizontal_m,
        curb,
        np.array(LABEL_OF_SURFACE, np.uint8),
    )
    return labels


@stage("classes")
def in_columns(
    parts: Sequence[RowsBeforeCurbs],
    curb_parts: Sequence[Mask],
    beams: Beams,
) -> U8:
    """Label final rows, and map them back to the columns of their scan lines, (lines, M) uint8.

    ``parts`` and ``curb_parts`` have the same rows, but different borders.
    """
    m = len(beams.beam_rad)
    if not parts:
        return np.empty((0, m), np.uint8)
    curb = curb_parts[0] if len(curb_parts) == 1 else np.concatenate(curb_parts)
    labels = []
    start = 0
    for part in parts:
        stop = start + len(part.surface)
        labels.append(to_columns(combine(part, curb[start:stop]), beams.sides, m))
        start = stop
    return labels[0] if len(labels) == 1 else np.concatenate(labels)


@stage("stages")
def stages_in_columns(parts: Sequence[RowsBeforeCurbs], labels: U8, beams: Beams) -> StageLabels:
    """Map the intermediate results of final rows back to the columns of their scan lines.

    ``labels`` (lines, M) uint8.
    """
    sides = beams.sides
    m = len(beams.beam_rad)
    if not parts:
        empty = np.empty((0, m), np.uint8)
        empty_heights = empty.astype(np.float32)
        return StageLabels(empty, empty, empty_heights, empty, empty.astype(np.uint16), empty)
    values: dict[str, Any] = {
        column.name: np.concatenate([getattr(part, column.name) for part in parts])
        for column in fields(RowsBeforeCurbs)
    }
    rows = RowsBeforeCurbs(**values)
    height = np.repeat(rows.ground_height_m[:, None], rows.surface.shape[1], axis=1)
    test = to_columns(rows.car_test, sides, m)
    test[(test == CarTest.CAR) & (labels != Label.CAR)] = CarTest.BEHIND_CURB
    return StageLabels(
        to_columns(rows.surface, sides, m),
        to_columns(rows.car_surface, sides, m),
        to_columns(height, sides, m),
        to_columns(rows.trigger, sides, m),
        to_columns(rows.car_interval, sides, m),
        test,
    )


def _split(
    parts: tuple[RowsBeforeCurbs, ...], n_rows: int
) -> tuple[list[RowsBeforeCurbs], tuple[RowsBeforeCurbs, ...]]:
    """Split off the first rows of a queue."""
    first_rows: list[RowsBeforeCurbs] = []
    for number, part in enumerate(parts):
        n = len(part.surface)
        if n_rows < n:
            if n_rows:
                first_rows.append(_rows_of(part, slice(0, n_rows)))
            return first_rows, (_rows_of(part, slice(n_rows, n)), *parts[number + 1 :])
        first_rows.append(part)
        n_rows -= n
    return first_rows, ()


def _rows_of(rows: RowsBeforeCurbs, part: slice) -> RowsBeforeCurbs:
    values: dict[str, Any] = {
        column.name: getattr(rows, column.name)[part] for column in fields(rows)
    }
    return RowsBeforeCurbs(**values)


def _check_shape(range_m: F32, xyz_m: F32 | None, beams: Beams) -> None:
    width = len(beams.beam_rad)
    if range_m.ndim != 2 or range_m.shape[1] != width:
        problem = (
            f"found an array of shape {range_m.shape}, "
            f"expected (lines, {width}) as the stream began"
        )
        raise InputError("block of ranges", problem, "check points_per_line")
    if xyz_m is not None and xyz_m.shape != (*range_m.shape, 3):
        problem = f"found coordinates of shape {xyz_m.shape}, expected {(*range_m.shape, 3)}"
        raise InputError(
            "block of coordinates", problem, "give xyz of every shot, NaN where it is missing"
        )
