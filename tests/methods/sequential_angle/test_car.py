"""Cars in a line."""

from __future__ import annotations

from typing import Any

import numpy as np

from prc_cli.core.types import I32
from prc_cli.methods.sequential_angle.car import dividers
from prc_cli.methods.sequential_angle.thresholds import DividerThresholds
from tests.methods.sequential_angle.scenes import (
    NOISE_M,
    Piece,
    Seen,
    curb,
    made,
    road,
    see,
    signed_angles,
    wall,
)

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
