"""The method for rings: its stages in order, and the state between blocks.

A block is labelled by itself, up to the plane of the ground, which a block that shows too little of
it takes from the blocks before. design/rings.md gives the stages and the reasons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from prc_cli.core.classes import LABELS_BY_REASON, Label
from prc_cli.core.loops import loops_of
from prc_cli.core.stream import MAX_RINGS, LabelledBlock, ScanBlock
from prc_cli.core.types import F32, F64, U8
from prc_cli.methods.base import (
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
from prc_cli.methods.plane import MANY_RINGS
from prc_cli.methods.returns import label_extra_returns
from prc_cli.methods.rings import cells_loops, ground_loops
from prc_cli.methods.rings.classes import (
    Cells,
    fill_cells,
    label_cells,
    label_shots,
    lonely_shots,
    low_plants,
    mark_shots,
    sunken_shots,
)
from prc_cli.methods.rings.ground import (
    USUAL_STEP_RAD,
    GroundPlane,
    Lowest,
    Polar,
    above_ground,
    find_plane,
)
from prc_cli.methods.rings.thresholds import FEW, MANY, Limits

LOOPS = loops_of(cells_loops, ground_loops)
WIDEST_FAN_RAD = math.radians(60)
"""Angle between the outermost rings of a spinning scanner, at most.

27 to 45 degrees are usual; profilers see 125 and more.
"""
STEEPEST_RAD = math.radians(40)
"""Angle of the lowest ring from straight down, at least.

Strips from the air are narrow, and look straight down.
"""
FEWEST_RINGS = 4
UP = {"auto": None, "z": 1.0, "-z": -1.0}
EXTRA_RETURN_M = 0.3
"""Further returns take the label of a shot around that is this near in range [m]."""
MEASURES = (
    "thickness of what is around, seen from above [m]",
    "its length [m]",
    "its upright share",
    "its smooth share",
    "levels of 0.25 m with shots",
    "the highest of them",
    "cells of 0.5 m with shots, of 25",
)
"""Names of the measures of cells."""
LABELS = frozenset(
    {
        Label.MISSING,
        Label.NOISE,
        Label.GROUND,
        Label.BUILDING,
        Label.VEGETATION,
        Label.CAR,
        Label.POLE,
    }
)


def is_fan(beam_rad: F64) -> bool:
    """Return whether beams, (M,) float64 [rad], are a fan of rings.

    >>> [is_fan(np.deg2rad(beams)) for beams in ([65.0, 80, 90, 92], [-90.0, -30, 30, 90])]
    [True, False]
    >>> is_fan(np.deg2rad([1.0] * 9))
    False
    """
    if not FEWEST_RINGS <= len(beam_rad) <= MAX_RINGS:
        return False
    return bool(np.ptp(beam_rad) < WIDEST_FAN_RAD and np.abs(beam_rad).min() > STEEPEST_RAD)


class RingsParams(MethodParams):
    """Parameters of the method for rings (``[rings]``).

    Its limits are constants, in thresholds.py.
    """

    lines_per_block: int = Field(
        1024, ge=1, le=100_000, description="scan lines that are labelled together"
    )
    up: Literal["auto", "z", "-z"] = Field(
        "auto",
        description="where up is: auto = z, unless the ground is there alone where z points down",
    )

    def method(self) -> Rings:
        """Return the method with these parameters."""
        return Rings(self)


@dataclass(frozen=True, slots=True)
class RingsState:
    """State handed to the next block."""

    plane: GroundPlane
    """The ground so far."""


PLANE = Part[GroundPlane]("plane")


@dataclass(frozen=True, slots=True)
class Rings(Classifier[F64, RingsState]):
    """The method for rings; its constants per scanner are the beam directions."""

    params: RingsParams

    @property
    def needs(self) -> Needs:
        """Blocks with beam angles and intensities; nothing of the lines after a block."""
        return Needs(
            LOOPS,
            self.params.lines_per_block,
            1,
            intensity=True,
            least_rings=MANY_RINGS,
        )

    @property
    def usual(self) -> UsualLabels:
        """Little noise, ground below the scanner, and things farther than a room is wide."""
        return UsualLabels(0.3, 0.6, ground_share=0.1, reach_m=6.0)

    @property
    def gives(self) -> frozenset[Label]:
        """No surfaces, curbs or stems."""
        return LABELS

    def scanner(self, first: ScanBlock) -> F64:
        """Return the beam directions."""
        return beams_of(first)

    def initial_state(self, scanner: F64) -> RingsState:
        """Return the state before the first block: no ground."""
        return RingsState(GroundPlane())

    def label(
        self,
        block: ScanBlock,
        scanner: F64,
        turn: Turn,
        wanted: Wanted,
    ) -> Sequence[LabelledBlock]:
        """Label a block, and its further returns by neighbouring shots of similar range."""
        check_block(
            block.range_m,
            block.next_m,
            len(scanner),
            self.params.lines_per_block,
            columns=", one column a ring",
            key="rings.lines_per_block",
        )
        limits = limits_of(scanner)
        xyz_m = coordinates_of(block, scanner)
        up = UP[self.params.up]

        def find(known: GroundPlane) -> tuple[tuple[Polar, Lowest], GroundPlane]:
            polar, low = find_plane(xyz_m, known, limits.ground, up)
            return (polar, low), low.plane

        polar, low = turn.hand_on(PLANE, find)
        plane = low.plane
        above_m = above_ground(polar, low, limits.ground)
        sunken = sunken_shots(polar, above_m, limits.sunken)
        # mirror images are no part of surfaces
        solid = polar.without(sunken)
        solid_m = np.where(sunken, np.float32(np.nan), above_m)
        marks = mark_shots(solid, solid_m, limits)
        range_m = block.range_m if block.frame is None else np.sqrt((xyz_m * xyz_m).sum(axis=2))
        lonely = lonely_shots(range_m, block.intensity, limits)
        cells = fill_cells(solid, solid_m, marks, lonely, limits.cells)
        cell_rules = label_cells(cells, sight_over(cells, scanner, plane, limits), limits)
        plants = low_plants(solid, solid_m, marks, limits)
        reasons = label_shots(above_m, marks, lonely, sunken, plants, cells, cell_rules, limits)
        labels = LABELS_BY_REASON[reasons]
        further = block.extra
        extra = label_extra_returns(
            block.range_m,
            labels,
            further.line,
            further.column,
            further.range_m,
            EXTRA_RETURN_M,
            EXTRA_RETURN_M,
        )
        if plane.up < 0 and block.beam_rad is not None:
            block = replace(block, beam_rad=upside_down(block.beam_rad))
        labelled = LabelledBlock(
            block,
            labels,
            extra,
            reasons=reasons if wanted.reasons else None,
            is_up_assumed=plane.is_both,
        )
        if wanted.stages:
            labelled = replace(labelled, above_m=above_m)
        if wanted.measures:
            labelled = replace(labelled, measures=measures_of(above_m, marks, cells))
        return (labelled,)

    def limits(self, block: ScanBlock) -> Limits:
        """Return the limits that a block is labelled by."""
        return limits_of(self.scanner(block))


def limits_of(beam_rad: F64) -> Limits:
    """Return the limits for a scanner with these beams, (M,) float64 [rad]."""
    return MANY if len(beam_rad) >= MANY_RINGS else FEW


def coordinates_of(block: ScanBlock, beam_rad: F64) -> F32:
    """Return the coordinates of a block's shots, (lines, M, 3) float32 [m]; NaN = missing.

    If the block has none, lines are assumed to be :data:`USUAL_STEP_RAD` apart.
    """
    if block.xyz_m is not None:
        xyz_m = block.xyz_m if block.frame is None else block.frame.own(block.xyz_m)
        return np.ascontiguousarray(xyz_m)
    azimuth = USUAL_STEP_RAD * (block.first_line + np.arange(block.n_lines))[:, None]
    across = block.range_m * np.abs(np.sin(beam_rad))
    height = -block.range_m * np.cos(beam_rad)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], axis=-1).astype(
        np.float32
    )


def upside_down(beam_rad: F64) -> F64:
    """Return beams from straight down where z points down, (M,) float64 [rad].

    >>> np.rad2deg(upside_down(np.deg2rad([80.0, -95.0]))).round(6).tolist()
    [100.0, -85.0]
    """
    return np.copysign(np.pi - np.abs(beam_rad), beam_rad)


def sight_over(
    cells: Cells,
    beam_rad: F64,
    plane: GroundPlane,
    limits: Limits,
) -> F64:
    """Return the height above the ground of the highest ring at every cell, (cells,) [m]."""
    place = (cells.where + 0.5) * limits.cells.cell_m - limits.cells.half_m
    if plane.turn is None:
        rise: Any = np.max(
            -plane.up * np.cos(beam_rad) / np.maximum(np.abs(np.sin(beam_rad)), 1e-3)
        )
    else:
        rise = _rise_of_leaning_ring(beam_rad, plane, np.arctan2(place[:, 1], place[:, 0]))
    sight: F64 = np.hypot(place[:, 0], place[:, 1]) * rise - plane.height_m
    return sight


def _rise_of_leaning_ring(beam_rad: F64, plane: GroundPlane, azimuth_rad: F64) -> F64:
    """Return metres up per metre of the highest ring, towards azimuths, if the scanner leans."""
    around = np.arange(-math.pi, math.pi, USUAL_STEP_RAD)
    from_down_rad = np.abs(beam_rad)
    outermost_rad = from_down_rad.min() if plane.up < 0 else from_down_rad.max()
    highest = math.pi / 2 - float(outermost_rad)
    flat = math.cos(highest)
    ring = np.stack(
        [flat * np.cos(around), flat * np.sin(around), np.full(len(around), -math.sin(highest))],
        axis=1,
    )
    x, y, z = (ring @ np.array(plane.turn).T).T
    azimuth = np.arctan2(y, x)
    rise = plane.up * z / np.maximum(np.hypot(x, y), 1e-3)
    order = np.argsort(azimuth)
    rises: F64 = np.interp(azimuth_rad, azimuth[order], rise[order], period=2 * math.pi)
    return rises


def measures_of(above_m: F32, marks: U8, cells: Cells) -> dict[str, NDArray[Any]]:
    """Return the measured quantities of every shot of a block, by names with their units."""
    return {
        "height above the ground [m]": above_m,
        "smooth along its ring": (marks & 1).astype(np.bool_),
        "on an upright surface": (marks & 4).astype(np.bool_),
        **{name: cells.of_shots(cells.measures[:, k]) for k, name in enumerate(MEASURES)},
    }
