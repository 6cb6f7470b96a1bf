"""The advice from given figures: every bound decides just beyond it, and not just before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prc_cli.jobs.calibrate.implied import Advice, Curves, imply, thresholds
from prc_cli.jobs.calibrate.sensor import SensorEstimate
from prc_cli.methods.prc.pipeline import PrcParams

SENSOR = SensorEstimate(
    points_per_line=2154, n_lines=500, n_shots=500 * 2154, n_missing=0,
    range_quantiles_m={"5%": 2.0, "25%": 4.0, "50%": 6.0, "75%": 10.0, "95%": 30.0}, noise=(), sigma_m=0.001,
    sigma_per_m=0.0, step_rad=None, step_source="", rounding_m=None, line_hz=None, in_line_m=None, across_lines_m=None,
)  # fmt: skip


def advised(
    sensor: SensorEstimate = SENSOR, *, low: float = 0.99, plateau: float = 0.9, zeta: float = 0.1, **params: object
) -> dict[str, Advice]:
    """Return the advice by key where thresholds below 1 m support ``low`` of what wide ones do."""
    used = PrcParams.model_validate({"support": {"zeta_s": zeta, "zeta_p": zeta}, **params})
    grid = thresholds(zeta)
    lengths = np.geomspace(0.001, 100.0, 51)
    reached = np.where(np.minimum(grid[:, None], grid[None, :]) < 1.0, low, 1.0) * plateau
    supported = np.round(100_000 * reached).astype(np.int64)
    background = np.full(len(lengths), 1000, np.int64)
    curves = Curves(grid, grid, supported, lengths, background, 100_000, 100_000, 100_000)
    return {item.key: item for item in imply(sensor, curves, used, 0.02)}


@pytest.mark.parametrize(("environment", "share"), [("urban", 0.95), ("forest", 0.5)])
@pytest.mark.parametrize("name", ["zeta_s", "zeta_p"])
def test_thresholds_stay_where_they_support_a_share_of_the_plateau(environment: str, share: float, name: str) -> None:
    key = f"prc.support.{name}"
    assert advised(low=share + 0.01, environment=environment)[key].value == 0.1
    raised = advised(low=share - 0.01, environment=environment)[key]
    assert (raised.before, raised.value) == (0.1, 1.0)
    assert raised.reason.endswith(f"reaches {share:.0%} of that and 6 times the noise of 1 mm")


def test_the_threshold_of_adjacent_lines_is_never_the_lower_one() -> None:
    """The paper advises zeta_s >= zeta_p; 0.1 m supports too little for zeta_p alone, so zeta_s follows."""
    grid = thresholds(0.1)
    reached = np.where(grid[:, None] < 1.0, 0.5, 1.0) * np.ones(len(grid))
    lengths = np.geomspace(0.001, 100.0, 51)
    flat = np.full(len(lengths), 1000, np.int64)
    n = 100_000
    curves = Curves(grid, grid, np.round(0.9 * n * reached).astype(np.int64), lengths, flat, n, n, n)
    params = PrcParams.model_validate({"support": {"zeta_s": 0.1, "zeta_p": 0.1}})
    found = {item.key: item for item in imply(SENSOR, curves, params, 0.02)}
    assert (found["prc.support.zeta_p"].value, found["prc.support.zeta_s"].value) == (1.0, 1.0)
    assert found["prc.support.zeta_s"].reason.startswith("raised to zeta_p, as zeta_s >= zeta_p is advisable (II-B)")


def test_thresholds_are_six_times_the_noise() -> None:
    noisy = replace(SENSOR, sigma_m=0.1)
    assert advised(noisy, zeta=0.61)["prc.support.zeta_s"].value == 0.61
    assert advised(noisy, zeta=0.59)["prc.support.zeta_s"].value == pytest.approx(0.64)


def test_a_plateau_is_a_fifth_of_the_returns() -> None:
    assert advised(low=0.5, plateau=0.21)["prc.support.zeta_s"].value == 1.0
    assert advised(low=0.5, plateau=0.19)["prc.support.zeta_s"].value == 0.1


@pytest.mark.parametrize(
    ("known", "value", "reason"),
    [
        ({}, 0.05, "the published value"),
        ({"sigma_m": 0.1}, 1.7, "17 times the deviation of flat stretches, 1e+02 mm at 10 m"),
        ({"sigma_m": None}, 0.05, "the published value"),
        ({"rounding_m": 0.1}, 0.5, "ranges are stored in steps of 0.1 m"),
        ({"step_rad": 0.01}, 0.2, "the three shots of eq. 9 span 0.2 m at 10 m under steps of 0.57 degrees"),
        ({"step_rad": 0.01, "rounding_m": 0.1}, 0.5, "ranges are stored in steps of 0.1 m"),
        ({"step_rad": 0.04, "rounding_m": 0.1}, 0.8, "the three shots of eq. 9 span 0.8 m"),
    ],
)
def test_the_length_is_the_largest_that_is_asked_for(known: dict[str, float], value: float, reason: str) -> None:
    found = advised(replace(SENSOR, **known))["prc.background.d_c"]  # type: ignore[arg-type]
    assert found.value == pytest.approx(value)
    assert found.reason.startswith(reason)
    assert "; marks 1.0% of the returns" in found.reason


@pytest.mark.parametrize(
    ("lines", "m", "value"), [(99, 2154, 30.0), (99, 1077, 15.0), (99, 870, 12.1), (99, 850, 12.0)]
)
def test_the_area_is_the_published_share_of_a_block_and_twelve_at_least(lines: int, m: int, value: float) -> None:
    found = advised(replace(SENSOR, points_per_line=m), lines_per_block=lines)["prc.surfaces.area"]
    assert found.value == value
    assert ("three lines of four shots" in found.reason) is (m == 850)
