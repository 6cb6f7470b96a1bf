"""The label of every shot, by a decision list (tests in a fixed order)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.classifiers.fused.ground import Ground, GroundParams
from prc_cli.classifiers.fused.neighbours import Neighbours
from prc_cli.classifiers.fused.plane import VOTE_LINES, ScanPlane
from prc_cli.classifiers.fused.strips import Standing, WallParams
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.thresholds_fused import DecisionThresholds, single
from prc_cli.core.types import F32, U8

NEVER = 1e9
"""A limit that no value reaches, for steps that are switched off."""


class NoiseParams(Params):
    """What is noise beside what is alone (``[fused.noise]``)."""

    spikes: bool = Field(True, description="whether a rough shot amid smooth ones is noise")
    spike_share: float = Field(
        0.65, ge=0, le=1, description="how smooth its surroundings are then, 0 = all rough, 1 = all smooth"
    )
    leaves: bool = Field(True, description="whether a lonely shot among rough ones is a leaf")
    leaf_slots: int = Field(
        4, ge=1, le=9, description="slots of 0.25 m around it, of 9, with rough shots in its strip and those beside"
    )
    held: bool = Field(
        True, description="whether a lonely shot with a smooth pair, in a wall or level with the ground is part of it"
    )
    ghosts: bool = Field(True, description="whether lonely rough shots far behind a wall, seen through it, are noise")
    ghost_m: float = Field(5.0, ge=0, le=100, description="they are farther behind it than this [m] ...")
    ghost_near: int = Field(6, ge=0, le=28, description="... and have fewer near neighbours, of 28")


class LeavesParams(Params):
    """What foliage is (``[fused.leaves]``)."""

    half_width_m: float = Field(0.35, gt=0, le=100, description="half width of the place whose smoothness counts [m]")
    share: float = Field(0.4, ge=0, le=1, description="places less smooth than this are foliage")
    share_before_walls: float = Field(0.2, ge=0, le=1, description="the same close before a wall")


class CarParams(Params):
    """Low things with level surfaces, that have no class (``[fused.cars]``)."""

    enabled: bool = Field(True, description="whether they are told from walls and hedges")
    top_m: float = Field(3.75, ge=0, le=15, description="what reaches above this is no car, in the scan plane [m]")
    level_bins: int = Field(3, ge=1, le=13, description="width of level surface within 1.5 m of it, of smooth things")
    level_bins_rough: int = Field(6, ge=1, le=13, description="the same of rough ones, as behind panes")


class PoleParams(Params):
    """Thin upright things: trunks below crowns, and poles, that have no class (``[fused.poles]``)."""

    enabled: bool = Field(True, description="whether they are told from walls")
    height_m: float = Field(1.0, gt=0, le=100, description="their part of a line is less high than this [m]")
    jump_m: float = Field(0.5, gt=0, le=100, description="range at which it ends [m]")
    far_m: float = Field(1.0, ge=0, le=100, description="what is seen beside them is so much farther, or nothing [m]")
    crown_slots: int = Field(5, ge=1, le=64, description="slots of 0.25 m with rough shots above them make them trunks")
    foot_m: float = Field(0.3, ge=0, le=10, description="lower shots, and lonely leaves, are not looked at [m]")


class VoteParams(Params):
    """The last word of the neighbours (``[fused.votes]``)."""

    enabled: bool = Field(True, description="whether shots take the label of most shots around them")
    half_width_m: float = Field(1.0, gt=0, le=100, description="half width of the place that votes [m]")
    near_m: float = Field(1.5, gt=0, le=100, description="its shots vote if this near to the side and in height [m]")


@stage("texture")
def texture_of(range_m: F32, seen: Neighbours, plane: ScanPlane, least_near: int, params: LeavesParams) -> F32:
    """Return the mean smoothness around every shot; see :func:`prc_cli.kernels.fused.classes.mean_smoothness`."""
    texture: F32 = kernels.mean_smoothness(
        range_m, seen.near, seen.smooth, plane.step_rad, np.float32(least_near), np.float32(params.half_width_m)
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
    """Label every shot of the lines; see :func:`prc_cli.kernels.fused.classes.fused_labels`.

    The first test that applies decides:

    1. isolated, and neither a leaf nor part of a surface: noise;
    2. a spike: noise;
    3. rough and far below the ground: noise;
    4. on the ground: ground;
    5. few near neighbours, rough and far behind a wall: noise;
    6. part of a low object with level surfaces (a car): unclassified;
    7. thin and upright: vegetation below a crown (a trunk), otherwise unclassified (a pole);
    8. in rough surroundings, and neither in a wall nor seen through its windows: vegetation;
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
) -> DecisionThresholds:
    """Return the thresholds of the decision; steps that are switched off get limits that no value reaches."""
    return single(
        DecisionThresholds,
        least_near=least_near,
        spike_share=noise.spike_share if noise.spikes else NEVER,
        below_m=ground.below_m,
        leaf_slots=noise.leaf_slots if noise.leaves else NEVER,
        walked_m=ground.walked_m,
        level_m=ground.level_m,
        soil_m=ground.soil_m,
        leaf_share=leaves.share,
        leaf_share_before_wall=leaves.share_before_walls,
        before_m=walls.before_m,
        front_m=walls.front_m,
        behind_m=walls.behind_m,
        over_m=walls.over_m,
        car_top_m=cars.top_m,
        car_bins=cars.level_bins if cars.enabled else NEVER,
        car_bins_rough=cars.level_bins_rough if cars.enabled else NEVER,
        pole_m=poles.height_m if poles.enabled else 0.0,
        jump_m=poles.jump_m,
        far_m=poles.far_m,
        crown_slots=poles.crown_slots,
        foot_m=poles.foot_m,
        keeps_held=1.0 if noise.held else 0.0,
        ghost_m=noise.ghost_m,
        ghost_near=noise.ghost_near if noise.ghosts else 0,
    )


@stage("votes")
def vote(labels: U8, range_m: F32, plane: ScanPlane, params: VoteParams) -> U8:
    """Give every shot the majority label of its surroundings; see :func:`prc_cli.kernels.fused.classes.vote_labels`."""
    if not params.enabled:
        return labels[VOTE_LINES:-VOTE_LINES]
    voted: U8 = kernels.vote_labels(
        labels, range_m, plane.beams, plane.step_rad, np.float32(params.half_width_m), np.float32(params.near_m)
    )
    return voted
