"""The rules of fused, one small scene each: what a shot is like, and the rule that is right.

The shots of a street are a patch of a smooth upright wall, 5 m to the right of the scanner and 1 m
above the ground, but for what a row says.
"""

import re
from collections.abc import Sequence
from inspect import getsource
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import LABEL_NAMES, LABELS_BY_REASON, Label, Reason
from prc_cli.core.types import U8
from prc_cli.methods.fused.classes_loops import (
    MARGIN,
    _label_noise_and_ground,
    _label_things,
    fused_labels,
)
from prc_cli.methods.fused.records import (
    FENCE,
    FEW_SHOTS,
    POST,
    SHORT,
    SLOTS,
    SMALL,
    STRIP_M,
    STRIPS,
    THIN,
    Beams,
    FilledSlots,
    Neighbours,
    Walls,
)
from prc_cli.methods.fused.thresholds import DecisionThresholds
from prc_cli.methods.fused.votes_loops import vote_labels

ROOT = Path(__file__).resolve().parents[3]
M = 9
STEP_RAD = np.float32(0.004)
SIDE_M = 5.0
ALL = 2**SLOTS - 1

LONELY = {"near": 1, "smooth": 0, "upright": 0}
ROUGH = {"smooth": 1, "texture": 0.1, "upright": 0}
TWIG = {"near": 9, "smooth": 2, "above_m": 2.5}
LEVEL = {"upright": 0, "level": 3}
WALL_5M = {"wall_m": 5.0, "wall_top_m": 8.0, "wall_ahead_m": 5.0}
WALL_3M = {"wall_m": 3.0, "wall_top_m": 8.0}
CAR = {"level_bins": 2, "slots": 0b1110}
LORRY = {"level_bins": 2, "is_high": True, "slots": 0b1110}


def reasons(
    *,
    range_m: float = SIDE_M,
    above_m: float = 1.0,
    near: int = 20,
    smooth: int = 9,
    upright: int = 3,
    level: int = 0,
    walked: bool = False,
    texture: float = 0.9,
    kind: int = 0,
    around_smooth: int | None = None,
    lines_beside: tuple[float, float] | None = None,
    rough_slots: int = 0,
    slots: int = 0,
    level_bins: int = 0,
    is_high: bool = False,
    wall_m: float = 0.0,
    wall_top_m: float = 0.0,
    wall_ahead_m: float = 0.0,
    **limits: float,
) -> U8:
    """Return the reasons of one line through the patch; only its middle shot has all of the row."""
    middle = M // 2
    angle = np.float32(np.pi / 2) + STEP_RAD * (np.arange(M, dtype=np.float32) - middle)
    beams = Beams(np.sin(angle), np.cos(angle))
    window = np.full((2 * MARGIN + 1, M), range_m, np.float32)
    if lines_beside is not None:
        window[:] = 9.0
        window[MARGIN - 1 : MARGIN + 2] = [[lines_beside[0]], [range_m], [lines_beside[1]]]
    counts = [np.full((5, M), value, np.uint8) for value in (near, smooth, upright, level)]
    if around_smooth is not None:
        counts[0][:] = 20
        counts[1][:] = around_smooth
        for array, value in zip(counts, (near, smooth, upright, level), strict=True):
            array[2, middle] = value
    strips = (1, STRIPS)
    is_level = np.zeros((1, 2 * STRIPS), np.uint8)
    first = STRIPS + int(2 * SIDE_M / STRIP_M) - level_bins
    is_level[:, first : first + 2 * level_bins] = 17 if is_high else 1
    return np.asarray(
        fused_labels(
            window,
            np.full((5, M), above_m, np.float32),
            Neighbours(*counts),
            np.full((5, M), walked),
            np.full((1, M), texture, np.float32),
            FilledSlots(np.full(strips, slots, np.uint64), np.full(strips, rough_slots, np.uint64)),
            Walls(
                *(
                    np.full(strips, value, np.float32)
                    for value in (wall_m, wall_top_m, wall_ahead_m)
                )
            ),
            is_level,
            np.full((1, M), kind, np.uint8),
            beams,
            STEP_RAD,
            DecisionThresholds()._replace(
                **{name: np.float32(value) for name, value in limits.items()}
            ),
        )
    )[0]


@pytest.mark.parametrize(
    "right, shot",
    [
        # noise
        (Reason.MISSING, {"range_m": np.nan, "above_m": np.nan, "near": 0}),
        (Reason.LONELY, {"near": 0, "smooth": 0}),
        (Reason.ISOLATED, LONELY),
        (Reason.ISOLATED, {**LONELY, "rough_slots": 0b0000_0011}),  # two leaves are too few
        (Reason.SPIKE, {"smooth": 0, "around_smooth": 8}),
        (Reason.BELOW_GROUND, {**ROUGH, "above_m": -0.31}),
        # few shots near, but on a surface: it is no noise
        (Reason.SMOOTH, {"near": 1, "smooth": 1}),
        (Reason.LOW, {**LONELY, "above_m": 0.05, "level": 0}),
        (Reason.SMOOTH, {"smooth": 0, "around_smooth": 5}),
        (Reason.SMOOTH, {**WALL_5M, **LONELY}),
        # ground
        (Reason.WALKED, {**LEVEL, "above_m": 0.29, "walked": True}),
        (Reason.SMOOTH, {"above_m": 0.31, "walked": True}),
        (Reason.LEVEL_LOW, {**LEVEL, "above_m": 0.11}),
        (Reason.SMOOTH, {"above_m": 0.11, "upright": 2, "level": 2}),
        (Reason.LOW, {"above_m": 0.05, "upright": 1}),
        (Reason.SMOOTH, {"above_m": 0.05, "upright": 2}),  # the foot of a wall
        # reflections
        (Reason.BEHIND_WALL, {**ROUGH, **WALL_3M, "range_m": 7.5, "near": 4}),
        (Reason.BEHIND_WALL, {**WALL_3M, "smooth": 0, "near": 4, "around_smooth": 5}),
        (Reason.IN_CAR, {**CAR, "smooth": 0, "near": 1, "above_m": 0.5, "around_smooth": 2,
                         "rough_slots": 0b1111_1111}),
        # trunks and poles
        (Reason.CROWN, {"kind": THIN, "rough_slots": 0b11111 << 8}),
        (Reason.POST, {"kind": THIN, "rough_slots": 0b1111 << 8}),  # four leaves are no crown
        (Reason.TRUNK, {"kind": THIN, "lines_beside": (5.15, 5.15)}),
        (Reason.TRUNK, {"kind": THIN, "lines_beside": (5.0, 5.3)}),  # as round, but tilted
        (Reason.POST, {"kind": THIN, "lines_beside": (5.03, 5.03)}),
        (Reason.TRUNK, {"kind": THIN, "lines_beside": (4.65, 5.35)}),  # a piece of a roof
        (Reason.POST, {"kind": POST}),
        (Reason.POST, {"kind": THIN, "lines_beside": (5.6, 5.6)}),  # that is the wall behind it
        (Reason.ARM, {**LEVEL, "kind": SHORT, "above_m": 3.5}),
        (Reason.SMOOTH, {**LEVEL, "kind": SHORT, "above_m": 2.5}),  # too low for an arm
        (Reason.SMOOTH, {**WALL_5M, "kind": THIN}),  # a pilaster
        (Reason.SMOOTH, {"kind": FEW_SHOTS}),
        (Reason.SMALL, {"kind": SMALL}),
        (Reason.SMOOTH, {"kind": FENCE}),
        (Reason.FOLIAGE, {**ROUGH, "kind": SMALL}),
        # cars
        (Reason.LEVEL_BODY, {**CAR, "above_m": 0.7}),
        (Reason.SMOOTH, {**CAR, "above_m": 4.8}),  # above its roof
        (Reason.SMOOTH, {**CAR, "slots": ALL, "above_m": 0.7}),  # a wall rises from it
        (Reason.SMOOTH, {**CAR, "level_bins": 1, "above_m": 0.7}),
        (Reason.FOLIAGE, {**ROUGH, **CAR, "above_m": 0.7}),
        (Reason.LEVEL_BODY, {**ROUGH, **CAR, "level_bins": 3, "above_m": 0.7}),
        (Reason.LEVEL_BODY, {**LORRY, "above_m": 5.5}),
        (Reason.SMOOTH, {**LORRY, "is_high": False, "above_m": 5.5}),
        # leaves and facades
        (Reason.FOLIAGE, ROUGH),
        (Reason.LEAF, {**LONELY, "rough_slots": 0b0000_0111, "upright": 3}),
        (Reason.LEAF, TWIG),
        (Reason.SMOOTH, {**TWIG, "near": 10}),
        (Reason.SMOOTH, {**TWIG, "above_m": 1.9}),
        (Reason.SMOOTH, {**TWIG, "smooth": 3}),
        (Reason.SMOOTH, {**TWIG, "near": 3, "rough_slots": 0}),
        (Reason.SMOOTH, {**TWIG, **WALL_3M, "range_m": 8.9, "wall_top_m": 2.0}),  # a roof
        (Reason.LEAF, {**TWIG, "smooth": 0, "kind": THIN, "above_m": 3.1}),
        (Reason.POST, {**TWIG, "smooth": 0, "kind": THIN}),  # low, it may be the foot of a post
        (Reason.FACADE, {**ROUGH, **WALL_5M}),
        (Reason.FACADE, {**ROUGH, **WALL_5M, "range_m": 5.9}),  # seen through its window
        (Reason.FOLIAGE, {**ROUGH, **WALL_5M, "range_m": 4.5}),  # a bush before it
        (Reason.FOLIAGE, {**ROUGH, **WALL_5M, "wall_top_m": -0.5, "above_m": 4.0}),
        (Reason.SMOOTH, {"texture": 0.41}),
        (Reason.FOLIAGE, {"texture": 0.39}),
        (Reason.SMOOTH, {"texture": 0.3, "wall_ahead_m": 6.0}),  # a balcony
    ],
)  # fmt: skip
def test_the_right_rule_decides(right, shot):
    assert Reason(reasons(**shot)[M // 2]).name == right.name


def rules_of_code() -> list[tuple[str, str]]:
    """Return label and reason of every rule, in the order of the code."""
    lists: Sequence[Any] = (_label_noise_and_ground, _label_things)
    code = "".join(getsource(rules.py_func) for rules in lists)
    rules = re.findall(r"rule = _([A-Z_]+)  # (\w+): ", code)
    assert len(rules) == len(re.findall(r"rule = _(?!OPEN)", code))
    return [(label, name.lower()) for name, label in rules]


def test_code_and_pages_have_the_rules_in_the_same_order():
    rules = rules_of_code()
    assert [LABEL_NAMES[LABELS_BY_REASON[Reason[name.upper()]]] for _, name in rules] == [
        label for label, _ in rules
    ]
    design = (ROOT / "design" / "fused.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| `(\w+)` \| (\w+) \|", design, re.MULTILINE)
    assert [(label, name) for name, label in table] == rules
    manual = (ROOT / "docs" / "fused.md").read_text(encoding="utf-8")
    steps = re.findall(r"^\d+\. (\w+).*?: (`.*`)$", manual, re.MULTILINE)
    in_manual = [(label, name) for label, names in steps for name in re.findall(r"\w+", names)]
    assert [("missing", "missing"), *in_manual] == rules


def test_a_wall_is_smooth():
    assert {*reasons().tolist()} == {int(Reason.SMOOTH)}


def test_most_shots_around_decide():
    """B building, V vegetation, G ground, N noise; every shot sees all of its three lines."""
    before = ["BBBBBBB", "BBVBGBN", "BBBBBBB"]
    after = "BBBBGBN"
    labels = np.array([[_LABELS[name] for name in line] for line in before], np.uint8)
    angle = np.float32(np.pi / 2) + STEP_RAD * np.arange(-3, 4, dtype=np.float32)
    beams = Beams(np.sin(angle), np.cos(angle))
    near_m, half_m = np.float32(1.0), np.float32(0.1)
    ranges = np.full(labels.shape, SIDE_M, np.float32)
    voted = vote_labels(labels, ranges, beams, STEP_RAD, half_m, near_m)
    assert voted.tolist() == [[_LABELS[name] for name in after]]
    ranges[1, 2] = SIDE_M - 2  # a leaf far before the wall
    voted = vote_labels(labels, ranges, beams, STEP_RAD, half_m, near_m)
    assert voted[0, 2] == Label.VEGETATION


_LABELS = {
    "B": Label.BUILDING,
    "V": Label.VEGETATION,
    "G": Label.GROUND,
    "N": Label.NOISE,
}
