"""Reader of range images (``.npy``, ``.npz``): every cell is a shot."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import Assumption, ScanBlock, StreamInfo
from prc_cli.core.types import F64
from prc_cli.formats.arrays.rows import ArrayFile, NpyHeader, Rows
from prc_cli.formats.names import ZENITH, angle_rules, split_unit, usual_names
from prc_cli.formats.options import FACTORS, InputConfig
from prc_cli.formats.organised.scans import (
    MAX_POINTS_PER_LINE,
    check_width,
    filled,
    lengths,
    refuse_rules,
    to_float32,
)
from prc_cli.formats.ranges import clean_ranges, refuse_scale, scale_told

CHUNK_SHOTS = 1 << 19
"""Shots read at a time."""
FEWEST_POINTS_PER_LINE = 8
"""Images of more than ``MANY_LINES`` shorter lines are refused, because every line takes time."""
MANY_LINES = 100_000
"""See :data:`FEWEST_POINTS_PER_LINE`."""

MOST_RINGS = 512
"""Most rows of an image of rings."""
LEVEL = 0.3
"""Elevations within rings scatter at most by this share of their scatter from ring to ring."""

RANGE = "range_m"
TIME = "time_s"
XYZ = "xyz"
INTENSITY = "intensity"
CLASS = "class"
"""Name of the array of class codes, which conversion and evaluation read."""
XYZ_DIMENSIONS = 3
"""Lines, columns and axes."""
_RECORD_LISTS = ("line", "scan_line", "column", "record")


class ArrayStream:
    """A range image as a :class:`prc_cli.core.stream.ScanStream`.

    ``.npy``: ranges [m], (lines, M), or (shots,) with ``points_per_line``. ``.npz``: the same as
    ``range_m`` or the only array of two dimensions, and, where present, ``angle_deg``,
    ``angle_rad``, ``angle_gon`` or ``zenith_deg`` (M,), ``time_s`` (lines,) or (lines, M), ``xyz``
    (lines, M, 3) sensor-centred [m] and ``intensity`` (lines, M). Without an array of ranges, the
    range is the length of ``xyz``. Integers are taken as metres. One time per line applies to all
    its shots.
    """

    def __init__(
        self,
        path: Path,
        config: InputConfig,
        lines_at_once: int = 1,
        *,
        chunk_shots: int = CHUNK_SHOTS,
    ) -> None:
        _check_rules(path, config)
        self._config = config
        self._file = ArrayFile(path)
        self._range, why = _find_ranges(self._file, config)
        turned = _why_turned(self._file, self._range, config)
        if turned:
            self._file.exchange(self._file.headers[self._range].shape[:2])
        header = self._file.headers[self._range]
        header.check_numbers()
        self._n_lines, self._m, self._n_records = _find_shape(header, self._file, config)
        n_missing = self._n_lines * self._m - self._n_records
        n_lines = max(1, chunk_shots // self._m)
        self._chunk_lines = max(1, n_lines // lines_at_once) * min(n_lines, lines_at_once)
        self._names = self._find_beside()
        assumed = [Assumption("input.range", self._range or "the array", why)]
        angles, self._angle_rad = self._find_angles(assumed)
        assumed += scale_told(config.range_scale)
        if turned:
            assumed.append(Assumption("input.lines", "columns of the arrays", turned))
        if self._range == XYZ:
            refuse_scale(config, str(path), "its ranges are lengths of x, y, z")
        if n_missing:
            assumed.append(
                Assumption("input.partial_line", "pad", f"the last line lacks {n_missing} shots")
            )
        used = (self._range, *self._names, angles, CLASS)
        if ignored := [name for name in self._file.headers if name not in used]:
            assumed.append(
                Assumption("input", f"not read: {', '.join(ignored[:20])}", "they are not needed")
            )
        has_line_times = TIME in self._names and len(self._file.headers[TIME].shape) == 1
        self.info = StreamInfo(
            path=str(path),
            format="array",
            points_per_line=self._m,
            n_records=self._n_records,
            n_lines=self._n_lines,
            angle_rad=self._angle_rad,
            line_hz=self._find_line_hz(),
            down_rad=next((math.radians(float(rule.value)) for rule in angle_rules(angles)), None),
            assumptions=tuple(assumed),
            facts=SourceFacts(
                time_name=TIME, has_line_times=has_line_times, refuses=self._refused(header)
            ),
        )
        """Metadata of the stream."""

    def _refused(self, header: Any) -> frozenset[str]:
        refused = {
            "lines",
            "columns",
            "scanner",
            "order",
            "range",
            "trajectory",
            "origin",
            "layout",
            "azimuth_step",
            "time_origin",
        }
        if len(header.shape) > 1:
            refused |= {"points_per_line", "partial_line"}
        return frozenset(refused | ({"range_scale"} if self._range == XYZ else set()))

    def _find_beside(self) -> tuple[str, ...]:
        """Return the names of the arrays beside the ranges; check their shapes and types."""
        image = (self._n_lines, self._m)
        shapes: dict[str, tuple[tuple[int, ...], ...]] = {
            TIME: ((self._n_lines,), image),
            XYZ: ((*image, 3),),
            INTENSITY: (image,),
        }
        present = tuple(
            name
            for name in shapes
            if name in self._file.headers and (name != self._range or name == XYZ)
        )
        for name in present:
            header = self._file.headers[name]
            header.check_numbers()
            if header.shape not in shapes[name]:
                expected = " or ".join(str(shape) for shape in shapes[name])
                problem = f"found shape {header.shape}, expected {expected}, as the ranges have it"
                raise InputError(
                    header.where, problem, "give it the shape of the ranges or another name"
                )
        return present

    def _find_angles(self, assumed: list[Assumption]) -> tuple[str | None, F64 | None]:
        """Return the name of the array of scan angles and the angle of every column [rad].

        The origin of the angles is added to ``assumed``.
        """
        start = self._config.angle_start
        step = self._config.angle_step
        if (start is None) != (step is None):
            missing = "angle_step" if step is None else "angle_start"
            raise ConfigError(
                f"input.{missing}", "not given, expected angle_start and angle_step together"
            )
        if start is not None and step is not None:
            return None, np.deg2rad(start + step * np.arange(self._m, dtype=np.float64))
        # other directions may be those of lines, or of every shot
        headers = self._file.headers.items()
        names = [
            name
            for name, candidate in headers
            if candidate.shape == (self._m,) or split_unit(name)[0] in ("angle", ZENITH)
        ]
        usual = usual_names((RANGE, *names)).get("angle")
        if usual is None:
            return None, None
        name = usual.name
        unit = usual.unit or "deg"
        header = self._file.headers[name]
        header.check_numbers()
        if header.shape != (self._m,):
            problem = f"found shape {header.shape}, expected ({self._m},), one angle a column"
            raise InputError(header.where, problem, "give one angle for every column of the ranges")
        with self._file.open(name) as (rows,):
            degrees = rows.read(self._m).astype(np.float64)
            rows.finish()
        word = {"deg": "degrees", "rad": "radians"}.get(unit, unit)
        if not np.isfinite(degrees).all():
            column = int(np.flatnonzero(~np.isfinite(degrees))[0])
            problem = f"column {column}: found {degrees[column]}, expected an angle in {word}"
            raise InputError(
                header.where, problem, "give every column its angle or leave the array out"
            )
        why = f"the array {name!r} is in the file, in {word}"
        # degrees as numpy converts them, bit for bit
        angle_rad: F64 = np.deg2rad(degrees) if unit == "deg" else degrees * FACTORS[unit]
        assumed.append(Assumption("input.angle_start", f"{np.rad2deg(angle_rad[0]):g} deg", why))
        return name, angle_rad

    def _find_line_hz(self) -> float | None:
        """Return the line frequency [Hz] from the first lines' times, None if it is unknown."""
        if TIME not in self._names:
            return None
        n = min(self._n_lines, self._chunk_lines, 1024)
        with self._file.open(TIME) as (rows,):
            times = rows.read(n).astype(np.float64)
        # extreme time stamps overflow here and give no frequency: no warning needed
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.diff(times if times.ndim == 1 else times[:, 0])
            steps = steps[np.isfinite(steps) & (steps > 0)]
            line_hz = float(1 / np.median(steps)) if len(steps) else 0.0
        return line_hz if 0 < line_hz < np.inf else None

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start."""
        names = tuple(dict.fromkeys((self._range, *self._names)))
        with self._file.open(*names) as rows:
            opened = dict(zip(names, rows, strict=True))
            for first in range(0, self._n_lines, self._chunk_lines):
                yield self._block(opened, first, min(self._chunk_lines, self._n_lines - first))
            for reader in rows:
                reader.finish()

    def _block(self, rows: dict[str, Rows], first: int, n: int) -> ScanBlock:
        xyz = to_float32(rows[XYZ].read(n)) if XYZ in rows else None
        if self._range == XYZ and xyz is not None:
            stored: NDArray[Any] = lengths(xyz.reshape(-1, 3).astype(np.float64))
        else:
            is_flat = len(self._file.headers[self._range].shape) == 1
            n_left = min(n * self._m, self._n_records - first * self._m)
            stored = rows[self._range].read(n_left if is_flat else n)
            if self._config.range_scale != 1.0:
                stored = stored * np.float64(self._config.range_scale)
        ranges, tally = clean_ranges(stored.ravel(), self._config.min_range, self._config.max_range)
        ranges = filled(ranges, n * self._m).reshape(n, self._m)
        record = time_s = None
        if self._file.headers[self._range].turned:
            # records are counted as the file has them
            line = np.arange(first, first + n, dtype=np.int64)[:, None]
            record = np.arange(self._m, dtype=np.int64) * self._n_lines + line
        elif self._n_lines * self._m != self._n_records:
            record = np.arange(first * self._m, (first + n) * self._m, dtype=np.int64).reshape(
                n, self._m
            )
            record[record >= self._n_records] = -1
        if TIME in rows:
            times = rows[TIME].read(n).astype(np.float64)
            time_s = np.repeat(times[:, None], self._m, axis=1) if times.ndim == 1 else times
        if xyz is not None:
            xyz[np.isnan(ranges)] = np.nan
        intensity = to_float32(rows[INTENSITY].read(n)) if INTENSITY in rows else None
        return ScanBlock(
            first,
            ranges,
            record,
            time_s=time_s,
            xyz_m=xyz,
            intensity=intensity,
            angle_rad=self._angle_rad,
            tally=tally,
        )


def _check_rules(path: Path, config: InputConfig) -> None:
    refuse_rules(
        path,
        config,
        "is a range image",
        lines=("auto", "fixed"),
        columns=("auto", "order"),
        scanner=("none",),
        order=("require", "trust"),
    )
    rule = config.range
    if rule != "auto" and not (rule.startswith("dimension:") and path.suffix.lower() == ".npz"):
        problem = f"{rule!r} does not fit the range image {path.name}, expected auto"
        if path.suffix.lower() == ".npz":
            problem = f"{problem} or dimension:NAME"
        raise ConfigError("input.range", problem, "leave the key out")


def _find_ranges(file: ArrayFile, config: InputConfig) -> tuple[str, str]:
    if not file.is_archive:
        return "", "it is the only array in the file"
    shown = (
        ", ".join(f"{name} {header.shape}" for name, header in list(file.headers.items())[:20])
        or "none"
    )
    if config.range != "auto":
        name = config.range.partition(":")[2]
        if name not in file.headers:
            raise InputError(
                str(file.path), f"no array {name!r}, the file has: {shown}", "check --range"
            )
        return name, "input.range names it"
    if RANGE in file.headers:
        return RANGE, "the file has an array of this name"
    images = [
        name
        for name, header in file.headers.items()
        if len(header.shape) == 2 and name not in (TIME, INTENSITY, CLASS)
    ]
    if len(images) == 1:
        return images[0], "it is the only array of two dimensions"
    if not images and len(file.headers[XYZ].shape if XYZ in file.headers else ()) == XYZ_DIMENSIONS:
        return XYZ, "the length of xyz, which is taken to be relative to the scanner"
    problem = f"no array {RANGE!r}, nor a single one of two dimensions; the file has: {shown}"
    raise InputError(
        str(file.path), problem, f"name the ranges {RANGE}, or set input.range to dimension:NAME"
    )


def _why_turned(file: ArrayFile, name: str, config: InputConfig) -> str:
    """Return a reason if rows are rings of constant elevation; empty if rows are lines."""
    header = file.headers[name]
    n_rows, n_columns = (*header.shape, 0, 0)[:2]
    if (
        not 1 < n_rows < n_columns
        or config.points_per_line not in (None, n_rows)
        or n_rows > MOST_RINGS
    ):
        return ""
    if config.points_per_line == n_rows:
        return f"points_per_line is {n_rows}, the number of rows"
    shapes = [
        candidate.shape
        for label, candidate in file.headers.items()
        if split_unit(label)[0] in ("angle", ZENITH, "elevation")
    ]
    if (n_rows,) in shapes and (n_columns,) not in shapes:
        return "rows are rings: there is an angle for every row"
    xyz = file.headers.get(XYZ)
    if xyz is None or xyz.shape != (n_rows, n_columns, 3) or n_rows * n_columns > CHUNK_SHOTS << 2:
        return ""
    with file.open(XYZ) as (rows,):
        x, y, z = np.moveaxis(rows.read(n_rows).astype(np.float64), -1, 0)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rows without returns
        flat = np.hypot(x, y)
        elevation = np.where(flat > 0, np.arctan2(z, flat), np.nan)
        within = float(np.nanmedian(np.nanstd(elevation, axis=1)))
        between = float(np.nanstd(np.nanmedian(elevation, axis=1)))
    return "rows are rings: each keeps its elevation" if within < LEVEL * between else ""


def _find_shape(header: NpyHeader, file: ArrayFile, config: InputConfig) -> tuple[int, int, int]:
    shape = header.shape
    wanted = config.points_per_line
    if header is file.headers.get(XYZ) and len(shape) == XYZ_DIMENSIONS:
        shape = shape[:2]
    if len(shape) == 1 and header.dtype == np.uint8 and not file.is_archive:
        # label files look like this: read as ranges they would be classified as a scan
        problem = "found bytes in a row, which look like class codes, expected ranges in metres"
        hint = "give the scan; give class codes with --labels or to prc evaluate"
        raise InputError(header.where, problem, hint)
    if len(shape) not in (1, 2):
        problem = f"found ranges of shape {shape}, expected (lines, points per line)"
        raise InputError(header.where, problem, "save the ranges alone, one row a scan line")
    if 0 in shape:
        raise InputError(
            header.where, f"no shots, found shape {shape}", "copy it from the archive again"
        )
    if len(shape) == 2:
        check_width(header.where, shape[1], config)
        if shape[1] > MAX_POINTS_PER_LINE:
            problem = f"found {shape[1]} points per line, expected at most {MAX_POINTS_PER_LINE}"
            raise InputError(header.where, problem, "save one row a scan line")
        if shape[0] > MANY_LINES and shape[1] < FEWEST_POINTS_PER_LINE:
            lines = f"found {shape[0]} lines of {shape[1]} points"
            problem = f"{lines}, expected at least {FEWEST_POINTS_PER_LINE} points"
            raise InputError(
                header.where, problem, "save one row a scan line, or all ranges in a row"
            )
        return shape[0], shape[1], shape[0] * shape[1]
    lists = [
        name for name in _RECORD_LISTS if name in file.headers and file.headers[name].shape == shape
    ]
    if lists:
        problem = f"{shape[0]} records beside an array {lists[0]!r}, expected an image of all shots"
        hint = "save the ranges as (lines, points per line), NaN for missing ones"
        raise InputError(header.where, problem, hint)
    if wanted is None:
        problem = f"found {shape[0]} ranges in a row, expected (lines, points per line)"
        raise InputError(header.where, problem, "set input.points_per_line")
    n_lines, n_left = divmod(shape[0], wanted)
    if n_left and config.partial_line == "error":
        problem = f"{shape[0]} ranges are {n_lines} lines of {wanted} and {n_left} more"
        hint = "check input.points_per_line, or set input.partial_line to pad"
        raise InputError(header.where, problem, hint)
    return n_lines + bool(n_left), wanted, shape[0]
