"""Pieces of jobs at their limits."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.jobs import doctor
from prc_cli.jobs.batch import report
from prc_cli.jobs.batch.report import drift
from prc_cli.jobs.calibrate import sensor
from prc_cli.jobs.calibrate.search import ANGLE_AXES, PRC_AXES
from prc_cli.jobs.evaluate.options import TIME_TOLERANCE_S
from prc_cli.jobs.render.cloud import FromAbove, _panel
from prc_cli.jobs.thin import _check_lines, _needed


def test_values_that_are_searched() -> None:
    """What a user sees tried; bounds hold the grid."""
    shown = {axis.key.removeprefix("prc."): (*axis.grid, "in", *axis.bounds) for axis in (*PRC_AXES, *ANGLE_AXES)}
    assert shown == {
        "background.d_c": (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, "in", 0.005, 10.0),
        "surfaces.area": (4.0, 8.0, 12.0, 20.0, 30.0, 60.0, 120.0, 240.0, "in", 1.0, 5000.0),
        "support.zeta_p": (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, "in", 0.01, 10.0),
        "support.zeta_s": (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, "in", 0.01, 10.0),
        "surfaces.gamma": (0.0, 1.0, 2.0, 3.0, 4.0, "in", 0.0, 20.0),
        "sequential_angle.angles.range_noise_m": (0.002, 0.005, 0.01, 0.02, 0.05, "in", 0.0005, 0.5),
    }
    for axis in (*PRC_AXES, *ANGLE_AXES):
        assert axis.bounds[0] <= min(axis.grid) <= max(axis.grid) <= axis.bounds[1]
        assert list(axis.grid) == sorted(axis.grid)


@pytest.mark.parametrize(
    ("gib", "level", "hint"),
    [
        (0.99, "bad", "end other programs, or give the container more"),
        (1.0, "warn", "take at most 1 files at a time with --jobs"),
        (3.99, "warn", "take at most 3 files at a time with --jobs"), (4.0, "ok", ""),
    ],
)  # fmt: skip
def test_memory_for_every_core(monkeypatch: pytest.MonkeyPatch, gib: float, level: str, hint: str) -> None:
    monkeypatch.setattr(doctor, "_free_memory", lambda: int(gib * (1 << 30)))
    monkeypatch.setattr(doctor, "default_threads", lambda: 4)
    (found,) = doctor._memory()
    assert (found.name, found.hint) == ("memory", hint)
    assert found.status == level
    monkeypatch.setattr(doctor, "_free_memory", lambda: None)
    assert list(doctor._memory()) == []


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


ANGLES = "read it with --set input.angle_start=5.0 --set input.angle_step=0.25"
ORIGIN = "read it with --set input.time_origin=7.25"
MOVE = "columns follow from the times: shots that share a stamp may move by a column"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({}, (ANGLES,)), ({"angle_start": 1.0}, (ANGLES,)), ({"angle_step": 1.0}, (ANGLES,)),
        ({"angle_start": 1.0, "angle_step": 1.0}, ()), ({"columns": "scan"}, ()),
        ({"columns": "time"}, (MOVE,)),
        ({"columns": "scan", "line_hz": 50.0}, (ORIGIN,)),
        ({"columns": "scan", "line_hz": 50.0, "time_origin": 1.0}, ()),
        ({"line_hz": 50.0, "columns": "time"}, (ORIGIN, MOVE)), ({"columns": "scan", "time_origin": 1.0}, ()),
    ],
)  # fmt: skip
def test_options_that_a_thinned_file_needs(given: dict[str, Any], told: tuple[str, ...]) -> None:
    assert _needed(rules(**given)) == told


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


def test_logarithmic_bins_equal_a_plain_count() -> None:
    edges = np.geomspace(0.25, 64.0, 17)
    values = np.array([0.2, 0.26, 1.0, 1.5, 3.0, 60.0, 65.0, 0.0, -1.0, np.nan, np.inf])
    counts = sensor._log_counts(values, edges)
    expected = [sum(low <= one < high for one in (0.26, 1.5, 3.0, 60.0)) for low, high in pairwise(edges)]
    # 1.0 is an edge, to rounding
    assert counts.sum() == sum(expected) + 1
    assert (counts >= expected).all()
    assert len(counts) == 16


@pytest.mark.parametrize("share", [0.01, 0.25, 0.5, 0.75, 1.0])
def test_quantiles_of_bins_are_in_the_middle_of_a_bin(share: float) -> None:
    edges = np.geomspace(1.0, 1024.0, 11)
    counts = np.array([0, 3, 0, 5, 0, 0, 8, 1, 0, 0])
    every = [k for k, n in enumerate(counts.tolist()) for _ in range(n)]
    place = every[math.ceil(share * len(every)) - 1]
    assert sensor._quantile(counts, edges, share) == pytest.approx(2.0 ** (place + 0.5))
    assert sensor._quantile(0 * counts, edges, share) is None


def test_the_most_frequent_value_of_bins_after_smoothing() -> None:
    edges = np.geomspace(1.0, 2.0**40, 41)
    counts = np.zeros(40, np.int64)
    counts[5], counts[19:24] = 90, 70
    assert sensor._log_mode(counts, edges, smooth=3) == pytest.approx(2.0**20.5, rel=1)
    assert sensor._log_mode(counts, edges, smooth=1) == pytest.approx(2.0**5.5)
    weights = [min(k + 1, 11 - k) / 6 for k in range(11)]
    smooth = [sum(w * counts[i + k - 5] for k, w in enumerate(weights) if 0 <= i + k - 5 < 40) for i in range(40)]
    assert sensor._log_mode(counts, edges, smooth=11) == pytest.approx(2.0 ** (int(np.argmax(smooth)) + 0.5))


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


def test_edges_of_bins_cover_all_scanners() -> None:
    """Four bins for twice the range, forty for ten times the deviation."""
    for edges, low, high, ratio in (
        (sensor._RANGE_EDGES, 0.25, 512.0, 2.0 ** (1 / 4)), (sensor._NOISE_EDGES, 1e-6, 10.0, 10.0 ** (1 / 40)),
        (sensor._LENGTH_EDGES, 1e-9, 1e39, 10.0 ** (1 / 100)),
    ):  # fmt: skip
        assert (edges[0], edges[-1]) == pytest.approx((low, high))
        np.testing.assert_allclose(edges[1:] / edges[:-1], ratio)
    assert sensor._ROUNDINGS[:5] == pytest.approx((5.0, 2.5, 2.0, 1.0, 0.5))
    assert sensor._ROUNDINGS[-4:] == pytest.approx((5e-4, 2.5e-4, 2e-4, 1e-4))
    assert len(sensor._ROUNDINGS) == 20


def test_what_other_programs_and_pages_rely_on() -> None:
    assert (report.SCHEMA, report.FAILED) == (1, 1)
    assert TIME_TOLERANCE_S == 6e-7


def test_axes_of_a_view_from_above_are_in_metres() -> None:
    camera = FromAbove(left=100.0, top=50.0, metres=0.25, size=(40, 24), highest=9.0)
    panel = _panel(np.zeros((24, 40, 3), np.uint8), camera, None, "class")
    assert (panel.x.first, panel.x.stop, panel.y.first, panel.y.stop) == (100.0, 110.0, 50.0, 44.0)
    assert panel.note.startswith("scale bar 2 m, 1 pixel = 25 cm")
