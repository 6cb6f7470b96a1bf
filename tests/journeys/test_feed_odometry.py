"""The recipes of docs/feed_odometry.md.

a folder of frames is thinned, and two libraries find the way.
"""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import load_settings
from tests.runner import runner

ROOT = Path(__file__).resolve().parent.parent.parent
N_FRAMES = 6


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """A slow drive of a coarse scanner of 16 rings.

    Its frames, thinned as the page says, in the folder ``still``.
    """
    folder = tmp_path_factory.mktemp("odometry")
    scanner = {"name": "vlp-16", "azimuth_step_deg": 1.0, "line_hz": 3600.0}
    options = {
        "scanner": scanner,
        "duration_s": N_FRAMES / 10,
        "seed": 5,
        "trajectory": {"speed_m_s": 3.0},
    }
    settings = load_settings("street", options={**options, "sight_m": 60.0})
    simulate("street", folder / "drive.npz", settings, beside=Beside(frames=folder / "frames"))
    (folder / "frames" / "velodyne").rename(folder / "velodyne")
    page = (ROOT / "docs" / "feed_odometry.md").read_text(encoding="utf-8")
    command = next(
        line for line in page.splitlines() if line.startswith("$ prc thin velodyne/ still/")
    )
    words = command.split()[2:]
    words[1:3] = [str(folder / "velodyne"), str(folder / "still")]
    result = runner().invoke(cli, [*words, "--accept-doubt", "few-rings"])
    assert result.exit_code == 0, result.stderr
    # a frame that lost all its points is there, so that the others keep their numbers
    assert len(list((folder / "still").iterdir())) == N_FRAMES
    return folder


def way_m(folder: Path) -> float:
    """True way from the first frame to the last [m]."""
    poses = np.loadtxt(folder / "frames" / "poses.txt").reshape(-1, 3, 4)
    return float(np.linalg.norm(poses[-1, :, 3] - poses[0, :, 3]))


def test_kiss_icp_reads_the_folder_as_it_is(frames, tmp_path):
    program = shutil.which("kiss_icp_pipeline")
    assert program is not None
    done = subprocess.run(
        [program, str(frames / "still")], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (poses,) = (tmp_path / "results" / "latest").glob("*poses_kitti.txt")
    track = np.loadtxt(poses).reshape(-1, 3, 4)
    assert len(track) == N_FRAMES
    # its voxels are of 1 m, and six frames are few
    assert np.linalg.norm(track[-1, :, 3] - track[0, :, 3]) == pytest.approx(way_m(frames), abs=0.8)


def test_small_gicp_reads_the_folder_as_it_is(frames, monkeypatch):
    page = (ROOT / "design" / "feed_odometry.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(frames)
    exec(compile(code, "design/feed_odometry.md", "exec"), {})
    track = np.loadtxt("poses.txt").reshape(-1, 4, 4)
    assert len(track) == N_FRAMES
    assert np.linalg.norm(track[-1, :3, 3] - track[0, :3, 3]) == pytest.approx(
        way_m(frames), rel=0.2
    )
