"""Pictures of the errors of a method: ranges, reference, prediction, and wrong returns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.contest_data import Scan
from benchmarks.contest_judge import mapping_of
from prc_cli.core.classes import LABEL_COLOURS, Label
from prc_cli.core.types import U8
from prc_cli.imaging.pictures import (
    AGREE_COLOUR,
    NOT_SCORED_COLOUR,
    difference_picture,
    range_bar,
    range_limits,
    range_picture,
)
from prc_cli.imaging.sheet import Axis, Panel, draw_sheet, zoom_for

MOST_LINES = 520
MOST_COLUMNS = 1100
"""Lines of a picture; columns are thinned to at most so many."""
NAMES = ("noise", "ground", "building", "vegetation", "stem", "other")
_LABELS = (
    Label.NOISE,
    Label.GROUND,
    Label.BUILDING,
    Label.VEGETATION,
    Label.STEM,
    Label.UNCLASSIFIED,
)
UNSCORED = len(NAMES) + 1
COLOURS: U8 = np.array(
    [LABEL_COLOURS[Label.MISSING], *(LABEL_COLOURS[label] for label in _LABELS), NOT_SCORED_COLOUR],
    np.uint8,
)
"""Of no return, the classes and what is not judged."""


def failures(
    scan: Scan,
    codes: U8,
    method: str,
    path: Path,
) -> None:
    """Draw the first lines of a scan and what a method makes of them into a PNG.

    Parameters
    ----------
    scan : Scan
        With a reference.
    codes : (lines, M) uint8
        Class codes of the method.
    method : str
        Its name, for the head.
    path : Path
        Picture.
    """
    order = np.argsort(scan.angle_rad)
    every = -(-scan.range_m.shape[1] // MOST_COLUMNS)
    part = (slice(0, MOST_LINES), order[::every])
    # upright scans are wide: lines across, columns upward
    ranges = scan.range_m[part]
    limits = range_limits(scan.range_m)
    predicted, reference = _places(scan, codes, part)
    pictures = {
        "range": range_picture(ranges, limits),
        "reference": COLOURS[reference],
        method: COLOURS[predicted],
        "wrong, in the colour of the predicted class": difference_picture(
            predicted, reference, COLOURS, UNSCORED
        ),
    }
    if scan.is_upright:
        pictures = {name: np.rot90(picture) for name, picture in pictures.items()}
    x = Axis("shot", 0, scan.range_m.shape[1])
    y = Axis("line", 0, ranges.shape[0])
    if scan.is_upright:
        x = y
        y = Axis("ring", scan.range_m.shape[1], 0)
    zoom = zoom_for(
        *next(iter(pictures.values())).shape[1::-1], least_width=700, least_height=120, most=1100
    )
    panels = [
        Panel(
            name,
            np.ascontiguousarray(picture),
            x,
            y,
            bar=range_bar(limits) if name == "range" else None,
            zoom=zoom,
        )
        for name, picture in pictures.items()
    ]
    used = np.unique(np.concatenate([predicted.ravel(), reference.ravel()]))
    key = [
        (NAMES[k - 1], tuple(int(c) for c in COLOURS[k])) for k in used.tolist() if 0 < k < UNSCORED
    ]
    key += [("not judged", NOT_SCORED_COLOUR), ("right", AGREE_COLOUR)]
    wide = pictures["range"].shape[1] > 2 * pictures["range"].shape[0]
    image = draw_sheet(f"{scan.name}: {method}", panels, tuple(key), columns=1 if wide else 2)
    path.parent.mkdir(parents=True, exist_ok=True)
    image.quantize(128).save(path, optimize=True)


def _places(scan: Scan, codes: U8, part: tuple[slice, NDArray[np.intp]]) -> tuple[U8, U8]:
    """Return places in :data:`COLOURS` of what is predicted and of the reference."""
    mapping = mapping_of(scan.mapping)
    there = ~np.isnan(scan.range_m[part])
    part_codes = codes[part].astype(np.int64)
    part_codes[part_codes == 0] = 1
    sides = []
    for values, side in ((part_codes, "predicted"), (scan.codes[part], "reference")):
        names = mapping.names(side)  # type: ignore[arg-type]
        place = np.array([NAMES.index(name) + 1 for name in names] + [UNSCORED])
        index = mapping.class_indices(values.ravel(), side).reshape(values.shape)  # type: ignore[arg-type]
        sides.append(np.where(there, place[index], 0).astype(np.uint8))
    return sides[0], sides[1]
