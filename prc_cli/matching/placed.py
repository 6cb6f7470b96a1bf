"""A raw drive whose shots get coordinates from a trajectory with orientations, as a source of records."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import ScanBlock, ScanStream
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.records import RecordChunk
from prc_cli.formats.writing.disk import DiskColumn
from prc_cli.methods.rings.pipeline import is_fan
from prc_cli.streams.trajectory import Trajectory

_NAMES = ("x", "y", "z", "time", "range", "scan_line")
_KEPT = np.dtype([(name, np.float64) for name in _NAMES])
_READ_AT_ONCE = 1 << 17


@dataclass(frozen=True)
class PlacedSource:
    """Coordinates, time, range and line of every shot of a drive, by record.

    The shot of a profiler lies in its plane: down, and to the left by the scan angle; other scanners have coordinates
    relative to themselves. Both are turned by the mount, moved by the lever arm, and brought to the points by the pose.
    """

    stream: ScanStream
    track: Trajectory
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the scanner on the vehicle."""
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the trajectory's point to the scanner, on the axes of the vehicle."""
    nadir_deg: float = 0.0
    """Scan angle of the beam that points straight down."""
    format: str = "drive"
    facts: SourceFacts = field(default_factory=SourceFacts)
    dimensions: tuple[str, ...] = _NAMES

    @property
    def path(self) -> str:
        """File name, for messages."""
        return self.stream.info.path

    @property
    def n_records(self) -> int | None:
        """Number of records; None if it is not known before reading."""
        return self.stream.info.n_records

    @cached_property
    def _mount(self) -> F64:
        """Turn of the scanner on the vehicle, (3, 3) float64."""
        from scipy.spatial.transform import Rotation

        matrix: F64 = Rotation.from_euler("ZYX", self.mount_deg[::-1], degrees=True).as_matrix()
        return matrix

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Place all shots, then yield them in the order of the records; NaN where there is no return."""
        fill = (np.nan,) * (len(_NAMES) - 1) + (-1.0,)
        with DiskColumn(Path(tempfile.gettempdir()) / "placed", _KEPT, fill) as rows:
            first, stop = 0, self.n_records or 0
            for block in self.stream.blocks():
                self._place(block, rows)
                # the last shots may have no return
                stop = max(stop, len(rows), int(block.records().max(initial=-1)) + 1)
            for values in rows.chunks(_READ_AT_ONCE, stop=stop):
                yield RecordChunk(first, {name: values[name].copy() for name in names}, len(values))
                first += len(values)

    def _place(self, block: ScanBlock, rows: DiskColumn) -> None:
        extra, own = block.extra, block.records()
        if block.time_s is None:
            hint = "give the file that has them"
            raise InputError(self.path, "no times of the shots, expected some to place them by", hint)
        unit = self._directions(block)
        line = np.repeat(np.arange(block.n_lines), block.points_per_line)
        self._put(own.ravel(), unit.reshape(-1, 3), block.range_m.ravel(), block.time_s.ravel(), line, block, rows)
        at = extra.line, extra.column
        self._put(extra.record, unit[at], extra.range_m, block.time_s[at], extra.line, block, rows)

    def _put(
        self, record: I64, unit: F64, range_m: F32, time_s: F64, line: NDArray[Any], block: ScanBlock, rows: DiskColumn
    ) -> None:  # fmt: skip
        found = np.isfinite(range_m) & np.isfinite(time_s) & np.isfinite(unit).all(axis=1) & (record >= 0)
        values = np.empty(int(np.count_nonzero(found)), _KEPT)
        vector = (unit[found] * range_m[found, None].astype(np.float64)) @ self._mount.T + np.array(self.arm_m)
        values["x"], values["y"], values["z"] = self.track.places(time_s[found], vector).T
        values["time"], values["range"] = time_s[found], range_m[found]
        values["scan_line"] = block.first_line + line[found]
        rows.put(record[found], values)

    def _directions(self, block: ScanBlock) -> F64:
        """Return unit vectors of the scanner (lines, M, 3)."""
        if block.xyz_m is not None:
            with np.errstate(invalid="ignore"):
                xyz = block.xyz_m.astype(np.float64)
                return np.asarray(xyz / np.sqrt((xyz * xyz).sum(axis=2, keepdims=True)), np.float64)
        angle = block.angle_rad if block.angle_rad is not None else self.stream.info.angle_rad
        if angle is None:
            problem = "neither scan angles nor coordinates relative to the scanner, expected them to place shots by"
            raise InputError(self.path, problem, "classify it with input.angle_start and input.angle_step set")
        angle = angle - np.deg2rad(self.nadir_deg)
        if is_fan(angle):
            problem = "the beams are a fan as the rings of a spinning scanner are, and their azimuths are not known"
            raise InputError(self.path, problem, "give a file with x, y, z relative to the scanner")
        unit = np.stack([np.zeros_like(angle), np.sin(angle), -np.cos(angle)], axis=1)
        return np.broadcast_to(unit, (block.n_lines, *unit.shape))
