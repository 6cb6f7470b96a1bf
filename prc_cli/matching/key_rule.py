"""Keys by which records are matched: a time, a record index, a dimension of whole numbers, or a place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, Mask

AXES = ("x", "y", "z")
_EXACT = float(1 << 53)
"""Whole numbers below are exact in float64."""


@dataclass(frozen=True, slots=True)
class KeyRule:
    """The key by which a record is matched."""

    kind: str
    """``time``, ``dimension``, ``cell`` (scan line and column), ``record`` (index in the input), ``rank`` (index among
    the records with a class) or ``place`` (coordinates)."""
    dimension: str = "time"
    """Dimension that holds the key; of a place, the axis that records are sorted by."""
    same: tuple[str, ...] = ()
    """Integer dimensions (0 to 65535) that must be equal beside the key, such as ``return_number``; at most three."""
    offset: float = 0.0
    """Added to the key [s for times]."""

    @property
    def key_names(self) -> tuple[str, ...]:
        """Dimensions that hold the key."""
        return AXES if self.kind == "place" else (self.dimension,) if self.kind in ("time", "dimension") else ()

    @property
    def names(self) -> tuple[str, ...]:
        """Dimensions that the rule reads."""
        return (*self.key_names, *self.same)


def exact_keys(stored: NDArray[Any]) -> tuple[F64, Mask]:
    """Return ids (n,) as float64, and which of them are whole numbers that it holds exactly.

    >>> exact_keys(np.array([7.0, 0.5, np.nan]))[1]
    array([ True, False, False])
    """
    with np.errstate(invalid="ignore"):
        key = stored.astype(np.float64)
        return key, (np.abs(key) < _EXACT) & (np.floor(key) == key)
