"""Why the fused method gives a shot its class: what its stages measure there, and the first test that applies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F32
from prc_cli.jobs.explain.answers import Answer, metres
from prc_cli.methods.fused.classes import are_wanted, ask_again, decide, vote
from prc_cli.methods.fused.forest import find_stems, heights_over_ground
from prc_cli.methods.fused.ground import Ground
from prc_cli.methods.fused.interlace import put_in_step
from prc_cli.methods.fused.neighbours import Neighbours
from prc_cli.methods.fused.pipeline import (
    MEMORY,
    NOISE,
    NOISE_ALONG,
    SPACING,
    TAIL,
    FusedParams,
    FusedScanner,
    evidence_of,
    lines_ahead,
    lines_apart,
    of_place,
    streams_of,
    window_of,
)
from prc_cli.methods.fused.plane import INNER_LINES, WIDE_LINES, points_of
from prc_cli.methods.fused.spacing import BESIDE_LINES, SPACED_LINES
from prc_cli.methods.fused.strips import Standing
from prc_cli.methods.fused.thresholds import FOREST, Forest, Limits

MOST_SMOOTH, MOST_NEAR, MOST_CHORDS = 10, 28, 3
STRIPS, STRIP_M = 320, 0.5
"""As in :mod:`strips_loops`."""
SPIKE_M, SPIKE_COLUMNS, SPIKE_PAIRS, BELOW_SMOOTH = 0.1, 6, 8, 3
"""As in :mod:`classes_loops`."""


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """What is known of a shot."""

    range_m: float
    near: int
    smooth: int
    upright: int
    level: int
    above_m: float
    walked: bool
    texture: float
    spike_share: float
    side_m: float
    height_m: float
    wall: tuple[float, float, float]
    """Distance and top of the wall in or before its strip, and distance of one in or behind it [m]; 0 = none."""


def fused_answers(
    item: LabelledBlock,
    block: ScanBlock,
    run: tuple[FusedScanner, Mapping[str, Any]],
    params: FusedParams,
    at: tuple[int, int],
) -> Iterator[Answer]:
    """Yield the answers of the stages, in their order."""
    scanner, heard = run
    is_forest = params.environment == "forest"
    noise_m = float(heard[NOISE.name] if is_forest else heard[NOISE_ALONG.name][SPACED_LINES + at[0]])
    yield Answer(
        "range noise",
        metres(noise_m, 4) if noise_m else "not known yet",
        "measured up to this block" if params.sensor.range_noise_m == "auto" else "as given",
        (("fused.sensor.range_noise_m", params.sensor.range_noise_m),),
    )
    if is_forest:
        yield from _forest(block, scanner, noise_m, at)
        yield _forest_reason(Label(int(item.labels[at])))
        return
    yield from _street(block, scanner, heard, (at, Label(int(item.labels[at]))))


def _street(
    block: ScanBlock,
    scanner: FusedScanner,
    heard: Mapping[str, Any],
    shot: tuple[tuple[int, int], Label],
) -> Iterator[Answer]:
    plane, limits, (at, final) = scanner.scan_plane, scanner.limits, shot
    line, column = at
    ahead, noise_m = lines_ahead(plane, limits), heard[NOISE_ALONG.name]
    wide = window_of(heard[TAIL.name], block.range_m, block.next_m, ahead)
    wide, limits = put_in_step(wide, plane, noise_m, limits), of_place(limits, wide)
    strides = heard.get(SPACING.name)
    if strides is None:
        strides = np.ones(block.n_lines + ahead + 2 * BESIDE_LINES, np.int64)
    streams = streams_of(wide, strides, plane, noise_m, limits)
    apart, grounds = int(lines_apart(strides)[line]), heard[MEMORY.name].parts
    k = next(k for k, each in enumerate(streams) if each.every == apart and each.first == line % apart)
    stream, ground = streams[k], grounds[k]
    at = line // apart, column
    around, inner, seen = stream.seen, stream.seen.range_m, stream.seen.neighbours
    least, evidence = int(limits.decision.least_near), evidence_of(around, ground.above_m, plane, limits)
    texture, standing = evidence.texture, evidence.standing
    decided = decide(stream.wide_m, seen, ground, texture, standing, plane, limits.decision)
    place = _place(inner, seen, ground, texture, standing, scanner, least, at)
    stride = int(strides[line + BESIDE_LINES])
    yield from _neighbourhood(place, stride, limits)
    yield from _around(place, limits)
    label = Label(int(decided[at[0] + 1, column]))
    reason, keys = _reason(place, label, limits)
    yield Answer("decision", reason, _name(label), keys)
    voted = vote(decided, inner[WIDE_LINES:-WIDE_LINES], plane, limits.votes)
    asked = ask_again((decided, voted), inner, seen.smooth, ground.above_m, texture, limits.again)
    labels = label, Label(int(voted[at])), Label(int(asked[at])), final
    yield from _afterwards(labels, limits, by_profile=are_wanted(plane, limits))


def _place(
    inner: F32, seen: Neighbours, ground: Ground, texture: F32, standing: Standing, scanner: FusedScanner, least: int,
    at: tuple[int, int],
) -> _Place:  # fmt: skip
    k, column = at[0] + INNER_LINES + 1, at[1]
    side, height = points_of(inner[k : k + 1], scanner.scan_plane)
    strip = int(np.floor(side[0, column] / STRIP_M)) + STRIPS // 2
    inside = 0 <= strip < STRIPS
    walls = tuple(float(each[at[0] + 1, strip]) if inside else 0.0 for each in standing.walls)
    range_m = float(inner[k, column])
    half = int(min(max(SPIKE_M / (range_m * float(scanner.scan_plane.step_rad)), 2), SPIKE_COLUMNS))
    rows, columns = slice(k - 1, k + 2), slice(max(column - half, 0), column + half + 1)
    counts = seen.near[rows, columns] >= least
    pairs = np.minimum(seen.smooth[rows, columns], SPIKE_PAIRS)[counts].sum()
    return _Place(
        range_m, int(seen.near[k, column]), int(seen.smooth[k, column]), int(seen.upright[k, column]),
        int(seen.level[k, column]), float(ground.above_m[k, column]), bool(ground.walked[k, column]),
        float(texture[at[0] + 1, column]), float(pairs) / max(SPIKE_PAIRS * int(counts.sum()), 1),
        float(side[0, column]), float(height[0, column]), (walls[0], walls[1], walls[2]),
    )  # fmt: skip


def _of(limits: Limits | Forest, *names: str) -> tuple[tuple[str, float], ...]:
    """Return limits by their names, such as ``walk.step_m``, with values to print."""
    return tuple((name, float(f"{attrgetter(name)(limits):.7g}")) for name in names)


def _neighbourhood(place: _Place, stride: int, limits: Limits) -> Iterator[Answer]:
    least = int(limits.decision.least_near)
    yield Answer(
        "near neighbours",
        f"{place.near} of {MOST_NEAR}, expected {least}",
        "in company" if place.near >= least else "isolated",
        _of(limits, "decision.least_near", "near.near_m", "near.along_m"),
    )
    lines = "" if stride == 1 else f"; lines {stride} away are compared, nearer ones see the same leaf again"
    lines = "; lines are not compared, the platform stands" if stride < 1 else lines
    yield Answer(
        "smoothness",
        f"{place.smooth} of {MOST_SMOOTH} pairs of neighbours lie on a smooth surface with it{lines}",
        "rough" if place.smooth <= limits.strips.rough else "smooth",
        _of(limits, "smoothness.noise_sigmas", "smoothness.least_m", "smoothness.per_metre"),
    )
    so = "neither upright nor level"
    if place.upright != place.level:
        so = "more upright than level" if place.upright > place.level else "more level than upright"
    told = f"{place.upright} upright and {place.level} level chords of {MOST_CHORDS}"
    yield Answer("direction", told, so, _of(limits, "chords.chord_m", "chords.slope"))


def _around(place: _Place, limits: Limits) -> Iterator[Answer]:
    yield Answer(
        "height",
        f"{metres(place.above_m)} above the ground, in the scan plane",
        "the walk along the ground went over it" if place.walked else "the walk along the ground did not go over it",
        _of(limits, "walk.step_m", "walk.slope"),
    )
    yield Answer(
        "surroundings",
        f"{place.texture:.0%} of the pairs around are smooth",
        "foliage" if place.texture < limits.decision.leaf_share else "no foliage",
        _of(limits, "decision.leaf_share", "foliage.half_width_m", "decision.leaf_share_before_wall"),
    )
    at_m, top_m, ahead_m = place.wall
    walls = []
    if at_m:
        walls.append(f"a wall {metres(abs(at_m), 1)} to the side, up to {metres(top_m, 1)} above the scanner")
    if ahead_m:
        walls.append(f"one in or behind its strip {metres(abs(ahead_m), 1)} to the side")
    yield Answer(
        "walls",
        "; ".join(walls) or "none in its strip",
        f"the shot is {metres(abs(place.side_m), 1)} to the side",
        _of(limits, "walls.height_m", "walls.share"),
    )


_Reason: TypeAlias = tuple[str, tuple[tuple[str, float], ...]]


def _reason(place: _Place, label: Label, limits: Limits) -> _Reason:
    """Return the first test that gives the label, in the order of :func:`~prc_cli.methods.fused.classes.decide`."""
    own = limits.decision
    if label == Label.NOISE:
        return _why_noise(place, limits)
    if label == Label.GROUND:
        height = abs(place.above_m)
        if place.walked and height < own.walked_m:
            return "walked over, and at the height of the ground", _of(limits, "decision.walked_m")
        if place.level > place.upright and height < own.level_m:
            return "more level than upright, and low", _of(limits, "decision.level_m")
        return "not upright, and very low", _of(limits, "decision.soil_m")
    if label == Label.CAR:
        told = "low, with level surfaces around that are wide enough"
        return told, _of(limits, "decision.car_bins", "decision.car_top_m")
    if label == Label.POLE:
        return _why_pole(place, limits)
    if label == Label.VEGETATION:
        if place.near < own.least_near:
            return "isolated, among other rough shots: a leaf", _of(limits, "decision.leaf_slots")
        if place.texture < own.leaf_share:
            return "rough surroundings, not in a wall", _of(limits, "decision.leaf_share")
        told = "thin and upright, below a crown or as thick as a trunk"
        return told, _of(limits, "decision.crown_slots", "decision.thick_m")
    if place.texture < own.leaf_share:
        told = "rough surroundings, but in or above a wall, seen through it, or close to one"
        return told, _of(limits, "decision.front_m", "decision.behind_m", "decision.roof_m")
    return "no test before applies: something smooth above the ground", _of(limits, "decision.leaf_share")


def _why_pole(place: _Place, limits: Limits) -> _Reason:
    if place.above_m < limits.decision.arm_m and place.level > 0:
        told = "small, with a level top, and far things beyond it: a bin or a cabinet"
        return told, _of(limits, "decision.box_m", "decision.box_lines")
    if place.level > 0:
        return "thin and high above the ground: an arm or a lamp", _of(limits, "decision.arm_m")
    told = "upright and thin: lines beside it, or shots above and below, see past it"
    return told, _of(limits, "decision.pole_m", "decision.far_m")


def _why_noise(place: _Place, limits: Limits) -> _Reason:
    own = limits.decision
    if place.near < own.least_near:
        told = "isolated, and neither a leaf among others nor on a surface"
        return told, _of(limits, "decision.leaf_slots", "decision.lone_m")
    if place.smooth == 0 and place.spike_share > own.spike_share:
        told = f"a spike: no pair is smooth with it, {place.spike_share:.0%} of those of the shots beside it are"
        return told, _of(limits, "decision.spike_share")
    if place.above_m < -own.below_m and place.smooth < BELOW_SMOOTH:
        return "rough and far below the ground", _of(limits, "decision.below_m")
    if place.smooth == 0:
        told = "few neighbours and no smooth pair, behind a wall or alone in a car: a reflection in a pane"
        return told, _of(limits, "decision.behind_m", "decision.ghost_near")
    told = "few neighbours, rough, and seen far behind a wall"
    return told, _of(limits, "decision.ghost_m", "decision.ghost_near")


def _afterwards(labels: tuple[Label, Label, Label, Label], limits: Limits, *, by_profile: bool) -> Iterator[Answer]:
    """Answer for what may change a decision."""
    decided, voted, asked, final = labels
    half = _of(limits, "votes.half_width_m")
    if decided in (Label.NOISE, Label.GROUND):
        yield Answer("vote", "noise and ground are not asked", "keeps its class", half)
    else:
        so = "keeps its class" if voted == decided else f"{_name(voted)}, as most shots around it"
        yield Answer("vote", "the shots around it", so, half)
    if asked != voted:
        told = "rough, and amid a car but farther than it, or with nothing around that is as far"
        yield Answer("wider window", told, _name(asked), _of(limits, "again.mirror_m", "again.alone_m"))
    if final == asked:
        return
    if final == Label.CURB:
        told, names = "the ground rises by a small step here", _of(limits, "curbs.least_m", "curbs.most_m")
        yield Answer("curbs", told, "curb", names)
    elif by_profile:
        told = "lines around see a car here: they climb from the ground to a roof, and see far beyond it"
        yield Answer("profile", told, _name(final), _of(limits, "roofs.least_m", "roofs.share"))


def _forest(block: ScanBlock, scanner: FusedScanner, noise_m: float, at: tuple[int, int]) -> Iterator[Answer]:
    plane, limits = scanner.plane, FOREST.class_thresholds(noise_m)
    range_m = np.ascontiguousarray(block.range_m)
    heights = heights_over_ground(range_m, plane, FOREST)
    on_stem = bool(find_stems(range_m, heights, plane, noise_m, FOREST)[at])
    above_m = float(heights[at])
    so = "at the ground" if above_m <= limits.soil_m else "above"
    yield Answer(
        "height",
        f"{metres(above_m)} above the ground, in the scan plane",
        "far below the ground" if above_m < -limits.below_m else so,
        (("classes.soil_m", round(limits.soil_m, 4)), ("classes.below_m", limits.below_m)),
    )
    yield Answer(
        "stems",
        "part of an upright run that other lines repeat" if on_stem else "part of none",
        "on a stem" if on_stem else "on no stem",
        _of(FOREST, "runs.above_m", "runs.tolerance_m", "run_sigmas", "runs.tolerance_share"),
    )


_FOREST_REASONS: dict[Label, tuple[str, tuple[str, ...]]] = {
    Label.GROUND: ("low, or in a flat place a little higher", ("classes.soil_m", "classes.cover_m")),
    Label.STEM: ("on a stem, or beside one and as far", ("classes.beside_m",)),
    Label.VEGETATION: ("above the ground, on no stem, in company", ()),
    Label.NOISE: ("far below the ground, or isolated", ("classes.below_m", "classes.near_m")),
}


def _forest_reason(label: Label) -> Answer:
    """Return the last answer in a forest."""
    told, names = _FOREST_REASONS.get(label, ("", ()))
    return Answer("decision", told, _name(label), _of(FOREST, *names))


def _name(label: Label) -> str:
    return label.name.lower()
