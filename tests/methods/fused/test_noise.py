"""The fused classifier on noise that only a wider window tells: each question finds what it is for, and it alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, U8
from prc_cli.methods.base import LABELS_ALONE, OneByOne
from prc_cli.methods.fused.pipeline import Fused, FusedParams, FusedScanner, initial_state
from prc_cli.methods.fused.thresholds import NEVER
from tests.methods.fused.street_lines import BEAM, BUILDING, CAR, HEIGHT_M, street_lines, with_limits

SCANNER = FusedScanner.of(BEAM)


def classified(ranges: F32, **again: Any) -> U8:
    scanner = with_limits(SCANNER, again=again)
    turn = OneByOne(initial_state(scanner))
    (found,) = Fused(FusedParams()).label(ScanBlock(0, ranges), scanner, turn, LABELS_ALONE)
    return found.labels


def share(labels: U8, where: np.ndarray[Any, Any], label: Label) -> float:
    return float((labels[where] == label).mean())


@pytest.fixture(scope="module")
def street() -> tuple[F32, U8]:
    return street_lines(48)


def test_what_is_mirrored_by_a_car_is_noise(street: tuple[F32, U8]) -> None:
    ranges, kind = street[0].copy(), street[1]
    flank = (kind == CAR) & (np.abs(ranges * np.sin(BEAM) - 2.0) < 0.05)
    flank[:19] = flank[29:] = False
    chosen = np.random.default_rng(5).random(ranges.shape)
    # some of the light goes through the panes
    ranges[flank & (chosen < 0.4)] *= 1.15
    mirrored = flank & (chosen > 0.95)
    ranges[mirrored] *= 1.5
    found, former = classified(ranges), classified(ranges, mirror_m=NEVER)
    assert share(found, mirrored, Label.NOISE) > 0.9
    assert share(former, mirrored, Label.NOISE) < 0.75
    assert share(found, flank & ~mirrored, Label.CAR) > 0.9


def test_a_range_that_nothing_around_has_is_noise(street: tuple[F32, U8]) -> None:
    ranges, kind = street[0].copy(), street[1]
    rng = np.random.default_rng(8)
    height = -ranges * np.cos(BEAM) + HEIGHT_M
    chosen, wall = rng.random(ranges.shape), (kind == BUILDING) & (height > 1) & (height < 5)
    # bars before a wall: no surface is smooth enough for a spike
    behind = np.arange(ranges.shape[1]) // 4 % 2 == 0
    ranges[wall & behind] += 0.6
    alone = wall & ~behind & (chosen > 0.997)
    ranges[alone] -= 0.25
    found, former = classified(ranges), classified(ranges, alone_texture=NEVER)
    assert share(former, alone, Label.NOISE) == 0.0
    assert share(found, alone, Label.NOISE) > 0.6
    assert share(found, wall & ~alone, Label.NOISE) < 0.01


def test_labels_of_the_wider_window_do_not_depend_on_blocks(street: tuple[F32, U8]) -> None:
    ranges = street[0]
    whole = classified(ranges)
    params, state = FusedParams(lines_per_block=5), OneByOne(initial_state(SCANNER))
    parts = []
    for first in range(0, len(ranges), 5):
        block = ScanBlock(first, ranges[first : first + 5], next_m=ranges[first + 5 : first + 45])
        parts.append(Fused(params).label(block, SCANNER, state, LABELS_ALONE)[0].labels)
    assert (np.concatenate(parts) != whole).mean() < 0.002
