"""Fans of rings have parameters of their own; figures of a real frame are in ``tests/cli/test_fused.py``."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.methods.fused.pipeline import FusedScanner
from prc_cli.methods.fused.thresholds import RINGS, STREET


@pytest.mark.parametrize(
    ("first_deg", "last_deg", "expected"),
    [(65, 92, True), (67.5, 112.5, True), (64.9, 125.0, False), (0, 180, False), (-150, 150, False)],
)
def test_narrow_beams_are_a_fan(first_deg: float, last_deg: float, expected: bool) -> None:
    assert FusedScanner.of(np.deg2rad(np.linspace(first_deg, last_deg, 64))).limits is (RINGS if expected else STREET)


def test_a_scanner_without_beams_is_no_fan() -> None:
    assert FusedScanner.of(np.empty(0)).limits is STREET
