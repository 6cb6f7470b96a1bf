"""Coarse classification of every line.

Vegetation, horizontal, vertical (Stamos et al. 2012, sec. 4).

The paper refers to Hadjiliadis and Stamos (2010). Vegetation is detected first, by the test between
hidden Markov models (Chen and Willett 2000, eqs. 23 to 28). Its forward recursion gives the
likelihoods of both models; the logarithm S of their ratio is reset whenever it falls below zero,
and raises an alarm when it exceeds a threshold. The first sample after the last reset estimates the
onset of the change. The rest of a line falls into runs; within a run, CUSUM tests for a change of
the mean angle by 90 deg, one per direction, separate horizontal from vertical.
"""

from __future__ import annotations

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8, Mask
from prc_cli.methods.sequential_angle import coarse_loops
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import (
    DENSE_VEGETATION,
    CoarseThresholds,
    MarkovThresholds,
    SurfaceThresholds,
)


def hmm_cusum(values: F32, thresholds: MarkovThresholds) -> Mask:
    """Mark the samples of every row that belong to model 1.

    Rows are independent. After an alarm, tests between two bounds on the samples behind it confirm
    the region, until one rejects; the end is pulled back to the sample after the last negative
    value (the group's script). An unconfirmed region at the end of a row is dropped. A sample with
    zero probability in both models restarts the test. After a reset the first sample depends only
    on the initial probabilities, which are the same in both models.

    ``values`` (R, n) float32, degrees; returns (R, n) bool.

    Foliage between two surfaces:

    >>> import numpy as np
    >>> foliage = [-90.0, 90.0, 0.0] * 10
    >>> values = np.array([[90.0] * 20 + foliage + [0.0] * 20], np.float32)
    >>> found = np.flatnonzero(hmm_cusum(values, MarkovThresholds())[0])
    >>> int(found[0]), int(found[-1])
    (22, 48)
    """
    marked: Mask = coarse_loops.hmm_cusum(values, thresholds)
    return marked


@stage("dense vegetation")
def dense_vegetation(differences_deg: F32, thresholds: MarkovThresholds = DENSE_VEGETATION) -> Mask:
    """Mark T', vegetation by the less sensitive test (Stamos et al. 2012, sec. 7.1).

    ``differences_deg`` (R, n) float32, degrees; returns (R, n) bool.
    """
    return hmm_cusum(differences_deg, thresholds)


def car_surface(
    signed_deg: F32,
    dense: Mask,
    lines: VerticalLines,
    thresholds: SurfaceThresholds,
) -> U8:
    """Classify every shot for the car algorithm.

    Like the coarse classification, with T' as vegetation.

    Shots of T that are not T' are thus labelled horizontal or vertical.

    ``signed_deg`` (R, n) float32, degrees; ``dense`` (R, n) bool; returns (R, n) uint8.
    """
    return surface_image(signed_deg, dense, lines, thresholds)


@stage("coarse")
def coarse(signed_deg: F32, lines: VerticalLines, thresholds: CoarseThresholds) -> U8:
    """Classify every shot as missing, vegetation, horizontal, vertical or undecided.

    ``signed_deg`` (R, n) float32, degrees; returns (R, n) uint8.

    Ground (2) and a wall (3) with one missing shot:

    >>> import numpy as np
    >>> x = np.array([4, 4.5, 5, 5.5, 6, 6, 6, np.nan, 6, 6])
    >>> z = np.array([-2, -2, -2, -2, -2, -1.5, -1, -0.5, 0, 0.5])
    >>> xyz = np.stack([x, 0 * x, z], axis=-1)[None].astype(np.float32)
    >>> beams = np.arctan2(x, -z)[None]
    >>> ranges = np.linalg.norm(xyz, axis=-1)
    >>> lines = VerticalLines(ranges, xyz, xyz[..., 0], np.array([10], np.int32), beams)
    >>> from prc_cli.methods.sequential_angle.angles import ChordThresholds, signed_angles
    >>> coarse(signed_angles(lines, ChordThresholds()).signed_deg, lines, CoarseThresholds())
    array([[2, 2, 2, 2, 3, 3, 3, 0, 3, 3]], dtype=uint8)
    """
    return surface_image(
        signed_deg, hmm_cusum(signed_deg, thresholds.vegetation), lines, thresholds.surfaces
    )


def surface_image(
    signed_deg: F32,
    vegetation: Mask,
    lines: VerticalLines,
    thresholds: SurfaceThresholds,
) -> U8:
    """Label the runs between vegetation as horizontal or vertical.

    A run is a maximal stretch of shots with an angle that are not vegetation; missing shots do not
    end it. Runs are independent of each other.

    ``signed_deg`` (R, n) float32, degrees; ``vegetation`` (R, n) bool; returns (R, n) uint8.
    """
    return coarse_loops.surface_image(
        signed_deg, vegetation, lines.range_m, lines.n_beams, thresholds
    )
