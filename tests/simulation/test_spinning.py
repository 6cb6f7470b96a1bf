"""Scanners: presets, values and bounds; spinning ones: firings as lines, turns as frames, snow."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import ConfigError, OutputExistsError
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.scanners import SCANNERS
from prc_cli.simulation.settings import _with_room_to_stop, load_settings, open_simulation
from prc_cli.simulation.trajectory import MOTIONS, MotionParams

COARSE = {"name": "vlp-32c", "azimuth_step_deg": 3.0, "line_hz": 1200.0}
"""120 firings a turn, ten turns a second."""


def options(**more: object) -> dict[str, object]:
    return {"scanner": COARSE, "duration_s": 0.25, "seed": 5, **more}


def test_frames_lie_where_their_poses_say(tmp_path):
    frames = tmp_path / "frames"
    settings = load_settings("street", options=options(trajectory={"stop_every_m": 0.0}))
    simulate("street", tmp_path / "drive.npz", settings, beside=Beside(frames=frames))
    poses = np.loadtxt(frames / "poses.txt").reshape(-1, 3, 4)
    assert np.loadtxt(frames / "times.txt") == pytest.approx([0.0, 0.1, 0.2], abs=2e-4)
    assert len(poses) == 3
    whole = np.load(tmp_path / "drive.npz")["range_m"]
    heights = []
    n_points = 0
    for number, pose in enumerate(poses):
        points = np.fromfile(frames / "velodyne" / f"{number:06d}.bin", "<f4").reshape(-1, 4)
        codes = np.fromfile(frames / "labels" / f"{number:06d}.label", "<u4")
        assert len(points) == len(codes)
        # ring after ring from the lowest
        elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
        assert (np.diff(elevation) > -1e-4).all()
        n_points += len(points)
        world = points[:, :3] @ pose[:, :3].T + pose[:, 3]
        near = (codes == ClassCodes().ground) & (np.hypot(points[:, 0], points[:, 1]) < 12.0)
        heights.append(float(np.median(world[near, 2])))
    assert n_points == np.count_nonzero(~np.isnan(whole))
    assert np.ptp(heights) < 0.05
    assert 0.5 < np.linalg.norm(poses[1][:, 3]) < 3.0


def test_snow_is_noise_near_the_scanner():
    def labelled(flake_m: float) -> tuple[np.ndarray, np.ndarray]:
        settings = load_settings("street", options=options(flake_m=flake_m))
        blocks = list(open_simulation("street", settings).scan.labelled_blocks(300))
        return np.concatenate([block.block.range_m for block in blocks]), np.concatenate(
            [block.labels for block in blocks]
        )

    clear, clear_labels = labelled(0.0)
    snowy, snowy_labels = labelled(100.0)
    flakes = (snowy_labels == Label.NOISE) & (clear_labels != Label.NOISE)
    assert 0.03 < flakes.mean() < 0.15
    assert np.median(snowy[flakes]) < 15.0
    same = snowy_labels != Label.NOISE
    assert np.array_equal(snowy[same], clear[same], equal_nan=True)
    assert np.array_equal(snowy_labels[same], clear_labels[same])


def test_what_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="rising elevations of a spinning scanner"):
        load_settings("street", options=options(scanner={**COARSE, "elevations_deg": [1.0, 0.0]}))
    with pytest.raises(ConfigError, match="a scanner that does not spin"):
        simulate(
            "street",
            tmp_path / "a.npz",
            load_settings("street", options={"lines": 9}),
            beside=Beside(frames=tmp_path / "frames"),
        )
    (tmp_path / "frames").mkdir()
    with pytest.raises(OutputExistsError):
        simulate(
            "street",
            tmp_path / "a.npz",
            load_settings("street", options=options()),
            beside=Beside(frames=tmp_path / "frames"),
        )
    assert not (tmp_path / "a.npz").exists()


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
def test_senseless_values_are_refused(values):
    with pytest.raises(ValidationError):
        SCANNERS["photon-80"].changed(**values)


def test_stops_are_as_far_apart_as_braking_needs():
    car = MOTIONS["car"].model_dump()
    none = {**car, "stop_every_m": 0.0}
    far = {**car, "stop_every_m": 5000.0}
    assert _with_room_to_stop(none) == none
    assert _with_room_to_stop(far) == far
    fast = _with_room_to_stop({**car, "speed_m_s": 30.0, "stop_every_m": 5.0})
    assert fast["stop_every_m"] == math.ceil(MotionParams(**fast).braking_m / 0.3)
