"""The label of every shot, by a decision list (tests in a fixed order)."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.classes import Label
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.ground import Ground, GroundParams
from prc_cli.methods.fused.neighbours import Neighbours
from prc_cli.methods.fused.plane import VOTE_LINES, ScanPlane
from prc_cli.methods.fused.strips import Standing, WallParams
from prc_cli.methods.fused.thresholds import DecisionThresholds, FanThresholds, typed

NO_BINS = 99
"""More bins than a level surface can have."""
ROOM_SHARE = 0.01
"""In a room a smaller share of the returns is as far away as streets are wide; in streets a quarter is, and more."""
BESIDE_THIN_LINES = 20
"""Lines before and after a line in which something is seen past a pole or a box."""
ACROSS_LINES = 4
"""Lines before and after a line by which a thing is found to be thin; at most :data:`BESIDE_THIN_LINES`."""
NEVER = 1e9
"""A limit that no value reaches, for steps that are switched off."""


class NoiseParams(Params):
    """Noise other than isolated shots, and isolated shots that are kept (``[fused.noise]``)."""

    spikes: bool = Field(True, description="whether a rough shot among smooth ones is noise")
    spike_share: float = Field(0.65, ge=0, le=1, description="least share of smooth pairs around it")
    pits: bool = Field(
        True, description="whether upright shots in company below the ground are no noise, but the side of a pit ..."
    )
    pit_near: int = Field(9, ge=0, le=28, description="... that is, with this many near neighbours, of 28")
    leaves: bool = Field(True, description="whether an isolated shot among rough ones is a leaf")
    leaf_slots: int = Field(
        4, ge=1, le=9, description="least number of cells of 0.25 m around it, of 9, that hold rough shots"
    )
    lone_leaves: bool = Field(True, description="whether a far shot without any near neighbour may be a leaf ...")
    lone_m: float = Field(5.0, ge=0, le=1e6, description="... beyond this range [m], as leaves are far apart there")
    held: bool = Field(
        True, description="whether a lonely shot with a smooth pair, in a wall or level with the ground is part of it"
    )
    ghosts: bool = Field(True, description="whether rough shots with few neighbours, seen far behind a wall, are noise")
    ghost_m: float = Field(5.0, ge=0, le=100, description="least distance behind the wall [m] ...")
    ghost_near: int = Field(
        6, ge=0, le=28, description="... and such shots have fewer near neighbours than this, of 28"
    )
    panes: bool = Field(
        True,
        description="whether shots with few neighbours and no smooth pair are noise behind a wall, and alone in a car",
    )
    spike_m: float = Field(
        0.05, ge=0, le=100, description="spikes nearer than this to the surface around are part of it [m]; 0 = none"
    )
    sparse: bool = Field(
        True, description="whether an isolated shot with more of its kind in a wider window is part of something ..."
    )
    sparse_shots: int = Field(3, ge=1, le=118, description="... with at least this many, of 118 shots, ...")
    sparse_share: float = Field(0.65, ge=0, le=1, description="... where a smaller share of the pairs is smooth ...")
    through_share: float = Field(
        0.25, ge=0, le=1, description="... and a smaller share of the window is on surfaces before it"
    )
    low_m: float = Field(
        0.2, ge=0, le=10, description="... or it is this near to the ground, and shots around are ground [m]; 0 = never"
    )
    mirrors: bool = Field(True, description="whether rough shots amid a car and farther than it are noise ...")
    mirror_m: float = Field(0.3, ge=0, le=100, description="... that is, by this much [m] ...")
    mirror_share: float = Field(
        0.7, ge=0, le=1, description="... with at least this share of car among the 24 shots on either side"
    )
    alone: bool = Field(
        True, description="whether a rough shot is noise that no other of 118 around is as far as, and none beyond ..."
    )
    alone_m: float = Field(0.1, ge=0, le=100, description="... as far: within this in range [m] ...")
    alone_gap_m: float = Field(0.75, ge=0, le=1000, description="... none beyond, or none before, within this [m] ...")
    alone_share: float = Field(0.25, ge=0, le=1, description="... where a greater share of the pairs is smooth")


class LeavesParams(Params):
    """Foliage: rough surroundings (``[fused.leaves]``)."""

    half_width_m: float = Field(0.35, gt=0, le=100, description="half width of the surroundings that are averaged [m]")
    share: float = Field(0.4, ge=0, le=1, description="surroundings with a smaller share of smooth pairs are foliage")
    share_before_walls: float = Field(0.2, ge=0, le=1, description="the same close in front of a wall")
    at_depth: bool = Field(
        True, description="whether rough surroundings are looked at again without what is nearer or farther ..."
    )
    depth_m: float = Field(1.0, gt=0, le=100, description="... by more than this [m] ...")
    depth_pairs: int = Field(
        3, ge=0, le=11, description="... around shots with this many smooth pairs; around all where columns are"
    )
    depth_step_deg: float = Field(0.2, ge=0, le=180, description="at least this far apart [deg]")

    def again(self, step_rad: float) -> tuple[np.float32, np.float32, np.float32]:
        """Return what the loop is given, for an angle between columns [rad]: a share, a distance and smooth pairs."""
        pairs = 0 if step_rad >= math.radians(self.depth_step_deg) else self.depth_pairs
        return np.float32(self.share if self.at_depth else 0.0), np.float32(self.depth_m), np.float32(pairs)


class CarParams(Params):
    """Cars: low objects with level surfaces (``[fused.cars]``)."""

    enabled: bool = Field(True, description="whether to separate them from walls and hedges")
    named: bool = Field(True, description="whether they get their class; otherwise they stay unclassified")
    top_m: float = Field(4.75, ge=0, le=15, description="objects higher than this, in the scan plane, are no cars [m]")
    lorry_top_m: float = Field(
        5.75, ge=0, le=15, description="the same where a body hangs as high as that of a lorry [m]"
    )
    level_bins: int = Field(4, ge=1, le=13, description="least width of level surface within 1.5 m of a smooth shot")
    level_bins_rough: int = Field(6, ge=1, le=13, description="the same for a rough shot, as behind panes")
    room_m: float = Field(
        6.0, ge=0, le=100, description="none are where less than 1 % of the returns around are farther: a room [m]"
    )
    roofs: bool = Field(
        True, description="whether they are also found by lines across their roofs, where columns are far apart ..."
    )
    roof_step_deg: float = Field(0.2, ge=0, le=90, description="... by at least this angle [deg]")
    roof_least_m: float = Field(1.2, ge=0, le=100, description="least height of a roof [m]; hedges are often lower")
    roof_most_m: float = Field(2.0, ge=0, le=100, description="greatest height of a roof [m]")
    roof_smooth: float = Field(
        0.5, ge=0, le=1, description="least share of smooth pairs on such a line; plants have less"
    )
    roof_share: float = Field(
        0.5, ge=0, le=1, description="least share of such lines, or lines with a car, among 12 to either side"
    )

    def in_rooms(self) -> CarParams:
        """Return the parameters for a room, where no car is found."""
        own = {"level_bins": NO_BINS, "level_bins_rough": NO_BINS, "roof_share": NEVER}
        return self.model_copy(update=own)

    def is_room(self, range_m: F32) -> bool:
        """Return whether ranges, (lines, M) float32 [m], are those of a place that is too narrow for cars.

        >>> params = CarParams()
        >>> params.is_room(np.full((9, 9), 5, np.float32)), params.is_room(np.full((9, 9), 7, np.float32))
        (True, False)
        """
        n_far, n = np.count_nonzero(range_m > np.float32(self.room_m)), np.count_nonzero(range_m == range_m)
        return bool(n_far < ROOM_SHARE * n)

    def roof_thresholds(self) -> FanThresholds:
        """Return what the loop that looks for roofs is given."""
        return typed(
            FanThresholds,
            least_m=self.roof_least_m,
            most_m=self.roof_most_m,
            smooth=self.roof_smooth,
            share=self.roof_share,
            label=Label.CAR if self.named else Label.UNCLASSIFIED,
        )


class PoleParams(Params):
    """Thin upright objects: trunks below crowns, and poles (``[fused.poles]``)."""

    enabled: bool = Field(True, description="whether to separate them from walls")
    named: bool = Field(True, description="whether poles get their class; otherwise they stay unclassified")
    height_m: float = Field(1.0, gt=0, le=100, description="their runs of a line are less high than this [m]")
    jump_m: float = Field(0.5, gt=0, le=100, description="difference in range that ends a run [m]")
    far_m: float = Field(
        1.0, ge=0, le=100, description="shots beside them are farther by more than this, or missing [m]"
    )
    crown_slots: int = Field(
        5, ge=1, le=64, description="cells of 0.25 m with rough shots above a pole that make it a trunk"
    )
    shots: int = Field(6, ge=1, le=1000, description="fewest shots of its run; leaves and bars of fences have fewer")
    trunks: bool = Field(True, description="whether what is thick and round is a trunk, crown or not ...")
    thick_m: float = Field(
        0.15, ge=0, le=100, description="... that is, this deep from the middle of its front to its edges [m]"
    )
    arms: bool = Field(True, description="whether thin level things high up are poles too: arms and lamps ...")
    arm_m: float = Field(3.0, ge=0, le=100, description="... that is, above this height [m]")
    boxes: bool = Field(True, description="whether small things with level tops are poles too: bins and cabinets ...")
    box_m: float = Field(2.0, ge=0, le=15, description="... that is, lower than this, in the scan plane [m] ...")
    box_flat_m: float = Field(
        0.25, ge=0, le=100, description="... with tops as deep as this at least; those of garden walls are less [m] ..."
    )
    box_deep_m: float = Field(0.75, ge=0, le=100, description="... themselves as deep as this at most [m] ...")
    box_lines: int = Field(16, ge=0, le=40, description="... and seen by so many other lines, at most")
    beside_cars: bool = Field(True, description="whether what is narrow in other lines too may stand beside a car")
    across: bool = Field(True, description="whether lines close by must see past a pole, as they do not past a fence")
    foot_m: float = Field(0.3, ge=0, le=10, description="lower shots are neither poles nor isolated leaves [m]")


class VoteParams(Params):
    """Final majority vote among neighbouring shots (``[fused.votes]``)."""

    enabled: bool = Field(True, description="whether shots take the majority label around them")
    half_width_m: float = Field(1.0, gt=0, le=100, description="half width of the voting surroundings [m]")
    near_m: float = Field(1.5, gt=0, le=100, description="shots vote if this near to the side and in height [m]")


@stage("texture")
def texture_of(range_m: F32, seen: Neighbours, plane: ScanPlane, least_near: int, params: LeavesParams) -> F32:
    """Return the mean smoothness around every shot; see :func:`texture_loops.mean_smoothness`."""
    again = params.again(float(plane.step_rad))
    texture: F32 = kernels.mean_smoothness(
        range_m, seen.near, seen.smooth, plane.step_rad, np.float32(least_near), np.float32(params.half_width_m), again
    )
    return texture


@stage("classes")
def decide(
    window_m: F32,
    seen: Neighbours,
    ground: Ground,
    texture: F32,
    standing: Standing,
    plane: ScanPlane,
    thresholds: DecisionThresholds,
) -> U8:
    """Label every shot of the lines; see :func:`classes_loops.fused_labels`.

    The first test that applies decides:

    1. isolated, and neither a leaf nor part of a surface: noise;
    2. a spike: noise;
    3. rough and far below the ground, and not the side of a pit: noise;
    4. on the ground: ground;
    5. few near neighbours behind a wall, and either no smooth pair, or rough and far behind it: noise; so is what is
       isolated in a car without a smooth pair;
    6. part of a low object with level surfaces: car;
    7. thin and upright, or thin and high above the ground: vegetation below a crown or where it is thick (a trunk),
       otherwise pole; so is what is small to all sides and has a level top, whatever it was so far: bins, cabinets;
    8. in rough surroundings, and neither in or above a wall nor seen through its windows: vegetation;
    9. otherwise: building.
    """
    labels: U8 = kernels.fused_labels(
        window_m, ground.above_m, seen.counts, ground.walked, texture, standing.slots, standing.walls,
        standing.levels, plane.beams, plane.step_rad, thresholds,
    )  # fmt: skip
    return labels


def decision_thresholds(
    least_near: int,
    ground: GroundParams,
    walls: WallParams,
    noise: NoiseParams,
    leaves: LeavesParams,
    cars: CarParams,
    poles: PoleParams,
    across_lines: int = ACROSS_LINES,
) -> DecisionThresholds:
    """Return the thresholds of the decision; steps that are switched off get limits that no value reaches."""
    return typed(
        DecisionThresholds,
        least_near=least_near,
        spike_share=noise.spike_share if noise.spikes else NEVER,
        below_m=ground.below_m,
        pit_near=noise.pit_near if noise.pits else NEVER,
        leaf_slots=noise.leaf_slots if noise.leaves else NEVER,
        lone_m=noise.lone_m if noise.leaves and noise.lone_leaves else NEVER,
        walked_m=ground.walked_m,
        level_m=ground.level_m,
        soil_m=ground.soil_m,
        leaf_share=leaves.share,
        leaf_share_before_wall=leaves.share_before_walls,
        before_m=walls.before_m,
        front_m=walls.front_m,
        behind_m=walls.behind_m,
        over_m=walls.over_m,
        roof_m=walls.roof_m if walls.roofs else -NEVER,
        storey_m=walls.storey_m,
        car_top_m=cars.top_m,
        lorry_top_m=cars.lorry_top_m,
        car_bins=cars.level_bins if cars.enabled else NEVER,
        car_bins_rough=cars.level_bins_rough if cars.enabled else NEVER,
        pole_m=poles.height_m if poles.enabled else 0.0,
        jump_m=poles.jump_m,
        far_m=poles.far_m,
        across_lines=across_lines,
        crown_slots=poles.crown_slots,
        pole_shots=poles.shots,
        thick_m=poles.thick_m if poles.trunks else NEVER,
        arm_m=poles.arm_m if poles.arms else NEVER,
        box_m=poles.box_m if poles.enabled and poles.boxes else 0.0,
        box_flat_m=poles.box_flat_m,
        box_deep_m=poles.box_deep_m,
        box_lines=poles.box_lines,
        keeps_parts=0.0 if poles.beside_cars else 1.0,
        takes_long=0.0 if poles.across else 1.0,
        foot_m=poles.foot_m,
        keeps_held=1.0 if noise.held else 0.0,
        ghost_m=noise.ghost_m,
        ghost_near=noise.ghost_near if noise.ghosts else 0,
        pane_m=walls.behind_m if noise.panes else NEVER,
        cabin_near=least_near if noise.panes else 0,
        car_label=Label.CAR if cars.named else Label.UNCLASSIFIED,
        pole_label=Label.POLE if poles.named else Label.UNCLASSIFIED,
    )


@stage("votes")
def vote(labels: U8, range_m: F32, plane: ScanPlane, params: VoteParams) -> U8:
    """Give every shot the majority label of its surroundings; see :func:`votes_loops.vote_labels`."""
    if not params.enabled:
        return labels[VOTE_LINES:-VOTE_LINES]
    voted: U8 = kernels.vote_labels(
        labels, range_m, plane.beams, plane.step_rad, np.float32(params.half_width_m), np.float32(params.near_m)
    )
    return voted
