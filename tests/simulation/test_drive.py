"""Whole simulated scans."""

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.types import F64
from prc_cli.formats.trajectory import project, read_sbet, read_text
from prc_cli.simulation.drive import SimulatedScan
from prc_cli.simulation.scanners import Scanner
from prc_cli.simulation.trajectory import (
    MOTIONS,
    Frame,
    MotionParams,
    Trajectory,
    write_trajectory,
)
from prc_cli.simulation.world import Bodies, Material, Shape

EXACT = Scanner(
    line_hz=10.0,
    points_per_line=360,
    field_deg=360.0,
    duty=1.0,
    height_m=2.0,
    principle="pulsed",
    divergence_mrad=0.0,
    exit_mm=0.001,
    min_range_m=0.01,
    max_range_m=500.0,
    half_range_m=5000.0,
    resolution_m=1e-6,
    noise_m=0.0,
    noise_per_m=0.0,
    noise_spread=0.0,
    lost_share=0.0,
)


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


def near(
    x_m: float,
    y_m: float,
    radius_m: float,
    time_s: float,
) -> Bodies:
    return STREET


def along_x(s_m: np.ndarray[tuple[int], np.dtype[np.float64]]) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    s = np.asarray(s_m, np.float64)
    return np.stack([s, 0.0 * s, 0.0 * s], axis=1), 0.0 * s


EVEN = MotionParams(
    speed_m_s=5.0,
    speed_variation=0.0,
    stop_every_m=0.0,
    roll_deg=0.0,
    pitch_deg=0.0,
    yaw_deg=0.0,
    bounce_m=0.0,
    lean_deg=0.0,
)


def scan_of(scanner: Scanner = EXACT, *, n_lines: int = 3, sight_m: float = 100.0) -> SimulatedScan:
    platform = Trajectory(along_x, EVEN, scanner.height_m, 1)
    return SimulatedScan(
        "test", near, scanner, platform, 1, n_lines, sight_m, with_xyz=True, with_world=True
    )


def test_ranges_labels_and_places_are_those_of_the_street():
    (item,) = scan_of().simulated()
    block = item.labelled.block
    angle = EXACT.angle_rad()
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


STEADY: dict[str, float] = {
    "roll_deg": 0,
    "pitch_deg": 0,
    "yaw_deg": 0,
    "bounce_m": 0,
    "lean_deg": 0,
    "speed_variation": 0,
    "stop_every_m": 0,
}


def straight(distance: F64) -> tuple[F64, F64]:
    zero = np.zeros_like(distance)
    return np.stack([distance, zero, zero], axis=1), zero


def winding(distance: F64) -> tuple[F64, F64]:
    """A way that turns and climbs by 1 in 20, a metre for every metre in the plane."""
    heading = 0.5 * np.sin(distance / 60.0)
    fine = np.arange(0.0, distance.max() + 2.0, 0.5)
    x, y = (
        np.concatenate([[0], np.cumsum(0.5 * f(0.5 * np.sin((fine + 0.25) / 60.0)))[:-1]])
        for f in (np.cos, np.sin)
    )
    xy = [np.interp(distance, fine, values) for values in (x, y)]
    return np.stack([*xy, distance / 20.0], axis=1), heading


def drive(**values: float) -> Trajectory:
    return Trajectory(straight, MotionParams(**{**STEADY, **values}), 2.5, seed=3)


def test_csv_is_what_the_reader_takes(tmp_path):
    path = tmp_path / "drive.csv"
    platform = Trajectory(winding, MOTIONS["car"], 2.5, seed=5)
    write_trajectory(path, platform, 3.0, start_s=1000.0, frame=Frame())
    time_s, xyz_m = read_text(path)
    np.testing.assert_allclose(time_s, 1000.0 + np.arange(601) / 200.0, atol=1e-6)
    np.testing.assert_allclose(
        xyz_m - Frame().origin(), platform.pose(time_s - 1000.0).position, atol=1e-4
    )


def test_sbet_is_what_the_reader_takes(tmp_path):
    pyproj = pytest.importorskip("pyproj")
    path = tmp_path / "drive.sbet"
    frame = Frame()
    platform = Trajectory(winding, MotionParams(**STEADY), 2.5, seed=5)
    assert MotionParams(speed_m_s=10.0, brake_m_s2=2.0).braking_m == pytest.approx(12.5 * np.pi)
    write_trajectory(path, platform, 3.0, frame=frame)
    time_s, position = read_sbet(path, path.stat().st_size)
    xyz_m = project(path, position, frame.crs)
    np.testing.assert_allclose(xyz_m - frame.origin(), platform.pose(time_s).position, atol=1e-5)
    # true heading against the geodesic from place to place; the way has corners of 0.2
    # degrees, and the meridian converges by 2 degrees
    records = np.fromfile(path, "<f8").reshape(-1, 17)
    longitude = np.degrees(position[:, 0])
    latitude = np.degrees(position[:, 1])
    azimuth, _, _ = pyproj.Geod(ellps="WGS84").inv(
        longitude[:-1], latitude[:-1], longitude[1:], latitude[1:]
    )
    np.testing.assert_allclose(np.degrees(records[:-1, 9]), azimuth % 360.0, atol=0.25)
    np.testing.assert_allclose(
        records[:, 8], np.arctan(1 / 20), atol=1e-6, err_msg="nose up is positive there"
    )
