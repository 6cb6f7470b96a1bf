"""The frame of a spinning scanner, from its rings."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.frame import SensorFrame, turning
from prc_cli.core.types import F32, I64
from prc_cli.formats.sensor_frame import find_frame, is_spinning
from tests.methods.rings.test_rings import N_RINGS, scene


def shots(n_lines: int = 1800) -> tuple[F32, I64]:
    ranges, xyz, _ = scene()
    there = np.isfinite(ranges[:n_lines])
    return xyz[:n_lines][there], np.nonzero(there)[1]


def moved(xyz: F32, turn_deg: tuple[float, float], apex_m: tuple[float, float, float]) -> F32:
    """Return coordinates in a frame in which a scanner is turned and stands elsewhere."""
    turn = turning(np.deg2rad([*turn_deg, 0.0]))
    elsewhere: F32 = (xyz.astype(np.float64) @ turn + np.array(apex_m)).astype(np.float32)
    return elsewhere


def test_the_own_frame_of_a_scanner_stays() -> None:
    assert find_frame(*shots()) is None


@pytest.mark.parametrize(
    ("turn_deg", "apex_m"),
    [
        ((0, 1), (0, 0, 0)),
        ((0, 0), (0, 0, 0.8)),
        ((0, 0), (0.3, 0, 0)),
        ((-6, 3), (1.2, -0.4, 1.9)),
        ((30, 35), (0, 0, 0)),
    ],
)
def test_axis_and_apex_are_found(
    turn_deg: tuple[float, float], apex_m: tuple[float, float, float]
) -> None:
    xyz, ring = shots()
    elsewhere = moved(xyz, turn_deg, apex_m)
    frame = find_frame(elsewhere, ring)
    assert frame is not None
    np.testing.assert_allclose(frame.apex_m, apex_m, atol=0.03)
    assert frame.lean_deg == pytest.approx(
        np.degrees(np.linalg.norm(np.radians(turn_deg))), abs=0.1
    )
    # heights and distances are those of the scanner; the azimuth may begin elsewhere
    np.testing.assert_allclose(frame.own(elsewhere)[:, 2], xyz[:, 2], atol=0.1)


def test_a_narrow_sector_tells_nothing() -> None:
    xyz, ring = shots(200)
    assert find_frame(moved(xyz, (0, 3), (0, 0, 0)), ring) is None


def test_frames_are_shown() -> None:
    assert SensorFrame(apex_m=(1.0, 0.0, 0.5)).shown() == "the scanner is at 1.00, 0.00, 0.50"


def test_lines_of_a_profiler_do_not_spin() -> None:
    angle = np.linspace(-2, 2, 100)
    line = np.stack([0 * angle, np.sin(angle), -np.cos(angle)], axis=1)
    assert not is_spinning(np.repeat(line[None].astype(np.float32), 50, axis=0))
    assert is_spinning(scene()[1][:50])
    assert scene()[1].shape[1] == N_RINGS
