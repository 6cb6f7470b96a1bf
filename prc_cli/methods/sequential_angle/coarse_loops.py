"""Loop over the runs between vegetation: horizontal or vertical (Stamos et al. 2012, sec. 4)."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.types import F32, F64, I32, U8, U32, Mask
from prc_cli.kernels.cache import boolean, float32, helper, inlined, int32, kernel, record, uint8
from prc_cli.methods.sequential_angle.thresholds import LayerThresholds, SurfaceThresholds, WallThresholds

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


@kernel(uint8[:, ::1](float32[:, ::1], boolean[:, ::1], float32[:, ::1], int32[::1], record(SurfaceThresholds)))
def surface_image(signed_deg: F32, vegetation: Mask, range_m: F32, n_beams: I32, thresholds: SurfaceThresholds) -> U8:
    """Label every shot of every row: missing, vegetation, horizontal, vertical, undecided.

    ``signed_deg`` (R, n) float32, degrees; ``vegetation`` (R, n) bool; ``range_m`` (R, n) float32, metres; ``n_beams``
    (R,) int32; returns (R, n) uint8.
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


@helper
def _sort(values: F64, n: int) -> None:
    """Sort the first n values; by hand: the library's sort takes seconds to compile."""
    gap = 1
    while 3 * gap + 1 < n:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            here = values[i]
            j = i
            while j >= gap and values[j - gap] > here:
                values[j] = values[j - gap]
                j -= gap
            values[j] = here
        gap //= 3


@helper
def _fullest(values: F64, begin: int, end: int, width: float) -> tuple[int, int]:
    """Return how many sorted values fit into a width at most, and the first of them."""
    most = first = stop = int(np.int64(0))
    stop = begin
    for i in range(begin, end):
        while stop < end and values[stop] - values[i] <= width:
            stop += 1
        if stop - i > most:
            most, first = stop - i, i
    return most, first


@helper
def _in_two_layers(values: F64, n: int, width: float) -> int:
    """Return how many values the fullest layer holds, and the fullest one of those beside it."""
    _sort(values, n)
    most, first = _fullest(values, 0, n, width)
    below, _ = _fullest(values, 0, first, width)
    above, _ = _fullest(values, first + most, n, width)
    return most + max(below, above)


_BINS = 256


@helper
def _may_be_layered(values: F64, m: int, width: float, share: float, bins: I32) -> bool:
    """Tell quickly whether two layers may hold a share of some values: most foliage need not be sorted.

    A layer lies in two neighbouring bins at most, so two of them hold no more than the four fullest bins.
    """
    if width <= 0.0:
        return True
    for i in range(_BINS):
        bins[i] = 0
    per_m = 1.0 / (1.01 * width)
    for i in range(m):
        bins[int(values[i] * per_m) & (_BINS - 1)] += 1
    inside = 0
    for _ in range(4):
        fullest = 0
        for i in range(1, _BINS):
            if bins[i] > bins[fullest]:
                fullest = i
        inside += bins[fullest]
        bins[fullest] = 0
    return bool(np.float64(inside) > share * np.float64(m))


@helper
def _settle(labels: U8, values: F64, beam: I32, m: int, thresholds: LayerThresholds, bins: I32) -> None:
    """Label the points of a run, if they lie in layers."""
    if m < thresholds.min_points or not _may_be_layered(values, m, thresholds.width_m, thresholds.share, bins):
        return
    inside = _in_two_layers(values, m, thresholds.width_m)
    if np.float64(inside) > thresholds.share * np.float64(m):
        for i in range(m):
            labels[beam[i]] = _VERTICAL


@kernel(uint8[:, ::1](uint8[:, ::1], float32[:, ::1], int32[::1], record(LayerThresholds)))
def upright_layers(surface: U8, horizontal_m: F32, n_beams: I32, thresholds: LayerThresholds) -> U8:
    """Make runs of vegetation vertical whose points lie in two upright layers.

    ``surface`` (R, n) uint8; ``horizontal_m`` (R, n) float32, metres; ``n_beams`` (R,) int32; returns (R, n) uint8.
    """
    n_rows, n = surface.shape
    image = np.empty((n_rows, n), np.uint8)
    values = np.empty(n, np.float64)
    beam = np.empty(n, np.int32)
    bins = np.empty(_BINS, np.int32)
    for row in range(n_rows):
        codes = surface[row]
        m = int(np.int64(0))
        width = np.int64(n_beams[row])
        for k in range(n):
            image[row, k] = codes[k]
            if k < width and codes[k] == _VEGETATION:
                values[m] = horizontal_m[row, k]
                beam[m] = k
                m += 1
            elif m > 0 and (k >= width or codes[k] != _MISSING):
                _settle(image[row], values, beam, m, thresholds, bins)
                m = int(np.int64(0))
        if m > 0:
            _settle(image[row], values, beam, m, thresholds, bins)
    return image


@helper
def _is_wall(x: F64, z: F64, begin: int, end: int, thresholds: WallThresholds) -> bool:
    """Tell whether a vertical run is high, straight and upright."""
    lowest = highest = z[begin]
    sum_z = sum_x = sum_zz = sum_zx = sum_xx = 0.0
    for i in range(begin, end):
        lowest, highest = min(lowest, z[i]), max(highest, z[i])
        up, away = z[i] - z[begin], x[i] - x[begin]
        sum_z += up
        sum_x += away
        sum_zz += up * up
        sum_zx += up * away
        sum_xx += away * away
    if highest - lowest < thresholds.extent_m or highest == lowest:
        return False
    n = end - begin
    mean_z, mean_x = sum_z / n, sum_x / n
    zz, zx, xx = sum_zz / n - mean_z * mean_z, sum_zx / n - mean_z * mean_x, sum_xx / n - mean_x * mean_x
    near = xx - zx * zx / zz <= thresholds.residual_m * thresholds.residual_m
    return bool(near and abs(zx) <= thresholds.slope * zz)


@helper
def _find_walls(x: F64, z: F64, code: U8, m: int, thresholds: WallThresholds, first: I32, place: F64) -> int:
    """List the walls of a row: the first return of each, and its horizontal distance; returns how many."""
    n_walls = i = int(np.int64(0))
    while i < m:
        begin = i
        i += 1
        if code[begin] != _VERTICAL:
            continue
        nearest = farthest = x[begin]
        while i < m and code[i] == _VERTICAL and abs(x[i] - x[i - 1]) <= thresholds.break_m:
            nearest, farthest = min(nearest, x[i]), max(farthest, x[i])
            i += 1
        if _is_wall(x, z, begin, i, thresholds):
            first[n_walls], place[n_walls] = begin, 0.5 * (nearest + farthest)
            n_walls += 1
    return n_walls


@kernel(uint8[:, ::1](uint8[:, ::1], float32[:, :, ::1], float32[:, ::1], int32[::1], record(WallThresholds)))
def behind_walls(surface: U8, xyz_m: F32, horizontal_m: F32, n_beams: I32, thresholds: WallThresholds) -> U8:
    """Make vegetation vertical that lies in the plane of a wall of its row, or behind one that stands above it.

    ``surface`` (R, n) uint8; ``xyz_m`` (R, n, 3) float32, metres; ``horizontal_m`` (R, n) float32, metres; ``n_beams``
    (R,) int32; returns (R, n) uint8.
    """
    n_rows, n = surface.shape
    image = np.empty((n_rows, n), np.uint8)
    x, z, code = np.empty(n, np.float64), np.empty(n, np.float64), np.empty(n, np.uint8)
    beam, first, place = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.float64)
    for row in range(n_rows):
        m = n_green = int(np.int64(0))
        width = np.int64(n_beams[row])
        for k in range(n):
            here = surface[row, k]
            image[row, k] = here
            if k < width and here != _MISSING:
                x[m], z[m] = horizontal_m[row, k], xyz_m[row, k, 2]
                beam[m], code[m] = k, here
                n_green += here == _VEGETATION
                m += 1
        if n_green == 0:
            continue
        n_walls = _find_walls(x, z, code, m, thresholds, first, place)
        if n_walls == 0:
            continue
        for i in range(m):
            if code[i] != _VEGETATION:
                continue
            for wall in range(n_walls):
                away = x[i] - place[wall]
                if abs(away) <= thresholds.width_m or (first[wall] > i and away >= -thresholds.front_m):
                    image[row, beam[i]] = _VERTICAL
                    break
    return image
