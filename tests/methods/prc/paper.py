"""The whole PRC method, written from the paper, in its order and symbols.

V. V. Lehtola et al. (2019), "Preregistration classification of mobile LIDAR data using spatial
correlations", IEEE TGRS 57(9), sections II-A to II-F and Algorithm 1, whose steps are numbered
here.

Slow: support and background are computed for the whole stream before it is cut into blocks, and the
areas of all segments are kept. The compiled classifier sees one block and a bounded state, and must
give the same labels and segments, bit for bit. This module shares no code with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, Mask


@dataclass(frozen=True)
class Settings:
    """Parameters, with the symbols of the paper; choices that it leaves open have names."""

    k: int = 99
    """Scan lines of a block."""
    environment: str = "urban"
    zeta_s: float = 1.0
    """Greatest range difference to shots of adjacent lines [m]."""
    zeta_p: float = 1.0
    """Greatest range difference within the line [m]."""
    rho_c: float = 1 / 3
    """Least share of the neighbourhood that supports a shot."""
    rounding: str = "ceil"
    """How ``rho_c |N|`` becomes a count.

    "ceil" as (3) has it, 3 of 8 and 2 of 6; "floor" 2 and 2.
    """
    form: str = "centred"
    """Reading of (9), see :func:`prc_cli.reference.prc.stages.is_intersection`."""
    alpha: float = 0.3
    d_c: float = 0.05
    """Least length of physical objects [m]."""
    min_votes: int = 3
    forks: str = "all"
    """Pieces of a split segment that keep its label: "all", or the "largest"."""
    area: float = 30.0
    """A, pixels of a smooth segment in a block of k lines."""
    gamma: int = 2
    """Iterations of the dilation."""
    ground: str = "running-total"
    """Which smooth segment is largest: by its pixels of all blocks, or of this one."""
    column_step: int = 10
    density: float = 1 / 3
    noise_in_ground_columns: bool = True
    """Whether ground overwrites noise as well, in the forest."""


# II-B. Supported measurements


def support(range_m: F32, settings: Settings) -> Mask:
    """Return S, the shots that enough of their neighbours support (4).

    Neighbours are counted along the stream, so the shots at the end of a line are next to those at
    the beginning of the next one. Missing ones support nothing."""
    r = range_m.ravel()
    m = range_m.shape[1]
    n_adjacent = (-m - 1, -m, -m + 1, m - 1, m, m + 1)  # (7)
    n_in_slice = (-4, -3, -2, -1, 1, 2, 3, 4)  # (8)
    need_in_slice = settings.rho_c * len(n_in_slice)
    need_adjacent = settings.rho_c * len(n_adjacent)
    if settings.rounding == "floor":
        need_in_slice = math.floor(need_in_slice)
        need_adjacent = math.floor(need_adjacent)
    supported = (
        ~np.isnan(r)
        & (_cover(r, n_in_slice, settings.zeta_p) >= need_in_slice)
        & (_cover(r, n_adjacent, settings.zeta_s) >= need_adjacent)
    )
    return supported.reshape(range_m.shape)


def _cover(r: F32, neighbourhood: tuple[int, ...], zeta: float) -> NDArray[np.int64]:
    """Return C, how many neighbours differ by less than zeta in range (5, 6)."""
    cover = np.zeros(len(r), dtype=np.int64)
    i = np.arange(len(r))
    for shift in neighbourhood:
        if shift != 0:  # in lines of one shot, a neighbour of (7) is the shot itself
            inside = i[(i + shift >= 0) & (i + shift < len(r))]
            difference = np.abs(r[inside] - r[inside + shift])
            cover[inside] += difference.astype(np.float64) < np.float64(zeta)
    return cover


# II-C. Extension of background


# II-D. Connected components in 2-D


# II-E. Smooth and nonsmooth surfaces


# II-F. Classification
