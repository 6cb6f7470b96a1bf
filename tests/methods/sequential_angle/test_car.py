"""Cars in a line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from prc_cli.core.types import I32, Mask
from prc_cli.methods.sequential_angle.car import cars, dividers
from prc_cli.methods.sequential_angle.thresholds import CarThresholds, DividerThresholds
from tests.methods.sequential_angle.scenes import (
    NOISE_M,
    Piece,
    Seen,
    bush,
    car,
    curb,
    made,
    road,
    see,
    signed_angles,
    wall,
)


def find(seen: Seen, params: CarThresholds | None = None) -> Mask:
    signed = signed_angles(seen.lines)
    return cars(
        seen.lines,
        seen.surface,
        seen.surface,
        signed,
        seen.z_g,
        (params or CarThresholds()).at_noise(NOISE_M),
    ).car


@pytest.mark.slow
def test_recall_and_precision_on_lines_of_a_street() -> None:
    rng = np.random.default_rng(6)
    scenes: list[list[Piece]] = []
    for _ in range(60):
        distance_m = float(rng.uniform(4, 12))
        kerb = distance_m + float(rng.uniform(2.2, 3.5))
        house = kerb + float(rng.uniform(1, 6))
        vehicle = car(distance_m, glass=bool(rng.random() < 0.7), tyre=bool(rng.random() < 0.3))
        parked = vehicle if rng.random() < 0.6 else []
        tree = bush(kerb + 0.4) if rng.random() < 0.3 else []
        scenes.append(
            [
                *road(),
                *parked,
                *curb(kerb),
                *tree,
                *wall(house, 0.15, windows=bool(rng.random() < 0.5)),
            ]
        )
    seen = see(scenes, rng, scanner_m=2.2)
    marked = find(seen)
    truth = np.array([[name == "car" for name in names] for names in seen.names]) & (
        seen.surface > 0
    )
    both = (marked & truth).sum()
    assert both / truth.sum() > 0.9
    assert both / marked.sum() > 0.9


PLAIN = {
    "return_points": 0,
    "from_start": False,
    "flat_step_m": 0.0,
    "tall_m": 0.0,
    "vertical_top_m": 0.0,
    "straight_extent_m": 0.0,
    "lean_sigmas": 0.0,
}
"""Without the readings that are ours, so that every rule is tested by itself."""


def plain(**values: Any) -> DividerThresholds:
    return made(DividerThresholds, **{**PLAIN, **values})


PARAMS = plain()


def find_intervals(
    seen: Seen,
    params: DividerThresholds = PARAMS,
    *,
    trigger: int = 0,
    noise_m: float = NOISE_M,
) -> I32:
    triggers = np.full(len(seen.surface), trigger, np.int32)
    literal = params.change_chord_m == 0
    signed = signed_angles(seen.lines) if literal else np.full_like(seen.lines.range_m, np.nan)
    return dividers(
        seen.lines, seen.surface, signed, triggers, seen.z_g, params.at_noise(noise_m)
    ).pieces


def share_of_lines(
    pieces: list[Piece], params: DividerThresholds, at_m: float, **how: Any
) -> float:
    """Share of 100 lines with an interval that begins within 40 cm of a distance."""
    seen = see([pieces] * 100, np.random.default_rng(4), **how)
    rows = [
        row
        for row, first, _ in find_intervals(seen, params)
        if abs(seen.lines.horizontal_m[row, first] - at_m) < 0.4
    ]
    return len(set(rows)) / 100


ALL_SUDDEN = plain(sudden_from_deg=-180, sudden_to_deg=180, vertical_extent_m=100, under_m=0.03)
"""Every change is sudden, so that TestUnder alone decides; 1 cm is within this noise near by."""


@pytest.mark.slow
@pytest.mark.parametrize("distance", [4.0, 7.0, 12.0])
@pytest.mark.parametrize("step_deg", [0.06, 0.115, 0.2])
def test_something_is_under_the_side_of_a_car_but_not_under_walls_and_curbs(
    distance: float, step_deg: float
) -> None:
    how = {"step_deg": step_deg, "high_deg": 95.0}
    assert share_of_lines([*road(), *car(distance)], ALL_SUDDEN, distance, **how) == 1
    assert share_of_lines([*road(), *wall(distance)], ALL_SUDDEN, distance, **how) == 0
    assert share_of_lines([*road(), *curb(distance)], ALL_SUDDEN, distance, **how) == 0


def test_walls_curbs_and_poles_give_no_interval() -> None:
    rng = np.random.default_rng(9)
    pole = [Piece("pole", (5.0, 0.0), (5.0, 1.1))]
    scenes = [
        [*road()],
        [*road(), *wall(9)],
        [*road(), *curb(9), *wall(12, 0.15, windows=True)],
        [*road(), *pole],
    ]
    seen = see(scenes * 25, rng)
    sudden = plain(sudden_from_deg=-60, sudden_to_deg=60)
    assert len(find_intervals(seen, sudden)) == 0
    assert len(set(find_intervals(seen)[:, 0].tolist())) <= 8, (
        "some of a hundred changes look gradual"
    )
