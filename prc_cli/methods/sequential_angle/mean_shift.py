"""Modes of one-dimensional samples by mean shift (Comaniciu and Meer 2002), for the ground algorithm.

Mean shift with a Gaussian kernel moves every sample uphill in the density of the samples; samples that arrive at the
same place belong to one mode. In one dimension the modes are the maxima of the density, and the samples of a mode are
those between the minima on either side, so no iteration is needed. The density is computed on a grid of an eighth of a
bandwidth, in integers: the result does not depend on the order of the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli import kernels
from prc_cli.core.errors import PrcError
from prc_cli.core.types import F64, I64

MOST_BANDWIDTHS = 1_000_000
"""Largest span of the samples [bandwidths]."""


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Modes of a set of samples, ascending."""

    places: F64
    """(m,) float64, maxima of the density, to an eighth of a bandwidth."""
    counts: I64
    """(m,) int64, number of samples of each mode."""

    def main(self) -> float:
        """Return the mode with most samples, on ties the lowest; NaN without samples."""
        return float(self.places[np.argmax(self.counts)]) if len(self.places) else float("nan")


def mean_shift(values: F64, bandwidth: float) -> Modes:
    """Find the modes of samples; modes closer than half a bandwidth are merged.

    ``values`` (n,) float64.

    >>> mean_shift(np.array([89.0, 90.0, 91.0, 130.0, 131.0]), 5.0).counts
    array([3, 2])
    """
    values = np.ascontiguousarray(values, dtype=np.float64)
    if not (np.isfinite(bandwidth) and bandwidth > 0):
        raise PrcError("mean shift", f"found a bandwidth of {bandwidth}, expected a positive number")
    if not np.isfinite(values).all():
        raise PrcError("mean shift", "found a sample that is no number, expected finite samples", "leave NaN out")
    if len(values) and np.ptp(values) / bandwidth > MOST_BANDWIDTHS:
        problem = f"found samples that span {np.ptp(values) / bandwidth:.3g} bandwidths, expected at most a million"
        raise PrcError("mean shift", problem, "widen the bandwidth")
    places, counts = kernels.find_modes(values, float(bandwidth))
    return Modes(places, counts)
