"""A folder of frames as KITTI and SemanticKITTI store them: points, classes, poses and times of every turn."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from types import TracebackType

import numpy as np

from prc_cli.core.files import output_errors, temporary_name
from prc_cli.core.types import F64
from prc_cli.formats.writing.base import StreamItem


class FrameFolder:
    """Writes ``velodyne/NNNNNN.bin``, ``labels/NNNNNN.label``, ``poses.txt`` and ``times.txt``; whole or not at all.

    Points are float32 x, y, z, intensity of the returns, ring after ring from the lowest, each ring in the order of
    firing; classes are uint32 class codes. A pose is the first three rows of the matrix that brings points of the
    middle of the turn to the frame of the first pose; a time is that of the turn's first shot [s].
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._temporary = temporary_name(folder)
        self._poses: list[F64] = []
        self._times: list[float] = []

    def __enter__(self) -> FrameFolder:
        with output_errors(self.folder):
            for name in ("velodyne", "labels"):
                (self._temporary / name).mkdir(parents=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with contextlib.suppress(OSError):
            shutil.rmtree(self._temporary, ignore_errors=True)

    def add(self, item: StreamItem, pose: F64) -> None:
        """Take a turn: a block of firings with coordinates and classes, and its pose, (4, 4) float64."""
        block = item.block
        assert block.xyz_m is not None
        assert block.time_s is not None
        assert item.codes is not None
        seen = ~np.isnan(block.range_m.T)
        points = np.zeros((int(seen.sum()), 4), "<f4")
        points[:, :3] = block.xyz_m.transpose(1, 0, 2)[seen]
        if block.intensity is not None:
            points[:, 3] = block.intensity.T[seen]
        name = f"{len(self._poses):06d}"
        with output_errors(self.folder):
            points.tofile(self._temporary / "velodyne" / f"{name}.bin")
            item.codes.T[seen].astype("<u4").tofile(self._temporary / "labels" / f"{name}.label")
        self._poses.append(pose)
        self._times.append(float(block.time_s[0].min()))

    def finish(self) -> None:
        """Write poses and times, and give the folder its name."""
        start = np.linalg.inv(self._poses[0]) if self._poses else np.eye(4)
        rows = [(start @ pose)[:3].ravel() for pose in self._poses]
        with output_errors(self.folder):
            np.savetxt(self._temporary / "poses.txt", np.array(rows).reshape(-1, 12), fmt="%.9g")
            np.savetxt(self._temporary / "times.txt", np.array(self._times), fmt="%.6f")
            self._temporary.rename(self.folder)
