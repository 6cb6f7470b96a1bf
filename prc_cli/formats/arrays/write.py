"""Writers of streams as range images: ``.npz`` with all values, ``.npy`` with the ranges alone.

Arrays grow in temporary files, because an archive holds one after the other, each with its shape in front.
"""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64
from prc_cli.formats.writing.base import StagedStreamWriter, StreamItem, StreamShape
from prc_cli.formats.writing.disk import npy_header

COPY_BYTES = 1 << 20
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of every member, the same as numpy's: equal runs give equal bytes."""


class _ArrayStream(StagedStreamWriter):
    """Base class of both: one scanner, lines from 0 on without a gap."""

    one_scanner = "a range image"

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path, shape)
        self._n_lines = 0
        self._m = 0


class NpyStream(_ArrayStream):
    """Writer of (lines, M) float32 ranges, NaN = missing."""

    def _start(self) -> None:
        self._handle = self._temporary.open("w+b")
        self._stack.callback(self._handle.close)
        self._header_bytes = 0

    def _add(self, item: StreamItem) -> None:
        if not self._n_lines:
            self._m = item.block.points_per_line
            self._header_bytes = self._handle.write(npy_header("<f4", (0, self._m)))
        self._n_lines += item.block.n_lines
        self._handle.write(np.ascontiguousarray(item.block.range_m, "<f4").data)

    def _write(self) -> None:
        header = npy_header("<f4", (self._n_lines, self._m))
        # numpy pads the first axis, so both headers have the same length
        assert len(header) == self._header_bytes
        self._handle.seek(0)
        self._handle.write(header)
        self._handle.close()


class NpzStream(_ArrayStream):
    """Writer of ``range_m``, ``angle_deg``, ``time_s``, ``xyz``, ``intensity`` and ``class``, as far as there are some.

    ``class`` holds class codes, (lines, M) int32; -1 = none.
    """

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path, shape)
        self._method = zipfile.ZIP_DEFLATED if shape.compress else zipfile.ZIP_STORED
        self._angle_deg: F64 | None = None
        self._parts: dict[str, tuple[BinaryIO, str, tuple[int, ...]]] = {}

    def _start(self) -> None:
        wanted = {
            "range_m": (True, "<f4", ()),
            "time_s": (self.shape.times, "<f8", ()),
            "xyz": (self.shape.xyz, "<f4", (3,)),
            "intensity": (self.shape.intensity, "<f4", ()),
            "class": (self.shape.codes, "<i4", ()),
        }
        self._parts = {
            name: (self._scratch(), dtype, rest) for name, (present, dtype, rest) in wanted.items() if present
        }

    def _add(self, item: StreamItem) -> None:
        block = item.block
        self._m = block.points_per_line
        self._n_lines += block.n_lines
        values: dict[str, NDArray[Any] | None] = {
            "range_m": block.range_m,
            "time_s": block.time_s,
            "xyz": block.xyz_m,
            "intensity": block.intensity,
            "class": item.codes,
        }
        for name, (handle, dtype, _) in self._parts.items():
            array = values[name]
            assert array is not None
            handle.write(np.ascontiguousarray(array, dtype).data)
        if self._angle_deg is None and block.angle_rad is not None:
            self._angle_deg = np.rad2deg(block.angle_rad)

    def _write(self) -> None:
        # write to our own file object, so that a failed write shows the error of the system
        with self._temporary.open("w+b") as target, zipfile.ZipFile(target, "w", self._method) as archive:
            for name, (handle, dtype, rest) in self._parts.items():
                with self._member(archive, name) as member:
                    member.write(npy_header(dtype, (self._n_lines, self._m, *rest)))
                    handle.seek(0)
                    shutil.copyfileobj(handle, member, COPY_BYTES)
                handle.close()
            if self._angle_deg is not None:
                with self._member(archive, "angle_deg") as member:
                    member.write(npy_header("<f8", self._angle_deg.shape))
                    member.write(self._angle_deg.astype("<f8").tobytes())

    def _member(self, archive: zipfile.ZipFile, name: str) -> zipfile._ZipWriteHandle:  # type: ignore[name-defined]
        info = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
        info.compress_type = self._method
        info.create_system = 3  # the same bytes on every platform
        return archive.open(info, "w", force_zip64=True)
