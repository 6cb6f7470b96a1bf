"""Lines that may hold a car (Stamos et al. 2012, sec. 7.2): a CUSUM test on the chain of H, V and M along the line."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import F64, I32, U8

Probability = Annotated[float, Field(gt=0, lt=1)]


def _distribution(row: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse probabilities that do not add up to one."""
    if not math.isclose(sum(row), 1.0, abs_tol=1e-6):
        msg = f"probabilities that add up to 1, found a sum of {sum(row):g}"
        raise ValueError(msg)
    return row


Row = Annotated[tuple[Probability, Probability, Probability], AfterValidator(_distribution)]
Matrix = tuple[Row, Row, Row]


class SuspiciousParams(Params):
    """Markov chains of H, V and M on a regular surface and on a car (``[sequential_angle.car.suspicious]``)."""

    enabled: bool = Field(False, description="test lines at all; false = every line may hold a car; published: true")
    h0: Matrix = Field(
        ((0.8, 0.1, 0.1), (0.09, 0.9, 0.01), (0.6, 0.3, 0.1)),
        description="regular surface: probabilities from H, V, M (rows) to H, V, M (published; the third column "
        "completes the rows)",
    )
    h1: Matrix = Field(
        ((0.5, 0.25, 0.25), (0.25, 0.5, 0.25), (0.25, 0.25, 0.5)),
        description="car: probabilities from H, V, M (rows) to H, V, M (published; the third column completes "
        "the rows)",
    )
    threshold: float = Field(
        1.0, ge=0, le=1e6, description="log likelihood ratio above which a line is suspicious [nat] (published)"
    )
    closed_gaps_only: bool = Field(
        False,
        description="leave out the missing shots behind the last return of a line, so that sky alone is not suspicious",
    )


def suspicious(car_surface: U8, n_beams: I32, params: SuspiciousParams) -> I32:
    """Find the beam at which every line becomes suspicious.

    ``S <- max(0, S + ln(H1/H0))`` over the transitions from the first return on; the first state adds nothing. Points
    of T', and points of lines without an angle, end it. With the published numbers every change from V to H or M and
    any two successive missing shots trigger at once; ground alone, one missing shot in the ground, or a wall up to the
    end of the line do not. On a regular surface there is a trigger every 18 beams, and every line that ends in the sky
    has one: this is a pre-selection, not a decision.

    ``car_surface`` (R, n) uint8; ``n_beams`` (R,) int32; returns (R,) int32.

    Ground with one missing shot, then ground with two:

    >>> lines = np.array([[2, 2, 0, 2, 2], [2, 2, 0, 0, 2]], dtype=np.uint8)
    >>> suspicious(lines, np.array([5, 5], dtype=np.int32), SuspiciousParams(enabled=True))
    array([-1,  3], dtype=int32)
    """
    if not params.enabled:
        return np.where(n_beams > 0, 0, -1).astype(np.int32)
    beam: I32 = kernels.first_triggers(
        car_surface, n_beams, increments(params), params.threshold, params.closed_gaps_only
    )[1]
    return beam


def increments(params: SuspiciousParams) -> F64:
    """Return ln(H1/H0) of every transition [nat].

    Returns (3, 3) float64.
    """
    ratios: F64 = np.array(params.h1) / np.array(params.h0)
    return np.log(ratios)
