"""Random arguments for the loops of the fused classifier.

Small streets of ground, walls, leaves and stray points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.fused import ground_loops as fused_ground
from prc_cli.methods.fused import neighbours_loops as fused_neighbours
from prc_cli.methods.fused import strips_loops as fused_strips
from prc_cli.methods.fused.confidence import MEASURES
from prc_cli.methods.fused.records import (
    Beams,
    FilledSlots,
    GroundMemory,
    Neighbours,
    Sides,
    StripSums,
    WalkMemory,
    WalkStart,
    Walls,
)
from prc_cli.methods.fused.thresholds import (
    ChordThresholds,
    ColumnThresholds,
    CurbThresholds,
    DecisionThresholds,
    DepthThresholds,
    FanThresholds,
    FlankThresholds,
    LateLeafThresholds,
    NearThresholds,
    SmoothThresholds,
    SpacingThresholds,
    StripThresholds,
    WalkThresholds,
    WallThresholds,
)
from tests.loops.twins import typed

AROUND = 4
INNER = 2
THIN = 20
USUAL = DecisionThresholds()
"""The limits of the program itself; cases scale them."""


@dataclass
class Street:
    """A window of ranges and what there is to know of its beams."""

    window: F32
    sine: F32
    cosine: F32
    step: np.float32
    left: I32
    right: I32

    @property
    def range_m(self) -> F32:
        return np.ascontiguousarray(self.window[INNER:-INNER])

    @property
    def window_and_beams(self) -> tuple[F32, F32, F32, np.float32]:
        return self.window, self.sine, self.cosine, self.step

    @property
    def beams(self) -> Beams:
        return Beams(self.sine, self.cosine)

    def points(self) -> tuple[F32, F32]:
        side, height = fused_neighbours.plane_points(self.range_m, self.sine, self.cosine)
        return side, height


def street(rng: Generator) -> Street:
    """Ground, walls to the sides, a thing in between, leaves that stray, missing shots.

    On a grid that makes ties.
    """
    n_lines = int(rng.integers(1, 4)) + 2 * AROUND
    m = int(rng.integers(1, 28))
    first, last = ((-2.2, 2.2), (3.0, 0.05), (0.1, 1.9))[rng.integers(3)]
    angle = np.linspace(first, last, m) if m > 1 else np.array([first])
    sine = np.sin(angle)
    cosine = np.cos(angle)
    with np.errstate(divide="ignore"):
        ranges = np.where(cosine > 0, 2.0 / cosine, np.inf)
        for place in rng.choice([-9.0, -6.0, -2.5, 2.0, 5.0, 85.0], int(rng.integers(0, 4))):
            ranges = np.minimum(ranges, np.where(sine * place > 0, place / sine, np.inf))
    ranges = np.tile(np.where(ranges < 90, ranges, np.nan), (n_lines, 1))
    ranges += rng.normal(0, rng.choice([0.0, 0.003, 0.3]), ranges.shape) * (
        rng.random(ranges.shape) < 0.7
    )
    if rng.random() < 0.3:
        ranges = np.round(ranges * 8) / 8
    strays = rng.random(ranges.shape) < rng.choice([0.0, 0.05, 0.4])
    ranges = np.where(strays, rng.choice([1.5, 4.0, 4.25, 30.0], ranges.shape), ranges)
    ranges[rng.random(ranges.shape) < rng.choice([0.0, 0.1, 0.6, 1.0], p=[0.4, 0.3, 0.2, 0.1])] = (
        np.nan
    )
    window = np.maximum(ranges, 0.3).astype(np.float32)
    outwards = np.argsort(np.abs(angle), kind="stable").astype(np.int32)
    positive = angle[outwards] >= 0
    step = np.float32(abs(last - first) / max(m - 1, 1))
    return Street(
        window,
        sine.astype(np.float32),
        cosine.astype(np.float32),
        step,
        outwards[positive].copy(),
        outwards[~positive].copy(),
    )


def points_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    return scene.window, scene.sine, scene.cosine


def near_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    chosen = typed(
        NearThresholds,
        near_m=rng.choice([0.4, 0.125, 2.0]),
        near_steps=rng.choice([0.0, 3.0]),
        thin_m=0.1,
        along_m=1.0,
        along_steps=rng.choice([0.0, 8.0]),
    )
    return *scene.window_and_beams, chosen


def smooth_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    chosen = typed(
        SmoothThresholds,
        tolerance_m=rng.choice([0.0, 0.006, 0.2]),
        tolerance_per_m=rng.choice([0.0, 0.01]),
        gap_m=rng.choice([0.4, 5.0]),
        apart_m=rng.choice([0.0, 0.5, 1.0, 3.0]),
        leaf_m=rng.choice([0.0, 1.0, 4.0]),
    )
    return *scene.window_and_beams, chosen


def repeats_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    lines = scene.window
    stride = int(rng.integers(1, 20))
    shape = (int(rng.integers(17, 30)), scene.window.shape[1])
    # the same leaves in several lines, some of them lost
    leaves = np.float32(5) + rng.integers(0, 20, (shape[0] // stride + 1, shape[1])).astype(
        np.float32
    ) / np.float32(8)
    range_m = np.repeat(leaves, stride, axis=0)[: shape[0]] + rng.choice(
        [0, 0, 0.0625], shape
    ).astype(np.float32)
    range_m[rng.random(shape) < 0.1] = np.nan
    range_m[: len(lines)] = np.where(rng.random() < 0.5, range_m[: len(lines)], lines[: shape[0]])
    chosen = typed(
        SpacingThresholds,
        tolerance_m=rng.choice([0.03, 0.0625, 0.2]),
        tolerance_per_m=rng.choice([0.0, 0.01]),
        near_m=rng.choice([1.5, 0.5]),
    )
    return np.ascontiguousarray(range_m, np.float32), int(rng.integers(0, 4)), chosen


def random_counts(rng: Generator, scene: Street) -> Neighbours:
    """Counts as neighbours have them, or any."""
    shape = scene.range_m.shape
    if rng.random() < 0.5:
        near, smooth, upright, level = (
            rng.integers(0, n, shape).astype(np.uint8) for n in (29, 11, 4, 4)
        )
        for counts in (near, smooth, upright, level):
            counts[np.isnan(scene.range_m)] = 0
        return Neighbours(near, smooth, upright, level)
    near = fused_neighbours.near_counts(
        *scene.window_and_beams,
        typed(NearThresholds, near_m=0.4, near_steps=3, thin_m=0.1, along_m=1, along_steps=8),
    )
    smooth = fused_neighbours.smooth_counts(
        *scene.window_and_beams,
        typed(
            SmoothThresholds,
            tolerance_m=0.006,
            tolerance_per_m=0.01,
            gap_m=0.4,
            gap_steps=16,
            apart_m=0.5,
        ),
    )
    usual = typed(ChordThresholds, chord_m=0.15, slope=0.35, slack_m=0.02, longest_m=2)
    chords = fused_neighbours.directions(scene.range_m, smooth, *scene.beams, scene.step, usual)
    return Neighbours(near, smooth, *chords)


def directions_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    chosen = typed(
        ChordThresholds,
        chord_m=rng.choice([0.15, 2.0, 20.0]),
        slope=rng.choice([0.35, 0.0]),
        slack_m=rng.choice([0.02, 0.0]),
        longest_m=5.0,
    )
    return scene.range_m, random_counts(rng, scene)[1], *scene.beams, scene.step, chosen


def walk_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    # ledges and roofs that were taken for the ground lie above it
    memory = rng.normal(rng.choice([-2.0, -1.0]), 0.2, (2, fused_ground.BINS)).astype(np.float32)
    age = rng.choice([0, 3, 60, 1000], (2, fused_ground.BINS)).astype(np.int32)
    if rng.random() < 0.5:
        age[:] = 1000
    chosen = typed(
        WalkThresholds,
        least_near=3,
        step_m=rng.choice([0.14, 1.0]),
        slope=0.3,
        slope_reach_m=0.5,
        gap_slope=rng.choice([0.0, 0.08]),
        known_m=0.15,
        memory_lines=rng.choice([0, 5, 60]),
        follow=0.4,
        start_reach_m=rng.choice([0.0, 1.0, 10.0]),
    )
    keep = int(rng.integers(0, len(scene.range_m) + 1))
    start = np.float32(rng.choice([-2.0, 0.0]))
    lost = int(rng.choice([-1, 0, 5, fused_ground.LOST_LINES - 2]))
    shots = np.zeros((2, fused_ground.DEPTHS), np.float32)
    if lost not in (0, -1):
        shots[:, 12:26] = np.sort(rng.integers(0, 9, (2, 14)), axis=0)
    sums = (shots * np.float32(-1.9)).astype(np.float32)
    sides = Sides(scene.left, scene.right)
    counts = random_counts(rng, scene)
    known = GroundMemory(
        WalkMemory(memory, age, shots, sums),
        WalkStart(float(start), lost, int(rng.integers(0, 8))),
    )
    return (
        scene.range_m,
        scene.beams,
        counts,
        sides,
        known,
        keep,
        chosen,
    )


def heights(rng: Generator, scene: Street) -> F32:
    """Heights above ground that is level, or where it may be."""
    above: F32 = (scene.points()[1] + rng.choice([2.0, 1.5, 5.0])).astype(np.float32)
    return above


def kinds(rng: Generator, shape: tuple[int, ...]) -> U8:
    """Things that stand alone, of any kind, in runs along the lines."""
    wide = (shape[0], -(-shape[1] // 8))
    is_thing = rng.random(wide) < rng.choice([0.0, 0.6])
    of_runs = np.where(is_thing, rng.integers(0, 7, wide), 0).astype(np.uint8)
    of_shots = of_runs.repeat(8, axis=1)[:, : shape[1]]
    return np.where(rng.random(shape) < 0.1, 0, of_shots).astype(np.uint8)


def strips_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    above = heights(rng, scene)
    smooth = rng.choice([3, 0])
    level = rng.choice([6, 2, 0])
    chosen = typed(
        StripThresholds,
        least_near=3,
        foot_m=rng.choice([0.15, 0.0]),
        rough=2,
        smooth=smooth,
        level_smooth=level,
        level_top_m=rng.choice([3.4, 0.5]),
        jump_m=rng.choice([1.0, 9.0]),
    )
    columns = kinds(rng, above.shape)
    return scene.range_m, above, random_counts(rng, scene), columns, scene.beams, scene.step, chosen


def columns_case(rng: Generator) -> tuple[Any, ...]:
    """Return lines with round and flat things of several widths before a wall, stray shots and
    gaps."""
    n_lines = int(rng.integers(3, 9))
    around = int(rng.integers(2, 12))
    m = 40
    beam = np.linspace(0.4, 2.2, m)
    window = np.full((n_lines + 2 * around, m), 9.0) + rng.choice([0.0, 0.3]) * rng.random(
        (n_lines + 2 * around, m)
    )
    for _ in range(int(rng.integers(1, 4))):
        first = int(rng.integers(0, len(window)))
        wide = int(rng.integers(1, 9))
        column = int(rng.integers(0, m - 12))
        lines = np.arange(first, min(first + wide, len(window)))
        off = (lines - first - (wide - 1) / 2) / (wide / 2)
        bulge = rng.choice([0.0, 0.1, 0.2, 0.9]) * (1 - np.sqrt(1 - off**2))
        window[lines, column : column + int(rng.integers(4, 30))] = (
            rng.choice([3.0, 7.0, 8.4]) + bulge
        )[:, None]
    window[rng.random(window.shape) < rng.choice([0.0, 0.01, 0.1])] = rng.choice(
        [np.nan, 2.0, 30.0]
    )
    window = (window / np.sin(beam)).astype(np.float32)
    beams = Beams(np.sin(beam).astype(np.float32), np.cos(beam).astype(np.float32))
    above = (np.float32(2) - window[around : len(window) - around] * beams[1]).astype(np.float32)
    odd = rng.random(above.shape) < rng.choice([0.0, 0.02, 0.2])
    counts = Neighbours(
        np.where(odd, 1, 9).astype(np.uint8),
        np.where(odd, 2, 7).astype(np.uint8),
        np.where(odd, 0, 3).astype(np.uint8),
        np.zeros(odd.shape, np.uint8),
    )
    chosen = typed(
        ColumnThresholds,
        lines=rng.choice([3, 8, 60]),
        foot_m=rng.choice([0.3, -9.0]),
        shots=rng.choice([1, 6]),
        share=rng.choice([0.2, 0.8]),
        tall_m=rng.choice([0.2, 1.0]),
        low_m=rng.choice([0.6, 3.0]),
        thin_lines=rng.choice([1, 5]),
        small_lines=rng.choice([1, 7]),
        small_share=rng.choice([0.2, 0.7]),
        small_m=rng.choice([0.1, 0.7, 3.0]),
        person_m=rng.choice([0.5, 1.5]),
        post_m=rng.choice([0.12, 1.0]),
        post_tall_m=rng.choice([0.1, 0.4]),
        post_top_m=rng.choice([0.6, 1.25]),
        reach=rng.choice([1, 2]),
        slim_lines=rng.choice([1, 4]),
        piece_lines=rng.choice([3, 24]),
        high_m=rng.choice([0.0, 1.2, 2.2]),
    )
    return window, above, counts, beams, chosen


def slots_case(rng: Generator) -> tuple[Any, ...]:
    slots = rng.integers(0, 2**63, (int(rng.integers(5, 8)), fused_strips.STRIPS), np.uint64)
    slots[rng.random(slots.shape) < rng.choice([0.3, 0.9, 1.0])] = 0
    return (slots,)


def levels_case(rng: Generator) -> tuple[Any, ...]:
    shape = int(rng.integers(5, 8)), 2 * fused_strips.STRIPS
    return ((rng.random(shape) < rng.choice([0.0, 0.1, 0.5])).astype(np.uint8),)


def walls_case(rng: Generator) -> tuple[Any, ...]:
    if rng.random() < 0.5:
        sums = fused_strips.fill_strips(*strips_case(rng))[1]
    else:
        shape = int(rng.integers(5, 8)), fused_strips.STRIPS
        is_filled = rng.random(shape) < rng.choice([0.0, 0.01, 0.1])
        length = np.where(is_filled, rng.random(shape) * 4, 0).astype(np.float32)
        wall = np.where(rng.random(shape) < 0.7, length, 0).astype(np.float32)
        middle = (np.arange(shape[1]) - shape[1] // 2 + np.float32(0.5)) * np.float32(0.5)
        top = np.where(wall > 0, rng.random(shape) * 9, fused_strips.NO_TOP).astype(np.float32)
        sums = StripSums(length, wall, (wall * middle).astype(np.float32), top)
    flanks = (
        rng.random((len(sums.length_m) - 4, fused_strips.STRIPS)) < rng.choice([0.0, 0.3])
    ).astype(np.uint8)
    chosen = typed(
        WallThresholds,
        height_m=rng.choice([0.01, 0.5, 1.5]),
        share=rng.choice([0.0, 0.3, 1.0]),
        lines=rng.choice([0, 2, 4, 5]),
        before_m=1.6,
    )
    return sums, flanks, chosen


def flanks_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    above = heights(rng, scene)
    counts = random_counts(rng, scene)
    if rng.random() < 0.5:
        above[(rng.random(above.shape) < 0.5) & ~np.isnan(above)] = 0
    shape = len(above), fused_strips.STRIPS
    wall = np.where(rng.random(shape) < rng.choice([0.01, 0.1]), rng.random(shape), 0).astype(
        np.float32
    )
    middle = (np.arange(shape[1]) - shape[1] // 2 + rng.random(shape)).astype(
        np.float32
    ) * np.float32(0.5)
    levels = (
        rng.random((len(above) - 4, 2 * fused_strips.STRIPS)) < rng.choice([0.0, 0.1])
    ).astype(np.uint8)
    every = rng.integers(0, 2**63, shape, np.uint64) << np.uint64(rng.choice([0, 3, 6]))
    chosen = typed(
        FlankThresholds,
        least_m=rng.choice([0.0, 0.1]),
        most_m=rng.choice([0.3, 3.0]),
        share=rng.choice([0.0, 0.5]),
        low_m=rng.choice([0.1, 0.0]),
        sill_m=rng.choice([0.5, 1.0]),
        body_m=rng.choice([0.75, 3.0, 0.0]),
        large_m=rng.choice([0.0, 0.5]),
        high_m=rng.choice([1.5, 3.0, -1.0]),
        soil_m=rng.choice([0.1, 2.0]),
        shots=rng.choice([0, 1, 3]),
    )
    length = wall * rng.choice([1.0, 2.0, 3.0], shape).astype(np.float32)
    return (
        scene.range_m,
        above,
        counts[2],
        scene.beams,
        StripSums(length, wall, wall * middle, np.zeros(shape, np.float32)),
        every,
        levels,
        chosen,
    )


def texture_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    near, smooth = random_counts(rng, scene)[:2]
    half = np.float32(rng.choice([0.35, 5.0, 0.0]))
    chosen = typed(
        DepthThresholds,
        share=rng.choice([0.0, 0.4, 2.0]),
        depth_m=rng.choice([0.2, 1.0, 1e9]),
        pairs=rng.choice([0, 2]),
    )
    return scene.range_m, near, smooth, scene.step, np.float32(rng.choice([0, 3])), half, chosen


def decision(rng: Generator) -> DecisionThresholds:
    """Numbers of the decision, near to those that are used, some of them off."""
    chosen = np.array(USUAL) * rng.choice([1.0, 1.0, 0.3, 2.0], len(USUAL))
    chosen[rng.random(len(USUAL)) < 0.05] = rng.choice([0.0, 1e9])
    thresholds = DecisionThresholds._make(np.float32(value) for value in chosen)
    top_m = min(thresholds.car_top_m, np.float32(15.0))
    lorry_m = min(thresholds.lorry_top_m, np.float32(15.0))
    flat_m = np.float32(rng.choice([0.25, 0.0]))
    deep_m = np.float32(rng.choice([0.75, 5.0]))
    thick_m = np.float32(rng.choice([0.15, 0.02]))
    thresholds = thresholds._replace(box_flat_m=flat_m, box_deep_m=deep_m, thick_m=thick_m)
    return thresholds._replace(car_top_m=top_m, lorry_top_m=lorry_m)


def box_case(rng: Generator) -> tuple[Any, ...]:
    """A bin or cabinet on level ground beside the scanner, a few lines wide, with some shots that
    stray."""
    m = 60
    n_lines = int(rng.integers(1, 6))
    first = THIN - int(rng.integers(0, 3))
    angle = np.linspace(0.95, 1.4, m) * rng.choice([-1.0, 1.0])
    sine = np.sin(angle)
    cosine = np.cos(angle)
    lid = rng.choice([0.8, 1.0]) / cosine
    away = lid * np.abs(sine) - 3.0
    is_lid = (away > 0) & (away < rng.choice([0.3, 0.5, 1.0]))
    is_face = (away <= 0) & (3.0 / np.abs(sine) < 2.0 / cosine)
    box = np.where(is_lid, lid, np.where(is_face, 3.0 / np.abs(sine), 2.0 / cosine))
    window = np.tile(2.0 / cosine, (2 * THIN + n_lines, 1))
    window[first : first + int(rng.integers(1, 9))] = box
    window[rng.random(window.shape) < rng.choice([0.0, 0.02])] = rng.choice([1.5, 8.0, np.nan])
    window = window.astype(np.float32)
    ranges = window[THIN - INNER : INNER - THIN]
    shape = (n_lines + 2 * INNER, m)
    sines = sine.astype(np.float32)
    cosines = cosine.astype(np.float32)
    above = (np.float32(2) - ranges * cosines).astype(np.float32)
    level = is_lid | (np.abs(above) < 0.1)
    odd = rng.random(shape) < rng.choice([0.0, 0.1])
    counts = Neighbours(
        np.where(odd, 2, 20).astype(np.uint8),
        np.where(odd, 1, 9).astype(np.uint8),
        np.where(level, 0, 3).astype(np.uint8),
        np.where(level, 3, 0).astype(np.uint8),
    )
    strips = np.zeros((n_lines, fused_strips.STRIPS), np.uint64)
    no_wall = np.zeros((n_lines, fused_strips.STRIPS), np.float32)
    chosen = USUAL._replace(
        far_m=np.float32(rng.choice([0.5, 1.0])),
        box_deep_m=np.float32(rng.choice([0.4, 0.75])),
        box_lines=np.float32(rng.choice([2, 16])),
    )
    return (
        window,
        above,
        counts,
        np.zeros(shape, np.bool_),
        np.ones((n_lines, m), np.float32),
        FilledSlots(strips, strips),
        Walls(no_wall, no_wall, no_wall),
        np.zeros((n_lines, 2 * fused_strips.STRIPS), np.uint8),
        np.zeros((n_lines, m), np.uint8),
        Beams(sines, cosines),
        np.float32(0.0076),
        chosen,
    )


def labels_case(rng: Generator) -> tuple[Any, ...]:
    if rng.random() < 0.3:
        return box_case(rng)
    scene = street(rng)
    counts = random_counts(rng, scene)
    above = heights(rng, scene)
    m = scene.range_m.shape[1]
    n_lines = len(scene.range_m) - 2 * INNER
    walked: Mask = (rng.random(above.shape) < 0.2) & ~np.isnan(above)
    slots, sums, levels = fused_strips.fill_strips(
        scene.range_m,
        above,
        counts,
        alone := kinds(rng, above.shape),
        scene.beams,
        scene.step,
        typed(
            StripThresholds,
            least_near=3,
            foot_m=0.15,
            rough=2,
            smooth=3,
            level_smooth=rng.choice([6, 3]),
            level_top_m=3.4,
            jump_m=1,
        ),
    )
    wide = FilledSlots(
        fused_strips.widen_slots(slots.by_any), fused_strips.widen_slots(slots.by_rough)
    )
    walls = fused_strips.find_walls(
        sums,
        np.zeros((n_lines, fused_strips.STRIPS), np.uint8),
        typed(
            WallThresholds,
            height_m=rng.choice([0.1, 1.5]),
            share=0.3,
            lines=rng.choice([0, 4]),
            before_m=1.6,
        ),
    )
    texture = rng.choice([0.0, 0.1, 0.3, 0.5, 1.0], (n_lines, m)).astype(np.float32)
    more = rng.integers(0, len(scene.window), (2, THIN - AROUND))
    cars = fused_strips.widen_levels(levels)
    cars |= ((rng.random(cars.shape) < rng.choice([0.0, 0.3])) * np.uint8(17)).astype(np.uint8)
    window = np.concatenate([scene.window[more[0]], scene.window, scene.window[more[1]]])
    return (
        window,
        above,
        counts,
        walked,
        texture,
        wide,
        walls,
        cars,
        alone[INNER:-INNER],
        scene.beams,
        scene.step,
        decision(rng),
    )


def vote_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    range_m = scene.range_m
    labels = rng.choice(
        [1, 2, 3, 4, 5, 7, 11], range_m.shape, p=[0.1, 0.1, 0.1, 0.25, 0.25, 0.1, 0.1]
    ).astype(np.uint8)
    if rng.random() < 0.5:
        labels[:, : labels.shape[1] // 2] = 4
    labels[np.isnan(range_m)] = 0
    half = np.float32(rng.choice([0.0, 0.8, 8.0]))
    near = np.float32(rng.choice([0.1, 2.0]))
    return labels, range_m, scene.beams, scene.step, half, near


def curb_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    above = heights(rng, scene)
    labels = rng.choice([1, 2, 3, 4, 5, 7], above.shape, p=[0.05, 0.1, 0.6, 0.1, 0.1, 0.05]).astype(
        np.uint8
    )
    labels[np.isnan(above)] = 0
    chosen = typed(
        CurbThresholds,
        least_m=rng.choice([0.05, 0.01]),
        most_m=rng.choice([0.25, 2.0, 9.0]),
        reach_m=rng.choice([0.4, 3.0]),
        half_m=rng.choice([0.08, 0.5]),
        share=rng.choice([0.0, 0.6]),
        margin=rng.choice([0.0, 0.2]),
        steep=rng.choice([0.0, 1.5]),
    )
    return labels, scene.range_m, above, scene.beams, scene.step, chosen


def late_leaf_case(rng: Generator) -> tuple[Any, ...]:
    """Labels and ranges of lines with one more before and after than the block."""
    scene = street(rng)
    n_lines = int(rng.integers(1, 4))
    m = scene.window.shape[1]
    range_m = np.ascontiguousarray(scene.window[rng.integers(0, len(scene.window), n_lines + 2)])
    if rng.random() < 0.5:
        # panes: most shots are before the others
        range_m[rng.random(range_m.shape) < 0.8] = rng.choice([3.0, 3.125])
    labels = rng.choice([2, 3, 4, 5, 7], (n_lines + 2, m), p=[0.3, 0.1, 0.1, 0.4, 0.1]).astype(
        np.uint8
    )
    labels[np.isnan(range_m)] = 0
    voted = labels[1:-1].copy()
    voted[voted == 5] = 4
    above = rng.choice([0.0, 1.0], (n_lines, m)).astype(np.float32)
    chosen = typed(
        LateLeafThresholds,
        foot_m=rng.choice([0.15, -1.0]),
        leaves=rng.choice([3.0, 1e9]),
        range_m=rng.choice([2.0, 0.2, 0.125]),
        apart_m=rng.choice([0.0, 0.01, 0.1]),
    )
    return labels, voted, range_m, above, scene.step, chosen


def fan_case(rng: Generator) -> tuple[Any, ...]:
    """Ground, and things of a few steps on it, as rings see them from near to far.

    All else at random.
    """
    n_lines = int(rng.integers(1, 30))
    m = int(rng.integers(1, 40))
    beam = np.sort(rng.uniform(0.6, 1.6, m)).astype(np.float32) * np.where(
        rng.random(m) < 0.1, -1, 1
    )
    range_m = np.full((n_lines, m), np.nan, np.float32)
    labels = np.full((n_lines, m), 3, np.uint8)
    start, length = sorted(rng.integers(0, m + 1, 2))
    labels[:, start:length] = rng.choice([4, 5])
    side = np.linspace(2, 40, m) - np.where(labels == 3, 0, 1) * np.linspace(0, 30, m)
    range_m[:] = np.abs(side / np.sin(beam))
    wrong = rng.random((n_lines, m)) < rng.choice([0.0, 0.05])
    labels[wrong] = rng.choice([1, 2, 3, 4, 5, 8, 11], wrong.sum())
    gone = rng.random((n_lines, m)) < rng.choice([0.0, 0.1, 1.0], p=[0.5, 0.45, 0.05])
    range_m[gone] = np.nan
    labels[gone] = 0
    above = np.where(labels == 3, 0, np.linspace(0, 3, m) * rng.choice([0.5, 1.0])).astype(
        np.float32
    )
    sides = Sides(
        np.flatnonzero(beam >= 0).astype(np.int32), np.flatnonzero(beam < 0).astype(np.int32)
    )
    before = rng.choice([0, 1, 2, 3], (12, 400), p=[0.7, 0.1, 0.1, 0.1]).astype(np.uint8) * int(
        rng.integers(2)
    )
    chosen = typed(
        FanThresholds,
        least_m=rng.choice([1.2, 0.1]),
        most_m=rng.choice([1.9, 9.0]),
        smooth=rng.choice([0.0, 0.3]),
        share=rng.choice([0.0, 0.3, 0.6]),
    )
    texture = rng.random((n_lines, m)).astype(np.float32)
    return (
        labels,
        range_m,
        above,
        texture,
        np.sin(beam).astype(np.float32),
        sides,
        before,
        int(rng.integers(1, n_lines + 1)),
        chosen,
    )


def confidence_case(rng: Generator) -> tuple[Any, ...]:
    scene = street(rng)
    above = heights(rng, scene)
    range_m = scene.range_m
    labels = rng.choice([1, 2, 3, 4, 5, 7, 8, 11], range_m.shape).astype(np.uint8)
    if rng.random() < 0.5:
        labels[:, : labels.shape[1] // 2] = rng.choice([2, 3, 4])
    labels[np.isnan(range_m)] = 0
    counts = Neighbours(
        *(rng.integers(0, most, range_m.shape).astype(np.uint8) for most in (29, 11, 4, 4))
    )
    texture = rng.choice([0.0, 0.2, 0.25, 0.6, 1.0], range_m.shape).astype(np.float32)
    strips = (len(range_m), fused_strips.STRIPS)
    words = rng.integers(0, 2**63, strips).astype(np.uint64) << rng.integers(0, 64, strips).astype(
        np.uint64
    )
    places = [0.0, -9.0, -2.25, 2.0, 5.0]
    walls = Walls(
        rng.choice(places, strips).astype(np.float32),
        np.zeros(strips, np.float32),
        rng.choice(places, strips).astype(np.float32),
    )
    limits = np.array(list(MEASURES.values()), np.float32)
    questions = rng.integers(0, len(limits), (12, 5))
    groups = np.array([-1, *rng.integers(0, 6, 11)], np.int64)
    return (
        labels,
        range_m,
        above,
        texture,
        counts,
        FilledSlots(words, words & rng.integers(0, 2**63, strips).astype(np.uint64)),
        walls,
        scene.beams,
        scene.step,
        groups,
        questions,
        limits,
    )


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "confidence_cells": confidence_case,
    "curb_labels": curb_case,
    "directions": directions_case,
    "fill_strips": strips_case,
    "find_columns": columns_case,
    "find_walls": walls_case,
    "fan_cars": fan_case,
    "find_flanks": flanks_case,
    "fused_labels": labels_case,
    "leaf_repeats": repeats_case,
    "mean_smoothness": texture_case,
    "near_counts": near_case,
    "plane_points": points_case,
    "smooth_counts": smooth_case,
    "leaves_amid_noise": late_leaf_case,
    "vote_labels": vote_case,
    "walk_ground": walk_case,
    "widen_levels": levels_case,
    "widen_slots": slots_case,
}
