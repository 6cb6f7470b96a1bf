"""Why shots have their labels.

One sentence for every rule, read by ``prc explain``, the viewer and the docs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from prc_cli.core.classes import (
    FURTHER_RETURN,
    LABEL_NAMES,
    LABELS_BY_REASON,
    VOTED,
    Label,
    Reason,
)
from prc_cli.core.types import U8


class Rule(NamedTuple):
    """A rule in words, and its limits."""

    sentence: str
    limits: tuple[str, ...] = ()
    """Keys of the configuration, or names of the fused method's constants."""


_FACADE = ("decision.front_m", "decision.behind_m", "decision.roof_m")
RULES: dict[Reason, Rule] = {
    Reason.MISSING: Rule("no return"),
    # Lehtola et al. (2019)
    Reason.UNSUPPORTED: Rule(
        "too few neighbouring shots, in its line or in the adjacent ones, are about as far",
        ("prc.support.zeta_p", "prc.support.zeta_s", "prc.support.rho_c"),
    ),
    Reason.MOST_SMOOTH: Rule(
        "part of the smooth segment with most shots so far", ("prc.urban.ground",)
    ),
    Reason.OTHER_SEGMENT: Rule(
        "part of a smooth segment that is not the ground", ("prc.surfaces.area", "prc.urban.ground")
    ),
    Reason.NON_SMOOTH: Rule(
        "part of a segment that is too small for a smooth surface, or close beside such a segment",
        ("prc.surfaces.area", "prc.surfaces.gamma"),
    ),
    Reason.GROUND_COLUMN: Rule(
        "in a column that is smooth in enough lines of the block",
        ("prc.forest.density", "prc.forest.column_step", "prc.forest.noise_in_ground_columns"),
    ),
    Reason.SMOOTH_COLUMN: Rule(
        "part of a smooth segment, in a column that is not ground",
        ("prc.surfaces.area", "prc.forest.density"),
    ),
    # Stamos et al. (2012)
    Reason.BEYOND_REACH: Rule("farther than the method looks", ("sequential_angle.max_range_m",)),
    Reason.UNDECIDED: Rule("its line has too few returns for an angle"),
    Reason.TO_AND_FRO: Rule(
        "the angles around it change back and forth",
        ("sequential_angle.coarse.vegetation.threshold",),
    ),
    Reason.HORIZONTAL: Rule(
        "a run of level angles, and neither ground nor car",
        ("sequential_angle.coarse.surfaces.threshold_horizontal_deg",),
    ),
    Reason.VERTICAL: Rule(
        "a run of upright angles, and neither curb nor car",
        ("sequential_angle.coarse.surfaces.threshold_vertical_deg",),
    ),
    Reason.GROUND_HEIGHT: Rule(
        "horizontal, and at the height of the ground",
        ("sequential_angle.ground.height_tolerance",),
    ),
    Reason.CURB_REGION: Rule(
        "a low vertical face between two ground surfaces, visible in enough lines",
        ("sequential_angle.curb.max_height_m", "sequential_angle.curb.min_lines"),
    ),
    Reason.BETWEEN_DIVIDERS: Rule(
        "between the dividers of a car, above the ground and nearer than any curb",
        ("sequential_angle.car.ground_layer_m",),
    ),
    # fused, streets
    Reason.LONELY: Rule(
        "near the scanner, but nothing is near it", ("decision.lone_m", "near.near_m")
    ),
    Reason.ISOLATED: Rule(
        "isolated, and neither a leaf among others nor on a surface",
        ("decision.least_near", "decision.leaf_slots"),
    ),
    Reason.SPIKE: Rule(
        "a spike: no pair is smooth with it, those of the shots beside it are",
        ("decision.spike_share",),
    ),
    Reason.BELOW_GROUND: Rule("rough and far below the ground", ("decision.below_m",)),
    Reason.BEHIND_WALL: Rule(
        "few neighbours, and rough or without a smooth pair far behind a wall: "
        "a reflection in a pane",
        ("decision.ghost_m", "decision.behind_m", "decision.ghost_near"),
    ),
    Reason.IN_CAR: Rule("isolated in a car, without a smooth pair", ("decision.least_near",)),
    Reason.WALKED: Rule(
        "at the height of the ground, and the search along the ground includes it",
        ("decision.walked_m", "walk.step_m"),
    ),
    Reason.LEVEL_LOW: Rule("low, and more level than upright", ("decision.level_m",)),
    Reason.LOW: Rule("very low, and not upright", ("decision.soil_m",)),
    Reason.LEVEL_BODY: Rule(
        "low, with level surfaces around that are wide enough for a car",
        ("decision.car_bins", "decision.car_bins_rough", "decision.car_top_m"),
    ),
    Reason.PROFILE: Rule(
        "lines around climb from the ground to a roof and see far beyond it: a car",
        ("roofs.least_m", "roofs.share"),
    ),
    Reason.CROWN: Rule("thin and upright, below a crown", ("decision.crown_slots",)),
    Reason.TRUNK: Rule(
        "thin and upright, and as thick and round as a trunk", ("decision.thick_m",)
    ),
    Reason.SMALL: Rule(
        "low, shallow and seen by few lines, which see past it on both sides",
        ("columns.high_m", "columns.person_m", "columns.small_m", "columns.small_lines"),
    ),
    Reason.POST: Rule(
        "upright and thin: lines beside it, or shots above and below, see past it",
        ("decision.pole_m", "decision.far_m", "columns.tall_m", "columns.lines", "columns.mast_m"),
    ),
    Reason.ARM: Rule(
        "thin or short, high above the ground: an arm or a lamp",
        ("decision.arm_m", "decision.far_m"),
    ),
    Reason.BOX: Rule(
        "small, with a level top, and far things beyond it: a bin or a cabinet",
        ("decision.box_m", "decision.box_lines"),
    ),
    Reason.LEAF: Rule(
        "few shots near it, rough ones around: a leaf or a bare branch",
        ("decision.leaf_near", "decision.leaf_slots"),
    ),
    Reason.FOLIAGE: Rule(
        "rough surroundings, not in a wall nor seen through it",
        ("decision.leaf_share", "decision.leaf_share_before_wall"),
    ),
    Reason.FACADE: Rule(
        "rough surroundings, but in a wall, seen through it, or on a facade", _FACADE
    ),
    Reason.SMOOTH: Rule(
        "no rule before applies: something smooth above the ground", ("decision.leaf_share",)
    ),
    Reason.CURB_FACE: Rule(
        "the line climbs, and the ground beyond is higher than before: the face of a curb",
        ("curbs.least_m", "curbs.most_m"),
    ),
    # fused, forests
    Reason.FAR_BELOW: Rule("far below the ground", ("classes.below_m",)),
    Reason.ALONE: Rule("no shot around is about as far", ("classes.near_m",)),
    Reason.SOIL: Rule("at the ground", ("classes.soil_m",)),
    Reason.FLAT: Rule("low, in a flat place", ("classes.cover_m", "classes.flat_m")),
    Reason.ON_STEM: Rule(
        "in an upright run that other lines repeat",
        ("runs.above_m", "runs.tolerance_m", "stems.total_m"),
    ),
    Reason.BESIDE_STEM: Rule("beside a stem, and as far", ("classes.beside_m",)),
    Reason.ABOVE_TOP: Rule("on a stem, but above the height where stems end", ("classes.top_m",)),
    Reason.PLANT: Rule(
        "above the ground, on no stem, with shots around as far", ("classes.near_m",)
    ),
    # rings
    Reason.FLAKE: Rule(
        "hardly any shot around is as far, and none as bright: snow, rain or dust",
        ("lonely.near_m", "lonely.most", "lonely.bright"),
    ),
    Reason.SURFACE: Rule(
        "on the surface through the lowest returns around", ("soil.soil_m", "ground.step_m")
    ),
    Reason.THIN_SMOOTH: Rule(
        "the object there is thin, smooth, upright and without gaps in height",
        ("leaves.thick", "leaves.smooth", "leaves.upright", "leaves.filled"),
    ),
    Reason.ROUGH_PLACE: Rule(
        "the object there is rough, thick, or has gaps in height",
        ("leaves.thick", "leaves.smooth", "leaves.filled"),
    ),
    Reason.LOW_PLANT: Rule(
        "low, in a rough place or above a smooth one", ("soil.smooth", "soil.rough", "soil.high")
    ),
    Reason.CAR_BOX: Rule(
        "part of a separate object of a car's size, and rings pass over it",
        ("cars.body_m", "cars.most_m", "cars.wide_m", "cars.seen_m"),
    ),
    Reason.LARGE_BOX: Rule(
        "part of a separate smooth object of a lorry's size, and rings pass over it",
        ("lorries.body_m", "lorries.most_m", "lorries.wide_m", "lorries.seen_m"),
    ),
    Reason.THIN_PLACE: Rule(
        "the object there is thin on all sides, high and separate",
        ("poles.thin_m", "poles.least_m"),
    ),
}
VOTE = Rule("most shots around are of this class", ("votes.half_width_m", "votes.near_m"))
FURTHER = Rule(
    "a further return: the class of a shot around that is as far, leaves around, or a lone shot"
)

LABEL_REASONS: dict[str, dict[Label, Reason]] = {
    "urban": {
        Label.NOISE: Reason.UNSUPPORTED,
        Label.GROUND: Reason.MOST_SMOOTH,
        Label.BUILDING: Reason.OTHER_SEGMENT,
        Label.VEGETATION: Reason.NON_SMOOTH,
    },
    "forest": {
        Label.NOISE: Reason.UNSUPPORTED,
        Label.GROUND: Reason.GROUND_COLUMN,
        Label.STEM: Reason.SMOOTH_COLUMN,
        Label.VEGETATION: Reason.NON_SMOOTH,
    },
    "sequential-angle": {
        Label.GROUND: Reason.GROUND_HEIGHT,
        Label.CURB: Reason.CURB_REGION,
        Label.CAR: Reason.BETWEEN_DIVIDERS,
        Label.VEGETATION: Reason.TO_AND_FRO,
        Label.HORIZONTAL: Reason.HORIZONTAL,
        Label.VERTICAL: Reason.VERTICAL,
        Label.UNCLASSIFIED: Reason.UNDECIDED,
    },
}
"""The one rule behind every label of PRC in streets, PRC in forests and sequential-angle."""


def reasons_of(labels: U8, of_label: Mapping[Label, Reason]) -> U8:
    """Return the reasons of labels that have one rule each.

    >>> reasons = reasons_of(np.array([0, 3], np.uint8), LABEL_REASONS["urban"])
    >>> [Reason(reason).name for reason in reasons]
    ['MISSING', 'MOST_SMOOTH']
    """
    table = np.array([of_label.get(label, Reason.MISSING) for label in Label], np.uint8)
    return table[labels]


def rule_of(reason: int) -> tuple[str, Rule]:
    """Return the name and the rule of a reason, by its number in files.

    >>> rule_of(Reason.SPIKE)[0], rule_of(VOTED + Label.CAR)[0], rule_of(200)[0]
    ('spike', 'voted', 'unknown')
    """
    if reason >= VOTED:
        return "voted", VOTE
    if reason >= FURTHER_RETURN:
        return "further_return", FURTHER
    if reason in Reason.__members__.values():
        return Reason(reason).name.lower(), RULES[Reason(reason)]
    return "unknown", Rule("no rule of this version")


def sentences() -> dict[int, str]:
    """Return the sentence of every reason but that of missing returns, by its number."""
    more = {
        kind + label: rule.sentence
        for kind, rule in ((VOTED, VOTE), (FURTHER_RETURN, FURTHER))
        for label in Label
    }
    return {**{int(reason): RULES[reason].sentence for reason in RULES if reason}, **more}


def reason_table() -> list[tuple[int, str, str, str]]:
    """Return number, class, name and sentence of every reason, by number.

    Votes and further returns have one row each.
    """
    rows = [
        (
            int(reason),
            LABEL_NAMES[LABELS_BY_REASON[reason]],
            reason.name.lower(),
            RULES[reason].sentence,
        )
        for reason in RULES
    ]
    more = [
        (VOTED, "any", "voted", VOTE.sentence),
        (FURTHER_RETURN, "any", "further_return", FURTHER.sentence),
    ]
    return [*sorted(rows), *sorted(more)]
