"""The coarse classification into vegetation, horizontal and vertical (Stamos et al. 2012, sec. 4)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.thresholds.sequential_angle import SurfaceThresholds
from prc_cli.core.types import F32, F64, I32, U8, Mask


def surface_image(signed_deg: F32, vegetation: Mask, range_m: F32, n_beams: I32, thresholds: SurfaceThresholds) -> U8:
    """Label surfaces; see :func:`prc_cli.kernels.sequential_angle.coarse.surface_image`."""
    image = np.full(signed_deg.shape, Surface.MISSING, np.uint8)
    for row, line in enumerate(signed_deg):
        beams = [k for k in range(n_beams[row]) if not np.isnan(line[k])]
        found: dict[int, Surface] = {}
        for run in runs(beams, vegetation[row]):
            if vegetation[row, run[0]]:
                found.update(dict.fromkeys(run, Surface.VEGETATION))
                continue
            tilt = np.abs(line[run].astype(np.float64))
            if thresholds.fold:
                tilt = np.minimum(tilt, 180.0 - tilt)
            found.update(zip(run, horizontal_or_vertical(tilt, thresholds), strict=True))
        valid = [k for k in range(n_beams[row]) if not np.isnan(range_m[row, k])]
        label = found[beams[0]] if beams else Surface.UNDECIDED
        for k in valid:
            label = found.get(k, label)
            image[row, k] = label
    return image


def horizontal_or_vertical(tilt: F64, thresholds: SurfaceThresholds) -> list[Surface]:
    """Label the samples of a run by the CUSUM test for a change of their mean, one test for either direction."""
    drifts = {Surface.HORIZONTAL: thresholds.drift_vertical_deg, Surface.VERTICAL: thresholds.drift_horizontal_deg}
    limits = {
        Surface.HORIZONTAL: thresholds.threshold_vertical_deg, Surface.VERTICAL: thresholds.threshold_horizontal_deg
    }  # fmt: skip
    vertical = not thresholds.start_horizontal and np.median(tilt[:5]) < 45.0
    label = Surface.VERTICAL if vertical else Surface.HORIZONTAL
    labels: list[Surface] = []
    s, n_since_reset = 0.0, 0
    for y in tilt:
        s += drifts[label] - y if label is Surface.HORIZONTAL else y - drifts[label]
        if s > limits[label]:
            label = Surface.HORIZONTAL if label is Surface.VERTICAL else Surface.VERTICAL
            if thresholds.backdate:
                labels[len(labels) - n_since_reset :] = [label] * n_since_reset
            s = 0.0
        labels.append(label)
        s, n_since_reset = (0.0, 0) if s <= 0 else (s, n_since_reset + 1)
    return labels


def runs(beams: list[int], vegetation: Mask) -> list[list[int]]:
    """Cut beams where vegetation begins or ends."""
    cuts = np.flatnonzero(np.diff(vegetation[beams].astype(int))) + 1
    return [list(run) for run in np.split(np.array(beams, int), cuts) if len(run)]
