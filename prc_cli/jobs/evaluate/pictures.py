"""Pictures of the classes of two label files side by side, for the page of an evaluation."""

from __future__ import annotations

import io
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from prc_cli.config import LoadedConfig, RunConfig, resolve
from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import PrcError
from prc_cli.core.types import I64, U8
from prc_cli.evaluation.html import class_colour
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.mapping import Side as SideName
from prc_cli.formats.labels import open_codes
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.options import InputConfig
from prc_cli.formats.writing.record import record_path
from prc_cli.jobs.render.scan import open_for_pictures, upright
from prc_cli.matching.join import CODE, KEY
from prc_cli.matching.keys import KeyRule
from prc_cli.matching.pairs import files_of, stem_of
from prc_cli.matching.sides import LINE, LONGEST_LINE, Side, SideFile

MAX_LINES = 600
"""Scan lines in a picture."""
_MAX_CELLS = 1 << 22
_WIDTH = 1200
_HEIGHT = 480
_NONE = (255, 255, 255)
_AGREE = (222, 222, 222)


def class_pictures(
    predicted: Path,
    reference: Path,
    mapping: ClassMapping,
    points_per_line: int | None = None,
    dimensions: tuple[str | None, str | None] = (None, None),
    points: tuple[Path | None, Path | None] = (None, None),
) -> tuple[tuple[str, bytes], ...]:
    """Draw the first lines as predicted, as in the reference, and their differences.

    Time runs to the right, the sky is up. Return captions and PNGs.
    """
    names = mapping.names("reference")
    names += tuple(name for name in mapping.names("predicted") if name not in names)
    paths = zip((predicted, reference), dimensions, strict=True)
    points_per_line = points_per_line or next(
        filter(None, (_line_length(*side) for side in paths)), None
    )
    if points_per_line is None:
        return ()
    most_lines = min(MAX_LINES, _MAX_CELLS // points_per_line)
    sides: tuple[tuple[SideName, Path], ...] = (("predicted", predicted), ("reference", reference))
    files = [
        _with_points(path, dimension, points_path)
        for (_, path), dimension, points_path in zip(sides, dimensions, points, strict=True)
    ]
    cells = [_Cells.read(file, points_per_line, most_lines) for file in files]
    # sides with equal numbers of records have the same cells
    known = [_placed(cells[0], cells[1]), _placed(cells[1], cells[0])]
    if any(cells_of_side.cell is None or not len(cells_of_side.codes) for cells_of_side in known):
        return ()
    first_line = max(cells_of_side.first_line for cells_of_side in known)
    n_lines = min(cells_of_side.stop_line(points_per_line) for cells_of_side in known) - first_line
    if n_lines <= 0:
        return ()
    images = []
    for (side, _), cells_of_side in zip(sides, known, strict=True):
        # 0: not scored
        colour_of_class = np.array([0, *(names.index(name) + 1 for name in mapping.names(side))])
        codes = cells_of_side.image(first_line, n_lines, points_per_line)
        images.append(colour_of_class[mapping.class_indices(codes, side) + 1].astype(np.uint8))
    point_files = (
        _points_of(path, points_path)
        for (_, path), points_path in zip(sides, points, strict=True)
        if points_path is not None
    )
    rows = _rows(
        (*point_files, predicted, reference), points_per_line, -(-points_per_line // _HEIGHT)
    )
    first, second = (places[:, rows].T for places in images)
    differ = np.where(first == second, np.uint8(len(names) + 1), first)
    differ[(first == 0) | (second == 0)] = 0
    lines = f"lines {first_line}-{first_line + n_lines - 1}"
    return (
        (f"Predicted, {lines} of {predicted.name}", _png(first, names)),
        (f"Reference, {lines} of {reference.name}", _png(second, names)),
        (
            "Where they differ, in the colour of the predicted class; grey: they agree",
            _png(differ, names),
        ),
    )


def _points_of(labels: Path, where: Path) -> Path:
    return next((path for path in files_of([where]) if stem_of(path) == stem_of(labels)), where)


def _rows(paths: Iterable[Path], points_per_line: int, every: int) -> NDArray[np.intp]:
    # indices of the columns to draw, from the top
    config = LoadedConfig(RunConfig(input=InputConfig(points_per_line=points_per_line)))
    columns = np.arange(0, points_per_line, every)
    for path in paths:
        # a file that cannot be read as a stream has no vertical direction
        with suppress(PrcError):
            block = next(iter(open_for_pictures(*resolve(path, config)).blocks()), None)
            if block is None or block.beam_rad is None or block.points_per_line != points_per_line:
                continue
            order = upright(block.beam_rad[::every])
            return columns if order is None else columns[order]
    return columns


def _line_length(path: Path, dimension: str | None) -> int | None:
    # None if the file has no line numbers, or lines of different length
    side = Side((SideFile.open(path, dimension, None),))
    if LINE not in side.dimensions:
        return None
    line = next(side.chunks((LINE,))).values[LINE]
    starts = np.flatnonzero(np.diff(line)) + 1
    if not starts.size:
        return None
    m = int(starts[0])
    return m if np.array_equal(line - line[0], np.arange(len(line)) // m) else None


@dataclass(frozen=True, slots=True)
class _Cells:
    """Codes of the first lines of a file, (n,) int64, and their cells."""

    codes: I64
    cell: I64 | None
    """Line times M plus column; None = not known."""
    n_records: int | None
    """Number of records of the file; None = not known."""
    first_line: int = 0
    is_assumed: bool = False
    """Whether prc only assumes a code for every cell."""

    @classmethod
    def read(cls, file: SideFile, points_per_line: int, most_lines: int) -> _Cells:
        most_cells = most_lines * points_per_line
        if not file.has_cells:
            codes = _first_codes(file, most_cells)
            # LAS has no shots without return; the run record of a label file may say that it has a
            # code for every cell
            is_dense = file.dense_line == points_per_line
            is_assumed = (
                not isinstance(file.table, LasSource)
                and not record_path(Path(file.codes.path)).is_file()
            )
            cell = np.arange(len(codes)) if is_dense or is_assumed else None
            return cls(codes, cell, file.codes.n_records, is_assumed=not is_dense)
        codes_read: list[I64] = []
        cells_read: list[I64] = []
        first: int | None = None
        for chunk in Side((file,), KeyRule("cell")).chunks((CODE, KEY)):
            line, column = np.divmod(chunk.values[KEY].astype(np.int64), LONGEST_LINE)
            if not len(line):
                continue
            first = int(line.min()) if first is None else first
            near = (line < first + most_lines) & (line >= first) & (column < points_per_line)
            codes_read.append(chunk.values[CODE][near].astype(np.int64))
            cells_read.append(line[near] * points_per_line + column[near])
            if line.min() >= first + most_lines:
                break
        empty = [np.empty(0, np.int64)]
        codes = np.concatenate(codes_read or empty)
        cell = np.concatenate(cells_read or empty)
        return cls(codes, cell, file.codes.n_records, first or 0)

    def stop_line(self, points_per_line: int) -> int:
        """Return the number of the last line + 1, without an incomplete line of dense codes."""
        assert self.cell is not None
        if np.array_equal(self.cell, np.arange(len(self.cell))):
            return len(self.cell) // points_per_line
        return int(self.cell.max()) // points_per_line + 1

    def image(self, first_line: int, n_lines: int, points_per_line: int) -> I64:
        """Return the code of the first record of every cell, (lines, M) int64; -1 = none."""
        assert self.cell is not None
        image = np.full(n_lines * points_per_line, NO_CODE, np.int64)
        cell = self.cell - first_line * points_per_line
        inside = (cell >= 0) & (cell < len(image))
        # the last assignment counts
        image[cell[inside][::-1]] = self.codes[inside][::-1]
        return image.reshape(n_lines, points_per_line)


def _placed(cells: _Cells, partner: _Cells) -> _Cells:
    # codes with the cells of the partner, if only that has cells, and as many records
    if (
        (cells.cell is not None and not cells.is_assumed)
        or partner.cell is None
        or partner.is_assumed
    ):
        return cells
    if cells.n_records is None or cells.n_records != partner.n_records:
        return cells
    n = min(len(cells.codes), len(partner.codes))
    return replace(partner, codes=cells.codes[:n], cell=partner.cell[:n])


def _with_points(path: Path, dimension: str | None, where: Path | None) -> SideFile:
    # the points have the cells of the labels, if they can be read as records
    points = None if where is None else _points_of(path, where)
    if points is not None:
        with suppress(PrcError):
            return SideFile.open(path, dimension, points)
    return SideFile.open(path, dimension, None)


def _first_codes(file: SideFile, most: int) -> I64:
    parts: list[I64] = []
    n = 0
    if most:
        for chunk in open_codes(Path(file.codes.path), file.name).codes():
            parts.append(chunk[: most - n])
            n += len(parts[-1])
            if n == most:
                break
    return np.concatenate(parts) if parts else np.empty(0, np.int64)


def _png(places: U8, names: tuple[str, ...]) -> bytes:
    # colour numbers: 0 = white, then the classes, then the colour of agreement
    colours = [_NONE, *(bytes.fromhex(class_colour(name)[1:]) for name in names), _AGREE]
    height, width = places.shape
    across = max(1, _WIDTH // width)
    down = max(1, _HEIGHT // height)
    # a small picture keeps its aspect ratio
    across, down = min(across, 4 * down), min(down, 4 * across)
    image = Image.fromarray(np.ascontiguousarray(places))
    image.putpalette([value for colour in colours for value in colour])
    target = io.BytesIO()
    image.resize((width * across, height * down), Image.Resampling.NEAREST).save(
        target, "PNG", optimize=True
    )
    return target.getvalue()
