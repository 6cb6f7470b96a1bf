"""One HTML page with the cloud and the range image of a scan, to turn, zoom and click.

Values travel as planes: integers of one to four bytes, 0 = none, differences between neighbouring
shots, byte by byte, deflated, base64. The page decodes them with what every browser has.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, U8
from prc_cli.imaging.cloud import Box, bounds, fullest_azimuth
from prc_cli.imaging.page import HandLabels, interactive_page, pack
from prc_cli.imaging.pictures import Limits, colour_map, range_limits, value_limits

_ROOM = 0.5
"""Room around the framed box within which points are kept, as a share of its longest side."""
_SEEN_DEG = 30.0


@dataclass(frozen=True, slots=True)
class Values:
    """A number for every shot."""

    title: str
    values: F64
    """(lines, columns) float64; NaN = none."""
    step: float
    """What values are rounded to, or coarser where ``n_bytes`` do not suffice."""
    n_bytes: int = 2
    unit: str = "m"
    is_scale: bool = True
    """Whether shots can be coloured by it."""
    is_logarithmic: bool = False
    words: Mapping[int, str] = field(default_factory=dict)
    """What whole numbers mean, where they are no quantity."""


@dataclass(frozen=True, slots=True)
class ClassEntry:
    """A class of the legend."""

    place: int
    """Its number among the shots' classes."""
    name: str
    colour: tuple[int, int, int]
    share: str
    hidden: bool = False


@dataclass(frozen=True, slots=True)
class Shots:
    """What the page shows: lines and columns of a scan at even steps."""

    classes: U8
    """(lines, columns) uint8; 0 = no return."""
    range_m: F64
    """(lines, columns) float64; NaN = no return."""
    xyz_m: F64 | None
    """(lines, columns, 3) float64 [m], NaN = no place; None = nothing says where shots are."""
    framed: NDArray[np.bool_]
    """(lines, columns) bool: the shots that the view of the cloud is framed by."""
    first: tuple[int, int]
    """Line and column of the first shot."""
    step: tuple[int, int]
    """Lines and columns between shots."""
    entries: Sequence[ClassEntry]
    more: Mapping[str, Values] = field(default_factory=dict)
    """Further values by a name of letters."""
    order: Sequence[int] | None = None
    """Columns from top to bottom; None = as they come."""
    is_mirrored: bool = False
    """Whether the first line is on the right."""


def viewer_page(
    shots: Shots,
    *,
    title: str,
    head: str,
    notes: Sequence[str],
    foot: str,
    labels: HandLabels,
    why: str = "",
) -> str:
    """Return the page."""
    n_lines, n_columns = shots.classes.shape
    quantities = {"range": Values("range", shots.range_m, 0.001, 3, is_logarithmic=True)}
    quantities.update(shots.more)
    box: dict[str, Any] = {"centre": [0.0, 0.0, 0.0], "size": [1.0, 1.0, 1.0], "azimuth": 0.0}
    if shots.xyz_m is not None:
        box, coordinates = _placed(shots.xyz_m, shots.framed)
        quantities.update(coordinates)

    # the description of every plane, and its values as text
    planes: dict[str, dict[str, Any]] = {
        "class": {"bytes": 1, "n": shots.classes.size, "title": "class"}
    }
    texts = {"class": pack(shots.classes.ravel().astype(np.uint32), 1)}
    for name, quantity in quantities.items():
        limits = range_limits(shots.range_m) if name == "range" else None
        planes[name], texts[name] = _plane(quantity, limits)

    order = range(n_columns) if shots.order is None else shots.order
    about = {
        "lines": {"n": n_lines, "first": shots.first[0], "step": shots.step[0]},
        "columns": {"n": n_columns, "first": shots.first[1], "step": shots.step[1]},
        "classes": [asdict(entry) for entry in shots.entries],
        "planes": planes,
        "box": box,
        "order": [int(column) for column in order],
        "mirrored": shots.is_mirrored,
        "why": why,
        "ramp": colour_map().tolist(),
    }
    # pages of one scan share their labels, whatever its classes are
    scan = hashlib.sha256(f"{about['lines']} {about['columns']} {texts['range']}".encode())
    about["paint"] = asdict(replace(labels, scan=scan.hexdigest()[:16]))
    values = {"title": title, "head": head, "notes": notes, "foot": foot}
    named = {f"plane-{name}": text for name, text in texts.items()}
    return interactive_page("viewer", about, named, values)


def _placed(xyz_m: F64, framed: NDArray[np.bool_]) -> tuple[dict[str, Any], dict[str, Values]]:
    """Return the box to look at, and the coordinates of the shots near it."""
    has_place = np.isfinite(xyz_m).all(axis=2)
    points = xyz_m[has_place & framed]
    if not len(points):
        points = xyz_m[has_place]
    if not len(points):
        points = np.zeros((1, 3))
    box = bounds(points)
    inside = points[box.contains(points)]
    if not len(inside):
        inside = points
    page_box = {
        "centre": ((box.low + box.high) / 2).tolist(),
        "size": np.maximum(box.high - box.low, 0.1).tolist(),
        "azimuth": fullest_azimuth(inside, _SEEN_DEG, 1200, 700),
    }
    room = _ROOM * float((box.high - box.low).max())
    near = has_place & Box(box.low - room, box.high + room).contains(xyz_m)
    coordinates = {}
    for k, axis in enumerate("xyz"):
        values = np.where(near, xyz_m[..., k], np.nan)
        coordinates[axis] = Values(axis, values, 0.001, is_scale=axis == "z")
    return page_box, coordinates


def _plane(quantity: Values, limits: Limits | None) -> tuple[dict[str, Any], str]:
    """Return the description of a plane, and its packed values."""
    values = np.asarray(quantity.values, np.float64).ravel()
    known = np.isfinite(values)
    low = high = 0.0
    if known.any():
        low = float(values[known].min())
        high = float(values[known].max())
    n_steps = (high - low) / quantity.step
    most_steps = 256**quantity.n_bytes - 2
    scale = quantity.step * max(1, math.ceil(n_steps / most_steps))
    codes = np.zeros(len(values), np.int64)
    codes[known] = np.rint((values[known] - low) / scale).astype(np.int64) + 1
    about: dict[str, Any] = {
        "bytes": quantity.n_bytes,
        "n": len(values),
        "offset": low,
        "scale": scale,
        "title": quantity.title,
        "unit": quantity.unit,
        "digits": max(0, -math.floor(math.log10(scale) + 1e-9)),
    }
    if quantity.words:
        about["words"] = {str(number): word for number, word in quantity.words.items()}
    elif quantity.is_scale:
        about["low"], about["high"] = value_limits(values) if limits is None else limits
        about["log"] = quantity.is_logarithmic
    return about, pack(codes.astype(np.uint32), quantity.n_bytes)
