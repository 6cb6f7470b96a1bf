"""What the sensor meter takes for flat, for rounded and for the middle."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.types import F64
from prc_cli.jobs.calibrate.sensor import SensorEstimate
from tests.jobs.test_calibrate import measure

N = 60
"""Stretches of a level; 50 make a range bin usable."""


def levels(*of: tuple[float, float], n: int | tuple[int, ...] = N) -> SensorEstimate:
    """Measure stretches of nine shots at some ranges [m] with exactly the standard deviations given beside them [m]."""
    place = np.arange(9) - 4
    pattern = np.where(place % 2, 1.0, -1.0)
    pattern -= np.polyval(np.polyfit(place, pattern, 2), place)
    pattern *= np.sqrt(6 / (pattern**2).sum())
    counts = (n,) * len(of) if isinstance(n, int) else n
    rows = [
        np.tile(range_m + sigma_m * pattern, (count, 1)) for (range_m, sigma_m), count in zip(of, counts, strict=True)
    ]
    return measure(np.concatenate(rows).astype(np.float32))


def flat(found: SensorEstimate) -> list[bool]:
    return [item.flat for item in found.noise]


def test_a_bin_gives_its_range_deviation_and_number() -> None:
    found = levels((2.2, 0.005), (9.0, 0.02))
    assert [item.n_stretches for item in found.noise] == [N, N]
    assert [item.range_m for item in found.noise] == pytest.approx([2.2, 9.0], rel=0.1)
    assert [item.sigma_m for item in found.noise] == pytest.approx([0.005, 0.02], rel=0.06)
    assert levels((2.2, 0.005), n=50).sigma_m is not None
    assert levels((2.2, 0.005), n=49).noise == ()


def test_deviations_of_a_decimetre_are_foliage() -> None:
    assert flat(levels((20.0, 0.09))) == [True]
    assert flat(levels((20.0, 0.115))) == [False]
    assert flat(levels((10.0, 0.06), (20.0, 0.09))) == [True, True]
    assert flat(levels((10.0, 0.06), (20.0, 0.12))) == [True, False]


def test_noise_may_grow_with_the_range_and_twice_as_much() -> None:
    assert flat(levels((2.2, 0.005), (4.4, 0.018))) == [True, True]
    assert flat(levels((2.2, 0.005), (4.4, 0.022))) == [True, False]
    # towards the scanner noise does not fall
    assert flat(levels((2.2, 0.009), (4.4, 0.005))) == [True, True]
    assert flat(levels((2.2, 0.011), (4.4, 0.005))) == [False, True]
    # what is no flat surface is no measure for what lies behind it
    assert flat(levels((2.2, 0.005), (4.4, 0.05), (8.8, 0.036))) == [True, False, True]
    assert flat(levels((2.2, 0.005), (4.4, 0.05), (8.8, 0.045))) == [True, False, False]


def test_rare_ranges_are_no_measure() -> None:
    assert flat(levels((2.2, 0.01), (4.4, 0.001), n=(1000, 99))) == [True, True]
    assert flat(levels((2.2, 0.01), (4.4, 0.001), n=(1000, 101))) == [False, True]


def test_noise_is_fitted_to_the_flat_bins() -> None:
    found = levels(*((range_m, float(np.hypot(0.004, 0.001 * range_m))) for range_m in (2.2, 5.2, 12.4)))
    assert found.sigma_m == pytest.approx(0.004, rel=0.15)
    assert found.sigma_per_m == pytest.approx(0.001, rel=0.15)
    one = levels((2.2, 0.01), (4.4, 0.5))
    assert (one.sigma_m, one.sigma_per_m) == (one.noise[0].sigma_m, 0.0)


def test_grazing_stretches_are_left_out() -> None:
    for ratio, n in ((1.28, 1), (1.32, 0)):
        # a plane, under a steep angle
        slanted = (1.0 + 1e-3 * (np.arange(9) % 2)) / np.linspace(1.0, 1 / ratio, 9)
        assert len(measure(np.tile(slanted, (N, 1)).astype(np.float32)).noise) == n


@pytest.mark.parametrize("power", [-4, -3, -2, -1, 0])
@pytest.mark.parametrize("factor", [1, 2, 2.5, 5])
def test_every_usual_rounding_is_found(factor: float, power: int) -> None:
    unit = factor * 10.0**power
    image = np.random.default_rng(7).uniform(3.0, 12.0, (40, 200))
    assert measure((np.round(image / unit) * unit).astype(np.float32)).rounding_m == pytest.approx(unit)


@pytest.mark.parametrize(("n_wrong", "expected"), [(9, 0.01), (11, None)])
def test_one_range_in_a_hundred_may_be_no_multiple(n_wrong: int, expected: float | None) -> None:
    """Every 37th shot of a block is tested."""
    image = np.random.default_rng(7).uniform(2.0, 12.0, (50, 740))
    flat = (np.round(image / 0.01) * 0.01).ravel()
    flat[: 37 * n_wrong : 37] += 0.00437
    assert measure(flat.reshape(image.shape).astype(np.float32)).rounding_m == expected


def test_differences_of_neighbours_are_their_median() -> None:
    steps = np.where(np.arange(200) % 10 < 6, 0.1, 1.0)
    along = 5.0 + np.cumsum(np.concatenate([[0.0], steps]))
    image: F64 = np.tile(along, (101, 1)) + np.cumsum(np.where(np.arange(101) % 10 < 6, 0.03, 0.3))[:, None]
    found = measure(image.astype(np.float32))
    assert found.in_line_m == pytest.approx(0.1, rel=0.02)
    assert found.across_lines_m == pytest.approx(0.03, rel=0.02)


def test_quantiles_of_the_ranges() -> None:
    image = np.linspace(10.0, 110.0, 20_000).reshape(100, 200)
    found = measure(image.astype(np.float32)).range_quantiles_m
    assert found == pytest.approx({"5%": 15.0, "25%": 35.0, "50%": 60.0, "75%": 85.0, "95%": 105.0}, rel=0.02)
