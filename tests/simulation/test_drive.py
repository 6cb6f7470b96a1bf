"""Parts of a simulated scan, on a street of one wall with results computed by hand."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.simulation.drive import SimulatedScan
from prc_cli.simulation.scanners import Scanner
from prc_cli.simulation.trajectory import MotionParams, Trajectory
from prc_cli.simulation.world import Bodies, Material, Shape

EXACT = Scanner(
    line_hz=10.0, points_per_line=360, field_deg=360.0, duty=1.0, height_m=2.0, principle="pulsed",
    divergence_mrad=0.0, exit_mm=0.001, min_range_m=0.01, max_range_m=500.0, half_range_m=5000.0, resolution_m=1e-6,
    noise_m=0.0, noise_per_m=0.0, noise_spread=0.0, lost_share=0.0,
)  # fmt: skip


def boxes(*rows: tuple[Material, tuple[float, ...]]) -> Bodies:
    """Boxes by material, centre, half edges."""
    n = len(rows)
    return Bodies(
        np.full(n, Shape.BOX, np.uint8),
        np.array([[*numbers, 0.0, 0.0, 0.0] for _, numbers in rows]),
        np.array([material for material, _ in rows], np.uint8),
        np.zeros(n),
        np.zeros((n, 2)),
        np.arange(n, dtype=np.float64),
    )


STREET = boxes(
    (Material.ASPHALT, (0.0, 0.0, -0.5, 900.0, 5.0, 0.5)),  # its top is at 0
    (Material.WALL, (0.0, 6.0, 5.0, 900.0, 1.0, 5.0)),  # its face is at y = 5
)


def near(x_m: float, y_m: float, radius_m: float, time_s: float) -> Bodies:
    return STREET


def along_x(s_m: np.ndarray[tuple[int], np.dtype[np.float64]]) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    s = np.asarray(s_m, np.float64)
    return np.stack([s, 0.0 * s, 0.0 * s], axis=1), 0.0 * s


EVEN = MotionParams(
    speed_m_s=5.0, speed_variation=0.0, stop_every_m=0.0, roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0, bounce_m=0.0,
    lean_deg=0.0,
)  # fmt: skip


def scan_of(scanner: Scanner = EXACT, *, n_lines: int = 3, sight_m: float = 100.0) -> SimulatedScan:
    platform = Trajectory(along_x, EVEN, scanner.height_m, 1)
    return SimulatedScan("test", near, scanner, platform, 1, n_lines, sight_m, with_xyz=True, with_world=True)


def test_ranges_labels_and_places_are_those_of_the_street() -> None:
    (item,) = scan_of().simulated()
    block, angle = item.labelled.block, EXACT.angle_rad()
    assert block.xyz_m is not None
    assert item.world_m is not None
    down = np.abs(angle) < np.deg2rad(45.0)
    assert np.abs(block.range_m[:, down] * np.cos(angle[down]) - 2.0).max() < 1e-5
    assert (item.labelled.labels[:, down] == Label.GROUND).all()
    wall = (angle > np.deg2rad(75.0)) & (angle < np.deg2rad(120.0))
    assert np.abs(block.range_m[:, wall] * np.sin(angle[wall]) - 5.0).max() < 1e-5
    assert (item.labelled.labels[:, wall] == Label.BUILDING).all()
    assert np.isnan(block.range_m[:, angle < -np.deg2rad(90.0)]).all()
    # the scanner moves half a metre a line, and along the line too
    assert block.time_s is not None
    assert np.abs(item.world_m[:, wall, 0] - 5.0 * block.time_s[:, wall]).max() < 1e-5
    assert np.abs(item.world_m[:, wall, 1] - 5.0).max() < 1e-5
    assert np.abs(item.world_m[:, down, 2]).max() < 1e-5
    assert np.abs(block.xyz_m[:, down, 2] + 2.0).max() < 1e-5
    assert np.abs(block.xyz_m[:, wall, 0]).max() < 1e-5
