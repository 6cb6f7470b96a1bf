"""Modes of samples on a line by mean shift (Comaniciu and Meer 2002), as the ground algorithm needs them.

Mean shift with a Gaussian kernel climbs the density of the samples from every sample; samples that end at one place
belong to one mode. On a line the places are the maxima of the density and the samples of a maximum are those between
the minima around it, so that nothing has to climb. The density is computed on a grid of an eighth of a bandwidth, in
whole numbers: the result does not depend on the order of the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli import kernels
from prc_cli.core.errors import PrcError
from prc_cli.core.types import F64, I64

MOST_BANDWIDTHS = 1_000_000
"""Samples may lie this far apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Modes of a set of samples, rising."""

    places: F64
    """(m,) float64, maxima of the density, to an eighth of a bandwidth."""
    counts: I64
    """(m,) int64, samples that belong to each."""

    def main(self) -> float:
        """Return the mode with most samples, of equals the lowest; NaN without samples."""
        return float(self.places[np.argmax(self.counts)]) if len(self.places) else float("nan")


def mean_shift(values: F64, bandwidth: float) -> Modes:
    """Find the modes of samples; modes closer than half a bandwidth are one.

    Parameters
    ----------
    values : (n,) float64
    bandwidth : float
        Standard deviation of the Gaussian kernel, in the unit of the values.

    Raises
    ------
    PrcError
        When a value is not finite, the bandwidth not positive, or the values span a million bandwidths.

    Examples
    --------
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
