"""Ranges: invalid ones become missing, and one return of a shot is chosen for the range image."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import Assumption, ReadTally
from prc_cli.core.types import F32, Mask
from prc_cli.formats.options import InputConfig

KEY = "input.range_scale"
_LARGEST = float(np.finfo(np.float32).max)


def clean_ranges(
    range_m: NDArray[Any], min_range: float = 0.0, max_range: float | None = None
) -> tuple[F32, ReadTally]:
    """Return float32 ranges, NaN where they are not finite, not positive or outside the bounds.

    Ranges are rounded to float32 before they are compared. The tally counts them by reason.
    """
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        stored = np.require(range_m, dtype=np.float32, requirements=["C", "W"])
        low = np.float32(min(max(min_range, 0.0), _LARGEST))
        high = np.float32(_LARGEST if max_range is None else min(max_range, _LARGEST))
        is_kept = (stored > low) & (stored <= high)
        n_lost = stored.size - np.count_nonzero(is_kept) - np.count_nonzero(np.isnan(stored))
        n_infinite = np.count_nonzero(np.isinf(stored))
        n_not_positive = np.count_nonzero(stored <= 0) - np.count_nonzero(stored == -np.inf)
    tally = ReadTally(
        n_not_finite=int(n_infinite),
        n_not_positive=int(n_not_positive),
        n_beyond=int(n_lost - n_infinite - n_not_positive),
    )
    ranges: F32 = np.where(is_kept, stored, np.float32(np.nan))
    return ranges, tally


def scale_told(scale: float) -> tuple[Assumption, ...]:
    """Return the assumption that a given scale of ranges is."""
    return (
        (Assumption(KEY, f"{scale:g}", "metres in one of the stored ranges, as given"),)
        if scale != 1.0
        else ()
    )


def refuse_scale(config: InputConfig, path: str, why: str) -> None:
    """Refuse a scale of ranges that would change nothing."""
    if config.range_scale != 1.0:
        raise ConfigError(
            KEY,
            f"{config.range_scale:g} changes nothing in {path}: {why}",
            "leave it out",
        )


ReturnRule: TypeAlias = Literal["strongest", "first", "last"]
"""The return of a shot that the range image shows (``input.return``)."""


def continues_run(keys: tuple[NDArray[Any], ...], number_of_returns: NDArray[Any]) -> Mask:
    """Mark records that may belong to the same shot as the record before."""
    several = number_of_returns > 1
    same: Mask = np.zeros(len(several), np.bool_)
    same[1:] = several[1:] & (number_of_returns[1:] == number_of_returns[:-1])
    for key in keys:
        same[1:] &= key[1:] == key[:-1]
    return same


def mark_shots(continues: Mask, return_number: NDArray[Any] | None) -> Mask:
    """Mark the first record of every shot.

    Two shots of two returns with one coarse time stamp:

    >>> mark_shots(np.array([False, True, True, True]), np.array([1, 2, 1, 2]))
    array([ True, False,  True, False])
    >>> mark_shots(np.array([False, True]), None)
    array([ True, False])
    """
    starts: Mask = ~continues
    if return_number is None or starts.all():
        return starts
    position = np.arange(len(starts))
    first_of_run = np.maximum.accumulate(np.where(starts, position, 0))
    repeats = return_number == return_number[first_of_run]
    repeats[1:] |= return_number[1:] == return_number[:-1]
    starts |= continues & repeats
    return starts


def choose_returns(
    starts: Mask,
    range_m: F32,
    intensity: NDArray[Any] | None,
    return_number: NDArray[Any] | None,
    rule: ReturnRule,
) -> Mask:
    """Mark the return of every shot that an image shows.

    Returns with a range come first. Of equal returns the earlier one is chosen.
    """
    if starts.all():
        return starts
    n = len(starts)
    if rule == "strongest" and intensity is not None:
        score = np.where(np.isfinite(intensity), intensity, -np.inf)
    else:
        order = np.arange(n) if return_number is None else return_number
        score = order.astype(np.float64) if rule == "last" else -order.astype(np.float64)
        score[np.isnan(score)] = -np.inf
    # returns with a range first, then the highest score among them
    first = np.flatnonzero(starts)
    shot = np.cumsum(starts) - 1
    valid = ~np.isnan(range_m)
    candidate = valid | ~np.logical_or.reduceat(valid, first)[shot]
    score = np.where(candidate, score, -np.inf)
    best = candidate & (score == np.maximum.reduceat(score, first)[shot])
    position = np.flatnonzero(best)
    earliest = np.ones(len(position), np.bool_)
    earliest[1:] = shot[position[1:]] != shot[position[:-1]]
    chosen: Mask = np.zeros(n, np.bool_)
    chosen[position[earliest]] = True
    return chosen
