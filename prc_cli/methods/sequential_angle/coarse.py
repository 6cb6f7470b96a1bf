"""Coarse classification of every line: vegetation, horizontal, vertical (Stamos et al. 2012, sec. 4).

The paper refers to Hadjiliadis and Stamos (2010). Vegetation is detected first, by the test between hidden Markov
models. The rest of a line falls into runs; within a run, CUSUM tests for a change of the mean angle by 90 deg, one per
direction, separate horizontal from vertical.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8, Mask
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.markov import Angles, HmmParams, Matrix, Row, Spreads, hmm_cusum
from prc_cli.methods.sequential_angle.thresholds import SurfaceThresholds
from prc_cli.methods.sequential_angle.windows import WindowsParams

_CALM: Row = (0.1, 0.8, 0.1)


class DenseVegetationParams(HmmParams):
    """The less sensitive test for vegetation (``[sequential_angle.dense_vegetation]``)."""

    means_deg: Angles = Field((-150.0, 0.0, 150.0), description="mean of every state [deg] (published)")
    sigmas_deg: Spreads = Field((30.0, 30.0, 30.0), description="standard deviation of every state [deg]")
    h0: Matrix = Field(
        (_CALM, _CALM, _CALM),
        description="transition probabilities of model 0, no vegetation; row = from, each adds up to 1 (published)",
    )
    initial_h0: Row = Field(
        _CALM, description="probabilities of the states of model 0 at the first sample of a start: those of its rows"
    )
    threshold: float = Field(
        10.0, gt=0, le=100, description="log-likelihood ratio that vegetation begins at [nats] (published)"
    )


@stage("dense vegetation")
def dense_vegetation(differences_deg: F32, params: DenseVegetationParams) -> Mask:
    """Mark T', vegetation by the less sensitive test (Stamos et al. 2012, sec. 7.1).

    ``differences_deg`` (R, n) float32, degrees; returns (R, n) bool.
    """
    return hmm_cusum(differences_deg, params)


def car_surface(signed_deg: F32, dense: Mask, lines: VerticalLines, params: TiltParams) -> U8:
    """Classify every shot for the car algorithm: like the coarse classification, with T' as vegetation.

    Shots of T that are not T' are thus labelled horizontal or vertical.

    ``signed_deg`` (R, n) float32, degrees; ``dense`` (R, n) bool; returns (R, n) uint8.
    """
    return surface_image(signed_deg, dense, lines, params)


class TiltParams(Params):
    """When a run turns from horizontal to vertical and back (``[sequential_angle.coarse.surfaces]``).

    From horizontal to vertical the sum of (drift - angle), from vertical to horizontal the sum of (angle - drift) is
    followed, never below zero, until it exceeds the threshold. Drift 45 and threshold 30 deg are the test between
    Gaussians of mean 90 and 0 and standard deviation 30 deg at a log-likelihood ratio of 3. One clean sample moves
    the sum by 45 deg: a threshold below that keeps curbs of a single sample.
    """

    drift_vertical_deg: float = Field(45.0, ge=0, le=180, description="drift from horizontal to vertical [deg]")
    threshold_vertical_deg: float = Field(30.0, ge=0, le=1e6, description="threshold from horizontal to vertical [deg]")
    drift_horizontal_deg: float = Field(45.0, ge=0, le=180, description="drift from vertical to horizontal [deg]")
    threshold_horizontal_deg: float = Field(
        30.0, ge=0, le=1e6, description="threshold from vertical to horizontal [deg]"
    )
    fold: bool = Field(
        True, description="angles beyond 90 deg, on surfaces that are passed downwards, count as their supplement"
    )
    backdate: bool = Field(
        True, description="a change is at the first sample after the sum was last zero; else where it is detected"
    )
    start: Literal["median", "horizontal"] = Field(
        "median",
        description='label that a run begins with: "median" of its first five angles, or always "horizontal"',
    )

    def thresholds(self) -> SurfaceThresholds:
        """Return the thresholds of the kernel."""
        return SurfaceThresholds(
            drift_vertical_deg=self.drift_vertical_deg,
            threshold_vertical_deg=self.threshold_vertical_deg,
            drift_horizontal_deg=self.drift_horizontal_deg,
            threshold_horizontal_deg=self.threshold_horizontal_deg,
            fold=self.fold,
            backdate=self.backdate,
            start_horizontal=self.start == "horizontal",
        )


class CoarseParams(Params):
    """The coarse classification (``[sequential_angle.coarse]``)."""

    vegetation: HmmParams = Field(
        HmmParams(), description="test for vegetation on signed angles; model 0 nearly forbids the state at -90 deg"
    )
    surfaces: TiltParams = Field(TiltParams(), description="test between horizontal and vertical surfaces")
    windows: WindowsParams = Field(WindowsParams(), description="facades seen through their windows")


@stage("coarse")
def coarse(signed_deg: F32, lines: VerticalLines, params: CoarseParams) -> U8:
    """Classify every shot as missing, vegetation, horizontal, vertical or undecided.

    ``signed_deg`` (R, n) float32, degrees; returns (R, n) uint8.

    Ground (2) and a wall (3) with one missing shot:

    >>> import numpy as np
    >>> x = np.array([4, 4.5, 5, 5.5, 6, 6, 6, np.nan, 6, 6])
    >>> z = np.array([-2, -2, -2, -2, -2, -1.5, -1, -0.5, 0, 0.5])
    >>> xyz = np.stack([x, 0 * x, z], axis=-1)[None].astype(np.float32)
    >>> beams = np.arctan2(x, -z)[None]
    >>> lines = VerticalLines(np.linalg.norm(xyz, axis=-1), xyz, xyz[..., 0], np.array([10], np.int32), beams)
    >>> from prc_cli.methods.sequential_angle.angles import AnglesParams, signed_angles
    >>> coarse(signed_angles(lines, AnglesParams()).signed_deg, lines, CoarseParams())
    array([[2, 2, 2, 2, 3, 3, 3, 0, 3, 3]], dtype=uint8)
    """
    return surface_image(signed_deg, hmm_cusum(signed_deg, params.vegetation), lines, params.surfaces)


def surface_image(signed_deg: F32, vegetation: Mask, lines: VerticalLines, params: TiltParams) -> U8:
    """Label the runs between vegetation as horizontal or vertical.

    A run is a maximal stretch of shots with an angle that are not vegetation; missing shots do not end it. Runs are
    independent of each other.

    ``signed_deg`` (R, n) float32, degrees; ``vegetation`` (R, n) bool; returns (R, n) uint8.
    """
    return kernels.surface_image(signed_deg, vegetation, lines.range_m, lines.n_beams, params.thresholds())
