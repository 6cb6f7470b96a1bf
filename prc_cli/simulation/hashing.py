"""Numbers that look random and depend on a seed, a purpose and a number alone."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F64, I64


def hashed(seed: int, purpose: int, number: I64) -> F64:
    """Hash whole numbers to 0..1 (finaliser of SplitMix64, Steele et al. 2014).

    >>> hashed(7, 0, np.array([1, 2, 1])).round(3).tolist()
    [0.772, 0.246, 0.772]
    """
    start = (seed * 0x9E3779B97F4A7C15 + purpose * 0xD1B54A32D192ED03) % 2**64
    with np.errstate(over="ignore"):
        x = number.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(start)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x = x ^ (x >> np.uint64(31))
    return (x >> np.uint64(11)).astype(np.float64) * 2.0**-53
