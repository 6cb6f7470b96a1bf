"""The shift of one registered cloud against another: first by occupied voxels, then by planes."""

from __future__ import annotations

from typing import Any

import numpy as np

from prc_cli.core.types import F64
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
_PAIRS = 2_500
_GROUPS = 8
_ROUNDS = 5
_AROUND = 16
_FLAT = 0.2
_REACH_M = 1.0
"""Neighbours of a plane; the most that they rise above it, as a share of their second extent (both
squared); how far planes are looked for."""
_GATE = 3.0


def shift_of(left: Cloud, right: Cloud) -> F64 | None:
    """Return the shift of the right cloud against the left one (3,) [m]; None = not significant."""
    coarse = _coarse_shift(left, right)
    start = np.zeros(3) if coarse is None else coarse
    random = np.random.default_rng(0)
    parts: list[tuple[F64, Any]] = []
    for x0, y0, x1, y1 in random.permutation(
        np.array(tiles_of(left, right)).reshape(-1, 4)
    ).tolist():
        left_xyz = xyz_of(sample_of(left.read((x0, y0, x1, y1)), random, _PAIRS))
        dx, dy = start[:2].tolist()
        right_xyz = xyz_of(right.read((x0 + dx, y0 + dy, x1 + dx, y1 + dy), _REACH_M))
        if len(left_xyz) and len(right_xyz) > _AROUND:
            parts.append((left_xyz, tree_of(right_xyz)))
        if len(parts) == _BOXES:
            break
    fitted = _fitted(parts, start)
    if fitted is None or np.abs(fitted[0] - start).max() > _REACH_M:
        return coarse
    shift, error = fitted
    sure = np.abs(shift) > np.maximum(_SURE * error, LEAST_SHIFT_M)
    return np.where(sure, shift, 0.0) if sure.any() else coarse


def _fitted(parts: list[tuple[F64, Any]], shift: F64) -> tuple[F64, F64] | None:
    """Move points until they lie on the planes around them.

    Return the shift (3,) and its standard error (3,).

    The error comes from groups of points along the drive, each left out once (jackknife): errors of
    a trajectory are alike for seconds.
    """
    for _ in range(_ROUNDS):
        pairs = [_planes(points + shift, tree) for points, tree in parts]
        if sum(len(pair[0]) for pair in pairs) < _GROUPS * _AROUND:
            return None
        place, normal, off = (np.concatenate(part) for part in zip(*pairs, strict=True))
        kept = _within(normal, off)
        place = place[kept]
        normal = normal[kept]
        off = off[kept]
        longer = int(np.argmax(np.ptp(place[:, :2], axis=0)))
        group = np.argsort(np.argsort(place[:, longer])) * _GROUPS // len(place)
        left = np.stack([normal[group == k].T @ normal[group == k] for k in range(_GROUPS)])
        right = np.stack([normal[group == k].T @ off[group == k] for k in range(_GROUPS)])
        shift = shift + np.linalg.lstsq(left.sum(axis=0), right.sum(axis=0))[0]
    left = left.sum(axis=0) - left
    right = right.sum(axis=0) - right
    without = np.array([np.linalg.lstsq(*sums)[0] for sums in zip(left, right, strict=True)])
    return shift, np.sqrt(
        (_GROUPS - 1) / _GROUPS * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    )


def _planes(points: F64, tree: Any) -> tuple[F64, F64, F64]:
    """Return points near planes (n, 3), normals (n, 3), distances along them (n,) [m]."""
    distance, near = tree.query(points, distance_upper_bound=_REACH_M)
    points = points[np.isfinite(distance)]
    near = near[np.isfinite(distance)]
    around = tree.data[tree.query(tree.data[near], k=_AROUND)[1]]
    middle = around.mean(axis=1)
    offsets = around - middle[:, None]
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    flat = spread[:, 0] < _FLAT * spread[:, 1]
    normal = axes[flat, :, 0]
    return points[flat], normal, ((middle[flat] - points[flat]) * normal).sum(axis=1)


def _within(normal: F64, off: F64) -> Any:
    """Return which pairs are no outliers among those whose planes face the same axis.

    Ground does not outvote walls.
    """
    facing = np.argmax(np.abs(normal), axis=1)
    kept = np.zeros(len(off), np.bool_)
    for axis in range(3):
        pairs = np.flatnonzero(facing == axis)
        if len(pairs):
            signed = off[pairs] * np.sign(normal[pairs, axis])
            middle = np.median(signed)
            kept[pairs] = (
                np.abs(signed - middle)
                <= _GATE * 1.4826 * np.median(np.abs(signed - middle)) + 1e-6
            )
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

    boxes = tiles_of(left, right)
    cells, n = left.counts()
    if not boxes or not right.n:
        return None
    column, row = (place[int(np.argmax(n))] * CELL_M for place in cell_places(cells))
    middle = np.array([column, row]) + CELL_M / 2
    half = np.array(_SHIFT_VOXELS) * SHIFT_VOXEL_M / 2
    box = (*(middle - half[:2]).tolist(), *(middle + half[:2]).tolist())
    both = [cloud.read(box) for cloud in (left, right)]
    if any(len(columns["z"]) < _LEAST_RECORDS for columns in both):
        return None
    corner = np.append(middle, np.median(both[0]["z"])) - half
    grids = []
    for columns in both:
        place = np.floor((xyz_of(columns) - corner) / SHIFT_VOXEL_M).astype(np.int64)
        place = place[((place >= 0) & (place < _SHIFT_VOXELS)).all(axis=1)]
        grid = np.zeros(_SHIFT_VOXELS, np.float32)
        grid[tuple(place.T)] = 1.0
        grids.append(fft.rfftn(grid))
    score = fft.irfftn(np.conj(grids[0]) * grids[1], _SHIFT_VOXELS)
    reach = int(_MOST_SHIFT_M / SHIFT_VOXEL_M)
    for axis, size in enumerate(_SHIFT_VOXELS):
        index = [slice(None)] * 3
        index[axis] = slice(reach + 1, size - reach)
        score[tuple(index)] = 0.0
    peak = np.unravel_index(int(np.argmax(score)), score.shape)
    steps = []
    for cell, size in zip(peak, _SHIFT_VOXELS, strict=True):
        steps.append(cell - size if cell > size // 2 else cell)
    if score[peak] < _CLEARER * score[0, 0, 0] or max(map(abs, steps)) < 2:
        return None
    return np.array(steps, np.float64) * SHIFT_VOXEL_M


def shift_text(shift: F64) -> str:
    """Return a shift for a sentence.

    >>> shift_text(np.array([0.0, 0.3, -0.4]))
    'by 0.50 m (x +0.00, y +0.30, z -0.40 m)'
    """
    axes = ", ".join(f"{axis} {value:+.2f}" for axis, value in zip(AXES, shift, strict=True))
    return f"by {np.linalg.norm(shift):.2f} m ({axes} m)"
