"""The shift of one registered cloud against another: first by occupied voxels, then by planes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from prc_cli.core.types import F64, Mask
from prc_cli.matching.keys import AXES
from prc_cli.matching.nearest import (
    CELL_M,
    Cloud,
    cell_places,
    sample_of,
    tiles_of,
    tree_of,
    xyz_of,
)

LEAST_SHIFT_M = 0.05
"""Shifts below are what registered drives differ by."""
_SURE = 4.0
"""A component of a shift is named from this multiple of its standard error on."""
_BOXES = 8
"""Boxes in which points are compared with planes, and points of the left cloud in each."""
_PAIRS = 2_500
_GROUPS = 8
"""Groups of points along the drive: the spread between them gives the standard error."""
_ROUNDS = 5
_AROUND = 16
"""Neighbours that a plane is fitted to."""
_FLAT = 0.2
"""Largest rise of the neighbours above their plane, as a share of their second extent (both
squared)."""
_REACH_M = 1.0
"""How far from a point its plane may be."""
_GATE = 3.0
"""Pairs farther from the median than this many standard deviations are outliers."""


def shift_of(left: Cloud, right: Cloud) -> F64 | None:
    """Return the shift of the right cloud against the left one (3,) [m]; None = not significant."""
    coarse = _coarse_shift(left, right)
    start = np.zeros(3) if coarse is None else coarse
    random = np.random.default_rng(0)
    parts: list[_Part] = []
    boxes = random.permutation(np.array(tiles_of(left, right)).reshape(-1, 4))
    for x0, y0, x1, y1 in boxes.tolist():
        left_sample = sample_of(left.read((x0, y0, x1, y1)), random, _PAIRS)
        dx, dy = start[:2].tolist()
        shifted_box = (x0 + dx, y0 + dy, x1 + dx, y1 + dy)
        right_xyz = xyz_of(right.read(shifted_box, _REACH_M))
        if len(left_sample["x"]) and len(right_xyz) > _AROUND:
            parts.append(_Part(xyz_of(left_sample), tree_of(right_xyz)))
        if len(parts) == _BOXES:
            break
    fit = _fitted(parts, start)
    if fit is None or np.abs(fit.shift - start).max() > _REACH_M:
        return coarse
    is_sure = np.abs(fit.shift) > np.maximum(_SURE * fit.error, LEAST_SHIFT_M)
    return np.where(is_sure, fit.shift, 0.0) if is_sure.any() else coarse


class _Part(NamedTuple):
    """Points of both clouds in a box."""

    points: F64
    """(n, 3) of the left cloud [m]."""
    tree: Any
    """Of the right cloud."""


class _PointsAtPlanes(NamedTuple):
    """Points of the left cloud near planes of the right one."""

    normal: F64
    """(n, 3) of the planes."""
    place: F64
    """(n, 3) of the points, shifted [m]."""
    off: F64
    """(n,) from the point to its plane, along the normal [m]."""


class _ShiftFit(NamedTuple):
    shift: F64
    """(3,) [m]."""
    error: F64
    """(3,) standard error [m]."""


def _fitted(parts: list[_Part], shift: F64) -> _ShiftFit | None:
    """Move points until they lie on the planes around them; None if too few have a plane.

    The error comes from groups of points along the drive, each left out once (jackknife): errors of
    a trajectory are alike for seconds.
    """
    for _ in range(_ROUNDS):
        pairs = [_at_planes(part.points + shift, part.tree) for part in parts]
        if sum(len(pair.place) for pair in pairs) < _GROUPS * _AROUND:
            return None
        normal = np.concatenate([pair.normal for pair in pairs])
        off = np.concatenate([pair.off for pair in pairs])
        place = np.concatenate([pair.place for pair in pairs])
        kept = _no_outliers(normal, off)
        normal = normal[kept]
        off = off[kept]
        place = place[kept]
        # the groups follow each other along the longer side of the plan
        longer = int(np.argmax(np.ptp(place[:, :2], axis=0)))
        rank = np.argsort(np.argsort(place[:, longer]))
        group = rank * _GROUPS // len(place)
        # least squares: normal . step = off, summed by group
        matrices = []
        vectors = []
        for k in range(_GROUPS):
            normal_of_group = normal[group == k]
            matrices.append(normal_of_group.T @ normal_of_group)
            vectors.append(normal_of_group.T @ off[group == k])
        matrix = np.stack(matrices)
        vector = np.stack(vectors)
        shift = shift + np.linalg.lstsq(matrix.sum(axis=0), vector.sum(axis=0))[0]
    matrix_without = matrix.sum(axis=0) - matrix
    vector_without = vector.sum(axis=0) - vector
    step_without = np.array(
        [np.linalg.lstsq(matrix_without[k], vector_without[k])[0] for k in range(_GROUPS)]
    )
    squares = (step_without - step_without.mean(axis=0)) ** 2
    error = np.sqrt((_GROUPS - 1) / _GROUPS * squares.sum(axis=0))
    return _ShiftFit(shift, error)


def _at_planes(points: F64, tree: Any) -> _PointsAtPlanes:
    """Fit a plane around the point of the tree nearest to each point (n, 3); keep flat ones."""
    distance, nearest = tree.query(points, distance_upper_bound=_REACH_M)
    has_near = np.isfinite(distance)
    points = points[has_near]
    nearest = nearest[has_near]
    _, neighbours = tree.query(tree.data[nearest], k=_AROUND)
    around = tree.data[neighbours]
    middle = around.mean(axis=1)
    offsets = around - middle[:, None]
    # eigenvalues ascend: the first axis is the normal of the plane
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    is_flat = spread[:, 0] < _FLAT * spread[:, 1]
    normal = axes[is_flat, :, 0]
    off = ((middle[is_flat] - points[is_flat]) * normal).sum(axis=1)
    return _PointsAtPlanes(normal=normal, place=points[is_flat], off=off)


def _no_outliers(normal: F64, off: F64) -> Mask:
    """Return which pairs are no outliers among those whose planes face the same axis.

    Ground does not outvote walls.
    """
    facing = np.argmax(np.abs(normal), axis=1)
    kept = np.zeros(len(off), np.bool_)
    for axis in range(3):
        pairs = np.flatnonzero(facing == axis)
        if len(pairs):
            signed = off[pairs] * np.sign(normal[pairs, axis])
            from_median = np.abs(signed - np.median(signed))
            limit = _GATE * 1.4826 * np.median(from_median) + 1e-6
            kept[pairs] = from_median <= limit
    return kept


SHIFT_VOXEL_M = 0.25
_SHIFT_VOXELS = (192, 192, 96)
_MOST_SHIFT_M = 12.0
_LEAST_RECORDS = 4_000
_CLEARER = 1.15
"""A shift is believed if this many times as many occupied voxels fall on each other after it."""


def _coarse_shift(left: Cloud, right: Cloud) -> F64 | None:
    """Return a shift of voxels (3,) [m], by Fourier transform of the fullest tile."""
    from scipy import fft

    cells, n_points = left.counts()
    if not tiles_of(left, right) or not right.n:
        return None
    columns, rows = cell_places(cells)
    fullest = int(np.argmax(n_points))
    middle = np.array([columns[fullest] * CELL_M, rows[fullest] * CELL_M]) + CELL_M / 2
    half = np.array(_SHIFT_VOXELS) * SHIFT_VOXEL_M / 2
    box = (*(middle - half[:2]).tolist(), *(middle + half[:2]).tolist())
    # only the coordinates are kept: clouds may have many other columns
    left_xyz = xyz_of(left.read(box))
    right_xyz = xyz_of(right.read(box))
    if min(len(left_xyz), len(right_xyz)) < _LEAST_RECORDS:
        return None

    # how many occupied voxels fall on each other after every shift
    corner = np.append(middle, np.median(left_xyz[:, 2])) - half
    transforms = []
    for xyz in (left_xyz, right_xyz):
        voxel = np.floor((xyz - corner) / SHIFT_VOXEL_M).astype(np.int64)
        is_inside = ((voxel >= 0) & (voxel < _SHIFT_VOXELS)).all(axis=1)
        grid = np.zeros(_SHIFT_VOXELS, np.float32)
        grid[tuple(voxel[is_inside].T)] = 1.0
        transforms.append(fft.rfftn(grid))
    score = fft.irfftn(np.conj(transforms[0]) * transforms[1], _SHIFT_VOXELS)
    reach = int(_MOST_SHIFT_M / SHIFT_VOXEL_M)
    for axis, size in enumerate(_SHIFT_VOXELS):
        beyond_reach = [slice(None)] * 3
        beyond_reach[axis] = slice(reach + 1, size - reach)
        score[tuple(beyond_reach)] = 0.0

    peak = np.unravel_index(int(np.argmax(score)), score.shape)
    steps = []
    for place, size in zip(peak, _SHIFT_VOXELS, strict=True):
        steps.append(place - size if place > size // 2 else place)  # the second half is negative
    is_unclear = score[peak] < _CLEARER * score[0, 0, 0]
    if is_unclear or max(map(abs, steps)) < 2:
        return None
    return np.array(steps, np.float64) * SHIFT_VOXEL_M


def shift_text(shift: F64) -> str:
    """Return a shift for a sentence.

    >>> shift_text(np.array([0.0, 0.3, -0.4]))
    'by 0.50 m (x +0.00, y +0.30, z -0.40 m)'
    """
    axes = ", ".join(f"{axis} {value:+.2f}" for axis, value in zip(AXES, shift, strict=True))
    return f"by {np.linalg.norm(shift):.2f} m ({axes} m)"
