"""Fans of rings have parameters of their own; figures of a real frame are in ``tests/cli/test_fused.py``."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.methods.fused import pipeline
from prc_cli.methods.fused.pipeline import FusedParams, FusedScanner


@pytest.mark.parametrize(
    ("first_deg", "last_deg", "expected"),
    [(65, 92, True), (67.5, 112.5, True), (64.9, 125.0, False), (0, 180, False), (-150, 150, False)],
)
def test_narrow_beams_are_a_fan(first_deg: float, last_deg: float, expected: bool) -> None:
    assert FusedScanner.of(np.deg2rad(np.linspace(first_deg, last_deg, 64))).is_fan == expected


def test_a_scanner_without_beams_is_no_fan() -> None:
    assert not FusedScanner.of(np.empty(0)).is_fan


def test_rings_take_the_place_of_other_parameters_and_of_no_more() -> None:
    given = FusedParams.model_validate({"rings": {"memory_lines": 7, "wall_m": 0.8}, "walls": {"share": 0.2}})
    own = pipeline.of_scanner(given, FusedScanner.of(np.deg2rad(np.linspace(65, 92, 64))))
    assert (own.ground.memory_lines, own.ground.step_m, own.ground.gap_slope) == (7, 0.1, 0.05)
    assert (own.smoothness.noise_sigmas, own.smoothness.per_step) == (1.5, 0.0)
    assert (own.walls.height_m, own.walls.share) == (0.8, 0.2)
    assert (own.leaves.share, own.leaves.share_before_walls) == (0.7, 0.1)
    assert (given.curbs.enabled, own.curbs.enabled) == (True, False)
    assert own.ground.known_m == given.ground.known_m
    assert given.ground.memory_lines == 60
