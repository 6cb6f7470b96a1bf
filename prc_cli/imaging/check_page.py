"""The page of a check by hand: drawn shots with their surroundings, one after the other.

The page never shows a predicted class. A person who sees it agrees more often than one who does
not, and a person who sees it after each answer learns what the classifier does.

Values travel as in the viewer. Every place has two texts: bytes (range on a logarithmic scale and
intensity of every cell) and coordinates (of the cells with a return).
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F64, I64
from prc_cli.imaging.page import HandLabels, interactive_page, pack
from prc_cli.imaging.pictures import colour_map

_FAR_M = 300.0
"""Points farther from the shot than this have no place [m]."""
_STEPS_M = (0.01, 0.02)
"""Coordinates are rounded to this in the near and in the wide window [m]."""
_RANGE_M = 0.002
"""Ranges of the near window are rounded to this, for the flood over like ranges [m]."""
_ZERO = 32_768
"""Coordinate 0 as an unsigned number of two bytes; 0 = no place."""
_LEAST_UP_DEG = 8.0
_MOST_UP_DEG = 60.0
_ABOVE_DEG = 8.0
"""The cloud is seen from the scanner, but a little from above."""
_MIDDLE = 60.0
"""Percentile of the distances that the first view shows."""
_REACH_M = (1.5, 12.0)
"""Least and greatest radius of the first view [m]."""


class Cell(NamedTuple):
    """A shot that was drawn."""

    scanner: int
    line: int
    column: int
    record: int
    stratum: int


class Window(NamedTuple):
    """Cells around a shot, which is in the middle."""

    steps: tuple[int, int]
    """Lines and columns from cell to cell."""
    range_m: F32
    """(lines, columns) float32 [m]; NaN = no return, or outside the scan."""
    xyz_m: F32 | None
    """(lines, columns, 3) float32 [m], relative to the shot; None = nothing places the shots."""
    intensity: F32
    """(lines, columns) float32; NaN = none."""
    record: I64
    """(lines, columns) int64, index in the input; -1 = none."""
    is_flipped: bool
    """Whether later columns are higher."""


class PlaceView(NamedTuple):
    """A shot and its surroundings."""

    cell: Cell
    near: Window
    wide: Window
    to_scanner: F64
    """(3,) float64, from the shot to the scanner in the frame of the coordinates; NaN = unknown."""


def check_page(
    views: Iterable[PlaceView],
    *,
    title: str,
    head: str,
    answers: Mapping[str, Any],
    colours: Sequence[tuple[int, int, int]],
    file: str,
    labels: HandLabels,
) -> str:
    """Return the page.

    Parameters
    ----------
    views : iterable of PlaceView
        In the order in which they are shown.
    title, head : str
    answers : mapping
        The answers file without answers, which the page fills in and saves.
    colours : sequence of colours
        Of the classes of ``answers``.
    file : str
        Name under which it is saved.
    labels : HandLabels
        How the near windows are painted.
    """
    places = []
    texts: dict[str, str] = {}
    for number, view in enumerate(views):
        about, texts_of_place = _place(view)
        places.append(about)
        texts |= {f"{name}-{number}": text for name, text in texts_of_place.items()}
    about = {
        "answers": answers,
        "colours": colours,
        "file": file,
        "command": shlex.join(["prc", "evaluate", labels.name, file]),
        "paint": asdict(labels),
        "range_step": _RANGE_M,
        "places": places,
        "ramp": colour_map().tolist(),
        "steps": _STEPS_M,
        "zero": _ZERO,
    }
    return interactive_page("check", about, texts, {"title": title, "head": head})


def _place(view: PlaceView) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the description of a place, and its packed values."""
    windows = (view.near, view.wide)
    bright = _linear_scale(view.wide.intensity)
    planes: list[NDArray[np.uint32]] = []
    points: list[NDArray[np.uint32]] = []
    for window, step_m in zip(windows, _STEPS_M, strict=True):
        planes += [_bytes(np.log(window.range_m), _log_scale(window.range_m))]
        if bright is not None:
            planes += [_bytes(window.intensity, bright)]
        if window.xyz_m is not None:
            points.append(_coordinates(window.xyz_m[window.range_m > 0], step_m))
    cell = view.cell
    middle = tuple(size // 2 for size in view.near.range_m.shape)
    azimuth_deg, up_deg = _direction(view.to_scanner)
    about = {
        "windows": [
            {"n": window.range_m.shape, "steps": window.steps, "flipped": window.is_flipped}
            for window in windows
        ],
        "range": round(float(view.near.range_m[middle]), 3),
        "cell": [cell.scanner, cell.line, cell.column, cell.record],
        "bright": bright is not None,
        "azimuth": azimuth_deg,
        "up": up_deg,
        "reach": _reach(view.wide),
        "points": sum(map(len, points)) // 3,
    }
    texts = {"cells": pack(np.concatenate([plane.ravel() for plane in planes]), 1)}
    texts["shots"] = pack(_shots(view.near), 4)
    if points:
        texts["points"] = pack(np.concatenate(points), 2)
    return about, texts


def _shots(window: Window) -> NDArray[np.uint32]:
    # record and range of every shot with a return, one after the other
    seen = window.range_m > 0
    steps = np.rint(window.range_m[seen].astype(np.float64) / _RANGE_M)
    return np.concatenate([window.record[seen] + 1, steps]).astype(np.uint32)


def _log_scale(range_m: F32) -> tuple[float, float]:
    known = np.log(range_m[np.isfinite(range_m)].astype(np.float64))
    low, high = np.percentile(known, (1, 99)) if len(known) else (0.0, 1.0)
    return round(float(low), 4), round(float(max(high, low + 0.02)), 4)


def _linear_scale(values: F32) -> tuple[float, float] | None:
    known = values[np.isfinite(values)].astype(np.float64)
    if not len(known) or np.ptp(known) == 0:
        return None
    low, high = np.percentile(known, (2, 98))
    return float(low), float(max(high, low + 1e-6))


def _bytes(values: NDArray[Any], scale: tuple[float, float]) -> NDArray[np.uint32]:
    # 0 = none, else 1 to 255 from the low to the high end
    share = (values.astype(np.float64) - scale[0]) / (scale[1] - scale[0])
    known = np.isfinite(share)
    codes = np.zeros(values.shape, np.uint32)
    codes[known] = 1 + np.rint(254 * np.clip(share[known], 0, 1)).astype(np.uint32)
    return codes


def _coordinates(xyz_m: F32, step_m: float) -> NDArray[np.uint32]:
    # x of all points, then y, then z: neighbours are alike
    is_near = np.isfinite(xyz_m).all(axis=1) & (np.abs(xyz_m) < _FAR_M).all(axis=1)
    codes = np.zeros(xyz_m.shape, np.uint32)
    steps = np.rint(xyz_m[is_near].astype(np.float64) / step_m).astype(np.int64)
    codes[is_near] = (steps + _ZERO).astype(np.uint32)
    return np.ascontiguousarray(codes.T).ravel()


def _direction(to_scanner: F64) -> tuple[float, float]:
    """Return azimuth (clockwise from north) and height of the first view [degrees]."""
    if not np.isfinite(to_scanner).all():
        return 215.0, 30.0
    east, north, up = to_scanner.tolist()
    azimuth_deg = math.degrees(math.atan2(east, north)) % 360
    up_deg = math.degrees(math.atan2(up, math.hypot(east, north)))
    up_deg = min(max(up_deg + _ABOVE_DEG, _LEAST_UP_DEG), _MOST_UP_DEG)
    return round(azimuth_deg, 1), round(up_deg, 1)


def _reach(window: Window) -> float:
    if window.xyz_m is None:
        return _REACH_M[0]
    distances = np.linalg.norm(window.xyz_m, axis=2)
    known = distances[np.isfinite(distances)]
    reach_m = float(np.percentile(known, _MIDDLE)) if len(known) else 0.0
    return round(min(max(reach_m, _REACH_M[0]), _REACH_M[1]), 2)
