"""Writer of streams as E57 (ASTM E2807).

Organised scans, one point per cell, in pieces, with the library of pye57.

A point has the row (column of the range image) and the column (scan line) of its cell, Cartesian
coordinates relative to the scanner as doubles, so that the range comes back bit for bit, and a
state that says whether there was a return.
"""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import OutputError
from prc_cli.core.files import why_not_written
from prc_cli.core.types import F64
from prc_cli.formats.writing.base import StreamItem, StreamShape, StreamWriter
from prc_cli.formats.writing.rows import stream_rows

POINTS_AT_ONCE = 1 << 17
"""Points per call of the library."""
LARGEST_INDEX = 2**31 - 1
"""Largest row or column number."""
INTENSITY_TOP = 65535.0
"""Upper limit of intensities in the header, where all lie between it and zero."""
INVALID = 2
"""State of a point without any coordinates."""

_DOUBLES = ("cartesianX", "cartesianY", "cartesianZ", "timeStamp")


class E57Stream(StreamWriter):
    """Writer of E57; scanners are scans, one after the other."""

    def __init__(self, path: Path, shape: StreamShape) -> None:
        try:
            from pye57 import libe57
        except ImportError:
            problem = "writing E57 needs pye57, which is not installed"
            raise OutputError(str(path), problem, "pip install prc-cli[e57]") from None
        super().__init__(path, shape)
        if shape.times or shape.returns:
            self._notice(
                "pye57 reads times and returns of E57 only with ignore_unsupported_fields=True"
            )
        self._library = libe57
        self._scan: _Scan | None = None
        self._done: list[int] = []
        self._fields = (
            *_DOUBLES[:3],
            "cartesianInvalidState",
            *(["intensity"] if shape.intensity or shape.returns else []),
            "rowIndex",
            "columnIndex",
            *(["returnIndex", "returnCount"] if shape.returns else []),
            *(["timeStamp"] if shape.times else []),
        )

    @property
    def losses(self) -> tuple[str, ...]:
        """Scanner numbers that are not those of the scans."""
        seen = [*self._done, *([] if self._scan is None else [self._scan.scanner])]
        if seen == list(range(len(seen))):
            return ()
        return (
            f"the numbers of the scanners ({', '.join(map(str, seen))}): scans are counted from 0",
        )

    def _start(self) -> None:
        with self._errors():
            image = self._library.ImageFile(
                os.fsencode(self._temporary), "w"
            )  # a name need not be UTF-8
            self._image = image
            self._stack.callback(self._cancel)
            image.extensionsAdd("", self._library.E57_V1_0_URI)
            root = image.root()
            root.set("formatName", self._library.StringNode(image, "ASTM E57 3D Imaging Data File"))
            root.set("guid", self._guid("file"))
            root.set(
                "versionMajor", self._library.IntegerNode(image, self._library.E57_FORMAT_MAJOR)
            )
            root.set(
                "versionMinor", self._library.IntegerNode(image, self._library.E57_FORMAT_MINOR)
            )
            root.set("coordinateMetadata", self._library.StringNode(image, ""))
            self._scans = self._library.VectorNode(image, True)
            root.set("data3D", self._scans)
            root.set("images2D", self._library.VectorNode(image, True))

    def _cancel(self) -> None:
        with contextlib.suppress(self._library.E57Exception, RuntimeError):
            if self._scan is not None:
                self._scan.writer.close()
        with contextlib.suppress(self._library.E57Exception, RuntimeError):
            self._image.cancel()

    def _guid(self, what: str) -> Any:
        # the same run gives the same names
        file_name = self.path.name.encode("utf-8", "backslashreplace").decode()
        guid = uuid.uuid5(uuid.NAMESPACE_URL, f"prc-cli:{file_name}:{what}")
        return self._library.StringNode(self._image, f"{{{str(guid).upper()}}}")

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except (self._library.E57Exception, RuntimeError) as error:
            if code := why_not_written(self._temporary):
                raise OSError(code, os.strerror(code), str(self._temporary)) from error
            text = (str(error).strip().splitlines() or [type(error).__name__])[0].strip(" *")
            raise OutputError(
                str(self.path), f"cannot be written ({text})", "check the disk"
            ) from error

    def _add(self, item: StreamItem) -> None:
        block = item.block
        if self._scan is None or self._scan.scanner != block.scanner:
            if block.scanner in self._done:
                problem = (
                    f"scanner {block.scanner} comes again after another, "
                    "expected all lines of a scanner together"
                )
                raise OutputError(
                    str(self.path),
                    problem,
                    "write .csv, .laz or .parquet, or split the input first",
                )
            with self._errors():
                self._close_scan()
                self._scan = _Scan(self, block.scanner, block.first_line)
        lines = max(1, POINTS_AT_ONCE // block.points_per_line)
        for first in range(0, block.n_lines, lines):
            values = self._points(item, slice(first, min(first + lines, block.n_lines)))
            with self._errors():
                self._scan.write(values)

    def _close_scan(self) -> None:
        if self._scan is not None:
            self._scan.close()
            self._done.append(self._scan.scanner)
            self._scan = None

    def _close(self) -> None:
        with self._errors():
            self._close_scan()
            self._image.close()

    def _points(self, item: StreamItem, rows: slice) -> dict[str, NDArray[Any]]:
        """Return the fields of the points of some lines.

        The chosen return of a shot comes first.
        """
        block = item.block
        m = item.block.points_per_line
        values = stream_rows(item, rows)
        line = values["line"] - block.first_line
        ranges = values["range_m"].astype(np.float64)
        cell = (line - rows.start) * m + values["column"]
        gone = np.isnan(ranges)
        places = self._directions(item, rows)[cell] * ranges[:, None]
        places[gone] = 0.0
        points = {name: places[:, axis].copy() for axis, name in enumerate(_DOUBLES[:3])}
        points["cartesianInvalidState"] = gone * INVALID
        first = 0 if self._scan is None else self._scan.first_line
        points["rowIndex"] = values["column"]
        points["columnIndex"] = block.first_line - first + line
        intensity = np.zeros(len(cell), np.float32)
        if block.intensity is not None:
            intensity = np.nan_to_num(block.intensity[rows].ravel(), nan=0.0)[cell]
        # the stream has the intensity of the chosen return of a shot only
        is_further = np.append(False, cell[1:] == cell[:-1])
        points["intensity"] = np.where(is_further, np.minimum(intensity, 0.0), intensity)
        points["returnIndex"] = values["return_number"] - 1
        points["returnCount"] = values["number_of_returns"]
        if "time_s" in values:
            points["timeStamp"] = np.nan_to_num(values["time_s"], nan=0.0)
        return points

    def _directions(self, item: StreamItem, rows: slice) -> F64:
        """Return the unit vector of every beam, (shots, 3) float64.

        May be NaN for shots without return.
        """
        block = item.block
        if block.xyz_m is not None:
            places: F64 = block.xyz_m[rows].reshape(-1, 3).astype(np.float64)
            with np.errstate(invalid="ignore", divide="ignore"):
                places /= np.sqrt((places**2).sum(axis=1))[:, None]
            return places
        angle = block.angle_rad
        if angle is None:
            self._notice(
                f"no angles: {block.points_per_line} columns are spread evenly over a turn "
                "from down"
            )
            angle = 2.0 * np.pi * np.arange(block.points_per_line) / block.points_per_line
        else:
            self._notice(
                "coordinates lie in the scan plane, x = 0: the stream has ranges and angles alone"
            )
        turned = angle - (self.shape.down_rad or 0.0)
        fan = np.stack([np.zeros(len(turned)), np.sin(turned), -np.cos(turned)], axis=1)
        return np.tile(fan, (rows.stop - rows.start, 1))


class _Scan:
    """A scan that is being written."""

    def __init__(self, output: E57Stream, scanner: int, first_line: int) -> None:
        self.scanner = scanner
        self.first_line = first_line
        self._names = output._fields
        library = output._library
        image = output._image
        self._library = library
        self._image = image
        self._limits = dict.fromkeys(("rowIndex", "columnIndex", "intensity"), (np.inf, -np.inf))
        self._node = library.StructureNode(image)
        self._node.set("guid", output._guid(f"scan {len(output._done)}"))
        self._node.set("name", library.StringNode(image, f"scanner {scanner}"))
        prototype = library.StructureNode(image)
        for name in self._names:
            prototype.set(name, self._kind(name))
        points = library.CompressedVectorNode(image, prototype, library.VectorNode(image, True))
        self._node.set("points", points)
        output._scans.append(self._node)
        # the library reads every piece from the same memory
        self._buffers = {name: np.zeros(POINTS_AT_ONCE) for name in self._names}
        wrapped = library.VectorSourceDestBuffer()
        for name, values in self._buffers.items():
            wrapped.append(
                library.SourceDestBuffer(image, name, values, POINTS_AT_ONCE, True, True)
            )
        self.writer = points.writer(wrapped)

    def _kind(self, name: str) -> Any:
        library = self._library
        image = self._image
        if name in _DOUBLES:
            return library.FloatNode(image, 0.0, library.E57_DOUBLE)
        if name == "intensity":
            return library.FloatNode(image, 0.0, library.E57_SINGLE)
        top = {"cartesianInvalidState": INVALID, "returnIndex": 254, "returnCount": 255}.get(
            name, LARGEST_INDEX
        )
        return library.IntegerNode(image, 0, 0, top)

    def write(self, values: dict[str, NDArray[Any]]) -> None:
        n = len(values["rowIndex"])
        for first in range(0, n, POINTS_AT_ONCE):
            part = slice(first, min(first + POINTS_AT_ONCE, n))
            for name, buffer in self._buffers.items():
                buffer[: part.stop - first] = values[name][part]
            self.writer.write(part.stop - first)
        for name, (low, high) in self._limits.items():
            self._limits[name] = (
                min(low, float(values[name].min())),
                max(high, float(values[name].max())),
            )

    def close(self) -> None:
        self.writer.close()
        names = ("rowMinimum", "rowMaximum", "columnMinimum", "columnMaximum")
        bounds = self._library.StructureNode(self._image)
        for name, bound in zip(
            names, (*self._limits["rowIndex"], *self._limits["columnIndex"]), strict=True
        ):
            bounds.set(name, self._library.IntegerNode(self._image, int(bound)))
        self._node.set("indexBounds", bounds)
        low, high = self._limits["intensity"]
        if "intensity" in self._names and 0 <= low <= high <= INTENSITY_TOP:
            limits = self._library.StructureNode(self._image)
            for name, value in (("intensityMinimum", 0.0), ("intensityMaximum", INTENSITY_TOP)):
                limits.set(name, self._library.FloatNode(self._image, value))
            self._node.set("intensityLimits", limits)
