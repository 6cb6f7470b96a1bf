"""Loop over the runs between vegetation: horizontal or vertical (Stamos et al. 2012, sec. 4)."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.thresholds.sequential_angle import SurfaceThresholds
from prc_cli.core.types import F32, F64, I32, U8, U32, Mask
from prc_cli.kernels.cache import helper, inlined, kernel

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
def _first_label(tilt: F64, begin: int, end: int) -> int:
    """Label that a run begins with: what the median of its first five samples is nearer to."""
    n = min(end - begin, 5)
    first = np.empty(5, np.float64)
    for i in range(n):  # by hand: the library's sort takes seconds to compile
        here = tilt[begin + i]
        j = i
        while j > 0 and first[j - 1] > here:
            first[j] = first[j - 1]
            j -= 1
        first[j] = here
    median = (first[(n - 1) // 2] + first[n // 2]) / 2.0
    return _VERTICAL if median < _MIDDLE else _HORIZONTAL


@inlined
def _label_run(
    tilt: F64, beam: U32, begin: np.uint64, end: np.uint64, labels: U8, thresholds: SurfaceThresholds
) -> None:
    """Label the samples of a run by the CUSUM test for a change of their mean."""
    label = _HORIZONTAL
    if not thresholds.start_horizontal:
        label = _first_label(tilt, int(np.int64(begin)), int(np.int64(end)))
    total = 0.0
    onset = begin
    for i in range(begin, end):
        horizontal = label == _HORIZONTAL
        total += thresholds.drift_vertical_deg - tilt[i] if horizontal else tilt[i] - thresholds.drift_horizontal_deg
        if total > (thresholds.threshold_vertical_deg if horizontal else thresholds.threshold_horizontal_deg):
            label = _VERTICAL if horizontal else _HORIZONTAL
            if thresholds.backdate:
                for j in range(onset, i):
                    labels[beam[j]] = label
            total = 0.0
        if total <= 0.0:
            total = 0.0
            onset = i + np.uint64(1)
        labels[beam[i]] = label


@kernel(
    "uint8[:, ::1](float32[:, ::1], boolean[:, ::1], float32[:, ::1], int32[::1], SurfaceThresholds)",
    tuples=[SurfaceThresholds],
)
def surface_image(signed_deg: F32, vegetation: Mask, range_m: F32, n_beams: I32, thresholds: SurfaceThresholds) -> U8:
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
    thresholds : SurfaceThresholds

    Returns
    -------
    (R, n) uint8
        :class:`prc_cli.core.classes.Surface`.
    """
    n_rows, n = signed_deg.shape
    image = np.zeros((n_rows, n), np.uint8)
    beam = np.empty(n, np.uint32)  # without a sign, for which every access would look
    tilt = np.empty(n, np.float64)
    grown = np.empty(n, np.bool_)
    for row in range(n_rows):
        width = min(np.int64(n_beams[row]), n)
        labels = image[row]
        m = np.uint64(0)
        for k in range(width):
            beam[m] = k
            tilt[m] = _tilt(np.float64(signed_deg[row, k]), thresholds.fold)
            grown[m] = vegetation[row, k]
            m += np.uint64(not math.isnan(signed_deg[row, k]))
        begin = np.uint64(0)
        while begin < m:
            if grown[begin]:
                labels[beam[begin]] = _VEGETATION
                begin += np.uint64(1)
                continue
            end = begin
            while end < m and not grown[end]:
                end += np.uint64(1)
            _label_run(tilt, beam, begin, end, labels, thresholds)
            begin = end
        # shots without an angle go with the shot before them, the first ones with the first that has one
        label = _UNDECIDED if m == 0 else int(labels[beam[0]])
        for k in range(width):
            here = int(labels[k])
            label = label if here == _MISSING else here
            labels[k] = _MISSING if here == _MISSING and math.isnan(range_m[row, k]) else label
    return image
