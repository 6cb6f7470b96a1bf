"""Writers of new LAS or LAZ files from other formats.

The files are LAS 1.4, point format 6, one record per return, chronological. Coordinates are those
of the input, or of its scan planes one behind the other. Extra bytes contain the range bit for bit,
scan line and column.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import NO_CODE, ClassCodes, Label
from prc_cli.core.errors import OutputError
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, I64, U8
from prc_cli.core.version import __version__
from prc_cli.formats.las.header import (
    COMPRESSED,
    LASZIP_KEY,
    RECORD_KEY,
    make_vlr,
    new_header,
    standard_bytes,
)
from prc_cli.formats.las.laz import LasSink, LazSink, PointSink, Target, batch_size, new_laszip
from prc_cli.formats.las.points import SCAN_ANGLE_STEP_DEG, extra_bytes_vlr, standard_columns
from prc_cli.formats.las.vlrs import RECORD_TEXT, lookup_vlr, vlr_of_crs
from prc_cli.formats.systems import looks_geographic, units_of_system
from prc_cli.formats.writing.base import StagedWriter, StreamItem, StreamShape
from prc_cli.formats.writing.columns import (
    RANGE,
    ExtraDimension,
    LabelOutput,
    LinesApart,
    asked_columns,
)
from prc_cli.formats.writing.record import RunRecord

SCAN_LINE = ExtraDimension("scan_line", np.dtype("<u4"), "scan line in the stream")
COLUMN = ExtraDimension("column", np.dtype("<u4"), "shot in the scan line")
SCALE_M = 0.001
"""Coordinate step of built files [m]."""
SCALE_DEG = 1e-8
"""Step of longitude and latitude in built files [deg]: 1 mm; 21 deg to either side fit."""

MOST_FAR = 0.01
"""Largest share of coordinates that are damaged; more are of another unit."""
INTENSITY_STEPS = 65535.0
"""Full scale of intensities."""

OFFSET_STEP_M = 1000.0
"""Registered coordinates are stored relative to a whole multiple of this [m]."""
_POINT_FORMAT = 6


class LasBuilder(StagedWriter):
    """Writer of a new LAS or LAZ file; the chosen return of a shot is the first one."""

    def __init__(
        self, path: Path, shape: StreamShape | None = None, labels: LabelOutput | None = None
    ) -> None:
        # every built file has the range
        asked = [] if labels is None else asked_columns(labels.options)
        super().__init__(
            path, labels, [column for column in asked if column.dimension is not RANGE]
        )
        self._crs = "" if shape is None else shape.crs
        self._user_names: Mapping[int, str] = {}
        self._has_offset = True
        if labels is not None:
            self._user_names = labels.user_names
            self._has_offset = labels.place is None or isinstance(labels.place, LinesApart)
        elif shape is not None:
            # which codes come is not known before; without classes there are none
            self._user_names = ClassCodes().user_names() if shape.codes else {}
            self._has_offset = not shape.registered
        self._compress = path.suffix.lower() == ".laz"
        self._by_return = np.zeros(15, np.int64)
        self._low = np.full(3, np.iinfo(np.int64).max, np.int64)
        self._high = np.full(3, np.iinfo(np.int64).min, np.int64)
        self._offset_m = np.zeros(3)
        self._scale = np.full(3, SCALE_M)
        self._intensity_scale: float | None = None
        self._n_moved = 0
        self._n_clipped = self._n_timeless = self._n_timed = self._n_codes_lost = 0

    @property
    def losses(self) -> tuple[str, ...]:
        """Class codes that do not fit into a byte."""
        if not self._n_codes_lost:
            return ()
        unknown = f"{self._codes.unclassified} ({Label.UNCLASSIFIED.name.lower()})"
        return (f"{self._n_codes_lost} class codes outside 0 to 255: written as {unknown}",)

    def _begin(self) -> None:
        dimensions = [RANGE, SCAN_LINE, COLUMN, *(column.dimension for column in self._optional)]
        extra_columns = [(dimension.name, dimension.dtype.str) for dimension in dimensions]
        self._dtype = np.dtype([*standard_columns(_POINT_FORMAT), *extra_columns])
        n_bytes = self._dtype.itemsize
        vlrs = [extra_bytes_vlr(dimensions)]
        if self._crs and (crs := vlr_of_crs(self._crs)[0]) is not None:
            vlrs.append(crs)
        if self._compress:
            laszip = new_laszip(
                str(self.path), _POINT_FORMAT, n_bytes - standard_bytes(_POINT_FORMAT)
            )
            vlrs.append(make_vlr(LASZIP_KEY, laszip, "laszip (lazrs)"))
        if self._user_names:
            vlrs.append(lookup_vlr(self._user_names))
        self._fields = new_header()
        self._fields.set("system_id", b"prc-cli")
        self._fields.set("software", f"prc-cli {__version__}"[:32].encode("ascii"))
        self._fields.set("point_offset", len(self._fields.data) + sum(len(vlr.raw) for vlr in vlrs))
        self._fields.set("n_vlrs", len(vlrs))
        self._fields.set("point_format", _POINT_FORMAT | (COMPRESSED if self._compress else 0))
        self._fields.set("record_length", n_bytes)
        self._target = Target(self._handle)
        for part in (self._fields.data, *(vlr.raw for vlr in vlrs)):
            self._target.write(part)
        self._sink: PointSink = (
            LazSink(self._target, laszip) if self._compress else LasSink(self._target)
        )

    def _add(self, item: StreamItem) -> None:
        scan = item.block
        block = item.labelled
        self._see_order(scan)
        codes = self._codes_of(item.codes, scan.range_m.shape)
        extra_codes = self._codes_of(item.extra_codes, (len(scan.extra),))
        cells = (
            {}
            if block is None
            else {column.name: self._cells(column, block) for column in self._optional}
        )
        self._placed = self._coordinates(item)
        self._set_offset(self._placed.cells)
        lines = max(
            1, batch_size(self._dtype.itemsize, compressed=self._compress) // scan.points_per_line
        )
        for first in range(0, scan.n_lines, lines):
            shots = gather_returns(scan, slice(first, first + lines), chosen_first=block is None)
            points = np.zeros(len(shots.line), self._dtype)
            is_chosen = shots.extra < 0
            points["classification"] = np.where(
                is_chosen,
                codes[shots.line, shots.column],
                extra_codes[shots.extra] if len(scan.extra) else 0,
            )
            for column in self._optional:
                values = cells[column.name][shots.line, shots.column]
                points[column.name] = np.where(is_chosen, values, column.dtype.type(column.fill))
            self._fill(points, scan, shots)
            if block is None:
                # a stream has the intensity of the chosen return of a shot only
                points["intensity"][~is_chosen] = 0
            self._count(points["classification"])
            self._sink.write(points.view(np.uint8).reshape(len(points), self._dtype.itemsize))

    def _codes_of(self, codes: NDArray[Any] | None, shape: tuple[int, ...]) -> U8:
        """Return class codes as bytes; unknown codes and codes above 255 become unclassified."""
        unknown = self._codes.unclassified
        if codes is None:
            return np.full(shape, unknown, np.uint8)
        if codes.dtype == np.uint8:
            return codes
        wrong = (codes < 0) | (codes > 255)
        self._n_codes_lost += int(np.count_nonzero(wrong & (codes != NO_CODE)))
        return np.where(wrong, unknown, codes).astype(np.uint8)

    def _fill(self, points: NDArray[Any], scan: ScanBlock, shots: Returns) -> None:
        """Set all fields but class and optional columns; update counts and bounds of the header."""
        steps = self._steps(scan, shots)
        for axis, name in enumerate("XYZ"):
            points[name] = steps[:, axis]
        if len(steps):
            self._low = np.minimum(self._low, steps.min(axis=0))
            self._high = np.maximum(self._high, steps.max(axis=0))
        points["range"] = shots.range_m
        points["scan_line"] = _fits(self.path, "scan line", scan.first_line + shots.line, 1 << 32)
        points["column"] = shots.column
        points["bit_fields"] = shots.number | (shots.n_returns << 4)
        points["point_source_id"] = _fits(self.path, "scanner", np.array([scan.scanner]), 1 << 16)
        self._by_return += np.bincount(shots.number, minlength=16)[1:16]
        if scan.angle_rad is not None:
            turn = np.remainder(np.rad2deg(scan.angle_rad) + 180.0, 360.0) - 180.0
            angle = np.rint(turn / SCAN_ANGLE_STEP_DEG)
            points["scan_angle"] = np.where(np.isfinite(angle), angle, 0.0).astype(np.int16)[
                shots.column
            ]
        if scan.intensity is not None:
            value = self._scaled(scan.intensity[shots.line, shots.column])
            clipped = np.clip(np.rint(value), 0, 65535)
            self._n_clipped += int(np.count_nonzero(clipped != np.rint(value)))
            points["intensity"] = clipped.astype(np.uint16)
        if scan.time_s is not None:
            time = scan.time_s[shots.line, shots.column]
            known = np.isfinite(time)
            points["gps_time"] = np.where(known, time, 0.0)
            self._n_timed += int(np.count_nonzero(known))
        self._n_timeless = int(self._by_return.sum()) - self._n_timed

    def _scaled(self, intensity: F32) -> F64:
        """Return intensities, scaled to 0 to 65535 if the first ones are fractions."""
        value = np.nan_to_num(intensity.astype(np.float64), nan=0.0, posinf=65536.0, neginf=-1.0)
        if self._intensity_scale is None and len(value):
            is_share = bool(value.min() >= 0 and value.max() <= 1 and (value % 1 != 0).any())
            self._intensity_scale = INTENSITY_STEPS if is_share else 1.0
            if is_share:
                self._notice(f"intensities from 0 to 1 are written as 0 to {INTENSITY_STEPS:.0f}")
        return value * (self._intensity_scale or 1.0)

    def _steps(self, scan: ScanBlock, shots: Returns) -> I64:
        """Return coordinates in steps, (n, 3) int64; raise an error if many do not fit."""
        xyz = self._placed.cells[shots.line, shots.column]
        is_extra = shots.extra >= 0
        xyz[is_extra] = self._placed.extra[shots.extra[is_extra]]
        steps: F64 = np.rint((xyz - self._offset_m) / self._scale)
        is_far = ~np.all(np.abs(steps) <= 2**31 - 1, axis=1)  # also NaN
        if is_far.any() and np.count_nonzero(is_far) <= max(MOST_FAR * len(steps), 1):
            # single damaged coordinates, beside a good range
            self._n_moved += int(np.count_nonzero(is_far))
            good = np.maximum.accumulate(np.where(is_far, 0, np.arange(len(steps))))
            steps = steps[good]
            steps[is_far & (good == 0)] = steps[~is_far][:1] if not is_far.all() else 0.0
        elif is_far.any():
            bad = int(np.argmax(is_far))
            line = scan.first_line + int(shots.line[bad])
            where = f"scan line {line}, column {int(shots.column[bad])}"
            problem = (
                f"{where}: found coordinates {xyz[bad].tolist()} m, "
                "expected finite ones within ±2147483 m"
            )
            raise OutputError(
                str(self.path), problem, "check the ranges' unit, or set [input] max_range"
            )
        whole_steps: I64 = steps.astype(np.int64)
        return whole_steps

    def _set_offset(self, xyz: F64) -> None:
        if self._has_offset:
            return
        known = xyz[np.isfinite(xyz).all(axis=2)]
        units = units_of_system(self._crs)
        if units.is_geographic if units is not None else looks_geographic(known):
            self._scale[:2] = SCALE_DEG
            self._offset_m[:2] = np.floor(known[0, :2]) if len(known) else 0.0
            self._has_offset = True
            self._notice(f"x and y are degrees: written in steps of {SCALE_DEG:g} deg")
        elif len(known):
            self._offset_m = np.floor(known[0] / OFFSET_STEP_M) * OFFSET_STEP_M
            self._has_offset = True

    def _write(self, record: RunRecord) -> RunRecord:
        if self._n_clipped:
            self._notice(f"{self._n_clipped} intensities lie outside 0 to 65535 and were clipped")
        if self._n_moved:
            how = "are at the place of the record before"
            self._notice(f"{self._n_moved} records have no usable x, y, z and {how}")
        if self._n_timed and self._n_timeless:
            self._notice(f"{self._n_timeless} records have no time; their gps_time is 0")
        self._sink.close()
        record = self._completed(record)
        fields = self._fields
        fields.set("evlr_start", self._target.tell())
        fields.set("n_evlrs", 1)
        self._target.write(make_vlr(RECORD_KEY, record.to_json(), RECORD_TEXT, extended=True).raw)
        fields.set("scales", *self._scale)
        fields.set("offsets", *self._offset_m)
        fields.set("n_points", int(self._by_return.sum()))
        fields.set("by_return", *self._by_return.tolist())
        if self._by_return.any():
            bounds = (
                np.stack([self._high, self._low], axis=1) * self._scale[:, None]
                + self._offset_m[:, None]
            )
            fields.set("bounds", *bounds.ravel())
        self._target.seek(0)
        self._target.write(fields.data)
        self._target.flush()
        self._handle.close()
        return record


class Returns(NamedTuple):
    """Returns of some lines of a block, chronological; the returns of a shot by range."""

    line: I64
    column: I64
    range_m: F32
    extra: I64
    """Index into the extra returns of the block, -1 = the chosen return of the shot."""
    number: U8
    n_returns: U8


def gather_returns(scan: ScanBlock, rows: slice, *, chosen_first: bool = False) -> Returns:
    """Gather the returns of some lines in record order, without shots that have no range."""
    line, column = np.nonzero(~np.isnan(scan.range_m[rows]))
    line += rows.start
    single = np.ones(len(line), np.uint8)
    returns = Returns(
        line, column, scan.range_m[line, column], np.full(len(line), -1, np.int64), single, single
    )
    of_lines = (scan.extra.line >= rows.start) & (scan.extra.line < rows.stop)
    chosen = np.flatnonzero(of_lines & ~np.isnan(scan.extra.range_m))
    if not len(chosen):
        return returns
    line = np.concatenate([line, scan.extra.line[chosen]])
    column = np.concatenate([column, scan.extra.column[chosen]])
    range_m = np.concatenate([returns.range_m, scan.extra.range_m[chosen]])
    extra = np.concatenate([returns.extra, chosen])
    order = np.lexsort((extra, range_m, column, line))
    shot: I64 = (line * scan.points_per_line + column)[order]
    first = np.flatnonzero(np.diff(shot, prepend=-1))
    size = np.diff(np.append(first, len(shot)))
    rank = np.arange(len(shot)) - np.repeat(first, size)
    # four bits each; more than 15 returns of a shot share the last number
    number = np.minimum(rank + 1, 15).astype(np.uint8)
    count = np.minimum(np.repeat(size, size), 15).astype(np.uint8)
    returns = Returns(line[order], column[order], range_m[order], extra[order], number, count)
    if not chosen_first:
        return returns
    order = np.lexsort((number, returns.extra >= 0, shot))
    return Returns._make(values[order] for values in returns)


def _fits(
    path: Path,
    what: str,
    values: NDArray[Any],
    limit: int,
) -> NDArray[Any]:
    if values.size and int(values.max()) >= limit:
        raise OutputError(
            str(path), f"{what} {int(values.max())} does not fit, LAS holds 0 to {limit - 1} here"
        )
    return values
