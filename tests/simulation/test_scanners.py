"""Presets of scanners: values from the papers, and bounds."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from prc_cli.simulation.scanners import SCANNERS


@pytest.mark.parametrize(
    ("name", "line_hz", "points"),
    [("photon-80", 48.0, 2154), ("focus3d-120", 97.0, 4270), ("profiler-1mhz", 200.0, 5000)],
)
def test_profilers_have_the_published_rates(name: str, line_hz: float, points: int) -> None:
    scanner = SCANNERS[name]
    assert (scanner.line_hz, scanner.points_per_line) == (line_hz, points)


def test_dead_angle_of_the_focus_points_down_and_the_sky_lies_amid_the_line() -> None:
    """Lehtola et al. (2019, III and IV-C): 55 degrees downward, M = 4270 shots of 5040 steps a turn."""
    scanner = SCANNERS["focus3d-120"].changed(slant_deg=0.0)
    angle = np.rad2deg(scanner.angle_rad())
    assert angle[0] == pytest.approx(55.0 / 2.0, abs=0.05)
    assert 360.0 - angle[-1] == pytest.approx(55.0 / 2.0, abs=0.05)
    assert scanner.step_rad == pytest.approx(2.0 * np.pi / 5040)
    assert scanner.directions()[scanner.points_per_line // 2, 2] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("name", sorted(SCANNERS))
def test_directions_are_unit_vectors_and_shots_fit_into_the_line(name: str) -> None:
    scanner = SCANNERS[name]
    assert scanner.directions().shape == (scanner.points_per_line, 3)
    np.testing.assert_allclose(np.linalg.norm(scanner.directions(), axis=1), 1.0, rtol=1e-12)
    assert scanner.shot_s * scanner.points_per_line <= 1.0 / scanner.line_hz * (1.0 + 1e-12)


def test_mount_turns_the_plane() -> None:
    """Heading by 90 degrees: left becomes back; roll by 10 degrees: what was down is 10 degrees to the left."""
    scanner = SCANNERS["photon-80"].changed(slant_deg=0.0)
    angle = scanner.angle_rad()
    turned = scanner.changed(heading_deg=90.0).directions()
    np.testing.assert_allclose(turned[:, 0], -np.sin(angle), atol=1e-12)
    rolled = scanner.changed(roll_deg=10.0).directions()
    np.testing.assert_allclose(rolled[:, 1], np.sin(angle + np.deg2rad(10.0)), atol=1e-12)


@pytest.mark.parametrize(
    "values",
    [
        {"max_range_m": 0.5},
        {"min_range_m": 9.0, "max_range_m": 5.0},
        {"pane_share": 0.7, "ghost_share": 0.4},
        {"is_static": True},
        {"colour": "red"},
        {"noise_m": float("nan")},
    ],
)
def test_senseless_values_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        SCANNERS["photon-80"].changed(**values)
