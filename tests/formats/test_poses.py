"""Trajectories with orientations.

TUM files and the poses of bags give the ranges that CSV positions give.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prc_cli.core.errors import InputError
from prc_cli.formats.trajectory import is_tum
from prc_cli.streams.trajectory import load_trajectory
from tests.formats.bags import recordings as made
from tests.formats.builders import of_points, write_csv

HEAD = {"crs": None, "source_crs_wkt": None, "time_offset": 0.0}


def poses(n: int = 40) -> np.ndarray:
    """Time, position and quaternion of a car on a bend: (n, 8)."""
    time_s = np.linspace(-0.1, 0.5, n)
    turn = Rotation.from_euler("zyx", np.stack([time_s, 0.02 * time_s, 0.1 * time_s], axis=1))
    xyz = np.stack([5 * time_s, np.zeros(n), np.full(n, 2.0)], axis=1)
    return np.column_stack([time_s, xyz, turn.as_quat()])


def tum(path: Path, rows: np.ndarray) -> Path:
    text = "".join(" ".join(f"{value:.9f}" for value in row) + "\n" for row in rows)
    path.write_text("# time x y z qx qy qz qw\n" + text)
    return path


def odometry(
    rows: np.ndarray,
    *,
    version: int = 2,
    kind: str = "nav_msgs/msg/Odometry",
    topic: str = "/odom",
) -> Any:
    """Messages with poses; times after a second, since stamps are not negative."""
    store = made.STORES[version]
    types = store.types
    sent = []
    for row in rows:
        time_ns = round((row[0] + 1) * 1e9)
        pose = types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](*row[1:4]),
            types["geometry_msgs/msg/Quaternion"](*row[4:]),
        )
        head = made.header(store, time_ns, "odom")
        if kind.endswith("PoseStamped"):
            message = types[kind](head, pose)
        else:
            zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
            twist = types["geometry_msgs/msg/TwistWithCovariance"](
                types["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
            )
            with_covariance = types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
            message = types[kind](head, "base_link", with_covariance, twist)
        sent.append(made.Sent(topic, kind, time_ns, message))
    return sent


def test_every_form_gives_the_positions_of_a_csv(tmp_path):
    rows = poses()
    arm = (0.5, -0.2, 1.5)
    moved = rows[:, 1:4] + Rotation.from_quat(rows[:, 4:]).apply(arm)
    columns = of_points(moved, time=rows[:, 0])
    csv = load_trajectory(write_csv(tmp_path / "track.csv", columns), **HEAD)
    sent = [*odometry(rows, version=1), *odometry(rows, version=1, topic="/x")]
    bag = made.write_bag(tmp_path / "poses.bag", sent)
    from_bag = {"topic": "/odom", "lever_arm_m": arm, "time_offset": -1.0}
    times = np.linspace(0.0, 0.4, 50)
    expected = csv.positions(times)
    for path, more in ((tum(tmp_path / "a.tum", rows), {"lever_arm_m": arm}), (bag, from_bag)):
        track = load_trajectory(path, **{**HEAD, **more})
        np.testing.assert_allclose(track.positions(times), expected, atol=2e-5)


def test_what_is_no_pose_is_refused(tmp_path):
    long = _written(tmp_path / "long.csv", "time,x,y,z\n" + "1" * 200_000)
    with pytest.raises(InputError, match="line 2: row of more than"):
        load_trajectory(long, **HEAD)  # type: ignore[arg-type]
    assert not is_tum(_written(tmp_path / "b.csv", "time x y z a b c d\n1 2 3 4 5 6 7 8\n"))
    assert not is_tum(_written(tmp_path / "c.csv", "\n# nothing\n"))


@pytest.mark.parametrize(
    "ahead, offset, name",
    [
        (18.0, 18, r"\+18 s, as UTC and GPS do"),
        (-18.0, -18, "-18 s, as UTC and GPS do"),
        (-315_964_782.0, -315964782, "UNIX and GPS time"),
        (-1_315_964_782.0, -1315964782, "UNIX and adjusted GPS time"),
        (315_964_782.0, 315964782, "UNIX and GPS time"),
    ],
)
def test_clocks_that_differ_are_named(
    tmp_path,
    ahead,
    offset,
    name,
):
    rows = poses()
    rows[:, 0] = np.linspace(1_700_000_000, 1_700_000_010, len(rows))
    track = load_trajectory(tum(tmp_path / "a.tum", rows), **HEAD)  # type: ignore[arg-type]
    with pytest.raises(
        InputError, match=rf"differ by {name}: try --set input.trajectory_time_offset={offset}$"
    ):
        track.positions(np.linspace(1_700_000_001, 1_700_000_009, 5) + ahead)


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path
