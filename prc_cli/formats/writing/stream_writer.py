"""Base class of the writers of whole streams: ranges, times, angles and coordinates, block by block.

A stream writer takes blocks in order and renames the file and its run record to their final names at the end.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Protocol

from prc_cli.core.errors import OutputError
from prc_cli.core.files import output_errors, temporary_name
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F64, I32
from prc_cli.formats.writing.base import (
    StagedOutput,
    Writer,
    close_quietly,
    remove_quietly,
)
from prc_cli.formats.writing.record import RunRecord

NO_CODE = -1
"""Class code of a shot without one."""


@dataclass(frozen=True, slots=True)
class StreamItem:
    """A block with classes and coordinates of its records."""

    block: ScanBlock
    codes: I32 | None = None
    """(lines, M) int32, class code of every cell, :data:`NO_CODE` = none; None where the input has no classes."""
    extra_codes: I32 | None = None
    """(n,) int32, class codes of ``block.extra``."""
    registered_m: F64 | None = None
    """(lines, M, 3) float64, coordinates of the input, or made up for a cloud [m], NaN = none; None where they are
    those of ``block.xyz_m``."""
    extra_registered_m: F64 | None = None
    """(n, 3) float64, the same for ``block.extra``."""


@dataclass(frozen=True, slots=True)
class StreamShape:
    """Which values the blocks of a stream have, known from the first block."""

    points_per_line: int
    """M, the largest of all scanners."""
    scanners: bool
    """Whether the stream may hold several scanners."""
    returns: bool
    """Whether the input counts the returns of a shot."""
    angles: bool
    times: bool
    xyz: bool
    """Whether blocks have coordinates relative to the scanner."""
    registered: bool
    """Whether blocks have coordinates of the input beside ranges."""
    intensity: bool
    codes: bool
    down_rad: float | None = None
    """Scan angle that points straight down [rad], None = unknown."""
    points: bool = False
    """Whether clouds and frames (``.ply .pcd .bin``) hold returns alone: cells without a range have no point."""
    rings: bool = False
    """Whether lines are cells of azimuth of a spinning scanner."""
    crs: str = ""
    """Coordinate system of registered coordinates, as pyproj takes it; empty = none."""
    compress: bool = False
    """Deflate the arrays of an archive (as ``numpy.savez_compressed``)."""

    @classmethod
    def of(cls, item: StreamItem, info: StreamInfo, *, scanners: bool, returns: bool) -> StreamShape:
        """Return the shape of a stream from its first block."""
        block = item.block
        return cls(
            points_per_line=info.points_per_line,
            scanners=scanners,
            returns=returns,
            angles=block.angle_rad is not None,
            times=block.time_s is not None,
            xyz=block.xyz_m is not None,
            registered=item.registered_m is not None,
            intensity=block.intensity is not None,
            codes=item.codes is not None,
            down_rad=info.down_rad,
        )


class StreamWriter(Writer, Protocol):
    """Writer that :func:`prc_cli.formats.stream_files.open_stream_writer` returns."""

    @property
    def losses(self) -> tuple[str, ...]:
        """Notices about values that the output cannot hold."""

    def add_item(self, item: StreamItem) -> None:
        """Take a block."""


class StagedStreamWriter(StagedOutput):
    """A :class:`StreamWriter` with temporary files."""

    one_scanner = ""
    """Name of the format in messages, for formats of a single scanner; empty = several scanners are allowed."""

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path)
        self.shape = shape
        self._scanner: int | None = None

    @property
    def losses(self) -> tuple[str, ...]:
        """Notices about values that the output cannot hold."""
        return ()

    def add_item(self, item: StreamItem) -> None:
        """Take a block (see :class:`StreamWriter`)."""
        scanner = item.block.scanner
        if self._scanner is None:
            self._scanner = scanner
        elif self.one_scanner and scanner != self._scanner:
            problem = (
                f"found scanners {self._scanner} and {scanner}, expected one: {self.one_scanner} holds one scanner"
            )
            raise OutputError(str(self.path), problem, "write .csv, .laz or .parquet, or split the input first")
        with output_errors(self.path):
            self._add(item)

    def finish(self, record: RunRecord) -> RunRecord:
        """Write and name the outputs (see :class:`StreamWriter`)."""
        with output_errors(self.path):
            self._write()
            record = self._with_output(replace(record, notices=(*record.notices, *self.notices)))
            self._record_temporary.write_bytes(record.to_json())
            self._commit()
        return record

    @abstractmethod
    def _add(self, item: StreamItem) -> None: ...

    @abstractmethod
    def _write(self) -> None:
        """Write the rest and close every temporary file."""

    def _scratch(self) -> BinaryIO:
        """Open a temporary file that is removed at the end."""
        path = temporary_name(self.path)
        self._stack.callback(remove_quietly, path)
        handle = path.open("w+b")
        self._stack.callback(close_quietly, handle)
        return handle
