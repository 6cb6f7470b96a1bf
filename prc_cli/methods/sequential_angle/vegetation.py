"""Vegetation for the car algorithm, T', by a less sensitive test (Stamos et al. 2012, sec. 7.1).

It is the test of the coarse classification, applied to the differences of successive signed angles. All rows of each
transition matrix are equal, so the models have no memory and this is Page's test on a mixture of Gaussians: a
difference clearly above 75 deg counts +1.204, one clearly below -0.875. It misses much vegetation, but has few false
alarms.
"""

from __future__ import annotations

from pydantic import Field

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8, Mask
from prc_cli.methods.sequential_angle.coarse import TiltParams, surface_image
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.markov import Angles, HmmParams, Matrix, Row, Spreads, hmm_cusum

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
    """Mark vegetation by the less sensitive test.

    ``differences_deg`` (R, n) float32, degrees; returns (R, n) bool.
    """
    return hmm_cusum(differences_deg, params)


def car_surface(signed_deg: F32, dense: Mask, lines: VerticalLines, params: TiltParams) -> U8:
    """Classify every shot for the car algorithm: like the coarse classification, with T' as vegetation.

    Shots of T that are not T' are thus labelled horizontal or vertical.

    ``signed_deg`` (R, n) float32, degrees; ``dense`` (R, n) bool; returns (R, n) uint8.
    """
    return surface_image(signed_deg, dense, lines, params)
