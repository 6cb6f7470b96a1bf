"""Slow and obvious twin of the kernel of rays, see :mod:`prc_cli.reference.prc.stages`."""

from __future__ import annotations

from fractions import Fraction
from math import floor, sqrt

import numpy as np

from prc_cli.core.types import F64


def aim_shots(position: F64, turn: F64, columns: F64) -> tuple[F64, F64]:
    """Place and turn every shot; see :func:`prc_cli.simulation.casting_loops.aim_shots`."""
    n_lines, n_knots, m = len(position), position.shape[1] - 1, len(columns)
    origin, direction = np.empty((n_lines, m, 3)), np.empty((n_lines, m, 3))
    for line, column in np.ndindex(n_lines, m):
        share = float(Fraction(column * n_knots, m))
        k = floor(share)
        share -= k
        start, end = position[line, k], position[line, k + 1]
        origin[line, column] = start + (end - start) * share
        first, last = (
            [sum([float(a) * float(b) for a, b in zip(row, columns[column], strict=True)]) for row in turn[line, knot]]
            for knot in (k, k + 1)
        )
        way = np.array(first) + (np.array(last) - np.array(first)) * share
        direction[line, column] = way / sqrt(sum(float(part) * float(part) for part in way))
    return origin, direction
