"""Cleans ranges: invalid ones become missing and are counted by reason."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli import kernels
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import Assumption, ReadTally
from prc_cli.core.types import F32
from prc_cli.formats.options import InputConfig

KEY = "input.range_scale"
_LARGEST = float(np.finfo(np.float32).max)


def clean_ranges(
    range_m: NDArray[Any], min_range: float = 0.0, max_range: float | None = None
) -> tuple[F32, ReadTally]:
    """Return ranges that are finite, positive and within bounds; all else as NaN, counted by its reason.

    Checked after rounding to float32, so that float32, float64 and decimal text give the same result.

    >>> import numpy as np
    >>> ranges, tally = clean_ranges(np.array([2.5, np.nan, 0.0, -1.0, np.inf, 300.0]), max_range=120.0)
    >>> ranges.tolist()
    [2.5, nan, nan, nan, nan, nan]
    >>> tally.n_not_positive, tally.n_not_finite, tally.n_beyond
    (2, 1, 1)
    """
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        given = np.require(range_m, dtype=np.float32, requirements=["C", "W"])
        low = np.float32(min(max(min_range, 0.0), _LARGEST))
        high = np.float32(_LARGEST if max_range is None else min(max_range, _LARGEST))
    ranges, n_not_finite, n_not_positive, n_beyond = kernels.clean_ranges(given.reshape(-1), low, high)
    tally = ReadTally(n_not_finite=n_not_finite, n_not_positive=n_not_positive, n_beyond=n_beyond)
    return ranges.reshape(given.shape), tally


def scale_told(scale: float) -> tuple[Assumption, ...]:
    """Return what is said of a scale of ranges that was given."""
    return (Assumption(KEY, f"{scale:g}", "metres in one of the stored ranges, as given"),) if scale != 1.0 else ()


def refuse_scale(config: InputConfig, path: str, why: str) -> None:
    """Refuse a scale of ranges that would do nothing."""
    if config.range_scale != 1.0:
        raise ConfigError(KEY, f"found {config.range_scale:g}, which does nothing for {path}: {why}", "leave it out")
