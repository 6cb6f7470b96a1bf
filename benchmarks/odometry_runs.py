"""Odometry of frames by KISS-ICP, GenZ-ICP and small_gicp, as their own examples run them, and how
far it is off.

Every frame is straightened before by the motion of the two frames before it (constant velocity),
the same way for all: KITTI's frames carry no times, and the time of a point follows from its
azimuth."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import small_gicp
from evo.core import metrics
from evo.core.trajectory import PosePath3D
from genz_icp.config import load_config as genz_config
from genz_icp.genz_icp import GenZICP
from kiss_icp.config import load_config as kiss_config
from kiss_icp.kiss_icp import KissICP
from scipy.spatial.transform import Rotation

from prc_cli.core.types import F64, I64

FAILED_M = 2.0
"""A run fails where a pose is farther from its true one [m], both counted from the first pose.

Or where it stops.
"""
FAILED_SHARE = 0.05
"""The same as a share of the way; the greater counts."""
DOWN_M = 0.25
VOXEL_M = 1.0
"""small_gicp: as its example of odometry, points one in 0.25 m, voxels of the map 1 m."""
NEAR_M = 1.0
N_KEPT = 10
N_TURNS = 15
"""Class to class: largest distance of a pair [m], frames of the map, iterations."""

Step = Callable[[F64, I64], F64]
"""Takes a frame, (n, 3) float64, and the classes of its points, (n,) int64.

Returns its pose, (4, 4).
"""


def kiss() -> Step:
    """Return KISS-ICP with its own configuration."""
    config = kiss_config(None)
    config.data.deskew = False
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    no_times = np.empty(0)

    def step(points: F64, _: I64) -> F64:
        odometry.register_frame(points, no_times)
        return np.array(odometry.last_pose)

    return step


def genz() -> Step:
    """Return GenZ-ICP with its own configuration."""
    config = genz_config(None)
    config.registration.max_num_threads = 1
    odometry = GenZICP(config)
    no_times = np.empty(0)

    def step(points: F64, _: I64) -> F64:
        odometry.register_frame(points, no_times)
        return np.array(odometry.last_pose)

    return step


class Small:
    """small_gicp: a frame against the Gaussian voxels of the frames before (VGICP)."""

    def __init__(self) -> None:
        self.map = small_gicp.GaussianVoxelMap(VOXEL_M)
        self.pose = np.eye(4)
        self.delta = np.eye(4)
        self.is_first = True

    def __call__(self, points: F64, _: I64) -> F64:
        cloud, _tree = small_gicp.preprocess_points(points, downsampling_resolution=DOWN_M)
        if not self.is_first:
            alignment = small_gicp.align(
                self.map, cloud, init_T_target_source=self.pose @ self.delta
            )
            self.delta = np.linalg.inv(self.pose) @ alignment.T_target_source
            self.pose = np.array(alignment.T_target_source)
        self.is_first = False
        self.map.insert(cloud, self.pose)
        return self.pose


class ClassToClass:
    """Points to planes of the ten frames before, pairs within a class.

    Trees and normals are small_gicp's.
    """

    def __init__(self) -> None:
        self.pose = np.eye(4)
        self.delta = np.eye(4)
        self.kept: deque[dict[int, tuple[F64, F64]]] = deque(maxlen=N_KEPT)

    def __call__(self, points: F64, classes: I64) -> F64:
        by_label = {}
        for label in np.unique(classes).tolist():
            mine = points[classes == label]
            if len(mine) > 20:
                cloud, _ = small_gicp.preprocess_points(mine, downsampling_resolution=DOWN_M)
                by_label[label] = np.array(cloud.points()[:, :3]), np.array(cloud.normals()[:, :3])
        if self.kept:
            before = self.pose
            self.pose = self._aligned(by_label, self.pose @ self.delta)
            self.delta = np.linalg.inv(before) @ self.pose
        turn = self.pose[:3, :3]
        shift = self.pose[:3, 3]
        self.kept.append(
            {
                label: (xyz @ turn.T + shift, normal @ turn.T)
                for label, (xyz, normal) in by_label.items()
            }
        )
        return self.pose

    def _aligned(self, by_label: dict[int, tuple[F64, F64]], pose: F64) -> F64:
        """Return the pose of a frame, by Gauss-Newton with Cauchy's weights."""
        sides = []
        for label, (points, _) in by_label.items():
            there = [frame[label] for frame in self.kept if label in frame]
            if there:
                xyz, normal = (np.concatenate(arrays) for arrays in zip(*there, strict=True))
                sides.append((points, xyz, normal, small_gicp.KdTree(xyz)))
        for _ in range(N_TURNS):
            lines = []
            apart = []
            for points, xyz, normal, tree in sides:
                moved = points @ pose[:3, :3].T + pose[:3, 3]
                which, squares = map(np.asarray, tree.batch_nearest_neighbor_search(moved))
                near = squares < NEAR_M**2
                moved = moved[near]
                targets = xyz[which[near]]
                up = normal[which[near]]
                lines.append(np.hstack([np.cross(moved - pose[:3, 3], up), up]))
                apart.append(((moved - targets) * up).sum(axis=1))
            rows = np.concatenate(lines)
            off = np.concatenate(apart)
            weight = 1.0 / (1.0 + (off / 0.1) ** 2)
            step = -np.linalg.lstsq(
                rows.T @ (rows * weight[:, None]), rows.T @ (off * weight), rcond=None
            )[0]
            pose = pose.copy()
            pose[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ pose[:3, :3]
            pose[:3, 3] += step[3:]
            if np.abs(step).max() < 1e-4:
                break
        return pose


LIBRARIES: dict[str, Callable[[], Step]] = {"KISS-ICP": kiss, "GenZ-ICP": genz, "small_gicp": Small}
CLASS_TO_CLASS = "point to plane"
"""Name of what matches class to class."""
_ALL = {**LIBRARIES, CLASS_TO_CLASS: ClassToClass}


def straightened(points: F64, delta: F64) -> F64:
    """Return points as seen from the middle of the turn, (n, 3).

    a turn begins at azimuth 0 and goes to the left.
    """
    after = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi) / (2 * np.pi) - 0.5
    turn = Rotation.from_matrix(delta[:3, :3]).as_rotvec()
    return Rotation.from_rotvec(after[:, None] * turn).apply(points) + after[:, None] * delta[:3, 3]


@dataclass(frozen=True, slots=True)
class Run:
    """How far an odometry is off."""

    ate_m: float
    """Root mean square of the positions' errors after alignment (evo) [m]."""
    rpe_m: float
    """Root mean square of the errors from frame to frame (evo) [m]."""
    is_failed: bool
    ms: float
    """Time of a frame [ms]."""
    points: float
    """Points of a frame, as the library gets them."""
    path_m: F64
    """(n, 3) positions, from the first."""


def run(name: str, frames: Iterable[tuple[F64, I64]], truth: F64) -> Run:
    """Run a library over frames and their classes; truth is (n, 4, 4), from the first pose."""
    step = _ALL[name]()
    poses = [np.eye(4)]
    n_points = 0
    spent = 0.0
    delta = np.eye(4)
    for k, (points, classes) in enumerate(frames):
        ready = straightened(points, delta)
        n_points += len(points)
        start = time.perf_counter()
        try:
            pose = step(ready, classes)
        except (RuntimeError, ValueError):
            break
        spent += time.perf_counter() - start
        if not np.isfinite(pose).all():
            break
        if k:
            delta = np.linalg.inv(poses[-1]) @ pose
            poses.append(pose)
    path = np.array(poses)
    n = len(path)
    ms = 1e3 * spent / n
    mean = n_points / n
    away = np.linalg.norm(path[:, :3, 3] - truth[:n, :3, 3], axis=1)
    way_m = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    is_failed = n < len(truth) or bool(away.max() > max(FAILED_M, FAILED_SHARE * way_m))
    if n < 10:
        return Run(*[float("nan")] * 2, True, ms, mean, path[:, :3, 3])
    return Run(*_evo(truth[:n], path), is_failed, ms, mean, path[:, :3, 3])


def _evo(truth: F64, estimate: F64) -> tuple[float, float]:
    sides = [PosePath3D(poses_se3=[_rigid(pose) for pose in poses]) for poses in (truth, estimate)]
    relative = metrics.RPE(metrics.PoseRelation.translation_part, 1, metrics.Unit.frames)
    relative.process_data(tuple(sides))
    sides[1].align(sides[0])
    absolute = metrics.APE(metrics.PoseRelation.translation_part)
    absolute.process_data(tuple(sides))
    kind = metrics.StatisticsType.rmse
    return float(absolute.get_statistic(kind)), float(relative.get_statistic(kind))


def _rigid(pose: F64) -> F64:
    """Return a pose whose rotation is one in all digits, (4, 4)."""
    rigid = np.eye(4)
    rigid[:3, :3] = Rotation.from_matrix(pose[:3, :3]).as_matrix()
    rigid[:3, 3] = pose[:3, 3]
    return rigid
