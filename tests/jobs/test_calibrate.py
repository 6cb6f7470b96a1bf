"""Curves against the classifier, and estimates for a known scanner."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import regroup
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32
from prc_cli.jobs.calibrate.implied import Advice, CurveCounter, Curves, imply, thresholds
from prc_cli.jobs.calibrate.sensor import NoiseBin, SensorEstimate, SensorMeter, _fit_noise
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.prc.support import (
    BackgroundParams,
    SupportParams,
    background,
    stream_window,
    support,
    window_reach,
)
from tests.street import POINTS_PER_LINE, street


def count(image: F32, params: PrcParams, lines: int) -> Curves:
    counter = CurveCounter(params)
    for block in regroup(iter([ScanBlock(0, image)]), lines):
        counter.add(block)
    return counter.finish()


@pytest.mark.parametrize("rounding", ["ceil", "floor"])
def test_curves_are_what_the_classifier_supports_at_every_threshold(rounding):
    image = street()[:40]
    params = PrcParams(support=SupportParams(zeta_s=0.7, zeta_p=0.25, rounding=rounding))
    curves = count(image, params, 7)
    window = stream_window(np.full(window_reach(POINTS_PER_LINE), np.nan, np.float32), image, None)
    n_returns = int(np.count_nonzero(~np.isnan(image)))
    assert (curves.n_returns, curves.n_shots) == (n_returns, image.size)

    def shares(zeta_p: float, zeta_s: float) -> float:
        used = SupportParams(zeta_s=zeta_s, zeta_p=zeta_p, rounding=rounding)
        return np.count_nonzero(support(window, POINTS_PER_LINE, used)) / n_returns

    assert curves.over_zeta_p(1.0).tolist() == [shares(float(zeta), 1.0) for zeta in curves.zetas_p]
    assert curves.over_zeta_s(1.0).tolist() == [shares(1.0, float(zeta)) for zeta in curves.zetas_s]
    assert curves.share(0.25, 0.7) == shares(0.25, 0.7)
    assert curves.share(float(curves.zetas_p[9]), float(curves.zetas_s[30])) == shares(
        float(curves.zetas_p[9]), float(curves.zetas_s[30])
    )


def test_background_curve_is_what_the_classifier_marks():
    image = street()[:30]
    curves = count(image, PrcParams(), 11)
    window = stream_window(np.full(window_reach(POINTS_PER_LINE), np.nan, np.float32), image, None)
    supported = support(window, POINTS_PER_LINE, SupportParams())
    for place in range(0, len(curves.lengths), 5):
        params = BackgroundParams(d_c=float(curves.lengths[place]))
        assert curves.background[place] == np.count_nonzero(background(window, supported, params))


def corridor(
    sigma_m: float,
    per_m: float,
    step_deg: float = 0.5,
    n_lines: int = 120,
) -> F32:
    """Ground 2 m below, walls at 6 and 15 m, from straight down to 60 degrees up on one side."""
    rng = np.random.default_rng(5)
    angle = np.deg2rad(np.arange(-80.0, 130.0, step_deg))
    with np.errstate(divide="ignore"):
        ground = np.where(np.cos(angle) > 0.01, 2.0 / np.cos(angle), np.inf)
        wall = np.where(
            np.sin(angle) > 0.01, 15.0 / np.sin(angle), 6.0 / np.maximum(-np.sin(angle), 0.01)
        )
    image = np.tile(np.minimum(ground, wall), (n_lines, 1))
    return (image + rng.normal(size=image.shape) * np.hypot(sigma_m, per_m * image)).astype(
        np.float32
    )


def measured(image: F32, **known: Any) -> SensorEstimate:
    meter = SensorMeter(
        StreamInfo("drive", "array", image.shape[1], image.size, len(image), **known)
    )
    for block in regroup(iter([ScanBlock(0, image)]), 50):
        meter.add(block)
    return meter.finish()


@pytest.mark.parametrize(
    "sigma_m, per_m", [(0.002, 0.0), (0.008, 0.0), (0.004, 0.001), (0.02, 0.001)]
)
def test_noise_is_found_without_knowing_angles_or_slopes(sigma_m, per_m):
    estimate = measured(corridor(sigma_m, per_m))
    for range_m in (2.5, 6.5, 15.0):
        assert estimate.noise_at(range_m) == pytest.approx(
            np.hypot(sigma_m, per_m * range_m), rel=0.2
        )


SENSOR = SensorEstimate(
    points_per_line=2154,
    n_lines=500,
    n_shots=500 * 2154,
    n_missing=0,
    range_quantiles_m={"5%": 2.0, "25%": 4.0, "50%": 6.0, "75%": 10.0, "95%": 30.0},
    noise=(),
    sigma_m=0.001,
    sigma_per_m=0.0,
    step_rad=None,
    step_source="",
    rounding_m=None,
    line_hz=None,
    in_line_m=None,
    across_lines_m=None,
)


def advised(
    sensor: SensorEstimate = SENSOR,
    *,
    low: float = 0.99,
    plateau: float = 0.9,
    zeta: float = 0.1,
    **params: object,
) -> dict[str, Advice]:
    """Return the advice by key where thresholds below 1 m support ``low`` of what wide ones do."""
    used = PrcParams.model_validate({"support": {"zeta_s": zeta, "zeta_p": zeta}, **params})
    grid = thresholds(zeta)
    lengths = np.geomspace(0.001, 100.0, 51)
    reached = np.where(np.minimum(grid[:, None], grid[None, :]) < 1.0, low, 1.0) * plateau
    supported = np.round(100_000 * reached).astype(np.int64)
    background = np.full(len(lengths), 1000, np.int64)
    curves = Curves(grid, grid, supported, lengths, background, 100_000, 100_000)
    return {item.key: item for item in imply(sensor, curves, used, 0.02)}


@pytest.mark.parametrize("environment, share", [("urban", 0.95), ("forest", 0.5)])
@pytest.mark.parametrize("name", ["zeta_s", "zeta_p"])
def test_thresholds_stay_where_they_support_a_share_of_the_plateau(environment, share, name):
    key = f"prc.support.{name}"
    assert advised(low=share + 0.01, environment=environment)[key].value == 0.1
    raised = advised(low=share - 0.01, environment=environment)[key]
    assert (raised.before, raised.value) == (0.1, 1.0)
    assert raised.reason.endswith(f"reaches {share:.0%} of that and 6 times the noise of 1 mm")


@pytest.mark.parametrize(
    "known, value, reason",
    [
        ({}, 0.05, "the published value"),
        ({"sigma_m": 0.1}, 1.7, "17 times the deviation of flat stretches, 1e+02 mm at 10 m"),
        ({"sigma_m": None}, 0.05, "the published value"),
        ({"rounding_m": 0.1}, 0.5, "ranges are stored in steps of 0.1 m"),
        (
            {"step_rad": 0.01},
            0.2,
            "the three shots of eq. 9 span 0.2 m at 10 m under steps of 0.57 degrees",
        ),
        ({"step_rad": 0.01, "rounding_m": 0.1}, 0.5, "ranges are stored in steps of 0.1 m"),
        ({"step_rad": 0.04, "rounding_m": 0.1}, 0.8, "the three shots of eq. 9 span 0.8 m"),
    ],
)
def test_the_length_is_the_largest_that_is_asked_for(known, value, reason):
    advice = advised(replace(SENSOR, **known))["prc.background.d_c"]  # type: ignore[arg-type]
    assert advice.value == pytest.approx(value)
    assert advice.reason.startswith(reason)
    assert "; marks 1.0% of the returns" in advice.reason


@pytest.mark.parametrize(
    "range_m, fitted", [([], (None, None)), ([7.0], (0.05, 0.0)), ([3, 9.0], (0.004, 0.003))]
)
def test_noise_is_fitted_to_flat_stretches(range_m, fitted):
    constant, growing = fitted
    bins = [
        NoiseBin(middle_m, float(np.hypot(constant or 0.0, (growing or 0.0) * middle_m)), 40, True)
        for middle_m in range_m
    ]
    assert _fit_noise((*bins, NoiseBin(20.0, 9.9, 40, False))) == pytest.approx(fitted)
