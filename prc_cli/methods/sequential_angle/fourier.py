"""Car or vegetation, by the spectrum of the signed angles (Stamos et al. 2012, sec. 7.5)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import F32, I32, Mask
from prc_cli.methods.sequential_angle.thresholds import FourierThresholds


class FourierParams(Params):
    """Which spectra are those of vegetation (``[sequential_angle.car.fourier]``)."""

    enabled: bool = Field(True, description="test intervals at all; the authors call this step dispensable")
    longest: int = Field(
        16,
        ge=0,
        le=1_000_000,
        description="test intervals of at most this many angles: windows of cars look like foliage to it, and where "
        "shots are many car.most_foliage tells more; published: 0, all [angles]",
    )
    band: float = Field(
        0.125,
        gt=0,
        le=0.5,
        description="lowest of the high frequencies, as a share of the number of angles (published)",
    )
    ratio: float = Field(
        0.5, gt=0, lt=1, description="a high frequency above this share of the largest one tells vegetation (published)"
    )
    min_points: int = Field(8, ge=1, le=1_000_000, description="an interval of fewer angles is no car [angles]")
    window: int = Field(
        64,
        ge=0,
        le=1_000_000,
        description="test windows of at most this many angles, of which at least half must be those of a car; "
        "published: 0, the whole interval [angles]",
    )
    max_points: int = Field(
        2048,
        ge=64,
        le=16_384,
        description="longer intervals are tested in windows of at most this many angles [angles]",
    )

    def thresholds(self) -> FourierThresholds:
        """Return the thresholds of the kernel."""
        return FourierThresholds(
            band=self.band,
            ratio=self.ratio,
            min_points=self.min_points,
            window_points=min(self.window or self.max_points, self.max_points),
            longest=self.longest,
        )


def fourier(signed_deg: F32, intervals: I32, params: FourierParams) -> Mask:
    """Classify intervals as car or vegetation.

    The N angles of an interval, missing ones left out, are transformed: F_k, 0 <= k <= N/2, the mean included. An
    interval is a car if no magnitude of F_k with k >= N/8 is above half of the largest one.

    ``signed_deg`` (R, n) float32, degrees; ``intervals`` (K, 3) int32; returns (K,) bool.

    Notes
    -----
    In dense vegetation two of three signs are negative, so the mean is not zero: F_0 grows with N, the other
    frequencies only with its square root. The whole spectrum therefore recognises foliage in .92 of intervals of 32
    angles, .65 of 128, .20 of 256, and none of 512; windows of 64 angles miss only .16 of 256 and .03 of 512. Some
    cars are lost either way: along a vertical side the mean is hardly above the noise.
    ``python -m benchmarks.sequential_angle readings`` prints the effect of the windows, and of the test, in simulated
    streets.

    The cost of a spectrum grows with the square of the number of angles, which ``max_points`` limits. Magnitudes that
    differ by less than 1e-9 of their size are taken as equal: no transform is more exact.

    A car's side and roof, then foliage:

    >>> car = np.repeat([2.0, 88.0], 16)
    >>> tree = np.tile([40.0, -70.0, 80.0, -20.0], 8)
    >>> angles = np.array([car, tree], dtype=np.float32)
    >>> fourier(angles, np.array([[0, 0, 31], [1, 0, 31]], dtype=np.int32), FourierParams(longest=32))
    array([ True, False])
    """
    if not params.enabled:
        return np.ones(len(intervals), np.bool_)
    stable: Mask = kernels.stable_intervals(signed_deg, intervals, params.thresholds())
    return stable
