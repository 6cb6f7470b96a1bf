"""The reference of the paper's forest: cylinders around stems, ground by height, else noise."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from prc_cli.core.classes import Label
from prc_cli.core.types import F64, U8
from prc_cli.simulation.forest.scene import ForestScene

CYLINDER_RADIUS_OF_DBH = 2.0
"""Radius of a cylinder over the diameter at breast height."""
CYLINDER_HEIGHT_M = 4.0
CYLINDER_BELOW_BREAST_M = 1.0
"""Cylinders begin this far below breast height [m]."""
GROUND_BELOW_BREAST_M = 0.5
"""Ground is what is lower than this under the breast height of the nearest tree [m]."""

_SEARCH_M = 15.0
"""Search radius for the nearest tree, beyond all points [m]; forests are denser."""
_NEIGHBOURS = 8
"""Stems keep apart; a point lies in no more cylinders than this."""
_POINTS_AT_ONCE = 1_000_000


def reference_labels(scene: ForestScene, xyz: F64) -> U8:
    """Label registered points by the rule of Lehtola et al. (2019, III), right or wrong as it is.

    A point is a stem within an upright cylinder on a tree: two diameters in radius, 4 m high, from
    1 m below the place where the diameter was measured (1.3 m above the ground). Outside of all
    cylinders it is ground where it lies 0.5 m or more under the breast height of the nearest tree,
    low plants included. All else is noise. The paper's sentence on the ground, "under 0.5 m from
    the nearest reference tree DBH altitude", can be read in other ways; read as here, the ground
    ends 0.8 m above the foot of the nearest tree.
    """
    labels = np.full(len(xyz), Label.MISSING, dtype=np.uint8)
    for start in range(0, len(xyz), _POINTS_AT_ONCE):
        part = slice(start, start + _POINTS_AT_ONCE)
        finite = np.isfinite(xyz[part]).all(axis=1)
        labels[part][finite] = _label(scene, xyz[part][finite])
    return labels


def _label(scene: ForestScene, xyz: F64) -> U8:
    labels = np.full(len(xyz), Label.NOISE, dtype=np.uint8)
    if not len(xyz):
        return labels
    low = xyz[:, :2].min(axis=0)
    high = xyz[:, :2].max(axis=0)
    x, y = ((low + high) / 2).tolist()
    reach = float(np.hypot(*(high - low))) / 2
    stems = scene.stems_near(x, y, reach + _SEARCH_M)
    if not len(stems):
        return labels
    breast = stems.breast
    radius = CYLINDER_RADIUS_OF_DBH * stems.dbh
    tree = cKDTree(breast[:, :2])
    away, nearest = tree.query(xyz[:, :2])
    is_ground = xyz[:, 2] <= breast[nearest, 2] - GROUND_BELOW_BREAST_M
    labels[is_ground] = Label.GROUND
    # cylinders overlap, and the nearest tree may have the thinner one
    near = np.flatnonzero(away <= radius.max())
    n_neighbours = min(_NEIGHBOURS, len(stems))
    away, neighbours = tree.query(xyz[near, :2], k=np.arange(1, n_neighbours + 1))
    above_breast = xyz[near, 2, None] - breast[neighbours, 2]
    is_inside = (away <= radius[neighbours]) & (above_breast >= -CYLINDER_BELOW_BREAST_M)
    is_inside &= above_breast <= CYLINDER_HEIGHT_M - CYLINDER_BELOW_BREAST_M
    labels[near[is_inside.any(axis=1)]] = Label.STEM
    return labels
