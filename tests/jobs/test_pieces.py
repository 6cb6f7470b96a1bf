"""Pieces of jobs at their limits."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.jobs.batch.report import drift
from prc_cli.jobs.calibrate import sensor
from prc_cli.jobs.thin import _check_lines


def files(*ground: int) -> list[dict[str, int]]:
    return [{"GROUND": n, "OBJECT": 1000 - n} for n in ground]


def test_alarms_at_their_limits() -> None:
    usual = files(600, 610, 591, 605, 595, 600, 600, 600)
    far = {"GROUND": 100, "OBJECT": 900}
    assert drift(far, usual) == "GROUND is 10.0 % of the records, in 8 earlier files 60.0 % (59.4 to 60.6 % in most)"
    # a file of a single record counts, an empty one does not
    assert drift(far, usual[:7]) is None
    assert drift(far, [*usual[:7], {"GROUND": 1}]) is not None
    assert drift(far, [*usual[:7], {"GROUND": 0}]) is None
    assert drift({}, usual) == "there are no records, while 8 earlier files have some"
    assert drift({"GROUND": 1}, usual) is not None
    # the change of a twentieth, or six standard deviations above the median distance
    equal = files(*[600] * 8)
    assert drift({"GROUND": 5500, "OBJECT": 4500}, equal) is None
    assert drift({"GROUND": 5499, "OBJECT": 4501}, equal) is not None
    wide = files(500, 520, 540, 560, 640, 660, 680, 700)
    # distances 100, 80, 60, 40, 40, 60, 80, 100: median 70, median deviation 20
    limit = 600 - 70 - 6 * 1.4826 * 20
    assert drift({"GROUND": math.ceil(limit), "OBJECT": 1000 - math.ceil(limit)}, wide) is None
    assert drift({"GROUND": math.floor(limit) - 1, "OBJECT": 1001 - math.floor(limit)}, wide) is not None


@pytest.mark.parametrize(
    ("n_alike", "n_usual", "is_odd"), [(2, 20, True), (3, 20, False), (4, 90, True), (5, 90, False)]
)
def test_a_kind_of_drive_that_was_there_is_not_odd(n_alike: int, n_usual: int, is_odd: bool) -> None:
    for alike, expected in ((149, is_odd), (151, True)):
        earlier = files(*[600] * n_usual, *[alike] * n_alike)
        assert (drift({"GROUND": 100, "OBJECT": 900}, earlier) is not None) is expected


def rules(**given: Any) -> Any:
    config = {key: given.pop(key, None) for key in ("time_origin", "angle_start", "angle_step")}
    usual = {"lines": "angle-wrap", "columns": "angle", "line_hz": None, "config": SimpleNamespace(**config)}
    grid = SimpleNamespace(grid=SimpleNamespace(start_rad=math.radians(5.0), step_rad=math.radians(0.25)))
    times = iter([SimpleNamespace(values={"time": np.array([7.25, 8.0])})])
    return SimpleNamespace(
        rules=SimpleNamespace(**{**usual, **given}),
        setups=dict(enumerate([SimpleNamespace(columns=one) for one in (grid, SimpleNamespace(grid=None), grid)])),
        source=SimpleNamespace(chunks=lambda _: times),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"lines": "fixed"}, "their order"), ({"columns": "order"}, "their order"),
        ({"columns": "time"}, "the first return of their line"), (None, "the records around them"),
        ({}, None), ({"columns": "time", "line_hz": 50.0}, None),
    ],
)  # fmt: skip
def test_cells_that_would_move(given: dict[str, Any] | None, said: str | None) -> None:
    opened: Any = SimpleNamespace(grid=None if given is None else rules(**given))
    if said is None:
        _check_lines(Path("a.las"), opened)
    else:
        with pytest.raises(ConfigError, match=f"the cells of shots follow from {said}, so that leaving"):
            _check_lines(Path("a.las"), opened)


def test_noise_is_fitted_as_a_constant_and_a_part_that_grows() -> None:
    def item(range_m: float, sigma_m: float, n: int, flat: bool = True) -> Any:
        return sensor.NoiseBin(range_m, sigma_m, n, flat=flat)

    a, b = 0.003, 0.0002
    exact = tuple(item(r, math.hypot(a, b * r), n) for r, n in ((2.0, 5), (10.0, 90), (40.0, 7)))
    assert sensor._fit_noise((*exact, item(5.0, 9.0, 999, flat=False))) == pytest.approx((a, b))
    assert sensor._fit_noise(()) == sensor._fit_noise((item(5.0, 9.0, 9, flat=False),)) == (None, None)
    assert sensor._fit_noise((item(5.0, 0.01, 9),)) == (0.01, 0.0)
    # weighted by the root of the number of stretches, relative errors
    one, other = item(3.0, 0.01, 400), item(3.0, 0.02, 100)
    square = np.array([1e-4, 4e-4])
    weight = np.array([20.0, 10.0]) / square
    found = sensor._fit_noise((one, other))
    assert found[0] is not None
    assert found[1] is not None
    assert found[0] ** 2 + 9 * found[1] ** 2 == pytest.approx((weight**2 * square).sum() / (weight**2).sum())


def noise_counts(bins: dict[int, tuple[float, int]]) -> np.ndarray:
    """Return counts by range bin: so many deviations of one size."""
    counts = np.zeros((len(sensor._RANGE_EDGES) - 1, len(sensor._NOISE_EDGES) - 1), np.int64)
    for place, (sigma_m, n) in bins.items():
        counts[place, int(np.searchsorted(sensor._NOISE_EDGES, sigma_m)) - 1] = n
    return counts


@pytest.mark.parametrize(
    ("bins", "flat"),
    [
        ({5: (0.005, 50)}, [True]), ({5: (0.005, 49)}, []), ({5: (0.09, 50)}, [True]), ({5: (0.12, 50)}, [False]),
        ({}, []),
        # from the flattest outwards, while noise grows at most twice as much as the range
        ({5: (0.009, 500), 6: (0.005, 500), 7: (0.011, 500)}, [True, True, True]),
        ({6: (0.005, 500), 7: (0.0135, 500), 8: (0.005, 500)}, [True, False, True]),
        ({4: (0.0125, 500), 6: (0.005, 500)}, [False, True]),
        # the flattest counts where it has a tenth of the most
        ({5: (0.001, 50), 6: (0.02, 500)}, [True, False]), ({5: (0.001, 50), 6: (0.02, 501)}, [True, True]),
    ],
)  # fmt: skip
def test_flat_bins_of_noise(bins: dict[int, tuple[float, int]], flat: list[bool]) -> None:
    found = sensor._noise_bins(noise_counts(bins))
    assert [one.flat for one in found] == flat
    for one, (place, (sigma_m, n)) in zip(found, bins.items(), strict=False):
        assert one.range_m == pytest.approx(math.sqrt(sensor._RANGE_EDGES[place] * sensor._RANGE_EDGES[place + 1]))
        assert one.sigma_m == pytest.approx(sigma_m, rel=0.06)
        assert one.n_stretches == n
