"""Trajectories: consistent formulas, motion of the platforms, readable files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.core.types import F64
from prc_cli.formats.trajectory import project, read_sbet, read_text
from prc_cli.simulation.scanners import SCANNERS
from prc_cli.simulation.trajectory import MOTIONS, Frame, MotionParams, Station, Trajectory, aim, write_trajectory

EVEN: dict[str, float] = {
    "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "bounce_m": 0, "lean_deg": 0, "speed_variation": 0, "stop_every_m": 0
}  # fmt: skip


def straight(distance: F64) -> tuple[F64, F64]:
    zero = np.zeros_like(distance)
    return np.stack([distance, zero, zero], axis=1), zero


def winding(distance: F64) -> tuple[F64, F64]:
    """A way that turns and climbs by 1 in 20, a metre for every metre in the plane."""
    heading = 0.5 * np.sin(distance / 60.0)
    fine = np.arange(0.0, distance.max() + 2.0, 0.5)
    x, y = (
        np.concatenate([[0], np.cumsum(0.5 * f(0.5 * np.sin((fine + 0.25) / 60.0)))[:-1]]) for f in (np.cos, np.sin)
    )
    xy = [np.interp(distance, fine, values) for values in (x, y)]
    return np.stack([*xy, distance / 20.0], axis=1), heading


def drive(**values: float) -> Trajectory:
    return Trajectory(straight, MotionParams(**{**EVEN, **values}), 2.5, seed=3)


def test_distance_speed_and_acceleration_are_derivatives_of_each_other() -> None:
    time_s = np.linspace(0, 600, 600_001)
    distance, speed, acceleration = Trajectory(straight, MOTIONS["car"], 2.5, seed=11).progress(time_s)
    assert distance[0] == 0
    np.testing.assert_allclose(np.gradient(distance, time_s)[1:-1], speed[1:-1], atol=1e-3)
    np.testing.assert_allclose(np.gradient(speed, time_s)[1:-1], acceleration[1:-1], atol=2e-3)
    assert speed.min() >= 0
    assert np.abs(acceleration).max() < 1.2 * MOTIONS["car"].brake_m_s2


@pytest.mark.parametrize("name", sorted(SCANNERS))
def test_rays_do_not_depend_on_how_lines_were_cut_into_blocks(name: str) -> None:
    scanner = SCANNERS[name]
    platform = Station(1.0, 2.0, 1.7) if scanner.is_static else Trajectory(winding, MOTIONS["car"], 2.5, seed=5)
    whole = aim(platform, scanner, 10, 7)
    for first, stop in pairwise((10, 11, 15, 17)):
        part = aim(platform, scanner, first, stop - first)
        lines = slice(first - 10, stop - 10)
        np.testing.assert_array_equal(part.time_s, whole.time_s[lines])
        np.testing.assert_allclose(part.origin, whole.origin[lines], rtol=0, atol=1e-9)
        np.testing.assert_allclose(part.direction, whole.direction[lines], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(whole.direction, axis=2), 1.0, rtol=1e-12)


def test_rays_between_poses_are_those_of_the_pose_at_their_own_time() -> None:
    scanner = SCANNERS["focus3d-120"]
    platform = Trajectory(winding, MOTIONS["backpack"], 2.0, seed=5)
    shots = aim(platform, scanner, 400, 3)
    pose = platform.pose(shots.time_s.ravel())
    own = np.einsum("nij,nj->ni", pose.turn(), np.tile(scanner.directions(), (3, 1)))
    assert np.abs(shots.origin.reshape(-1, 3) - pose.position).max() < 1e-4
    assert np.abs(shots.direction.reshape(-1, 3) - own).max() < 5e-5, "1 mm at 20 m"


def test_csv_is_what_the_reader_takes(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    platform = Trajectory(winding, MOTIONS["car"], 2.5, seed=5)
    write_trajectory(path, platform, 3.0, start_s=1000.0, frame=Frame())
    time_s, xyz_m = read_text(path)
    np.testing.assert_allclose(time_s, 1000.0 + np.arange(601) / 200.0, atol=1e-6)
    np.testing.assert_allclose(xyz_m - Frame().origin(), platform.pose(time_s - 1000.0).position, atol=1e-4)


def test_sbet_is_what_the_reader_takes(tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    path, frame = tmp_path / "drive.sbet", Frame()
    platform = Trajectory(winding, MotionParams(**EVEN), 2.5, seed=5)
    write_trajectory(path, platform, 3.0, frame=frame)
    time_s, position = read_sbet(path, path.stat().st_size)
    xyz_m = project(path, position, frame.crs)
    np.testing.assert_allclose(xyz_m - frame.origin(), platform.pose(time_s).position, atol=1e-5)
    # true heading and velocity against the geodesic from place to place; the way has corners of 0.2 degrees, and the
    # meridian converges by 2 degrees
    records = np.fromfile(path, "<f8").reshape(-1, 17)
    longitude, latitude = np.degrees(position[:, 0]), np.degrees(position[:, 1])
    azimuth, _, way = pyproj.Geod(ellps="WGS84").inv(longitude[:-1], latitude[:-1], longitude[1:], latitude[1:])
    np.testing.assert_allclose(np.degrees(records[:-1, 9]), azimuth % 360.0, atol=0.25)
    np.testing.assert_allclose(np.arctan2(records[:-1, 5], records[:-1, 4]), np.radians(azimuth), atol=5e-3)
    np.testing.assert_allclose(np.hypot(records[:-1, 4], records[:-1, 5]), way * 200.0, rtol=2e-3)
    np.testing.assert_allclose(records[:, 8], np.arctan(1 / 20), atol=1e-6, err_msg="nose up is positive there")


def test_sbet_needs_a_place_on_earth(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere on earth"):
        write_trajectory(tmp_path / "drive.out", drive(), 1.0)
    pytest.importorskip("pyproj")
    with pytest.raises(ConfigError, match="not a projected one"):
        write_trajectory(tmp_path / "drive.out", drive(), 1.0, frame=Frame(crs="EPSG:4326"))
    with pytest.raises(ConfigError, match="cannot be used"):
        write_trajectory(tmp_path / "drive.out", drive(), 1.0, frame=Frame(crs="EPSG:0"))
    assert not list(tmp_path.iterdir())
