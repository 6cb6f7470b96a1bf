"""Slow and obvious twin of the test between horizontal and vertical surfaces."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, I32, U8, Mask


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
    """Label surfaces; see :func:`prc_cli.kernels.sequential_angle.coarse.surface_image`."""
    drifts = {Surface.HORIZONTAL: drift_vertical, Surface.VERTICAL: drift_horizontal}
    thresholds = {Surface.HORIZONTAL: threshold_vertical, Surface.VERTICAL: threshold_horizontal}
    image = np.full(signed_deg.shape, Surface.MISSING, np.uint8)
    for row, line in enumerate(signed_deg):
        beams = [k for k in range(n_beams[row]) if not np.isnan(line[k])]
        found: dict[int, Surface] = {}
        for run in runs(beams, vegetation[row]):
            if vegetation[row, run[0]]:
                found.update(dict.fromkeys(run, Surface.VEGETATION))
                continue
            tilt = np.abs(line[run].astype(np.float64))
            if fold:
                tilt = np.minimum(tilt, 180.0 - tilt)
            vertical = not start_horizontal and np.median(tilt[:5]) < 45.0
            label = Surface.VERTICAL if vertical else Surface.HORIZONTAL
            since_reset: list[int] = []
            s = 0.0
            for k, y in zip(run, tilt, strict=True):
                step = drifts[label] - y if label is Surface.HORIZONTAL else y - drifts[label]
                s += step
                since_reset.append(k)
                if s > thresholds[label]:
                    label = Surface.HORIZONTAL if label is Surface.VERTICAL else Surface.VERTICAL
                    if backdate:
                        found.update(dict.fromkeys(since_reset, label))
                    s = 0.0
                if s <= 0:
                    s, since_reset = 0.0, []
                found[k] = label
        valid = [k for k in range(n_beams[row]) if not np.isnan(range_m[row, k])]
        label = found[beams[0]] if beams else Surface.UNDECIDED
        for k in valid:
            label = found.get(k, label)
            image[row, k] = label
    return image


def runs(beams: list[int], vegetation: Mask) -> list[list[int]]:
    """Cut beams where vegetation begins or ends."""
    cuts = np.flatnonzero(np.diff(vegetation[beams].astype(int))) + 1
    return [list(run) for run in np.split(np.array(beams, int), cuts) if len(run)]
