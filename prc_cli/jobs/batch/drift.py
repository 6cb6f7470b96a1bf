"""Alarms for files whose classes are unlike those of earlier files.

A sensor that loses range, a wrong preset or a covered window does not make a file fail, but it
changes its classes. So prc compares the shares of the classes with earlier files of the same
configuration. The statistics are robust: a few unusual earlier files neither hide the next one nor
raise an alarm for good files.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64
from prc_cli.jobs.batch.journal import Entry
from prc_cli.jobs.batch.outcomes import Done, Outcome
from prc_cli.jobs.batch.types import Task


@dataclass(frozen=True, slots=True)
class Alarm:
    """A file whose classes are unlike those of earlier ones."""

    name: str
    sentence: str
    """What is unusual, with the class and both shares."""


MIN_EARLIER = 8
"""Least number of earlier files for an alarm."""
FLOOR = 0.05
"""Least total change of the shares for an alarm."""
SPREADS = 6.0
"""Least distance for an alarm, in robust standard deviations above the median distance."""
KNOWN_FRACTION = 0.05
"""No alarm if this share of the earlier files is like the file.

Archives have several kinds of drive.
"""
KNOWN_FILES = 3
"""Least number of such files for no alarm."""
_MAD_TO_SIGMA = 1.4826
"""Median absolute deviation to standard deviation, for a normal distribution."""


EARLIER_FILES = 500
"""Files are compared with so many that were done last before this run."""


def find_alarms(
    tasks: Iterable[Task], outcomes: Mapping[str, Outcome], known: Iterable[Entry]
) -> Iterator[Alarm]:
    """Compare every finished file of a run with the files of the same configuration before it."""
    latest_first = sorted(known, key=lambda entry: (entry.finished or "", entry.name), reverse=True)
    earlier: dict[str, list[Done]] = {}
    for entry in latest_first:
        files = earlier.setdefault(entry.config_sha256, [])
        # one more than needed, since a file is not compared with itself
        is_done = entry.state == "done" and len(files) <= EARLIER_FILES
        if is_done and isinstance(entry.outcome, Done):
            files.append(entry.outcome)
    for task in tasks:
        done = outcomes.get(task.name)
        if not isinstance(done, Done):
            continue
        files = earlier.get(task.config_sha256, [])
        labels = [dict(file.labels) for file in files if file.name != task.name]
        sentence = drift(dict(done.labels), labels[:EARLIER_FILES])
        if sentence is not None:
            yield Alarm(task.name, sentence)


def drift(labels: Mapping[str, int], earlier: Iterable[Mapping[str, int]]) -> str | None:
    """Compare the classes of a file with earlier files; return a sentence if they are unusual.

    The distance of two files is half the sum of the differences of their shares (total variation, 0
    to 1): the share of the records that would have to change class. A file is unusual if its
    distance from the median of the earlier files is above :data:`FLOOR`, and above the median of
    their distances by :data:`SPREADS` robust standard deviations, and if no small group of earlier
    files is within :data:`FLOOR` of it.
    """
    known = [histogram for histogram in earlier if sum(histogram.values()) > 0]
    if len(known) < MIN_EARLIER:
        return None
    names = sorted({name for histogram in (labels, *known) for name in histogram})
    if sum(labels.values()) <= 0:
        return f"there are no records, while {len(known)} earlier files have some"
    shares = _shares(known, names)
    file_shares = _shares([labels], names)[0]
    usual = np.median(shares, axis=0)
    distances = _distance(shares, usual)
    distance = float(_distance(file_shares, usual))
    middle = float(np.median(distances))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(distances - middle)))
    if distance <= max(FLOOR, middle + SPREADS * spread):
        return None
    n_alike = int(np.count_nonzero(_distance(shares, file_shares) <= FLOOR))
    if n_alike >= max(KNOWN_FILES, KNOWN_FRACTION * len(known)):
        return None
    # rounded, so that the first of two classes with the same change is named
    moved = int(np.argmax(np.round(np.abs(file_shares - usual), 9)))
    low, high = 100.0 * np.quantile(shares[:, moved], [0.1, 0.9])
    return (
        f"{names[moved]} is {100.0 * file_shares[moved]:.1f} % of the records, "
        f"in {len(known)} earlier files {100.0 * usual[moved]:.1f} % "
        f"({low:.1f} to {high:.1f} % in most)"
    )


def _shares(histograms: list[Mapping[str, int]], names: list[str]) -> F64:
    # (files, classes); every row sums to 1
    counts = np.array(
        [[histogram.get(name, 0) for name in names] for histogram in histograms], np.float64
    )
    shares: F64 = counts / counts.sum(axis=1, keepdims=True)
    return shares


def _distance(shares: F64, point: F64) -> F64:
    # total variation of every row, 0 to 1
    distance: F64 = 0.5 * np.abs(shares - point).sum(axis=-1)
    return distance
