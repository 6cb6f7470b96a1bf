"""Finds the angle of every beam from straight down in coordinates relative to the scanner.

Such coordinates are directions: they give the scan plane of every line and the angle of every shot
in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.stream import FAR_M
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.streams.down import (
    DECIMALS,
    MIN_RISE_RAD,
    LevelLinesError,
    NoddingError,
    NoDirectionError,
    TooFewReturnsError,
    WrongOriginError,
    wrap,
)

MAX_SCATTER_RAD = math.radians(5.0)
"""Largest median deviation of the directions of a column from line to line."""
SEAM_RAD = math.radians(30.0)
"""Larger steps beyond the usual one are dead angles.

Scanners with rows of unlike spacing have smaller ones.
"""
BACKWARD_RAD = math.radians(10.0)
"""Steps back up to this are scatter; larger ones are steps forward over the rest of the turn."""
MAX_TURNS = 1.1
"""Most turns of a line."""
MIN_ARC_RAD = math.radians(0.5)
"""Shorter lines give no plane."""
MAX_OFF_PLANE = 0.02
"""Largest median distance of shots from a plane through the scanner, as a share of the arc of the
line: scanners that turn while they sweep reach 0.011."""
MIN_OFF_PLANE_RAD = math.radians(0.1)
"""Shots closer to the plane than this are always accepted."""
MAX_DRIFT_RAD = math.radians(15.0)
"""Largest change of the tilt of the scan planes.

With more, the scanner nods and its lines are not vertical.
"""
MIN_LEVEL_RAD = math.radians(10.0)
"""Lines that rise by less than this and less than they sweep sideways are level arcs."""
LEAST_STEP_RAD = 1e-6
"""Angles closer than this are equal."""
N_TRIMS = 5
PLANE_SHOTS = 1 << 12
"""Shots of which a scan plane is fitted: about a line, in which no vehicle turns much."""

_TURN = 2 * math.pi


@dataclass(frozen=True, slots=True)
class Beams:
    """Beam directions of the columns of a scanner."""

    beam_rad: F64
    """(M,) float64, angle from straight down, (-pi, pi] [rad]; it turns one way, at most once."""
    is_straight: bool
    """Whether the angles are linear in the column."""
    n_lines: int
    """Number of lines used."""


def fit_beams(xyz: NDArray[Any]) -> Beams:
    """Find the angle of every beam from straight down in coordinates relative to the scanner.

    The scan plane of a line is fitted through the scanner; angles are measured in it, from its
    lowest direction. The sign is chosen so that angles grow with the column. Each column gets the
    median of its lines. If a straight line in the column is within half a step of nearly all
    medians it is used (profilers turn evenly), else the medians, made monotone.
    """
    unit, seen = _directions(xyz)
    enough = seen.sum(axis=1) >= 2
    if not enough.any():
        shown = "no line has two returns" if seen.any() else "no shot has a return"
        raise TooFewReturnsError(f"{shown} in the first lines")
    _check_lengths(xyz)
    unit = unit[enough]
    seen = seen[enough]
    normal, arc, off = _planes(unit, seen)
    wide = arc >= MIN_ARC_RAD
    if not wide.any():
        raise NoDirectionError(
            f"every line spans less than {math.degrees(MIN_ARC_RAD):g} deg of directions"
        )
    unit = unit[wide]
    seen = seen[wide]
    normal = normal[wide]
    arc = arc[wide]
    off = off[wide]
    rise = np.arccos(np.clip(np.abs(normal[:, 2]), 0.0, 1.0))
    if float(np.median(rise)) < MIN_RISE_RAD:
        raise LevelLinesError(
            "the lines do not rise: their planes are "
            f"{math.degrees(float(np.median(rise))):.1f} deg from horizontal, "
            f"expected at least {math.degrees(MIN_RISE_RAD):g}"
        )
    _check_level(unit, seen)
    _check_planes(arc, off, rise)
    steep = rise >= MIN_RISE_RAD
    angle = _angles_in_plane(unit[steep], seen[steep], normal[steep])
    seen = seen[steep]
    return _columns(angle, seen)


def _check_lengths(xyz: NDArray[Any]) -> None:
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.sqrt((np.asarray(xyz, np.float64) ** 2).sum(axis=-1))
    far = float(np.nanmedian(length[length > 0]))
    if far > FAR_M:
        raise WrongOriginError(
            f"xyz is not relative to the scanner: its ranges are {far / 1000:.0f} km in the middle"
        )


def _check_level(unit: F64, seen: Mask) -> None:
    """Refuse lines that run sideways at a nearly constant elevation.

    Such lines are sweeps of a turning head, not of its mirror.
    """
    elevation = np.arcsin(np.clip(unit[..., 2], -1.0, 1.0))
    azimuth = np.arctan2(unit[..., 1], unit[..., 0])
    is_level = np.zeros(len(unit), np.bool_)
    for row, has in enumerate(seen):
        rise = float(np.ptp(elevation[row, has]))
        # modulo half a turn, because a line through the zenith does not run sideways
        azimuths = np.sort(np.remainder(azimuth[row, has], math.pi))
        around = math.pi - float(np.max(np.diff(azimuths, append=azimuths[0] + math.pi)))
        sideways = around * float(np.cos(np.median(elevation[row, has])))
        is_level[row] = rise < MIN_LEVEL_RAD and rise < 0.5 * sideways
    if np.mean(is_level) > 0.5:
        raise LevelLinesError(
            "the lines do not rise: most run sideways at an elevation that changes by less than "
            f"{math.degrees(MIN_LEVEL_RAD):g} deg"
        )


def _check_planes(arc: F64, off: F64, rise: F64) -> None:
    """Refuse lines whose shots are off a plane through the origin, and planes of different tilt."""
    out = float(np.median(off))
    whole = float(np.median(arc))
    if out > max(MAX_OFF_PLANE * whole, MIN_OFF_PLANE_RAD):
        raise WrongOriginError(
            "xyz is not relative to the scanner: the shots of a line lie "
            f"{math.degrees(out):.2f} deg off a plane "
            f"through the origin over {math.degrees(whole):.1f} deg"
        )
    # planes of short lines are uncertain
    low, high = np.percentile(rise[arc >= 0.5 * whole], (5, 95)).tolist()
    if high - low > MAX_DRIFT_RAD:
        raise NoddingError(
            f"the lines are not vertical lines: their planes are {math.degrees(low):.0f} to "
            f"{math.degrees(high):.0f} deg from horizontal, "
            f"expected the same within {math.degrees(MAX_DRIFT_RAD):g} deg"
        )


def _directions(xyz: NDArray[Any]) -> tuple[F64, Mask]:
    wide = np.asarray(xyz, np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.sqrt((wide * wide).sum(axis=-1))
        seen: Mask = np.isfinite(length) & (length > 0)
        unit = np.where(seen[..., None], wide / length[..., None], 0.0)
    return unit, seen


def _planes(unit: F64, seen: Mask) -> tuple[F64, F64, F64]:
    """Fit planes through the scanner to lines.

    Return normals, arcs [rad], median distances of shots [rad].
    """
    weight = seen.astype(np.float64)
    for _ in range(N_TRIMS):
        moments = np.einsum("lm,lmi,lmj->lij", weight, unit, unit)
        values, vectors = np.linalg.eigh(moments)
        normal: F64 = vectors[:, :, 0]
        off = np.where(seen, np.abs(np.einsum("lmi,li->lm", unit, normal)), np.nan)
        middle = np.nanmedian(off, axis=1)
        # trim the farthest shots, but none within 0.5 deg
        limit = np.maximum(3 * 1.4826 * middle, math.radians(0.5))
        weight = (seen & (off <= limit[:, None])).astype(np.float64)
    total = np.maximum(values.sum(axis=1), np.finfo(float).tiny)
    # the standard deviation of a uniform distribution over an arc is the arc over the root of 12
    arc = np.sqrt(12 * np.maximum(values[:, 1], 0.0) / total)
    return normal, arc, np.arcsin(np.minimum(middle, 1.0))


def _angles_in_plane(unit: F64, seen: Mask, normal: F64) -> F64:
    """Return the angle from the lowest direction of the plane, (lines, M), growing with the column.

    NaN = none.
    """
    flat = np.hypot(normal[:, 0], normal[:, 1])
    side = np.stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal))], axis=1) / flat[:, None]
    down = normal * normal[:, 2:3]
    down[:, 2] -= 1.0
    down /= flat[:, None]
    angle: F64 = np.arctan2(
        np.einsum("lmi,li->lm", unit, side), np.einsum("lmi,li->lm", unit, down)
    )
    angle[~seen] = np.nan
    for row, has in zip(angle, seen, strict=True):
        step = wrap(np.diff(row[has]))
        if np.sign(step[np.abs(step) < math.pi / 2]).sum() < 0:
            np.negative(row, out=row)
    return angle


def _columns(angle: F64, seen: Mask) -> Beams:
    m = angle.shape[1]
    columns = np.flatnonzero(seen.any(axis=0))
    angle = angle[:, columns]
    seen = seen[:, columns]
    filled = np.where(seen, angle, 0.0)
    middle = np.arctan2((np.sin(filled) * seen).sum(axis=0), (np.cos(filled) * seen).sum(axis=0))
    for _ in range(2):
        middle = wrap(middle + np.nanmedian(wrap(angle - middle), axis=0))
    scatter = float(np.nanmedian(np.abs(wrap(angle - middle))))
    if scatter > MAX_SCATTER_RAD:
        raise NoDirectionError(
            "the shots of a column look different ways, "
            f"{math.degrees(scatter):.1f} deg apart in the middle"
        )
    beam_rad, is_straight = turn_evenly(columns, middle, seen.sum(axis=0).astype(np.float64), m)
    return Beams(beam_rad, is_straight, len(angle))


def forward_steps(angle: F64) -> F64:
    """Return the steps of angles that grow modulo a turn, but for scatter [rad]."""
    step = wrap(np.diff(angle))
    step[step < -BACKWARD_RAD] += _TURN
    return step


def turn_evenly(
    columns: I64,
    angle: F64,
    weight: F64,
    points_per_line: int,
) -> tuple[F64, bool]:
    """Return angles of all columns from those of some, growing with the column."""
    step = forward_steps(angle)
    along = angle[0] + np.concatenate([[0.0], np.cumsum(step)])
    if along[-1] - along[0] > MAX_TURNS * _TURN:
        turns = (along[-1] - along[0]) / _TURN
        raise NoDirectionError(
            "the directions do not turn with the column: "
            f"{turns:.1f} turns in a line, expected one at most"
        )
    beyond = step - float(np.median(step / np.diff(columns))) * np.diff(columns)
    seam = int(np.argmax(beyond)) + 1
    if beyond[seam - 1] > SEAM_RAD:
        # the sector that is not measured lies within the line: begin behind it, or amid columns
        # never seen
        first = (int(columns[seam - 1]) + int(columns[seam]) + 1) // 2
        turned = np.roll((columns - first) % points_per_line, -seam)
        beam, is_straight = _grown(
            turned, np.roll(angle, -seam), np.roll(weight, -seam), points_per_line
        )
        return np.roll(beam, first), is_straight
    return _grown(columns, angle, weight, points_per_line)


def _grown(
    columns: I64,
    angle: F64,
    weight: F64,
    points_per_line: int,
) -> tuple[F64, bool]:
    """Return the angles of all columns, without steps of half a turn or more.

    See :func:`turn_evenly`.
    """
    along = angle[0] + np.concatenate([[0.0], np.cumsum(forward_steps(angle))])
    every = np.arange(points_per_line, dtype=np.float64)
    slope, start = _straight(columns.astype(np.float64), along, weight)
    off = np.abs(along - (start + slope * columns))
    if slope > 0 and float(np.percentile(off, 99)) <= 0.5 * slope:
        return _finish(start + slope * every), True
    known_columns, value = _monotone(columns.astype(np.float64), along, weight)
    if len(known_columns) < 2:
        raise NoDirectionError("the directions do not turn with the column")
    beam = np.interp(every, known_columns, value)
    slope = float((value[-1] - value[0]) / (known_columns[-1] - known_columns[0]))
    before = every < known_columns[0]
    after = every > known_columns[-1]
    beam[before] = value[0] + slope * (every[before] - known_columns[0])
    beam[after] = value[-1] + slope * (every[after] - known_columns[-1])
    return _finish(beam), False


def _finish(beam: F64) -> F64:
    if len(beam) and beam[-1] - beam[0] > MAX_TURNS * _TURN:
        raise NoDirectionError(
            "the directions do not turn with the column: "
            f"{(beam[-1] - beam[0]) / _TURN:.1f} turns in a line"
        )
    step = float(np.max(np.diff(beam), initial=0.0))
    if step >= math.pi:
        raise NoDirectionError(
            f"neighbouring columns look {math.degrees(step):.0f} deg apart, "
            "expected less than half a turn"
        )
    return wrap(np.round(beam, DECIMALS))


def _straight(column: F64, angle: F64, weight: F64) -> tuple[float, float]:
    """Return slope and intercept of a straight line, without outliers."""
    use = weight
    for _ in range(N_TRIMS):
        total = use.sum()
        x = column - (use * column).sum() / total
        y = angle - (use * angle).sum() / total
        square = (use * x * x).sum()
        slope = float((use * x * y).sum() / square) if square > 0 else 0.0
        off = np.abs(y - slope * x)
        use = np.where(off <= max(3 * 1.4826 * float(np.median(off)), 1e-9), weight, 0.0)
        if not use.any():
            break
    return slope, float((angle - y).flat[0] - slope * (column - x).flat[0])


def _monotone(column: F64, angle: F64, weight: F64) -> tuple[F64, F64]:
    """Return strictly growing knots of the isotonic regression of the angles."""
    from scipy.optimize import (
        isotonic_regression,
    )  # imported here: loading takes longer than classifying a small file

    value = isotonic_regression(angle, weights=weight).x
    # sums of equal angles differ in their last bits
    first = np.flatnonzero(np.diff(value, prepend=-np.inf) > LEAST_STEP_RAD)
    total = np.add.reduceat(weight, first)
    return np.add.reduceat(weight * column, first) / total, value[first]


def angles_in_planes(xyz: F32) -> F64:
    """Return the angle of every shot in its scan plane, from the lowest direction [rad].

    >>> angle = np.linspace(-1.0, 1.0, 5)
    >>> line = np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1).astype(np.float32)
    >>> np.abs(angles_in_planes(line)).round(3).tolist()
    [1.0, 0.5, 0.0, 0.5, 1.0]
    """
    wide = xyz.astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = wide / np.sqrt((wide * wide).sum(axis=1))[:, None]
    angle = np.full(len(unit), np.nan)
    before = np.array([0.0, 1.0, 0.0])
    for first in range(0, len(unit), PLANE_SHOTS):
        part = unit[first : first + PLANE_SHOTS]
        seen = part[np.isfinite(part).all(axis=1)]
        if len(seen) < 3:
            continue
        normal = np.linalg.eigh(seen.T @ seen)[1][:, 0]
        normal = normal if normal @ before >= 0 else -normal
        before = normal
        down = normal * normal[2] - np.array([0.0, 0.0, 1.0])
        down /= max(math.hypot(normal[0], normal[1]), 1e-9)
        angle[first : first + PLANE_SHOTS] = np.arctan2(part @ np.cross(normal, down), part @ down)
    return wrap(angle)
