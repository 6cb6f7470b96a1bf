"""Loop over the runs between vegetation: horizontal or vertical (Stamos et al. 2012, sec. 4)."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.kernels.cache import helper, kernel

_MISSING, _VEGETATION, _HORIZONTAL, _VERTICAL, _UNDECIDED = 0, 1, 2, 3, 4
"""As :class:`prc_cli.core.classes.Surface` numbers them."""
_MIDDLE = 45.0
"""Half way between a vertical (0) and a horizontal (90) surface [deg]."""


@helper
def _tilt(signed_deg: float, fold: bool) -> float:
    """Angle of a chord with the vertical whatever its sign, and with ``fold`` whether it goes up or down [deg]."""
    angle = abs(signed_deg)
    return min(angle, 180.0 - angle) if fold else angle


@helper
def _first_label(signed: F32, beam: I32, begin: int, end: int, fold: bool) -> int:
    """Label that a run begins with: what the median of its first five samples is nearer to."""
    n = min(end - begin, 5)
    first = np.empty(5, np.float64)
    for i in range(n):  # by hand: the library's sort takes seconds to compile
        tilt = _tilt(np.float64(signed[beam[begin + i]]), fold)
        j = i
        while j > 0 and first[j - 1] > tilt:
            first[j] = first[j - 1]
            j -= 1
        first[j] = tilt
    median = (first[(n - 1) // 2] + first[n // 2]) / 2.0
    return _VERTICAL if median < _MIDDLE else _HORIZONTAL


@kernel(
    "uint8[:, ::1](float32[:, ::1], boolean[:, ::1], float32[:, ::1], int32[::1],"
    "float64, float64, float64, float64, boolean, boolean, boolean)"
)
def surface_image(
    signed_deg: F32,
    vegetation: Mask,
    range_m: F32,
    n_beams: I32,
    drift_vertical: float,
    threshold_vertical: float,
    drift_horizontal: float,
    threshold_horizontal: float,
    fold: bool,
    backdate: bool,
    start_horizontal: bool,
) -> U8:
    """Label every shot of every row: missing, vegetation, horizontal, vertical, undecided.

    Parameters
    ----------
    signed_deg : (R, n) float32, degrees
        sV, NaN = no angle.
    vegetation : (R, n) bool
        Shots with an angle that are vegetation.
    range_m : (R, n) float32, metres
        NaN = missing.
    n_beams : (R,) int32
        Beams of every row; what comes after them is labelled missing.
    drift_vertical, threshold_vertical : float, degrees
        From H to V: the sum of (drift - angle) since its last reset is above the threshold.
    drift_horizontal, threshold_horizontal : float, degrees
        From V to H: the sum of (angle - drift) is.
    fold : bool
        Angles beyond 90 deg count as their supplement.
    backdate : bool
        A change begins at the first sample after the last reset rather than at the alarm.
    start_horizontal : bool
        Runs begin with H, not with what their first five samples are.

    Returns
    -------
    (R, n) uint8
        :class:`prc_cli.core.classes.Surface`.
    """
    n_rows, n = signed_deg.shape
    image = np.zeros((n_rows, n), np.uint8)
    beam = np.empty(n, np.int32)
    for row in range(n_rows):
        width = min(np.int64(n_beams[row]), n)
        signed = signed_deg[row]
        labels = image[row]
        m = 0
        for k in range(width):
            beam[m] = k
            m += not math.isnan(signed[k])
        begin = int(np.int64(0))  # not the literal, for which a helper would be compiled once more
        while begin < m:
            if vegetation[row, beam[begin]]:
                labels[beam[begin]] = _VEGETATION
                begin += 1
                continue
            end = begin
            while end < m and not vegetation[row, beam[end]]:
                end += 1
            label = _HORIZONTAL if start_horizontal else _first_label(signed, beam, begin, end, fold)
            total = 0.0
            onset = begin
            for i in range(begin, end):
                tilt = _tilt(np.float64(signed[beam[i]]), fold)
                step = drift_vertical - tilt if label == _HORIZONTAL else tilt - drift_horizontal
                limit = threshold_vertical if label == _HORIZONTAL else threshold_horizontal
                total += step
                if total > limit:
                    label = _VERTICAL if label == _HORIZONTAL else _HORIZONTAL
                    if backdate:
                        for j in range(onset, i):
                            labels[beam[j]] = label
                    total = 0.0
                if total <= 0.0:
                    total = 0.0
                    onset = i + 1
                labels[beam[i]] = label
            begin = end
        # shots without an angle go with the shot before them, the first ones with the first that has one
        label = _UNDECIDED if m == 0 else int(labels[beam[0]])
        for k in range(width):
            if labels[k] != _MISSING:
                label = int(labels[k])
            elif not math.isnan(range_m[row, k]):
                labels[k] = label
    return image
