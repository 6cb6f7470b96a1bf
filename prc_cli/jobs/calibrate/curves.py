"""Shares of supported shots and of background over many thresholds, from one pass over the stream.

The curves of Lehtola et al. (2019), Fig. 4, for every pair of zeta_p and zeta_s at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from prc_cli import kernels
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, I64
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.prc.support import required_counts, stream_window, tail_after, window_reach

DECADES = (-3, 2)
"""Range of the threshold sweep, as powers of ten [m] (Fig. 4)."""
PER_DECADE = 10
"""Thresholds per decade."""


def thresholds(*also: float) -> F64:
    """Return ascending thresholds from 1 mm to 100 m, logarithmically spaced, including the given ones [m].

    >>> thresholds(0.7)[[0, -1]], 0.7 in thresholds(0.7)
    (array([1.e-03, 1.e+02]), True)
    """
    first, last = DECADES
    tenths = np.arange(first * PER_DECADE, last * PER_DECADE + 1)
    # 10 ** n of whole numbers is exact, so that 1 m is there as 1.0
    decade, rest = np.divmod(tenths, PER_DECADE)
    grid = np.array([float(f"1e{d}") for d in decade]) * 10 ** (rest / PER_DECADE)
    return np.unique(np.concatenate([grid, [value for value in also if value > 0]]))


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Numbers of supported and of background returns by threshold."""

    zetas_p: F64
    """(P,) float64, thresholds in the line [m]."""
    zetas_s: F64
    """(Q,) float64, thresholds to adjacent lines [m]."""
    supported: I64
    """(P, Q) int64, supported returns at every pair."""
    lengths: F64
    """(D,) float64, values of d_c [m]."""
    background: I64
    """(D,) int64, returns between two returns that eq. 9 marks at every d_c, supported or not."""
    n_between: int
    """Returns between two returns."""
    n_returns: int
    n_shots: int

    def share(self, zeta_p: float, zeta_s: float) -> float:
        """Return the supported share of the returns at thresholds of the grid."""
        p, q = np.flatnonzero(self.zetas_p == zeta_p), np.flatnonzero(self.zetas_s == zeta_s)
        if not (p.size and q.size):
            raise KeyError((zeta_p, zeta_s))
        return float(self.supported[p[0], q[0]] / self.n_returns)

    def over_zeta_p(self, zeta_s: float) -> F64:
        """Return the share over zeta_p with zeta_s fixed, (P,) float64."""
        column: F64 = self.supported[:, np.flatnonzero(self.zetas_s == zeta_s)[0]] / self.n_returns
        return column

    def over_zeta_s(self, zeta_p: float) -> F64:
        """Return the share over zeta_s with zeta_p fixed, (Q,) float64."""
        row: F64 = self.supported[np.flatnonzero(self.zetas_p == zeta_p)[0]] / self.n_returns
        return row

    def background_share(self) -> F64:
        """Return the share of background over d_c, (D,) float64, of the returns between two returns."""
        shares: F64 = self.background / max(1, self.n_between)
        return shares

    def as_dict(self, zeta_p: float, zeta_s: float) -> dict[str, Any]:
        """Return the curves as plain lists, zeta_p swept at the given zeta_s and the other way round."""
        return {
            "n_shots": self.n_shots,
            "n_returns": self.n_returns,
            "over_zeta_p": {
                "zeta_s": zeta_s,
                "zeta_p": self.zetas_p.tolist(),
                "supported_share": self.over_zeta_p(zeta_s).tolist(),
            },
            "over_zeta_s": {
                "zeta_p": zeta_p,
                "zeta_s": self.zetas_s.tolist(),
                "supported_share": self.over_zeta_s(zeta_p).tolist(),
            },
            "over_d_c": {"d_c": self.lengths.tolist(), "background_share": self.background_share().tolist()},
        }


@dataclass(slots=True)
class CurveCounter:
    """Accumulates the counts over blocks, in bounded memory."""

    params: PrcParams
    zetas_p: F64 = field(init=False)
    zetas_s: F64 = field(init=False)
    lengths: F64 = field(init=False)
    n_shots: int = 0
    _support: I64 = field(init=False)
    _bend: I64 = field(init=False)
    _tails: dict[int, F32] = field(default_factory=dict)

    def __post_init__(self) -> None:
        support = self.params.support
        # either curve is taken with the other threshold at 1 m, as published
        self.zetas_p = thresholds(1.0, support.zeta_p)
        self.zetas_s = thresholds(1.0, support.zeta_s)
        self.lengths = thresholds(self.params.background.d_c)
        self._support = np.zeros((len(self.zetas_p) + 1, len(self.zetas_s) + 1), np.int64)
        self._bend = np.zeros(len(self.lengths) + 1, np.int64)

    def add(self, block: ScanBlock) -> None:
        """Count a block with look-ahead (``next_m``); blocks of a scanner must come in order."""
        m = block.points_per_line
        tail = self._tails.get(block.scanner)
        if tail is None:
            tail = np.full(window_reach(m), np.nan, np.float32)
        window = stream_window(tail, block.range_m, block.next_m)
        self._tails[block.scanner] = tail_after(tail, block.range_m)
        in_slice, adjacent = required_counts(self.params.support)
        n = block.n_lines
        self._support += kernels.support_histogram(window, n, m, self.zetas_p, self.zetas_s, in_slice, adjacent)
        self._bend += kernels.bend_histogram(window, n, m, self.lengths, self.params.background.alpha)
        self.n_shots += block.range_m.size

    def finish(self) -> Curves:
        """Return the curves."""
        n_between = int(self._bend.sum())
        return Curves(
            zetas_p=self.zetas_p,
            zetas_s=self.zetas_s,
            supported=self._support.cumsum(axis=0).cumsum(axis=1)[:-1, :-1],
            lengths=self.lengths,
            background=n_between - self._bend.cumsum()[:-1],
            n_between=n_between,
            n_returns=int(self._support.sum()),
            n_shots=self.n_shots,
        )
