"""Writers of streams as range images: ``.npz`` with all values, ``.npy`` with the ranges alone.

Arrays grow in temporary files, because an archive stores one after the other.
"""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from prc_cli.core.types import F64
from prc_cli.formats.writing.base import StreamItem, StreamShape, StreamWriter
from prc_cli.formats.writing.disk import NpyFile

COPY_BYTES = 1 << 20
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of every array, as in numpy: equal runs give equal bytes."""


class NpyStream(StreamWriter):
    """Writer of (lines, M) float32 ranges, NaN = missing."""

    one_scanner = "a range image"

    _array: NpyFile | None = None

    def _add(self, item: StreamItem) -> None:
        if self._array is None:
            self._array = NpyFile(self._handle, "<f4", (item.block.points_per_line,))
        self._array.append(item.block.range_m)

    def _close(self) -> None:
        (self._array or NpyFile(self._handle, "<f4", (0,))).finish()
        self._handle.close()


class NpzStream(StreamWriter):
    """Writer of an archive of all values; ``class`` is int32, -1 = none."""

    one_scanner = "a range image"

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path, shape)
        self._method = zipfile.ZIP_DEFLATED if shape.compress else zipfile.ZIP_STORED
        self._angle_deg: F64 | None = None
        self._parts: dict[str, NpyFile] = {}

    def _add(self, item: StreamItem) -> None:
        block = item.block
        shape = self.shape
        wanted = {
            "range_m": (True, "<f4", block.range_m),
            "time_s": (shape.times, "<f8", block.time_s),
            "xyz": (shape.xyz, "<f4", block.xyz_m),
            "intensity": (shape.intensity, "<f4", block.intensity),
            "class": (shape.codes, "<i4", item.codes),
        }
        for name, (present, dtype, values) in wanted.items():
            if present:
                assert values is not None
                if name not in self._parts:
                    self._parts[name] = NpyFile(self._scratch(), dtype, values.shape[1:])
                self._parts[name].append(values)
        if self._angle_deg is None and block.angle_rad is not None:
            self._angle_deg = np.rad2deg(block.angle_rad)

    def _close(self) -> None:
        # write to our own file object, so that a failed write shows the error of the system
        with self._handle, zipfile.ZipFile(self._handle, "w", self._method) as archive:
            for name, array in self._parts.items():
                array.finish()
                with self._member(archive, name) as member:
                    shutil.copyfileobj(array.handle, member, COPY_BYTES)
                array.handle.close()
            if self._angle_deg is not None:
                with self._member(archive, "angle_deg") as member:
                    np.save(member, self._angle_deg.astype("<f8"))

    def _member(self, archive: zipfile.ZipFile, name: str) -> IO[bytes]:
        info = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
        info.compress_type = self._method
        info.create_system = 3  # the same bytes on every platform
        return archive.open(info, "w", force_zip64=True)
