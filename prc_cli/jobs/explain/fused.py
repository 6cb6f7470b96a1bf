"""Why the fused method gives a shot its class: what its stages measure there, and the first test that applies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F32
from prc_cli.jobs.explain.answers import Answer, metres
from prc_cli.methods.fused.classes import PoleParams, decide, vote
from prc_cli.methods.fused.ground import Ground
from prc_cli.methods.fused.neighbours import Neighbours
from prc_cli.methods.fused.noise import again_limits, ask_again
from prc_cli.methods.fused.pipeline import (
    MEMORY,
    NOISE,
    NOISE_ALONG,
    SPACING,
    TAIL,
    FusedParams,
    FusedScanner,
    evidence_of,
    in_step,
    lines_ahead,
    lines_apart,
    of_place,
    of_scanner,
    streams_of,
    thresholds_of,
    window_of,
)
from prc_cli.methods.fused.plane import INNER_LINES, WIDE_LINES, points_of
from prc_cli.methods.fused.profiles import are_wanted
from prc_cli.methods.fused.spacing import BESIDE_LINES, SPACED_LINES
from prc_cli.methods.fused.stems import find_stems
from prc_cli.methods.fused.strips import Standing
from prc_cli.methods.fused.terrain import heights_over_ground

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
        yield from _forest(block, scanner, noise_m, params, at)
        yield _forest_reason(Label(int(item.labels[at])), params)
        return
    yield from _street(block, scanner, heard, of_scanner(params, scanner), (at, Label(int(item.labels[at]))))


def _street(
    block: ScanBlock,
    scanner: FusedScanner,
    heard: Mapping[str, Any],
    params: FusedParams,
    shot: tuple[tuple[int, int], Label],
) -> Iterator[Answer]:
    plane, (at, final) = scanner.scan_plane, shot
    line, column = at
    ahead, noise_m = lines_ahead(plane, params), heard[NOISE_ALONG.name]
    wide = window_of(heard[TAIL.name], block.range_m, block.next_m, ahead)
    wide, params = in_step(wide, scanner, noise_m, params), of_place(params, wide)
    strides = heard.get(SPACING.name)
    if strides is None:
        strides = np.ones(block.n_lines + ahead + 2 * BESIDE_LINES, np.int64)
    streams = streams_of(wide, strides, plane, noise_m, params)
    apart, grounds = int(lines_apart(strides)[line]), heard[MEMORY.name].parts
    k = next(k for k, each in enumerate(streams) if each.every == apart and each.first == line % apart)
    stream, ground = streams[k], grounds[k]
    at = line // apart, column
    around, inner, seen = stream.seen, stream.seen.range_m, stream.seen.neighbours
    least, evidence = params.company.least, evidence_of(around, ground.above_m, plane, params)
    texture, standing = evidence.texture, evidence.standing
    limits = thresholds_of(stream, params)
    decided = decide(stream.wide_m, seen, ground, texture, standing, plane, limits)
    place = _place(inner, seen, ground, texture, standing, scanner, least, at)
    stride = int(strides[line + BESIDE_LINES])
    yield from _neighbourhood(place, stride, params)
    yield from _around(place, params)
    label = Label(int(decided[at[0] + 1, column]))
    reason, keys = _reason(place, label, params)
    yield Answer("decision", reason, _name(label), keys)
    voted = vote(decided, inner[WIDE_LINES:-WIDE_LINES], plane, params.votes)
    again = again_limits(params.company, params.noise, params.strips, params.cars)
    asked = ask_again((decided, voted), inner, seen, ground.above_m, texture, plane, again)
    labels = label, Label(int(voted[at])), Label(int(asked[at])), final
    yield from _afterwards(labels, place, params, by_profile=are_wanted(plane, params.cars))


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


def _neighbourhood(place: _Place, stride: int, params: FusedParams) -> Iterator[Answer]:
    company = params.company
    yield Answer(
        "near neighbours",
        f"{place.near} of {MOST_NEAR}, expected {company.least}",
        "in company" if place.near >= company.least else "isolated",
        (
            ("fused.company.least", company.least), ("fused.company.near_m", company.near_m),
            ("fused.company.along_m", company.along_m),
        ),
    )  # fmt: skip
    lines = "" if stride == 1 else f"; lines {stride} away are compared, nearer ones see the same leaf again"
    lines = "; lines are not compared, the platform stands" if stride < 1 else lines
    smoothness = params.smoothness
    yield Answer(
        "smoothness",
        f"{place.smooth} of {MOST_SMOOTH} pairs of neighbours lie on a smooth surface with it{lines}",
        "rough" if place.smooth <= params.strips.rough else "smooth",
        (
            ("fused.smoothness.noise_sigmas", smoothness.noise_sigmas),
            ("fused.smoothness.least_m", smoothness.least_m),
            ("fused.smoothness.per_metre", smoothness.per_metre),
        ),
    )  # fmt: skip
    so = "neither upright nor level"
    if place.upright != place.level:
        so = "more upright than level" if place.upright > place.level else "more level than upright"
    yield Answer(
        "direction",
        f"{place.upright} upright and {place.level} level chords of {MOST_CHORDS}",
        so,
        (("fused.directions.chord_m", params.directions.chord_m), ("fused.directions.slope", params.directions.slope)),
    )


def _around(place: _Place, params: FusedParams) -> Iterator[Answer]:
    yield Answer(
        "height",
        f"{metres(place.above_m)} above the ground, in the scan plane",
        "the walk along the ground went over it" if place.walked else "the walk along the ground did not go over it",
        (("fused.ground.step_m", params.ground.step_m), ("fused.ground.slope", params.ground.slope)),
    )
    yield Answer(
        "surroundings",
        f"{place.texture:.0%} of the pairs around are smooth",
        "foliage" if place.texture < params.leaves.share else "no foliage",
        (
            ("fused.leaves.share", params.leaves.share), ("fused.leaves.half_width_m", params.leaves.half_width_m),
            ("fused.leaves.share_before_walls", params.leaves.share_before_walls),
        ),
    )  # fmt: skip
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
        (("fused.walls.height_m", params.walls.height_m), ("fused.walls.share", params.walls.share)),
    )


def _reason(place: _Place, label: Label, params: FusedParams) -> tuple[str, tuple[tuple[str, Any], ...]]:
    """Return the first test that gives the label, in the order of :func:`~prc_cli.methods.fused.classes.decide`."""
    ground, noise, leaves, cars, poles = params.ground, params.noise, params.leaves, params.cars, params.poles
    if label == Label.NOISE:
        return _why_noise(place, params)
    if label == Label.GROUND:
        height = abs(place.above_m)
        if place.walked and height < ground.walked_m:
            return "walked over, and at the height of the ground", (("fused.ground.walked_m", ground.walked_m),)
        if place.level > place.upright and height < ground.level_m:
            return "more level than upright, and low", (("fused.ground.level_m", ground.level_m),)
        return "not upright, and very low", (("fused.ground.soil_m", ground.soil_m),)
    if label == Label.CAR:
        told = "low, with level surfaces around that are wide enough"
        return told, (("fused.cars.level_bins", cars.level_bins), ("fused.cars.top_m", cars.top_m))
    if label == Label.POLE:
        return _why_pole(place, poles)
    if label == Label.VEGETATION:
        if place.near < params.company.least:
            return "isolated, among other rough shots: a leaf", (("fused.noise.leaf_slots", noise.leaf_slots),)
        if place.texture < leaves.share:
            return "rough surroundings, not in a wall", (("fused.leaves.share", leaves.share),)
        return "thin and upright, below a crown or as thick as a trunk", (
            ("fused.poles.crown_slots", poles.crown_slots), ("fused.poles.thick_m", poles.thick_m),
        )  # fmt: skip
    if label == Label.BUILDING:
        if place.texture < leaves.share:
            told = "rough surroundings, but in or above a wall, seen through it, or close to one"
            return told, (
                ("fused.walls.front_m", params.walls.front_m),
                ("fused.walls.behind_m", params.walls.behind_m),
                ("fused.walls.roof_m", params.walls.roof_m),
            )
        return "no test before applies: something smooth above the ground", (("fused.leaves.share", leaves.share),)
    return "a car or a pole, which have no class of their own here", (
        ("fused.cars.named", cars.named), ("fused.poles.named", poles.named),
    )  # fmt: skip


def _why_pole(place: _Place, poles: PoleParams) -> tuple[str, tuple[tuple[str, Any], ...]]:
    if place.above_m < poles.arm_m and place.level > 0:
        told = "small, with a level top, and far things beyond it: a bin or a cabinet"
        return told, (("fused.poles.box_m", poles.box_m), ("fused.poles.box_lines", poles.box_lines))
    if place.level > 0:
        return "thin and high above the ground: an arm or a lamp", (("fused.poles.arm_m", poles.arm_m),)
    told = "upright and thin: lines beside it, or shots above and below, see past it"
    return told, (("fused.poles.height_m", poles.height_m), ("fused.poles.far_m", poles.far_m))


def _why_noise(place: _Place, params: FusedParams) -> tuple[str, tuple[tuple[str, Any], ...]]:
    noise = params.noise
    if place.near < params.company.least:
        told = "isolated, and neither a leaf among others nor on a surface"
        return told, (("fused.noise.leaf_slots", noise.leaf_slots), ("fused.noise.lone_m", noise.lone_m))
    if noise.spikes and place.smooth == 0 and place.spike_share > noise.spike_share:
        told = f"a spike: no pair is smooth with it, {place.spike_share:.0%} of those of the shots beside it are"
        return told, (("fused.noise.spike_share", noise.spike_share),)
    if place.above_m < -params.ground.below_m and place.smooth < BELOW_SMOOTH:
        return "rough and far below the ground", (("fused.ground.below_m", params.ground.below_m),)
    if noise.panes and place.smooth == 0:
        told = "few neighbours and no smooth pair, behind a wall or alone in a car: a reflection in a pane"
        return told, (("fused.walls.behind_m", params.walls.behind_m), ("fused.noise.ghost_near", noise.ghost_near))
    told = "few neighbours, rough, and seen far behind a wall"
    return told, (("fused.noise.ghost_m", noise.ghost_m), ("fused.noise.ghost_near", noise.ghost_near))


def _why_again(asked: Label, place: _Place, params: FusedParams) -> tuple[str, tuple[tuple[str, Any], ...]]:
    """Return why the answer of the wider window is another one."""
    noise = params.noise
    if asked == Label.NOISE:
        return "rough, and amid a car but farther than it, or with nothing around that is as far", (
            ("fused.noise.mirror_m", noise.mirror_m), ("fused.noise.alone_m", noise.alone_m),
        )  # fmt: skip
    if place.near >= params.company.least:
        return "a spike, but close to the surface around", (("fused.noise.spike_m", noise.spike_m),)
    return "isolated, but more of the same is around", (("fused.noise.sparse_shots", noise.sparse_shots),)


def _afterwards(
    labels: tuple[Label, Label, Label, Label], place: _Place, params: FusedParams, *, by_profile: bool
) -> Iterator[Answer]:
    """Answer for what may change a decision."""
    decided, voted, asked, final = labels
    half = (("fused.votes.half_width_m", params.votes.half_width_m),)
    if decided in (Label.NOISE, Label.GROUND):
        yield Answer("vote", "noise and ground are not asked", "keeps its class", half)
    else:
        so = "keeps its class" if voted == decided else f"{_name(voted)}, as most shots around it"
        yield Answer("vote", "the shots around it", so, half)
    if asked != voted:
        told, keys = _why_again(asked, place, params)
        yield Answer("wider window", told, _name(asked), keys)
    if final == asked:
        return
    if final == Label.CURB:
        limits = (("fused.curbs.least_m", params.curbs.least_m), ("fused.curbs.most_m", params.curbs.most_m))
        yield Answer("curbs", "the ground rises by a small step here", "curb", limits)
        return
    if final in (Label.CAR, Label.UNCLASSIFIED) and by_profile:
        cars = params.cars
        roof = (("fused.cars.roof_least_m", cars.roof_least_m), ("fused.cars.roof_share", cars.roof_share))
        told = "lines around see a car here: they climb from the ground to a roof, and see far beyond it"
        yield Answer("profile", told, _name(final), roof)
        return
    limit = (("fused.spacing.keeps", params.spacing.keeps),)
    yield Answer("standing", "the platform stands or hardly moves", f"{_name(final)}, as before", limit)


def _forest(
    block: ScanBlock, scanner: FusedScanner, noise_m: float, params: FusedParams, at: tuple[int, int]
) -> Iterator[Answer]:
    forest, plane = params.forest, scanner.plane
    range_m = np.ascontiguousarray(block.range_m)
    heights = heights_over_ground(range_m, plane, forest.terrain)
    stems = find_stems(range_m, heights, plane, noise_m, forest.stems)
    limits = forest.thresholds(noise_m)
    above_m = float(heights[at])
    so = (
        "far below the ground"
        if above_m < -limits.below_m
        else "at the ground"
        if above_m <= limits.soil_m
        else "above"
    )
    yield Answer(
        "height",
        f"{metres(above_m)} above the ground, in the scan plane",
        so,
        (("fused.forest.soil_m", round(limits.soil_m, 4)), ("fused.forest.below_m", limits.below_m)),
    )
    on_stem = bool(stems[at])
    yield Answer(
        "stems",
        "part of an upright run that other lines repeat" if on_stem else "part of none",
        "on a stem" if on_stem else "on no stem",
        tuple((f"fused.forest.stems.{key}", value) for key, value in forest.stems.model_dump().items())[:4],
    )


def _forest_reason(label: Label, params: FusedParams) -> Answer:
    """Return the last answer in a forest."""
    forest = params.forest
    told: dict[Label, tuple[str, tuple[tuple[str, Any], ...]]] = {
        Label.GROUND: (
            "low, or in a flat place a little higher",
            (("fused.forest.soil_m", forest.soil_m), ("fused.forest.flat.cover_m", forest.flat.cover_m)),
        ),
        Label.STEM: (
            "on a stem, or beside one and as far",
            (("fused.forest.touching.range_m", forest.touching.range_m),),
        ),
        Label.VEGETATION: ("above the ground, on no stem, in company", ()),
        Label.NOISE: (
            "far below the ground, or isolated",
            (("fused.forest.below_m", forest.below_m), ("fused.forest.company.range_m", forest.company.range_m)),
        ),
    }
    found, limits = told.get(label, ("", ()))
    return Answer("decision", found, _name(label), limits)


def _name(label: Label) -> str:
    return label.name.lower()
