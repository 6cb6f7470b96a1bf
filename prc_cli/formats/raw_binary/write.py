"""Writers of raw dumps with a configuration beside them, and of folders of frames (KITTI)."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import numpy as np

from prc_cli.core.files import discard, output_errors, place_all, temporary_name
from prc_cli.core.types import F64, I64
from prc_cli.formats.writing.base import StreamItem, StreamShape, StreamWriter
from prc_cli.formats.writing.columns import coordinates

EVEN_RAD = 1e-10
"""Angles are written as start and step if all are this close to even steps [rad]."""


_FRAME = ("x", "y", "z", "intensity")


def config_path(path: Path) -> Path:
    """Return the name of the configuration beside a raw dump.

    >>> config_path(Path("drive.bin")).name
    'drive.bin.toml'
    """
    return path.with_name(path.name + ".toml")


def open_stream(path: Path, shape: StreamShape) -> StreamWriter:
    """Return the writer of a dump; a frame for returns with coordinates relative to the scanner."""
    return FrameStream(path, shape) if shape.points and shape.xyz else RawStream(path, shape)


class FrameStream(StreamWriter):
    """Writer of a frame of KITTI: float32 x, y, z, intensity in the order of the input."""

    one_scanner = "a frame"

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path, shape)
        self._config_temporary = self._output(config_path(path))
        self._records: list[I64] = []

    def _add(self, item: StreamItem) -> None:
        block = item.block
        extra = item.block.extra
        has_return = ~np.isnan(block.range_m)
        xyz, extra_xyz = coordinates(block, None)[0]
        if item.extra_registered_m is not None:
            extra_xyz = item.extra_registered_m
        points = np.zeros((int(has_return.sum()) + len(extra), 4), "<f4")
        points[:, :3] = np.concatenate([xyz[has_return], extra_xyz])
        if block.intensity is not None:
            points[: int(has_return.sum()), 3] = np.nan_to_num(block.intensity[has_return])
        if extra.intensity is not None:
            points[int(has_return.sum()) :, 3] = np.nan_to_num(extra.intensity)
        self._records.append(np.concatenate([block.records()[has_return], extra.record]))
        self._handle.write(points.data)

    def _close(self) -> None:
        record = np.concatenate(self._records) if self._records else np.empty(0, np.int64)
        if (record[1:] < record[:-1]).any():
            self._handle.seek(0)
            points = np.frombuffer(self._handle.read(), "<f4").reshape(-1, 4)
            self._handle.seek(0)
            self._handle.write(points[np.argsort(record, kind="stable")].data)
        self._handle.close()
        rules = [
            "[input]",
            'lines = "rings"',
            f"points_per_line = {self.shape.points_per_line}",
        ] * self.shape.rings
        lines = [
            f"# the points of {self.path.name}",
            *rules,
            *_layout(np.dtype([(name, "f4") for name in _FRAME])),
        ]
        self._config_temporary.write_text("\n".join(lines), encoding="utf-8")


class RawStream(StreamWriter):
    """Writer of little-endian records: range, intensity, time, x, y, z, angle, class."""

    one_scanner = "a raw dump"

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path, shape)
        self._config_temporary = self._output(config_path(path))
        self._dtype: np.dtype[np.void] | None = None
        self._m = 0
        self._even: tuple[float, float] | None = None

    def _open(self, item: StreamItem) -> np.dtype[np.void]:
        shape = self.shape
        self._m = item.block.points_per_line
        angle_rad = item.block.angle_rad
        # with registered heights, write the angle per record: both are needed to find straight down
        if angle_rad is not None and not shape.registered:
            degrees: F64 = np.rad2deg(angle_rad).round(10)
            self._even = even_steps(degrees)
        xyz = "<f8" if shape.registered else "<f4"
        wanted = [
            ("range", "<f4", True),
            ("intensity", "<f4", shape.intensity),
            ("time", "<f8", shape.times),
            *((axis, xyz, shape.xyz or shape.registered) for axis in "xyz"),
            ("angle", "<f8", shape.angles and self._even is None),
            ("class", "<i4", shape.codes),
        ]
        return np.dtype([(name, kind) for name, kind, present in wanted if present])

    def _add(self, item: StreamItem) -> None:
        if self._dtype is None:
            self._dtype = self._open(item)
        block = item.block
        shots = np.empty(block.range_m.shape, self._dtype)
        shots["range"] = block.range_m
        names = self._dtype.names or ()
        for name, image in (
            ("intensity", block.intensity),
            ("time", block.time_s),
            ("class", item.codes),
        ):
            if name in names and image is not None:
                shots[name] = image
        xyz = item.registered_m if item.registered_m is not None else block.xyz_m
        if xyz is not None:
            for index, axis in enumerate("xyz"):
                shots[axis] = xyz[:, :, index]
        if "angle" in names:
            shots["angle"] = block.angle_rad
        self._handle.write(shots.data)

    def _close(self) -> None:
        self._handle.close()
        assert self._dtype is not None
        lines = [
            f"# reads {self.path.name}: "
            f"prc classify {self.path.name} OUT --config {config_path(self.path).name}"
        ]
        lines += [
            "",
            "[input]",
            'lines = "fixed"',
            'columns = "order"',
            'range = "dimension:range"',
        ]
        if self._even is not None:
            lines += [f"angle_start = {self._even[0]!r}", f"angle_step = {self._even[1]!r}"]
        if self.shape.down_rad is not None and not self.shape.registered:
            lines += [f"nadir = {float(np.rad2deg(self.shape.down_rad))!r}"]
        lines += ["", *_layout(self._dtype, f"points_per_line = {self._m}")]
        self._config_temporary.write_text("\n".join(lines), encoding="utf-8")


def _layout(dtype: np.dtype[np.void], *keys: str) -> list[str]:
    lines = ["[layout]", 'endian = "little"', *keys, "fields = ["]
    for name in dtype.names or ():
        unit = ', unit = "rad"' if name == "angle" else ""
        lines.append(f'    {{ name = "{name}", type = "{dtype[name].str[1:]}"{unit} }},')
    return [*lines, "]", ""]


def even_steps(degrees: F64) -> tuple[float, float] | None:
    """Return start and step of angles that grow evenly, None if they do not.

    >>> even_steps(np.array([10.0, 10.5, 11.0]))
    (10.0, 0.5)
    >>> even_steps(np.array([10.0, 10.5, 12.0]))
    """
    if len(degrees) < 2:
        return None
    step = float((degrees[-1] - degrees[0]) / (len(degrees) - 1))
    even = degrees[0] + step * np.arange(len(degrees))
    if step == 0 or not np.allclose(even, degrees, rtol=0.0, atol=np.rad2deg(EVEN_RAD)):
        return None
    return float(degrees[0]), step


class FrameFolder:
    """Writes ``velodyne/NNNNNN.bin``, ``labels/NNNNNN.label``, ``poses.txt``, ``times.txt``.

    Points are float32 x, y, z, intensity of the returns, ring after ring from the lowest, each ring
    in the order of firing; classes are uint32 class codes. A pose is the first three rows of the
    matrix that brings points of the middle of the turn to the frame of the first pose; a time is
    that of the turn's first shot [s].
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        discard(self._temporary)

    def add(self, item: StreamItem, pose: F64) -> None:
        """Write a turn: a block of firings with coordinates and classes; pose (4, 4) float64."""
        block = item.block
        assert block.xyz_m is not None
        assert block.time_s is not None
        assert item.codes is not None
        has_return = ~np.isnan(block.range_m.T)
        points = np.zeros((int(has_return.sum()), 4), "<f4")
        points[:, :3] = block.xyz_m.transpose(1, 0, 2)[has_return]
        if block.intensity is not None:
            points[:, 3] = block.intensity.T[has_return]
        name = f"{len(self._poses):06d}"
        with output_errors(self.folder):
            points.tofile(self._temporary / "velodyne" / f"{name}.bin")
            item.codes.T[has_return].astype("<u4").tofile(
                self._temporary / "labels" / f"{name}.label"
            )
        self._poses.append(pose)
        self._times.append(float(block.time_s[0].min()))

    def finish(self) -> None:
        """Write poses and times, and rename the folder."""
        start = np.linalg.inv(self._poses[0]) if self._poses else np.eye(4)
        rows = [(start @ pose)[:3].ravel() for pose in self._poses]
        with output_errors(self.folder):
            np.savetxt(self._temporary / "poses.txt", np.array(rows).reshape(-1, 12), fmt="%.9g")
            np.savetxt(self._temporary / "times.txt", np.array(self._times), fmt="%.6f")
            place_all([(self._temporary, self.folder, False)])
