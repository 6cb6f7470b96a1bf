"""Sequential test between two hidden Markov models: where a sequence starts and stops fluctuating.

The paper takes it from Chen and Willett (2000, eqs. 23 to 28). The forward recursion gives the likelihoods of both
models; the logarithm S of their ratio is reset whenever it falls below zero, and raises an alarm when it exceeds a
threshold. The first sample after the last reset estimates the onset of the change.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import F32, F64, Mask
from prc_cli.methods.sequential_angle.thresholds import MarkovModel, MarkovThresholds

Probability = Annotated[float, Field(ge=0, le=1)]
Row = tuple[Probability, Probability, Probability]
Matrix = tuple[Row, Row, Row]
Angles = tuple[
    Annotated[float, Field(ge=-360, le=360)],
    Annotated[float, Field(ge=-360, le=360)],
    Annotated[float, Field(ge=-360, le=360)],
]
Spreads = tuple[
    Annotated[float, Field(gt=0, le=360)], Annotated[float, Field(gt=0, le=360)], Annotated[float, Field(gt=0, le=360)]
]

UNIFORM: Row = (1 / 3, 1 / 3, 1 / 3)
"""Uniform probabilities of the states."""


class HmmParams(Params):
    """Two hidden Markov models of three states with common Gaussians, and how the test between them ends."""

    means_deg: Angles = Field((-90.0, 0.0, 90.0), description="mean of every state [deg] (published)")
    sigmas_deg: Spreads = Field((30.0, 30.0, 30.0), description="standard deviation of every state [deg]")
    h0: Matrix = Field(
        ((0.05, 0.475, 0.475), (0.05, 0.875, 0.075), (0.05, 0.075, 0.875)),
        description="transition probabilities of model 0, no vegetation; row = from, each adds up to 1",
    )
    h1: Matrix = Field(
        (UNIFORM, UNIFORM, UNIFORM),
        description="transition probabilities of model 1, vegetation; row = from, each adds up to 1",
    )
    initial_h0: Row = Field(
        (0.05, 0.475, 0.475),
        description="probabilities of the states of model 0 at the first sample of a start: stationary, so that a "
        "region begins with a value near -90 deg; with 1/3 each this sample tells nothing, values that alternate "
        "between -90 and 90 are never found, and stairs are",
    )
    initial_h1: Row = Field(
        UNIFORM, description="probabilities of the states of model 1 at the first sample of a start"
    )
    threshold: float = Field(10.0, gt=0, le=100, description="log-likelihood ratio that vegetation begins at [nats]")
    threshold_back: float = Field(
        10.0, gt=0, le=100, description='log-likelihood ratio that vegetation ends at, with end = "cusum" [nats]'
    )
    end: Literal["cusum", "sprt"] = Field(
        "cusum",
        description='how a region ends: "cusum" runs the same test with the models exchanged; "sprt" confirms the '
        "region by a test between two bounds on the samples after the alarm, repeats that until one rejects, and "
        "pulls the end back to the sample after the last negative value",
    )
    sprt_accept: float = Field(10.0, gt=0, le=100, description='upper bound with end = "sprt" [nats]')
    sprt_reject: float = Field(-5.0, lt=0, ge=-100, description='lower bound with end = "sprt" [nats]')
    merge_gap: int = Field(
        5, ge=0, le=100_000, description='with end = "sprt" regions closer than this become one [samples]'
    )
    backdate: bool = Field(
        True, description="a change is at its estimated onset; else at the sample that raised the alarm"
    )

    def thresholds(self) -> MarkovThresholds:
        """Return the thresholds of the kernel."""
        return MarkovThresholds(
            threshold=self.threshold,
            threshold_back=self.threshold_back,
            backdate=self.backdate,
            sprt=self.end == "sprt",
            accept=self.sprt_accept,
            reject=self.sprt_reject,
            merge_gap=self.merge_gap,
        )

    @model_validator(mode="after")
    def _rows_are_distributions(self) -> HmmParams:
        rows = [(f"h0 row {i + 1}", row) for i, row in enumerate(self.h0)]
        rows += [(f"h1 row {i + 1}", row) for i, row in enumerate(self.h1)]
        for name, row in [*rows, ("initial_h0", self.initial_h0), ("initial_h1", self.initial_h1)]:
            if abs(sum(row) - 1.0) > 1e-6:
                msg = f"probabilities of {name} that add up to 1, found {sum(row):g}"
                raise ValueError(msg)
        return self


def hmm_cusum(values: F32, params: HmmParams) -> Mask:
    """Mark the samples of every row that belong to model 1.

    Rows are independent. After an alarm the test continues at the next sample with the models exchanged. When that
    raises an alarm, the region ends just before the onset of the change back, and the search for the next region
    begins after that alarm: every sample is used once in either direction. The end of a row closes an open region;
    with ``end = "sprt"``, an unconfirmed region at the end of a row is dropped. A sample with zero probability in both
    models restarts the test.

    After a reset the first sample depends only on the initial probabilities. With the stationary probabilities of
    each model (Chen and Willett) it counts like any other; a change from 0 to 90 deg, as on stairs, then begins no
    region, but counts within one. With the same probabilities in both models it is neutral.

    ``values`` (R, n) float32, degrees; returns (R, n) bool.

    Foliage between two surfaces:

    >>> foliage = [-90.0, 90.0, 0.0] * 10
    >>> values = np.array([[90.0] * 20 + foliage + [0.0] * 20], np.float32)
    >>> found = np.flatnonzero(hmm_cusum(values, HmmParams())[0])
    >>> int(found[0]), int(found[-1])
    (20, 49)
    """
    return kernels.hmm_cusum(
        values,
        _array(params.means_deg),
        _array(params.sigmas_deg),
        MarkovModel(_array(params.h0), _array(params.initial_h0)),
        MarkovModel(_array(params.h1), _array(params.initial_h1)),
        params.thresholds(),
    )


def _array(numbers: Row | Matrix) -> F64:
    """Convert a vector or a matrix of parameters to float64."""
    return np.array(numbers, np.float64)
