"""A picture from above: where two labellings are right and wrong."""

from __future__ import annotations

import io

import numpy as np

from prc_cli.core.types import F64, I64, U8
from prc_cli.evaluation.three import NO_STATE
from prc_cli.matching.nearest import cell_keys, cell_places

EDGE_M = 0.5
_MOST_PIXELS = 1600
_WHITE = (255, 255, 255)
STATE_COLOURS = ((222, 222, 222), (0, 114, 178), (230, 159, 0), (180, 20, 40), (204, 121, 167))
"""Colours of :data:`~prc_cli.evaluation.three.STATES` (Okabe and Ito's, safe for the colour-blind)."""


class StatePlan:
    """Shots by square of the plan and state."""

    def __init__(self) -> None:
        self._keys, self._counts = np.empty(0, np.int64), np.empty((0, NO_STATE + 1), np.int64)

    def add(self, x: F64, y: F64, states: U8) -> None:
        """Count shots."""
        keys, index = np.unique(cell_keys(x, y, EDGE_M), return_inverse=True)
        n = np.bincount(index * (NO_STATE + 1) + states, minlength=len(keys) * (NO_STATE + 1))
        both = np.concatenate([self._keys, keys])
        self._keys, place = np.unique(both, return_inverse=True)
        counts = np.zeros((len(self._keys), NO_STATE + 1), np.int64)
        np.add.at(counts, place, np.concatenate([self._counts, n.reshape(-1, NO_STATE + 1)]))
        self._counts = counts

    def picture(self) -> bytes | None:
        """Draw the most frequent error of every square, grey where none is; None without coordinates."""
        from PIL import Image

        column, row = cell_places(self._keys)
        if not len(column):
            return None
        column, row = column - column.min(), row.max() - row
        step = -(-max(int(column.max()), int(row.max()), 1) // _MOST_PIXELS)
        shape = int(row.max()) // step + 1, int(column.max()) // step + 1
        totals = np.zeros((shape[0] * shape[1], NO_STATE), np.int64)
        np.add.at(totals, row // step * shape[1] + column // step, self._counts[:, :NO_STATE])
        image = Image.fromarray(_worst(totals).reshape(shape))
        image.putpalette([value for colour in (_WHITE, *STATE_COLOURS) for value in colour])
        zoom = max(1, 800 // max(shape))
        target = io.BytesIO()
        image.resize((shape[1] * zoom, shape[0] * zoom), Image.Resampling.NEAREST).save(target, "PNG", optimize=True)
        return target.getvalue()


def _worst(counts: I64) -> U8:
    """Return 0 for squares without shots, 1 for those mostly right, else 1 + the most frequent other state."""
    n = counts.sum(axis=1)
    wrong = counts[:, 1:]
    place = np.where(2 * wrong.sum(axis=1) > n, 2 + np.argmax(wrong, axis=1), 1)
    return np.where(n > 0, place, 0).astype(np.uint8)
