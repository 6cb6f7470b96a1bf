"""Label shots: the rules of :mod:`classes_loops`, a vote, and what only a wider window shows."""

from __future__ import annotations

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.classes_loops import MARGIN, fused_labels
from prc_cli.methods.fused.curbs_loops import curb_labels
from prc_cli.methods.fused.fans_loops import BINS, LINES, fan_cars
from prc_cli.methods.fused.ground import Ground
from prc_cli.methods.fused.noise_loops import leaves_amid_noise
from prc_cli.methods.fused.plane import VOTE_LINES, WIDE_LINES, ScanPlane
from prc_cli.methods.fused.records import Neighbours
from prc_cli.methods.fused.strips import Strips
from prc_cli.methods.fused.texture_loops import mean_smoothness
from prc_cli.methods.fused.thresholds import (
    CurbThresholds,
    DecisionThresholds,
    FanThresholds,
    LateLeafThresholds,
    Limits,
    Votes,
)
from prc_cli.methods.fused.votes_loops import vote_labels

ROOM_SHARE = 0.01
"""In a room a smaller share of the returns is as far away as streets are wide.

In streets a quarter is, and more.
"""
BESIDE_THIN_LINES = 33
"""Lines before and after a line in which something is seen past a trunk or a post."""


def is_room(range_m: F32, limits: Limits) -> bool:
    """Whether ranges, (lines, M) float32 [m], show a place that is too narrow for cars.

    >>> [is_room(np.full((9, 9), far_m, np.float32), Limits()) for far_m in (6, 7)]
    [True, False]
    """
    n_far = np.count_nonzero(range_m > np.float32(limits.room_m))
    n = np.count_nonzero(range_m == range_m)
    return bool(n_far < ROOM_SHARE * n)


CEILED_SHARE = 0.98
"""So many of the shots up meet a ceiling; the sky, and a street beside a bridge, answer fewer."""
CEILING_M = 1.5
"""A ceiling is at most so far above the scanner, where no vehicle goes under a bridge [m] ..."""
LOWEST_BRIDGE_M = 4.2
"""... or above the floor: bridges leave more room for lorries [m]."""


def has_ceiling(range_m: F32, plane: ScanPlane) -> bool:
    """Return whether the ranges, (lines, M) float32 [m], are those of a place indoors.

    Under a low ceiling.

    >>> plane = ScanPlane.of(np.deg2rad(np.linspace(-179.0, 180.0, 360)))
    >>> way = np.abs(plane.cosine).clip(0.2)
    >>> rooms = [np.where(plane.cosine > 0, 1.7, up)[None] / way for up in (1.0, 2.4, 3.5, np.nan)]
    >>> [has_ceiling(range_m, plane) for range_m in rooms]
    [True, True, False, False]
    """
    seen = range_m[~np.isnan(range_m).all(axis=1)]
    up = plane.cosine < -0.5
    down = plane.cosine > 0.9
    answered = ~np.isnan(seen[:, up])
    if not answered.size or answered.mean() < CEILED_SHARE:
        return False
    ceiling_m = -float(np.median((seen[:, up] * plane.cosine[up])[answered]))
    floors = (seen[:, down] * plane.cosine[down])[~np.isnan(seen[:, down])]
    return ceiling_m <= CEILING_M or (
        bool(floors.size) and ceiling_m + float(np.median(floors)) <= LOWEST_BRIDGE_M
    )


@stage("texture")
def texture_of(
    range_m: F32,
    neighbours: Neighbours,
    plane: ScanPlane,
    limits: Limits,
) -> F32:
    """Return the mean smoothness around every shot; see :func:`texture_loops.mean_smoothness`."""
    foliage = limits.foliage
    decision = limits.decision
    texture: F32 = mean_smoothness(
        range_m,
        neighbours.near,
        neighbours.smooth,
        plane.step_rad,
        decision.least_near,
        np.float32(foliage.half_width_m),
        foliage.thresholds(float(decision.leaf_share), float(plane.step_rad)),
    )
    return texture


@stage("classes")
def decide(
    window_m: F32,
    neighbours: Neighbours,
    ground: Ground,
    texture: F32,
    strips: Strips,
    plane: ScanPlane,
    thresholds: DecisionThresholds,
) -> U8:
    """Label every shot of the lines by the rules of :mod:`classes_loops`, in their order.

    ``window_m`` (lines + 2 n, M) float32, metres; ``texture`` and ``strips`` of the lines alone;
    all else of two more lines before and after; returns (lines, M) uint8,
    :class:`~prc_cli.core.classes.Reason`.
    """
    beside = (len(window_m) - len(texture)) // 2 - MARGIN
    labels: U8 = fused_labels(
        window_m[beside : len(window_m) - beside],
        ground.above_m,
        neighbours,
        ground.walked,
        texture,
        strips.slots,
        strips.walls,
        strips.levels,
        strips.kinds,
        plane.beams,
        plane.step_rad,
        thresholds,
    )
    return labels


@stage("votes")
def vote(
    labels: U8,
    range_m: F32,
    plane: ScanPlane,
    limits: Votes | None,
) -> U8:
    """Give every shot the majority label of its surroundings.

    See :func:`votes_loops.vote_labels`.
    """
    if limits is None:
        return labels[VOTE_LINES:-VOTE_LINES]
    voted: U8 = vote_labels(
        labels, range_m, plane.beams, plane.step_rad, limits.half_width_m, limits.near_m
    )
    return voted


@stage("leaves amid noise")
def find_late_leaves(
    decided: U8,
    voted: U8,
    range_m: F32,
    above_m: F32,
    plane: ScanPlane,
    limits: LateLeafThresholds,
) -> U8:
    """Label leaves among the noise; see :func:`noise_loops.leaves_amid_noise`.

    ``decided`` (lines + 2, M) uint8 and ``voted`` (lines, M) uint8, labels; ``range_m, above_m``
    (lines + 6, M) float32, metres; returns (lines, M) uint8.
    """
    inner = slice(WIDE_LINES + VOTE_LINES, -WIDE_LINES - VOTE_LINES)
    labels: U8 = leaves_amid_noise(
        decided, voted, range_m[WIDE_LINES:-WIDE_LINES], above_m[inner], plane.step_rad, limits
    )
    return labels


@stage("curbs")
def find_curbs(
    labels: U8,
    range_m: F32,
    above_m: F32,
    plane: ScanPlane,
    limits: CurbThresholds | None,
) -> U8:
    """Label the faces of curbs; see :func:`curbs_loops.curb_labels`."""
    if limits is None:
        return labels
    with_curbs: U8 = curb_labels(labels, range_m, above_m, plane.beams, plane.step_rad, limits)
    return with_curbs


def no_profiles() -> U8:
    """Return the marks before the first line."""
    return np.zeros((LINES, 2 * BINS), np.uint8)


def has_car_profiles(plane: ScanPlane, limits: Limits) -> bool:
    """Return whether cars are looked for in the profiles of a scanner's lines."""
    return float(plane.step_rad) >= limits.roof_step_rad


@stage("profiles")
def find_cars(
    labels: U8,
    range_m: F32,
    above_m: F32,
    texture: F32,
    n_lines: int,
    plane: ScanPlane,
    before: U8,
    thresholds: FanThresholds,
) -> tuple[U8, U8]:
    """Label cars by lines across their roofs; see :func:`fans_loops.fan_cars`.

    The first four are (lines + ahead, M); ``before`` (LINES, 2 BINS) uint8; returns the labels of
    ``n_lines`` lines, and the marks for the next block.
    """
    with_cars, after = fan_cars(
        labels, range_m, above_m, texture, plane.sine, plane.sides, before, n_lines, thresholds
    )
    return with_cars, after
