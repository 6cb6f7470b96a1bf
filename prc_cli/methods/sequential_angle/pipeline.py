"""The order of the algorithms within a line and across lines, and the state between blocks.

Stamos et al. (2012), sec. 8. All processing is online. Most stages need only their own line. The
ground height needs the lines before it, and curbs need all lines of their component. So a line
becomes final once the ground height is known and all components of vertical points on it are
decided. Labels do not depend on how the stream was cut into blocks.

:func:`classify_block` is the whole method. Two of its steps (:func:`follow_ground` and
:func:`decide_curbs`) pass a state from block to block, the others need only their own block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli import kernels
from prc_cli.core.blocks import LineBuffer
from prc_cli.core.classes import LABEL_OF_SURFACE, CarTest, Label, Reason, Surface
from prc_cli.core.errors import InputError
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
from prc_cli.methods.sequential_angle.angles import angle_differences, line_angles, signed_angles
from prc_cli.methods.sequential_angle.car import CarSearch, car_search, cars
from prc_cli.methods.sequential_angle.coarse import (
    car_surface,
    coarse,
    dense_vegetation,
    without_windows,
)
from prc_cli.methods.sequential_angle.curb import CurbState, curbs, possible_curbs
from prc_cli.methods.sequential_angle.ground import ground, initial_ground, potential_ground
from prc_cli.methods.sequential_angle.lines import (
    Sides,
    VerticalLines,
    split_sides,
    to_columns,
    vertical_lines,
)
from prc_cli.methods.sequential_angle.thresholds import (
    CurbThresholds,
    GroundState,
    GroundThresholds,
    PotentialGround,
    SequentialAngleThresholds,
)

KERNELS = frozenset({"sequential_angle"})


class _SequentialAngleTable(MethodParams):
    """Parameters of the sequential-angle classifier (``[sequential_angle]``)."""

    def method(self) -> SequentialAngle:
        """Return the method with these parameters."""
        return SequentialAngle(thresholds_of(SequentialAngleThresholds(), self).at_noise())


if TYPE_CHECKING:
    SequentialAngleParams: TypeAlias = Any
else:
    SequentialAngleParams = table_of(
        SequentialAngleThresholds(), "sequential_angle", _SequentialAngleTable
    )


@dataclass(frozen=True, slots=True, eq=False)
class Within:
    """Results that depend on single half-lines only; R rows of n beams."""

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
class OnGround:
    """Rows whose ground is known."""

    rows: Within
    ground: Mask
    """(R, n) bool, G."""
    height_m: F32
    """(R,) float32, z_g [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Undecided:
    """Rows whose curbs are still open."""

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
    xyz_m: F32
    """(R, n, 3) float32, relative to the scanner [m]."""
    ground_height_m: F32
    """(R,) float32, z_g [m]."""
    trigger: U8
    """(R, n) uint8, as in :class:`~prc_cli.methods.sequential_angle.car.CarSearch`.

    n = 0 if not wanted.
    """
    car_interval: U16
    """(R, n) uint16, likewise."""
    car_test: U8
    """(R, n) uint8, likewise."""


@dataclass(frozen=True, slots=True, eq=False)
class WithCars:
    """Rows whose cars and possible curbs are known."""

    lines: VerticalLines
    signed_deg: F32
    """(R, n) float32, signed angle [deg]."""
    possible_curb: I32
    """(R,) int32, beam of the possible curb point, -1 = none."""
    undecided: Undecided


@dataclass(frozen=True, slots=True, eq=False)
class GroundSoFar:
    """State of the ground estimate after the lines so far."""

    waiting: tuple[Within, ...]
    """Rows waiting for the first ground height, in order."""
    heights_m: F64
    """(waiting rows,) float64, their z_i [m], NaN = none."""
    n_most: int
    """Largest number of waiting rows."""
    known: GroundState | None
    """None until the ground height is known."""


@dataclass(frozen=True, slots=True, eq=False)
class CurbsSoFar:
    """State of the curb search after the lines so far."""

    regions: CurbState
    undecided: tuple[Undecided, ...]
    """Rows waiting for their curbs, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class SequentialAngleState:
    """State handed to the next block; size limited by M, ``start_lines`` and ``curb.max_lines``."""

    ground: GroundSoFar
    curbs: CurbsSoFar
    waiting: tuple[ScanBlock, ...] = ()
    """Lines waiting for their labels, in order."""


GROUND = Part[GroundSoFar]("ground")
CURBS = Part[CurbsSoFar]("curbs")
WAITING = Part[tuple[ScanBlock, ...]]("waiting")


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
class Final:
    """Lines that became final, in order; may be empty."""

    labels: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label`."""
    rows: Sequence[Undecided]
    """Intermediate results, for :func:`stages_in_columns`."""


@dataclass(frozen=True, slots=True)
class SequentialAngle(Classifier[Beams, SequentialAngleState]):
    """The sequential-angle classifier; its constants per scanner are the beam directions."""

    thresholds: SequentialAngleThresholds

    @property
    def needs(self) -> Needs:
        """Blocks of any number of lines, with beam angles."""
        return Needs(KERNELS)

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
        """All classes but those that only the other methods have."""
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
        lines = turn.hand_on(
            WAITING, lambda before: _split_lines((*before, block), len(final.labels))
        )
        parts = []
        start = 0
        for part in lines:
            rows = slice(start, start + part.n_lines)
            start = rows.stop
            part_stages = None if stages is None else stages.of_lines(rows)
            labelled = _labelled(part, final.labels[rows], part_stages, self.thresholds)
            if part_stages is not None:
                labelled = replace(labelled, above_m=_above(part, part_stages, scanner))
            if wanted.reasons:
                reasons = _reasons(labelled.labels, final.labels[rows])
                labelled = replace(labelled, reasons=reasons)
            if wanted.measures:
                labelled = replace(labelled, measures=measures_of(labelled))
            parts.append(labelled)
        return parts

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


def _reasons(labels: U8, method_labels: U8) -> U8:
    """Return the rules of labels.

    Returns beyond the reach are missing in ``method_labels``.
    """
    reasons = reasons_of(labels, LABEL_REASONS["sequential-angle"])
    reasons[labels != method_labels] = Reason.BEYOND_REACH
    return reasons


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
    ground_so_far = GroundSoFar((), np.empty(0), n_lines * sides.n_sides, None)
    return SequentialAngleState(ground_so_far, CurbsSoFar(regions, ()))


def classify_block(
    range_m: F32,
    xyz_m: F32 | None,
    beams: Beams,
    turn: Turn,
    thresholds: SequentialAngleThresholds,
    *,
    last: bool = False,
    stages: bool = False,
) -> Final:
    """Add the next lines of a stream, any number, and label those that become final.

    ``range_m`` (lines, M) float32; ``xyz_m`` (lines, M, 3) float32 or None.
    """
    rows = within_lines(range_m, xyz_m, beams, thresholds)
    ready = turn.hand_on(GROUND, lambda before: follow_ground(rows, before, thresholds, last=last))
    with_cars = [find_cars(part, thresholds, stages=stages) for part in ready]
    done, curb = turn.hand_on(
        CURBS, lambda before: decide_curbs(with_cars, before, thresholds, last=last)
    )
    return Final(in_columns(done, curb, beams, thresholds.curb), done)


def _above(block: ScanBlock, stages: StageLabels, beams: Beams) -> F32:
    """Return heights above the ground, (lines, M) float32 [m]; NaN = missing or unknown."""
    if block.xyz_m is None:
        up_m = block.range_m * -np.cos(beams.beam_rad).astype(np.float32)
    else:
        up_m = np.where(np.isnan(block.range_m), np.float32(np.nan), block.xyz_m[..., 2])
    above: F32 = (up_m - stages.ground_height_m).astype(np.float32, copy=False)
    return above


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
    labels, n_beyond = kernels.mark_beyond(block.range_m, labels)
    block = replace(block, next_m=None, tally=block.tally + ReadTally(n_beyond=n_beyond))
    # which lines become final together depends on the blocks: only the shot's own line may be used
    further = block.extra
    limit_m = thresholds.extra_return_m
    extra = label_extra_returns(
        block.range_m,
        labels,
        further.line,
        further.column,
        further.range_m,
        limit_m,
        0.0,
        alone=Label.UNCLASSIFIED,
    )
    return LabelledBlock(block, labels, extra, stages=stages)


@stage("angles")
def within_lines(
    range_m: F32,
    xyz_m: F32 | None,
    beams: Beams,
    thresholds: SequentialAngleThresholds,
) -> Within:
    """Run the stages that need only one half-line: coarse layer, car layer, potential ground."""
    lines = vertical_lines(range_m, xyz_m, beams.beam_rad, beams.sides, thresholds.max_range_m)
    angles = signed_angles(lines, thresholds.angles)
    surface = coarse(angles.signed_deg, lines, thresholds.coarse)
    surface = without_windows(surface, lines, thresholds.coarse.windows)
    dense = dense_vegetation(angle_differences(angles.signed_deg), thresholds.dense_vegetation)
    car_layer = car_surface(angles.signed_deg, dense, lines, thresholds.coarse.surfaces)
    line_angle_deg = line_angles(lines, angles.ahead, surface)
    return Within(
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
    rows: Within,
    state: GroundSoFar,
    thresholds: SequentialAngleThresholds,
    *,
    last: bool,
) -> tuple[list[OnGround], GroundSoFar]:
    """Find the ground of the next rows, in order (sec. 5).

    The first rows wait until its height is known.
    """
    ready, state = _start_ground(rows, state, thresholds.ground, last=last)
    on_ground = []
    for part in ready:
        assert state.known is not None
        mask, height_m, known = ground(
            part.lines,
            part.surface,
            part.line_angle_deg,
            part.ahead,
            part.potential,
            state.known,
            thresholds.ground,
        )
        state = replace(state, known=known)
        on_ground.append(OnGround(part, mask, height_m))
    return on_ground, state


def _start_ground(
    rows: Within,
    state: GroundSoFar,
    thresholds: GroundThresholds,
    *,
    last: bool,
) -> tuple[list[Within], GroundSoFar]:
    """Let rows wait until the first ground height is known (sec. 5, part b)."""
    if state.known is not None:
        return [rows], state
    waiting = (*state.waiting, rows)
    heights = np.concatenate([state.heights_m, rows.potential.height_m])
    enough = int(np.count_nonzero(np.isfinite(heights[: state.n_most]))) >= thresholds.start_heights
    if not enough and len(heights) < state.n_most and not last:
        return [], replace(state, waiting=waiting, heights_m=heights)
    known = initial_ground(heights[: state.n_most], thresholds, rows.lines.n_sides)
    return list(waiting), replace(state, waiting=(), heights_m=np.empty(0), known=known)


@stage("cars")
def find_cars(
    part: OnGround, thresholds: SequentialAngleThresholds, *, stages: bool = False
) -> WithCars:
    """Find cars and possible curb points, which need only the ground height."""
    rows = part.rows
    z_g = part.height_m
    lines = rows.lines
    surface = rows.surface
    possible = possible_curbs(lines, surface, part.ground, z_g, thresholds.curb)
    cars_found = cars(lines, surface, rows.car_surface, rows.signed_deg, z_g, thresholds.car)
    search = car_search(cars_found, lines) if stages else CarSearch.none(len(z_g))
    undecided = Undecided(
        surface,
        rows.car_surface,
        part.ground,
        cars_found.car,
        lines.horizontal_m,
        lines.xyz_m,
        z_g,
        search.trigger,
        search.interval,
        search.test,
    )
    return WithCars(lines, rows.signed_deg, possible, undecided)


@stage("curbs")
def decide_curbs(
    parts: Sequence[WithCars],
    state: CurbsSoFar,
    thresholds: SequentialAngleThresholds,
    *,
    last: bool,
) -> tuple[tuple[list[Undecided], list[Mask]], CurbsSoFar]:
    """Verify curbs across the next rows, in order (sec. 6).

    Return the rows that became final, and their curbs.
    """
    done: list[Undecided] = []
    masks: list[Mask] = []
    for number, part in enumerate(parts):
        curb, regions = curbs(
            part.lines,
            part.undecided.surface,
            part.signed_deg,
            part.possible_curb,
            state.regions,
            thresholds.curb,
            last=last and number == len(parts) - 1,
        )
        final, open_rows = _split((*state.undecided, part.undecided), len(curb))
        state = CurbsSoFar(regions, open_rows)
        done += final
        masks.append(curb)
    return (done, masks), state


def combine(rows: Undecided, curb: Mask, thresholds: CurbThresholds) -> U8:
    """Give every beam its class; cars behind a curb go back to the coarse classification (sec. 8).

    ``curb`` (R, n) bool; returns (R, n) uint8.
    """
    labels: U8 = kernels.combine_classes(
        rows.surface,
        rows.ground,
        rows.car,
        rows.horizontal_m,
        rows.xyz_m,
        curb,
        np.array(LABEL_OF_SURFACE, np.uint8),
        thresholds.stands_below_m,
    )
    return labels


@stage("classes")
def in_columns(
    done: Sequence[Undecided],
    curb: Sequence[Mask],
    beams: Beams,
    thresholds: CurbThresholds,
) -> U8:
    """Label final rows, and map them back to the columns of their scan lines."""
    sides = beams.sides
    m = len(beams.beam_rad)
    if not done:
        return np.empty((0, m), np.uint8)
    curbs_of_all = curb[0] if len(curb) == 1 else np.concatenate(curb)
    ends = np.cumsum([len(part.surface) for part in done])
    labels = [
        to_columns(combine(part, curbs_of_all[end - len(part.surface) : end], thresholds), sides, m)
        for part, end in zip(done, ends, strict=True)
    ]
    return labels[0] if len(labels) == 1 else np.concatenate(labels)


@stage("stages")
def stages_in_columns(done: Sequence[Undecided], labels: U8, beams: Beams) -> StageLabels:
    """Map the intermediate results of final rows back to the columns of their scan lines.

    ``labels`` (lines, M) uint8.
    """
    sides = beams.sides
    m = len(beams.beam_rad)
    if not done:
        none = np.empty((0, m), np.uint8)
        return StageLabels(none, none, none.astype(np.float32), none, none.astype(np.uint16), none)
    rows = _join(done)
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
    parts: tuple[Undecided, ...], n_rows: int
) -> tuple[list[Undecided], tuple[Undecided, ...]]:
    """Split off the first rows of a queue."""
    first_rows: list[Undecided] = []
    for number, part in enumerate(parts):
        n = len(part.surface)
        if n_rows < n:
            if n_rows:
                first_rows.append(_rows_of(part, slice(0, n_rows)))
            return first_rows, (_rows_of(part, slice(n_rows, n)), *parts[number + 1 :])
        first_rows.append(part)
        n_rows -= n
    return first_rows, ()


def _rows_of(rows: Undecided, part: slice) -> Undecided:
    values: dict[str, Any] = {
        column.name: getattr(rows, column.name)[part] for column in fields(rows)
    }
    return Undecided(**values)


def _join(parts: Sequence[Undecided]) -> Undecided:
    values: dict[str, Any] = {
        column.name: np.concatenate([getattr(part, column.name) for part in parts])
        for column in fields(Undecided)
    }
    return Undecided(**values)


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
