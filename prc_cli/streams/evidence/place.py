"""Street or forest: what kind of place the first lines of a scan show.

A road is smooth, and most objects beside it are, too. The floor of a forest is rough, and most
objects on it are leaves. A shot is smooth if it is near the line between two shots a little before
and after it in its scan line. Facades also go on from line to line, stems do not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, Mask

SAMPLE_LINES = 64
MOST_LINES = 256
"""Lines with returns that show a clear forest, and for all else: a stem fills the first few."""
MAX_CELLS = 1 << 22
"""Most cells that are read to find these lines."""
REACH_RAD = math.radians(0.6)
"""Angle to the two shots of the line, one column at least."""
JOINED_M = 0.3
JOINED_STEPS = 6.0
"""Two shots are on one surface up to this distance, or this many distances across the beam."""
SMOOTH_M = 0.015
SMOOTH_PER_M = 0.002
"""A smooth shot is this near to the line, and so much farther per metre of range.

Roads are rough to 5 mm, ranges of
coarse scanners to 10 mm, plants to 5 cm."""
LOW_RAD = math.radians(75.0)
LOW_M = 15.0
"""The ground is looked for this near to straight down, in this range."""
HIGH_M = 40.0
"""Largest range of objects above the scanner."""
LEAST_LOW = 1000
"""Fewer shots on the ground are too few to tell."""
LEAST_HIGH_SHARE = 0.01
"""With fewer shots, of all cells, there are no objects above the scanner."""
FOREST_SCORE = 0.98
OPEN_SCORE = 0.05
"""Score: the smooth share of the ground, plus a third of the smooth share of objects above.

Streets have 0.99 and more, forests 0.5 to 0.97. Chosen on 31 simulated streets (of four scanners)
and 10 forests. Within ``OPEN_SCORE`` more lines are used: coarse noisy scanners have 0.978 in 64
lines of a street, and 1.02 and more in 256.
"""
CLOSE_SCORE = 0.03
"""Scores this near to it give a warning."""
BUILT_SHARE = 0.42
"""Least smooth share of objects above in a street.

With less, a place with a smooth floor may be a park, or a forest on level ground. Of 48 simulated
streets one has less in 256 lines. Forests have 0.05 to 0.41, a park 0.2.
"""
LASTING_LINES = 16
LASTING_M = 0.1
LASTING_PER_M = 0.02
"""A smooth object lasts if its column has this range, nearly, so many lines later.

A facade does. A bare stem is as smooth within a line, but narrow.
"""
LASTING_SHARE = 0.14
"""Least lasting share of objects above in a street, and most in a forest.

Chosen on 5 simulated streets, with 22 to 41 %, and 4 forests with a smooth or rough floor, with 1
to 7 %.
"""


Kind = Literal["street", "forest", "unknown"]


@dataclass(frozen=True, slots=True)
class Place:
    """The kind of a place."""

    kind: Kind
    why: str
    """The figures, for people."""
    is_open: bool = False
    """Whether more lines may change the kind."""
    doubt: str = ""
    """The reason for another kind, with the limit; empty if there is none."""


def place_of(range_m: F32, beam_rad: F64) -> Place:
    """Return whether the place is a street or a forest."""
    steps = np.abs(np.diff(np.unwrap(beam_rad)))
    step = float(np.median(steps)) if len(steps) else 0.0
    k = max(round(REACH_RAD / step), 1) if step > 0 else 1
    if range_m.shape[1] <= 2 * k:
        return Place("unknown", "the lines are too short to show a street or a forest")
    middle_m = range_m[:, k:-k].astype(np.float64)
    beam = beam_rad[k:-k]
    joined, smooth = _smooth(range_m, beam_rad, k, step)
    low = joined & (np.abs(beam) < LOW_RAD) & (middle_m < LOW_M)
    high = ~np.isnan(middle_m) & (-np.cos(beam) > 0) & (middle_m < HIGH_M)
    n_low = int(np.count_nonzero(low))
    n_high = int(np.count_nonzero(high))
    if n_low < LEAST_LOW:
        return Place(
            "unknown", "too few neighbouring shots are on the ground to show a street or a forest"
        )
    floor = int(np.count_nonzero(low & smooth)) / n_low
    reason = f"{100 * floor:.0f} % of the ground is smooth"
    if n_high < LEAST_HIGH_SHARE * middle_m.size:
        # no objects: a road in the open, or a clearing
        limit = FOREST_SCORE - BUILT_SHARE / 3
        kind: Kind = "street" if floor > limit else "unknown"
        doubt = (
            f"a road has more than {limit:.0%} of smooth ground"
            if abs(floor - limit) < CLOSE_SCORE
            else ""
        )
        return Place(kind, f"{reason}, and no object is above the scanner", bool(doubt), doubt)
    standing = int(np.count_nonzero(high & smooth)) / n_high
    reason += f", and {100 * standing:.0f} % of the objects above the scanner"
    lasting = _lasting_share(middle_m, high, high & smooth)
    is_built = standing >= BUILT_SHARE if lasting is None else lasting >= LASTING_SHARE
    score = floor + standing / 3
    kind = "forest" if score < FOREST_SCORE else "street"
    off = abs(score - FOREST_SCORE)
    doubt = ""
    if kind == "street" and standing < BUILT_SHARE and not is_built:
        kind = "unknown"
        doubt = f"forests have less smooth ground, streets more smooth objects ({BUILT_SHARE:.0%})"
    elif lasting is not None and is_built != (kind == "street"):
        doubt = (
            f"{lasting:.0%} of the objects are smooth and go on for {LASTING_LINES} lines; streets "
            f"have more than {LASTING_SHARE:.0%}, forests less"
        )
        kind = "unknown" if kind == "street" else "forest"
    if off < CLOSE_SCORE:
        doubt = (
            f"the first plus a third of the second is {score:.2f}, "
            f"near the limit of forests ({FOREST_SCORE:.2f})"
        )
    return Place(kind, reason, kind != "forest" or off < OPEN_SCORE or bool(doubt), doubt)


def _lasting_share(middle_m: F64, high: Mask, smooth: Mask) -> float | None:
    """Return the share of the objects above that are smooth and go on; None: too few lines."""
    now_m = middle_m[:-LASTING_LINES]
    n_high = int(np.count_nonzero(high[:-LASTING_LINES]))
    if not n_high:
        return None
    apart_m = np.abs(middle_m[LASTING_LINES:] - now_m)
    lasts = smooth[:-LASTING_LINES] & (apart_m < LASTING_M + LASTING_PER_M * now_m)
    return int(np.count_nonzero(lasts)) / n_high


def _smooth(
    range_m: F32,
    beam_rad: F64,
    k: int,
    step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return which shots have both neighbours on one surface, and which are smooth.

    The first and last k columns are left out.
    """
    r = range_m.astype(np.float64)
    y = r * np.sin(beam_rad)
    z = -r * np.cos(beam_rad)
    middle_m = r[:, k:-k]
    across = y[:, 2 * k :] - y[:, : -2 * k]
    up = z[:, 2 * k :] - z[:, : -2 * k]
    length = np.hypot(across, up)
    beside = np.abs((y[:, k:-k] - y[:, : -2 * k]) * up - (z[:, k:-k] - z[:, : -2 * k]) * across)
    # comparisons with NaN are false: missing shots are neither
    joined = ~np.isnan(middle_m) & (
        length < np.maximum(JOINED_M, JOINED_STEPS * k * step * middle_m)
    )
    return joined, joined & (beside < (SMOOTH_M + SMOOTH_PER_M * middle_m) * length)


def place_of_blocks(blocks: Iterator[ScanBlock]) -> Place:
    """Return the place that the first lines of the first scanner show, for any blocks.

    Needs beam directions.
    """
    rows: list[F32] = []
    beam_rad: F64 | None = None
    first: Place | None = None
    scanner = None
    n_cells = 0
    for block in blocks:
        scanner = block.scanner if scanner is None else scanner
        if block.scanner != scanner:
            continue
        beam_rad = block.beam_rad
        most = max((MAX_CELLS - n_cells) // block.points_per_line, 0)
        lines = block.range_m[:most]
        n_cells += lines.size
        rows.extend(lines[~np.isnan(lines).all(axis=1)][: MOST_LINES - len(rows)])
        if first is None and beam_rad is not None and len(rows) >= SAMPLE_LINES:
            first = place_of(np.stack(rows[:SAMPLE_LINES]), beam_rad)
            if not first.is_open:
                return first
        if len(rows) == MOST_LINES or most <= block.n_lines:
            break
    if beam_rad is None or not rows:
        return Place("unknown", "there are no returns to show a street or a forest")
    return place_of(np.stack(rows), beam_rad)
