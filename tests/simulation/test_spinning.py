"""Scanners: presets, values and bounds; spinning ones: firings as lines, turns as frames, snow."""

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import load_settings, open_simulation

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
