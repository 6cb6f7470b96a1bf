"""Matcher by place: which records of a window have the nearest coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64
from prc_cli.matching.join import CODE, Columns, Match
from prc_cli.matching.key_rule import AXES
from prc_cli.matching.keys import both
from prc_cli.matching.ties import pair_in_order

_TREE = {"balanced_tree": False, "compact_nodes": False}
"""Medians are slow where many points share a coordinate, as on a grid."""


@dataclass(frozen=True, slots=True)
class NearestPlaces:
    """Pairs of records with the nearest coordinates; the key of the join is one of the three.

    Records of one place are paired as :func:`prc_cli.matching.ties.pair_in_order` says.

    Both left points are near the right one, which is nearer to the second:

    >>> left, right = ({"x": np.array(x), "y": np.zeros(len(x)), "z": np.zeros(len(x))} for x in ([0, 0.1], [0.11]))
    >>> one, several = (NearestPlaces(0.5, one_to_one=mutual)(left, right, slice(0, 2)) for mutual in (True, False))
    >>> one.left, several.left
    (array([1]), array([0, 1]))
    """

    tolerance: float
    """Largest distance [m]."""
    one_to_one: bool = True
    """Whether a pair must be nearest to each other; else every left record takes its nearest right one."""

    def __call__(self, left: Columns, right: Columns, decided: slice) -> Match:
        """Pair the records of a window."""
        from scipy.spatial import cKDTree

        (left_value, left_group), (right_value, right_group) = _places(left), _places(right)
        if not len(left_value) or not len(right_value):
            return pair_in_order(left_group, right_group, np.full(len(left_value), -1))
        # coordinates of a projection are millions of metres: the trees work beside the origin
        origin = right_value[0]
        left_value, right_value = left_value - origin, right_value - origin
        # the bound is exclusive
        bound = float(np.nextafter(self.tolerance, math.inf))
        _, found = cKDTree(right_value, **_TREE).query(left_value, distance_upper_bound=bound, workers=-1)
        near = found < len(right_value)
        partner = np.where(near, found, -1).astype(np.int64)
        if self.one_to_one:
            asked = np.unique(partner[near])
            if len(asked):
                back = np.full(len(right_value), -1)
                _, back[asked] = cKDTree(left_value, **_TREE).query(right_value[asked], workers=-1)
                partner[near & (back[partner] != np.arange(len(left_value)))] = -1
            return pair_in_order(left_group, right_group, partner, classes=both(left, right, CODE))
        first = np.full(len(right_value), len(right_group), np.int64)
        np.minimum.at(first, right_group, np.arange(len(right_group)))
        chosen = np.flatnonzero(partner[left_group] >= 0)
        return Match(chosen, first[partner[left_group[chosen]]])


def _places(columns: Columns) -> tuple[F64, I64]:
    """Return the different places (k, 3), and which one every record is at (n,)."""
    xyz = np.stack([np.asarray(columns[axis], np.float64) for axis in AXES], axis=1)
    order = np.lexsort((xyz[:, 2], xyz[:, 1], xyz[:, 0]))
    placed = xyz[order]
    new = np.ones(len(xyz), np.bool_)
    np.any(placed[1:] != placed[:-1], axis=1, out=new[1:])
    group = np.empty(len(xyz), np.int64)
    group[order] = np.cumsum(new) - 1
    return placed[new], group
