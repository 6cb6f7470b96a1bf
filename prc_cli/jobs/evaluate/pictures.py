"""Pictures of the classes of two label files side by side, shot by shot, for the page of an evaluation."""

from __future__ import annotations

import io
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.core.errors import PrcError
from prc_cli.core.types import I64, U8
from prc_cli.evaluation.html import class_colour
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.mapping import Side as SideName
from prc_cli.formats.labels import open_codes
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.render.scan import open_for_pictures, upright
from prc_cli.matching.pairs import files_of, stem_of
from prc_cli.matching.sides import LINE, Side, SideFile

MAX_LINES = 600
"""Scan lines in a picture."""
_MAX_CELLS = 1 << 22
_WIDTH, _HEIGHT = 1200, 480
_NONE, _AGREE = (255, 255, 255), (222, 222, 222)


def class_pictures(
    predicted: Path,
    reference: Path,
    mapping: ClassMapping,
    points_per_line: int | None = None,
    dimensions: tuple[str | None, str | None] = (None, None),
    points: tuple[Path | None, Path | None] = (None, None),
) -> tuple[tuple[str, bytes], ...]:
    """Draw the first lines as predicted, as in the reference, and where they differ; time to the right, sky up."""
    names = mapping.names("reference")
    names += tuple(name for name in mapping.names("predicted") if name not in names)
    paths = zip((predicted, reference), dimensions, strict=True)
    points_per_line = points_per_line or next(filter(None, (_line_length(*side) for side in paths)), None)
    if points_per_line is None:
        return ()
    wanted = min(MAX_LINES, _MAX_CELLS // points_per_line) * points_per_line
    sides: tuple[tuple[SideName, Path], ...] = (("predicted", predicted), ("reference", reference))
    found = []
    for (side, path), dimension in zip(sides, dimensions, strict=True):
        codes = _first_codes(path, dimension, wanted)
        # place 0: not scored
        place = np.array([0, *(names.index(name) + 1 for name in mapping.names(side))])
        found.append(place[mapping.class_indices(codes, side) + 1].astype(np.uint8))
    n_lines = min(len(places) for places in found) // points_per_line
    if not n_lines:
        return ()
    beside = (_points_of(path, where) for (_, path), where in zip(sides, points, strict=True) if where is not None)
    rows = _rows((*beside, predicted, reference), points_per_line, -(-points_per_line // _HEIGHT))
    first, second = (
        places[: n_lines * points_per_line].reshape(n_lines, points_per_line)[:, rows].T for places in found
    )
    differ = np.where(first == second, np.uint8(len(names) + 1), first)
    differ[(first == 0) | (second == 0)] = 0
    lines = f"lines 0-{n_lines - 1}"
    return (
        (f"Predicted, {lines} of {predicted.name}", _png(first, names)),
        (f"Reference, {lines} of {reference.name}", _png(second, names)),
        ("Where they differ, in the colour of the predicted class; grey: they agree", _png(differ, names)),
    )


def _points_of(labels: Path, where: Path) -> Path:
    """Return the point file of a label file."""
    return next((path for path in files_of([where]) if stem_of(path) == stem_of(labels)), where)


def _rows(paths: Iterable[Path], points_per_line: int, every: int) -> NDArray[np.intp]:
    """Return the columns that are drawn, from the top."""
    config = LoadedConfig(RunConfig(input=InputConfig(points_per_line=points_per_line)))
    columns = np.arange(0, points_per_line, every)
    for path in paths:
        # a file that cannot be read as a stream has no vertical direction
        with suppress(PrcError):
            block = next(iter(open_for_pictures(config, path).blocks()), None)
            if block is None or block.beam_rad is None or block.points_per_line != points_per_line:
                continue
            order = upright(block.beam_rad[::every])
            return columns if order is None else columns[order]
    return columns


def _line_length(path: Path, dimension: str | None) -> int | None:
    """Return M of a file that numbers its scan lines, None if lines are not known or not equally long."""
    side = Side((SideFile.open(path, dimension, None),))
    if LINE not in side.dimensions:
        return None
    line = next(side.chunks((LINE,))).values[LINE]
    starts = np.flatnonzero(np.diff(line)) + 1
    if not starts.size:
        return None
    m = int(starts[0])
    return m if np.array_equal(line - line[0], np.arange(len(line)) // m) else None


def _first_codes(path: Path, dimension: str | None, wanted: int) -> I64:
    parts: list[I64] = []
    n = 0
    if wanted:
        for chunk in open_codes(path, dimension).chunks():
            parts.append(chunk[: wanted - n])
            n += len(parts[-1])
            if n == wanted:
                break
    return np.concatenate(parts) if parts else np.empty(0, np.int64)


def _png(places: U8, names: tuple[str, ...]) -> bytes:
    """Draw places in the table of classes; 0 = white, the place after the last class = they agree."""
    colours = [_NONE, *(bytes.fromhex(class_colour(name)[1:]) for name in names), _AGREE]
    height, width = places.shape
    across, down = max(1, _WIDTH // width), max(1, _HEIGHT // height)
    # a small picture keeps its aspect ratio
    across, down = min(across, 4 * down), min(down, 4 * across)
    image = Image.fromarray(np.ascontiguousarray(places))
    image.putpalette([value for colour in colours for value in colour])
    target = io.BytesIO()
    image.resize((width * across, height * down), Image.Resampling.NEAREST).save(target, "PNG", optimize=True)
    return target.getvalue()
