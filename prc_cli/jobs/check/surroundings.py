"""The surroundings of drawn shots: windows of lines and columns, near and wide."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from prc_cli.config import LoadedConfig
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.input import Input
from prc_cli.formats.records import Source
from prc_cli.formats.writing.columns import behind
from prc_cli.imaging.check_page import Cell, PlaceView, Window
from prc_cli.jobs.check.draw import order_lines
from prc_cli.jobs.coordinates import spacing
from prc_cli.jobs.render.cloud import AXES, Cloud
from prc_cli.jobs.render.viewer import plane_normal

NEAR = (20, 40)
"""Lines and columns of the near window on either side of the shot, every one of them."""
WIDE = (52, 64)
"""Lines and columns of the wide window on either side of the shot, at even steps."""
REACH_M = 10.0
"""Distance that the wide window covers along the drive on either side, if lines are that close."""
REACH_TURN = 0.125
"""Part of a line that the wide window covers on either side."""
FULL_SIZE = 300
"""With more places, windows are smaller, so that the page does not grow."""
_SAMPLED = 50
"""Points of a window that tell whether all coordinates are in one plane."""
_TIMES_FROM = 64
"""Lines whose times give the line frequency."""


class Steps(NamedTuple):
    """Lines and columns from one cell of a window to the next."""

    line: int
    column: int


@dataclass(slots=True)
class _Patch:
    """Cells of a window, filled while the stream passes."""

    lines: I64
    columns: I64
    steps: Steps
    range_m: F32
    record: I64
    sensor_m: F32
    """(lines, columns, 3) float32 [m], relative to the scanner; NaN = none."""
    intensity: F32
    placed_m: F32
    """(lines, columns, 3) float32 [m], by the file, from its first point; NaN = none."""
    origin_m: F64 | None = None
    """First point, (3,) float64 [m]."""

    @classmethod
    def around(cls, place: Cell, half: tuple[int, int], steps: Steps) -> _Patch:
        lines = place.line + steps.line * np.arange(-half[0], half[0] + 1)
        columns = place.column + steps.column * np.arange(-half[1], half[1] + 1)
        shape = (len(lines), len(columns))
        return cls(
            lines,
            columns,
            steps,
            np.full(shape, np.nan, np.float32),
            np.full(shape, -1, np.int64),
            np.full((*shape, 3), np.nan, np.float32),
            np.full(shape, np.nan, np.float32),
            np.empty((0, 0, 3), np.float32),
        )

    def place(self, ids: I64, xyz_m: F64) -> F64:
        """Take the coordinates of the records that the window has; return them, (n, 3) [m].

        ``ids`` are records in ascending order.
        """
        if not self.placed_m.size:
            self.placed_m = np.full((*self.record.shape, 3), np.nan, np.float32)
        index = np.minimum(np.searchsorted(ids, self.record), len(ids) - 1)
        is_there = (self.record >= 0) & (ids[index] == self.record)
        # missing shots are records of a text file, too
        is_there &= np.isfinite(xyz_m[index]).all(axis=-1)
        placed: F64 = xyz_m[index[is_there]]
        if self.origin_m is None and len(placed):
            self.origin_m = placed[0]
        if self.origin_m is not None:
            self.placed_m[is_there] = placed - self.origin_m
        return placed

    def take(self, block: ScanBlock) -> None:
        """Copy the cells that a block has."""
        first, last = np.searchsorted(
            self.lines, (block.first_line, block.first_line + block.n_lines)
        )
        left, right = np.searchsorted(self.columns, (0, block.points_per_line))
        if first == last:
            return
        lines = self.lines[first:last] - block.first_line
        cells = np.ix_(lines, self.columns[left:right])
        target = (slice(first, last), slice(left, right))
        self.range_m[target] = block.range_m[cells]
        self.record[target] = block.records()[cells]
        if block.xyz_m is not None:
            self.sensor_m[target] = block.xyz_m[cells]
        elif block.beam_rad is not None:
            beam_rad = block.beam_rad[self.columns[left:right]]
            self.sensor_m[target] = behind(np.zeros(1), beam_rad, block.range_m[cells])
        if block.intensity is not None:
            self.intensity[target] = block.intensity[cells]


@dataclass(slots=True)
class _Windows:
    """The windows of all places of one scanner."""

    lines: I64
    """Lines of the places, ascending."""
    numbers: I64
    """Numbers of these places."""
    reach: int
    """Most lines from a place to the end of its windows."""
    near: dict[int, _Patch]
    wide: dict[int, _Patch]
    beam_rad: F64 | None
    spacing_m: float
    has_plane: bool = field(default=False)
    """Whether all coordinates relative to the scanner are in one plane."""

    @classmethod
    def of(
        cls,
        block: ScanBlock,
        places: Sequence[Cell],
        info: StreamInfo,
        *,
        in_forest: bool,
    ) -> _Windows:
        """Choose the windows by the first block of a scanner."""
        lines, numbers = order_lines(tuple(places), block.scanner)
        time_s = None if block.time_s is None else block.time_s[:_TIMES_FROM]
        spacing_m, _ = spacing(info, time_s, in_forest=in_forest)
        size = min(1.0, math.sqrt(FULL_SIZE / max(len(places), 1)))
        near_half = (_half(NEAR[0], size), min(_half(NEAR[1], size), block.points_per_line))
        wide_half = (_half(WIDE[0], size), min(_half(WIDE[1], size), block.points_per_line))
        n_lines = min(max(REACH_M / spacing_m, wide_half[0]), 10 * wide_half[0])
        n_columns = block.points_per_line * REACH_TURN
        steps = Steps(
            max(1, math.ceil(n_lines / wide_half[0])),
            max(1, math.ceil(n_columns / wide_half[1])),
        )
        chosen = [int(number) for number in numbers]
        return cls(
            lines,
            numbers,
            max(near_half[0], wide_half[0] * steps.line),
            {k: _Patch.around(places[k], near_half, Steps(1, 1)) for k in chosen},
            {k: _Patch.around(places[k], wide_half, steps) for k in chosen},
            block.beam_rad,
            spacing_m,
        )

    def take(self, block: ScanBlock) -> None:
        """Fill the windows that a block touches."""
        ends = (block.first_line - self.reach, block.first_line + block.n_lines + self.reach)
        first, last = np.searchsorted(self.lines, ends)
        for number in self.numbers[first:last].tolist():
            self.near[number].take(block)
            self.wide[number].take(block)


def _half(most: int, size: float) -> int:
    return max(6, round(most * size))


def surroundings(
    blocks: Iterator[ScanBlock],
    scan: Input,
    loaded: LoadedConfig,
    info: StreamInfo,
    places: Sequence[Cell],
    see: Callable[[ScanBlock], None],
) -> Iterator[PlaceView]:
    """Read the windows of all places, and yield them in their order.

    Memory depends on the number of places, not on the length of the drive.
    """
    config = loaded.config
    in_forest = (config.fused if config.method == "fused" else config.prc).environment == "forest"
    by_scanner: dict[int, _Windows] = {}
    for block in blocks:
        windows = by_scanner.get(block.scanner)
        if windows is None:
            windows = _Windows.of(block, places, info, in_forest=in_forest)
            by_scanner[block.scanner] = windows
        windows.take(block)
        see(block)
    records = _with_coordinates(scan, loaded)
    is_placed = records is not None and _put_coordinates(records, by_scanner)
    return _views(places, by_scanner, is_placed=is_placed)


def _views(
    places: Sequence[Cell], by_scanner: dict[int, _Windows], *, is_placed: bool
) -> Iterator[PlaceView]:
    across = {scanner: _plane(windows) for scanner, windows in by_scanner.items()}
    for number, place in enumerate(places):
        windows = by_scanner[place.scanner]
        patches = (windows.near.pop(number), windows.wide.pop(number))
        yield _view(place, patches, windows, across[place.scanner], is_placed=is_placed)


def _with_coordinates(scan: Input, loaded: LoadedConfig) -> Source | None:
    with suppress(InputError):
        return Cloud.open(scan, loaded, None).records
    return None


def _plane(windows: _Windows) -> F64 | None:
    """Return the normal of the scan plane, upright; None if the scanner turns or is unknown."""
    rows = [patch.sensor_m[np.isfinite(patch.sensor_m[..., 0])] for patch in windows.wide.values()]
    points = np.concatenate(rows).astype(np.float64) if rows else np.empty((0, 3))
    across = plane_normal(points)
    return across if across is not None and abs(across[2]) < 0.5 else None


def _view(
    place: Cell,
    patches: tuple[_Patch, _Patch],
    windows: _Windows,
    across: F64 | None,
    *,
    is_placed: bool,
) -> PlaceView:
    to_scanner = np.full(3, np.nan)
    shown = []
    for patch in patches:
        middle = (len(patch.lines) // 2, len(patch.columns) // 2)
        to_scanner = -patch.sensor_m[middle].astype(np.float64)
        xyz_m = patch.sensor_m
        if is_placed and patch.placed_m.size:
            xyz_m = patch.placed_m
            to_scanner = _turned(patch.sensor_m[middle[0]], xyz_m[middle[0]], to_scanner)
        elif across is not None:
            along_m = (patch.lines - place.line) * windows.spacing_m
            xyz_m = (xyz_m + along_m[:, None, None] * across).astype(np.float32)
        is_known = bool(np.isfinite(xyz_m[middle]).all())
        shown.append(
            Window(
                patch.steps,
                patch.range_m,
                xyz_m - xyz_m[middle] if is_known else None,
                patch.intensity,
                patch.record,
                _is_flipped(windows.beam_rad, patch.columns),
            )
        )
    return PlaceView(place, shown[0], shown[1], to_scanner)


def _is_flipped(beam_rad: F64 | None, columns: I64) -> bool:
    # later columns are higher, so the picture is turned upside down
    if beam_rad is None:
        return False
    inside = columns[(columns >= 0) & (columns < len(beam_rad))]
    return bool(abs(beam_rad[inside[-1]]) > abs(beam_rad[inside[0]]))


def _put_coordinates(records: Source, by_scanner: dict[int, _Windows]) -> bool:
    """Read coordinates of the file into all windows; False if they do not place the lines."""
    patches = [
        patch
        for windows in by_scanner.values()
        for number in windows.numbers.tolist()
        for patch in (windows.near[number], windows.wide[number])
    ]
    ends = np.array([_ends(patch.record) for patch in patches]).reshape(-1, 2)
    sample = []
    for chunk in records.chunks(AXES):
        ids = chunk.records()
        order = np.argsort(ids, kind="stable")
        ids = ids[order]
        if not len(ids):
            continue
        xyz_m = np.stack([np.asarray(chunk.values[axis], np.float64) for axis in AXES], axis=1)
        xyz_m = xyz_m[order]
        for number in np.flatnonzero((ends[:, 0] <= ids[-1]) & (ends[:, 1] >= ids[0])).tolist():
            placed = patches[number].place(ids, xyz_m)
            sample.append(placed[:: max(1, len(placed) // _SAMPLED)])
    known = np.concatenate(sample) if sample else np.empty((0, 3))
    # coordinates in the scan plane do not place the lines
    return len(known) > 0 and plane_normal(known) is None


def _ends(record: I64) -> tuple[int, int]:
    known = record[record >= 0]
    return (int(known.min()), int(known.max())) if len(known) else (1, 0)


def _turned(sensor_m: F32, placed_m: F32, to_scanner: F64) -> F64:
    """Turn the direction to the scanner about the vertical, into the frame of the file.

    The points of one scan line are known in both frames.
    """
    known = np.isfinite(sensor_m).all(axis=1) & np.isfinite(placed_m).all(axis=1)
    if np.count_nonzero(known) < 3 or not np.isfinite(to_scanner).all():
        return to_scanner
    before = sensor_m[known].astype(np.float64) @ (1, 1j, 0)
    after = placed_m[known].astype(np.float64) @ (1, 1j, 0)
    turn = np.vdot(before - before.mean(), after - after.mean())
    moved = complex(*to_scanner[:2]) * turn / max(abs(turn), 1e-12)
    return np.array([moved.real, moved.imag, to_scanner[2]])
