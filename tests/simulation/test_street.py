from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.config import build
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import ScanStream
from prc_cli.core.types import F32, F64, U8
from prc_cli.simulation.houses import lots_between
from prc_cli.simulation.params import StreetParams
from prc_cli.simulation.street import LANE_M, StreetScan, simulate_street

CLEAN = {"noise_m": 0.0, "noise_per_m": 0.0, "background_share": 0.0, "mixed_share": 0.0}


def street(**params: Any) -> StreetScan:
    return simulate_street(StreetParams(**{"n_lines": 130, "points_per_line": 360, "speed_m_s": 20.0} | params))


def simulated(scan: StreetScan, lines: int = 64) -> tuple[F32, U8]:
    items = list(scan.labelled_blocks(lines))
    return np.concatenate([item.block.range_m for item in items]), np.concatenate([item.labels for item in items])


def across(scan: StreetScan, range_m: F32) -> tuple[F64, F64]:
    """Place across the street and height of every shot, from range and angle alone."""
    slant = np.deg2rad(scan.params.slant_deg)
    y = LANE_M + range_m * np.sin(scan.angle_rad)
    z = scan.params.height_m - range_m * np.cos(scan.angle_rad) * np.cos(slant)
    return y.astype(np.float64), z.astype(np.float64)


@pytest.mark.parametrize("lines", [1, 7, 130, 1000])
def test_lines_per_block_change_nothing(lines: int) -> None:
    whole, cut = simulated(street()), simulated(street(), lines)
    assert whole[0].tobytes() == cut[0].tobytes()
    assert whole[1].tobytes() == cut[1].tobytes()


def test_the_beginning_does_not_depend_on_the_length() -> None:
    short, long = simulated(street(n_lines=50)), simulated(street(n_lines=130))
    assert short[0].tobytes() == long[0][:50].tobytes()


def test_seed_decides() -> None:
    assert simulated(street(seed=4))[0].tobytes() == simulated(street(seed=4))[0].tobytes()
    assert simulated(street(seed=4))[0].tobytes() != simulated(street(seed=5))[0].tobytes()


@pytest.mark.parametrize(
    "params",
    [{}, {"slant_deg": 0.0}, {"slant_deg": -60.0}, {"slant_deg": 60.0}, {"speed_m_s": 0.0}, {"points_per_line": 16}],
)
def test_what_every_street_keeps(params: dict[str, float]) -> None:
    scan = street(**params)
    range_m, labels = simulated(scan)
    assert range_m.dtype == np.float32
    assert labels.dtype == np.uint8
    assert range_m.shape == labels.shape == (130, scan.params.points_per_line)
    assert np.array_equal(np.isnan(range_m), labels == Label.MISSING)
    seen = range_m[~np.isnan(range_m)]
    assert seen.min() > 0
    assert seen.max() <= scan.params.max_range_m
    known = {Label.MISSING, Label.UNCLASSIFIED, Label.NOISE, Label.GROUND, Label.BUILDING, Label.VEGETATION, Label.CAR}
    assert set(np.unique(labels)) <= known


def test_blocks_are_a_stream() -> None:
    scan = street()
    stream: ScanStream = scan
    blocks = list(stream.blocks())
    assert [block.first_line for block in blocks] == [0, 64, 128]
    assert stream.info.n_records == 130 * 360
    assert stream.info.points_per_line == blocks[0].points_per_line == 360
    assert np.array_equal(np.concatenate([block.range_m for block in blocks]), simulated(scan)[0], equal_nan=True)
    times = np.concatenate([block.time_s for block in blocks if block.time_s is not None]).ravel()
    assert np.allclose(np.diff(times), 1 / (48.0 * 360))


def test_range_straight_down_is_the_height_over_the_cosine_of_the_slant() -> None:
    scan = street(points_per_line=2154, n_lines=3, **CLEAN)
    range_m, labels = simulated(scan)
    down = int(np.argmin(np.abs(scan.angle_rad)))
    road = -0.1 * abs(LANE_M) / 5.2
    assert (labels[:, down] == Label.GROUND).all()
    assert range_m[:, down] == pytest.approx((2.2 - road) / np.cos(np.deg2rad(25.0)), abs=1e-4)


def test_labels_stand_where_such_things_stand() -> None:
    scan = street(n_lines=400, points_per_line=900, speed_m_s=8.33, **CLEAN)
    range_m, labels = simulated(scan)
    y, z = across(scan, range_m)
    ground = labels == Label.GROUND
    profile = np.interp(np.abs(y[ground]), [0.0, 5.2, 5.22, 8.5, 200.0], [0.0, -0.1, 0.02, 0.18, 0.18])
    assert np.abs(z[ground] - profile).max() < 1e-3
    building = labels == Label.BUILDING
    assert np.abs(y[building]).min() > 8.79
    assert z[building].min() > 0.0
    assert z[building].max() < 21.0
    car = labels == Label.CAR
    assert np.abs(y[car]).min() > 2.9
    assert np.abs(y[car]).max() < 5.2
    assert z[car].max() < 2.1
    post = labels == Label.UNCLASSIFIED
    assert np.abs(np.abs(y[post]) - 5.7).max() < 0.35


def test_facades_stand_on_the_lots_that_are_built() -> None:
    scan = street(n_lines=600, points_per_line=900, speed_m_s=8.33, **CLEAN)
    range_m, labels = simulated(scan)
    y, z = across(scan, range_m)
    # the slanted plane meets what is above the scanner ahead of it
    shot = np.arange(labels.size).reshape(labels.shape)
    x = shot * 8.33 / (48.0 * 900) + (z - 2.2) * np.tan(np.deg2rad(25.0))
    facade = (labels == Label.BUILDING) & (np.abs(y) < 9.7)
    assert (z[facade] > 6.0).sum() > 1000
    for side in (1, -1):
        lots = lots_between(1, side, -10.0, 150.0)
        at = facade & (y * side > 0)
        lot = np.searchsorted(lots.edge, x[at], side="right") - 1
        beside = np.minimum(x[at] - lots.edge[lot], lots.edge[lot + 1] - x[at])
        assert (lots.built[lot] | (beside < 0.8)).all()


def test_every_class_is_there_in_earnest() -> None:
    scan = street(n_lines=600, points_per_line=720, speed_m_s=8.33)
    _, labels = simulated(scan)
    share = np.bincount(labels.ravel(), minlength=len(Label)) / labels.size
    assert 0.15 < share[Label.MISSING] < 0.45
    assert share[Label.GROUND] > 0.2
    assert share[Label.BUILDING] > 0.05
    assert share[Label.VEGETATION] > 0.04
    assert share[Label.CAR] > 0.01
    assert 0.02 < share[Label.NOISE] < 0.1
    assert share[Label.UNCLASSIFIED] > 0.0005


def test_range_noise_has_the_asked_size_and_grows_with_range() -> None:
    asked = {"noise_m": 0.004, "noise_per_m": 0.001}
    exact, labels = simulated(street(points_per_line=900, **CLEAN))
    noisy, _ = simulated(street(points_per_line=900, **{**CLEAN, **asked}))
    surface = (labels == Label.GROUND) | (labels == Label.BUILDING)
    for low, high in ((2.0, 3.0), (9.0, 12.0)):
        at = surface & (exact > low) & (exact < high)
        expected = 0.004 + 0.001 * float(exact[at].mean())
        assert np.std((noisy - exact)[at]) == pytest.approx(expected, rel=0.05)


def test_background_shots_come_from_anywhere_in_the_asked_share() -> None:
    clean, labels = simulated(street(points_per_line=900, **CLEAN))
    noisy, noisy_labels = simulated(street(points_per_line=900, **{**CLEAN, "background_share": 0.1}))
    road = (labels == Label.GROUND) & (clean < 6.0)
    strays = noisy_labels[road] == Label.NOISE
    assert strays.mean() == pytest.approx(0.1, abs=0.01)
    assert np.median(noisy[road][strays]) == pytest.approx(60.0, abs=5.0)
    assert np.array_equal(noisy[road][~strays], clean[road][~strays])
    # parts of the sky shine more than the road does
    sky = np.isnan(clean)
    assert (noisy_labels[sky] == Label.NOISE).mean() > 0.11


def test_mixed_pixels_lie_between_the_two_sides_of_an_edge() -> None:
    clean, _ = simulated(street(points_per_line=900, **CLEAN))
    mixed, labels = simulated(street(points_per_line=900, **{**CLEAN, "mixed_share": 1.0}))
    line, column = np.nonzero(labels == Label.NOISE)
    assert line.size > 100
    near, far = clean[line, column], clean[line, column + 1]
    known = ~np.isnan(near) & ~np.isnan(far)
    assert known.mean() > 0.8
    low, high = np.minimum(near, far)[known], np.maximum(near, far)[known]
    assert ((mixed[line, column][known] >= low - 1e-4) & (mixed[line, column][known] <= high + 1e-4)).all()


def test_memory_does_not_grow_with_length() -> None:
    def peak(n_lines: int) -> int:
        tracemalloc.start()
        for _ in street(n_lines=n_lines).labelled_blocks(lines=16):
            pass
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(32)
    assert peak(640) < 1.3 * peak(64)


def test_a_block_needs_a_line() -> None:
    with pytest.raises(ConfigError, match="lines: found 0, expected at least 1"):
        next(street().labelled_blocks(lines=0))


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"n_lines": 0}, "n_lines: found 0, expected"),
        ({"slant_deg": 80.0}, "slant_deg: found 80.0, expected"),
        ({"sed": 3}, "unknown key 'sed'; did you mean 'seed'"),
        ({"noise_m": float("nan")}, "noise_m"),
    ],
)
def test_parameters_out_of_bounds(table: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(StreetParams, table, "street.toml")
    assert expected in str(caught.value)
