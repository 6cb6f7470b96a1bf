"""Find files whose class shares are far from those of the archive's earlier files.

A sensor that loses range, a wrong preset or a covered window do not make a file fail, they change what is found in it.
The shares of the classes are compared with those of earlier files of the same configuration. Robust statistics are
taken, so that some earlier files that were odd as well neither hide the next one nor raise an alarm for good ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from prc_cli.core.types import F64

MIN_EARLIER = 8
"""Least number of earlier files for an alarm."""
FLOOR = 0.05
"""Least total change of the shares for an alarm."""
SPREADS = 6.0
"""Least distance for an alarm, in robust standard deviations above the median distance."""
KNOWN_FRACTION = 0.05
"""An archive holds several kinds of drive: a file is not odd if so many earlier ones are like it."""
KNOWN_FILES = 3
"""The same, as the least number of files."""
_MAD_TO_SIGMA = 1.4826
"""Median absolute deviation to standard deviation, for a normal distribution."""


def drift(labels: Mapping[str, int], earlier: Iterable[Mapping[str, int]]) -> str | None:
    """Compare the classes of a file with those of earlier ones.

    The distance of two files is half the sum of the differences of their shares (total variation, 0 to 1): the part of
    the records that would have to change class. A file is odd if its distance from the median of the earlier files is
    above :data:`FLOOR` and above the median of their own distances by :data:`SPREADS` robust standard deviations,
    and there is no small group of earlier files within :data:`FLOOR` of it.

    >>> street = [{"GROUND": 600 + i, "OBJECT": 400 - i} for i in range(20)]
    >>> drift({"GROUND": 590, "OBJECT": 410}, street) is None
    True
    >>> drift({"GROUND": 150, "OBJECT": 850}, street)
    'GROUND is 15.0 % of the records, in 20 earlier files 60.9 % (60.2 to 61.7 % in most)'
    """
    known = [histogram for histogram in earlier if sum(histogram.values()) > 0]
    if len(known) < MIN_EARLIER:
        return None
    names = sorted({name for histogram in (labels, *known) for name in histogram})
    if sum(labels.values()) <= 0:
        return f"there are no records, while {len(known)} earlier files have some"
    shares = _shares(known, names)
    own = _shares([labels], names)[0]
    usual = np.median(shares, axis=0)
    distances = _distance(shares, usual)
    distance = float(_distance(own, usual))
    middle = float(np.median(distances))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(distances - middle)))
    if distance <= max(FLOOR, middle + SPREADS * spread):
        return None
    n_alike = int(np.count_nonzero(_distance(shares, own) <= FLOOR))
    if n_alike >= max(KNOWN_FILES, KNOWN_FRACTION * len(known)):
        return None
    # rounded, so that of two classes that moved by the same the first is named whatever the last bit says
    moved = int(np.argmax(np.round(np.abs(own - usual), 9)))
    low, high = 100.0 * np.quantile(shares[:, moved], [0.1, 0.9])
    return (
        f"{names[moved]} is {100.0 * own[moved]:.1f} % of the records, in {len(known)} earlier files "
        f"{100.0 * usual[moved]:.1f} % ({low:.1f} to {high:.1f} % in most)"
    )


def _shares(histograms: list[Mapping[str, int]], names: list[str]) -> F64:
    """Return the shares of the classes, (files, classes) float64, each row summing to 1."""
    counts = np.array([[histogram.get(name, 0) for name in names] for histogram in histograms], np.float64)
    shares: F64 = counts / counts.sum(axis=1, keepdims=True)
    return shares


def _distance(shares: F64, point: F64) -> F64:
    """Return the total variation distance of every row from a point, float64, 0 to 1."""
    distance: F64 = 0.5 * np.abs(shares - point).sum(axis=-1)
    return distance
