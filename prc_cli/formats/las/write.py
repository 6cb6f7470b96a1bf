"""Streams as new LAS or LAZ files: the builder of classified files, with the classes and coordinates of the input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import I64, U8
from prc_cli.formats.las.build import LasBuilder, Returns, gather_returns
from prc_cli.formats.writing.options import OutputConfig
from prc_cli.formats.writing.stream_writer import NO_CODE, StreamItem, StreamShape

OFFSET_STEP_M = 1000.0
"""Registered coordinates are kept relative to a whole multiple of this [m]."""


class LasStream(LasBuilder):
    """Writer of a stream as LAS 1.4, point format 6; missing shots have no record.

    The return that stands for its shot comes first, whatever its number, so that it does so again when it is read.
    """

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path, ClassCodes(), OutputConfig(), shape.points_per_line)
        self._item: StreamItem | None = None
        self._n_codes_lost = 0
        self._has_offset = False

    @property
    def losses(self) -> tuple[str, ...]:
        """Class codes that a byte does not hold."""
        if not self._n_codes_lost:
            return ()
        unknown = f"{self._codes.unclassified} ({Label.UNCLASSIFIED.name.lower()})"
        return (f"{self._n_codes_lost} class codes outside 0 to 255: written as {unknown}",)

    def add_item(self, item: StreamItem) -> None:
        """Take a block (see :class:`prc_cli.formats.writing.stream_writer.StreamWriter`)."""
        block = item.block
        self._item = item
        if item.registered_m is not None and not self._has_offset:
            self._set_offset(item)
        codes = self._codes_of(item.codes, block.range_m.shape)
        self.add(LabelledBlock(block, codes, self._codes_of(item.extra_codes, (len(block.extra),))))

    def _set_offset(self, item: StreamItem) -> None:
        """Take the offset of the header from the first coordinates."""
        assert item.registered_m is not None
        known = item.registered_m[np.isfinite(item.registered_m).all(axis=2)]
        if len(known):
            self._offset_m = np.floor(known[0] / OFFSET_STEP_M) * OFFSET_STEP_M
            self._has_offset = True

    def _codes_of(self, codes: NDArray[np.int32] | None, shape: tuple[int, ...]) -> U8:
        """Return class codes as they are stored; what does not fit a byte, or is not known, is unclassified."""
        unknown = self._codes.unclassified
        if codes is None:
            return np.full(shape, unknown, np.uint8)
        wrong = (codes < 0) | (codes > 255)
        self._n_codes_lost += int(np.count_nonzero(wrong & (codes != NO_CODE)))
        return np.where(wrong, unknown, codes).astype(np.uint8)

    def _encode(self, labels: U8, range_m: NDArray[np.float32]) -> U8:
        return labels  # codes already

    def _gather(self, scan: ScanBlock, rows: slice) -> Returns:
        shots = gather_returns(scan, rows)
        if not (shots.extra >= 0).any():
            return shots
        order = np.lexsort((shots.number, shots.extra >= 0, shots.column, shots.line))
        moved = Returns(shots.line[order], shots.column[order], shots.range_m[order], shots.extra[order])
        moved.number, moved.count = shots.number[order], shots.count[order]
        return moved

    def _fill(self, points: NDArray[Any], scan: ScanBlock, shots: Returns) -> None:
        super()._fill(points, scan, shots)
        # the stream knows the intensity of the return that stands for a shot, not of the others
        points["intensity"][shots.extra >= 0] = 0

    def _steps(self, scan: ScanBlock, shots: Returns) -> I64:
        item = self._item
        if item is None or item.registered_m is None:
            return super()._steps(scan, shots)
        xyz = item.registered_m[shots.line, shots.column]
        other = shots.extra >= 0
        if other.any() and item.extra_registered_m is not None:
            xyz[other] = item.extra_registered_m[shots.extra[other]]
        return self._whole_steps(xyz, scan, shots)
