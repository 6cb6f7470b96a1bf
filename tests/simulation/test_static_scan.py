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
from prc_cli.simulation.furniture import Body
from prc_cli.simulation.rays import Bounds, Hits, Rays
from prc_cli.simulation.static_bodies import Foliage, House, Painted, Slab
from prc_cli.simulation.static_cars import car
from prc_cli.simulation.static_scan import StaticScan, StaticScanParams, simulate_static_scan
from prc_cli.simulation.static_street import BUILDING_LINE_M, ROAD_HALF_M, Ground, lay_out

CLEAN = {"noise_m": 0.0, "mixed_share": 0.0}


def scan_of(**params: Any) -> StaticScan:
    return simulate_static_scan(StaticScanParams(**{"azimuth_step_deg": 3.0, "elevation_step_deg": 0.5} | params))


def simulated(scan: StaticScan, lines: int = 32) -> tuple[F32, U8, F32]:
    items = list(scan.labelled_blocks(lines))
    xyz = [item.block.xyz_m for item in items if item.block.xyz_m is not None]
    return (
        np.concatenate([item.block.range_m for item in items]),
        np.concatenate([item.labels for item in items]),
        np.concatenate(xyz),
    )


def fan(azimuth_deg: F64, elevation_deg: F64, z: float = 1.75, y: float = 0.0) -> Rays:
    """Rays of a scanner above the crown of the road; (azimuths, elevations)."""
    azimuth, elevation = np.deg2rad(azimuth_deg)[:, None], np.deg2rad(elevation_deg)[None, :]
    dx, dy = np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation)
    return Rays(np.zeros(dx.shape), y, z, dx, dy, np.broadcast_to(np.sin(elevation), dx.shape))


def cast(body: Body, rays: Rays, chance: float = 0.5) -> tuple[F64, U8]:
    shape = rays.dx.shape
    t, label = body.cast(rays, np.full(shape, chance), np.full(shape, 1e-9))
    return t, np.broadcast_to(np.asarray(label, dtype=np.uint8), shape)


@pytest.mark.parametrize("lines", [1, 7, 119, 1000])
def test_lines_per_block_change_nothing(lines: int) -> None:
    whole, cut = simulated(scan_of()), simulated(scan_of(), lines)
    assert [array.tobytes() for array in whole] == [array.tobytes() for array in cut]


def test_seed_decides() -> None:
    assert simulated(scan_of(seed=4))[0].tobytes() == simulated(scan_of(seed=4))[0].tobytes()
    assert simulated(scan_of(seed=4))[0].tobytes() != simulated(scan_of(seed=5))[0].tobytes()


@pytest.mark.parametrize(
    "params",
    [
        {},
        {"across_m": -7.0},
        {"across_m": 6.4, "seed": 3},
        {"lowest_deg": -89.0, "highest_deg": 89.0},
        {"leaf_m": 0.0, "moving_cars": 0},
        {"length_m": 20.0, "first_azimuth_deg": 350.0, "azimuth_deg": 45.0},
        {"max_range_m": 5.0},
        {"moving_cars": 20, "shots_hz": 2000.0},
    ],
)
def test_what_every_scan_keeps(params: dict[str, float]) -> None:
    scan = scan_of(**params)
    range_m, labels, xyz = simulated(scan)
    assert [str(array.dtype) for array in (range_m, labels, xyz)] == ["float32", "uint8", "float32"]
    assert range_m.shape == labels.shape == xyz.shape[:2] == (scan.params.n_lines, scan.params.points_per_line)
    assert np.array_equal(np.isnan(range_m), labels == Label.MISSING)
    assert np.array_equal(np.isnan(range_m), np.isnan(xyz).any(axis=2))
    seen = ~np.isnan(range_m)
    assert range_m[seen].min() > 0
    assert range_m[seen].max() <= scan.params.max_range_m
    assert np.allclose(np.linalg.norm(xyz[seen], axis=1), range_m[seen], rtol=1e-6)
    known = {Label.MISSING, Label.NOISE, Label.GROUND, Label.HORIZONTAL, Label.CURB}
    assert set(np.unique(labels)) <= known | {Label.VERTICAL, Label.VEGETATION, Label.CAR}


def test_blocks_are_a_stream() -> None:
    scan = scan_of()
    stream: ScanStream = scan
    blocks = list(stream.blocks())
    assert [block.first_line for block in blocks] == [0, 32, 64, 96]
    assert stream.info.n_lines == sum(block.n_lines for block in blocks) == 120
    assert stream.info.points_per_line == blocks[0].points_per_line == 251
    beam = blocks[0].beam_rad
    assert beam is not None
    assert np.allclose(np.rad2deg(beam[[0, -1]]), (45.0, 170.0))
    assert np.all(np.diff(beam) > 0)
    assert stream.info.angle_rad is not None
    assert stream.info.nadir_rad is not None
    assert np.allclose(stream.info.angle_rad - stream.info.nadir_rad, beam)
    xyz = blocks[0].xyz_m
    assert xyz is not None
    down = np.arccos(-xyz[..., 2] / np.linalg.norm(xyz, axis=2))
    assert np.nanmax(np.abs(down - beam)) < 1e-5


def test_ranges_of_the_road_follow_from_height_and_elevation() -> None:
    scan = scan_of(seed=2, across_m=0.0, moving_cars=0)
    range_m, labels, _ = simulated(scan)
    elevation, azimuth = scan.elevation_rad, scan.azimuth_rad
    crossfall = lay_out(scan.params).ground.crossfall
    # from the crown both halves fall away: the height over the road's plane is what the scanner stands high
    down = -np.sin(elevation) - crossfall * np.abs(np.sin(azimuth))[:, None] * np.cos(elevation)
    road = (labels == Label.GROUND) & (range_m < 30)
    residual = (range_m - scan.params.height_m / np.where(down > 0, down, np.nan))[road]
    assert road.sum() > 3000
    assert abs(residual.mean()) < 0.001
    assert residual.std() == pytest.approx(scan.params.noise_m, rel=0.05)


def test_curb_and_sidewalk_heights() -> None:
    scan = scan_of(seed=8, azimuth_step_deg=0.5, elevation_step_deg=0.1, highest_deg=5.0, moving_cars=0, **CLEAN)
    _, labels, xyz = simulated(scan)
    street = lay_out(scan.params)
    y = xyz[..., 1] + scan.params.across_m
    z = xyz[..., 2] + scan.params.height_m + street.ground.z(scan.params.across_m)
    curb = labels == Label.CURB
    assert curb.sum() > 1000
    assert np.allclose(np.abs(y[curb]), ROAD_HALF_M, atol=1e-4)
    assert 0.1 < np.ptp(z[curb]) <= street.ground.curb_m + 1e-4
    assert 0.12 <= street.ground.curb_m <= 0.15
    sidewalk = (labels == Label.HORIZONTAL) & (np.abs(y) < BUILDING_LINE_M - 0.6) & (z < 0.3)
    expected = street.ground.gutter_z + street.ground.curb_m + 0.02 * (np.abs(y[sidewalk]) - ROAD_HALF_M)
    assert np.abs(z[sidewalk] - expected).max() < 0.001


def test_the_far_curb_is_seen_from_the_sidewalk_and_the_near_one_is_not() -> None:
    ground = Ground(0.025, 0.13)
    rays = fan(np.array([90.0, -90.0]), np.linspace(-60, -1, 600), z=ground.z(6.4) + 1.7, y=6.4)
    hits = Hits.none(rays.dx.shape)
    ground.cast(rays, hits)
    assert Label.CURB not in hits.label[0]
    assert np.count_nonzero(hits.label[1] == Label.CURB) > 2
    assert Label.GROUND not in hits.label[0]


def test_cars_stand_on_tyres_over_a_gap() -> None:
    bodies = list(car(np.random.default_rng(3), (0.0, 4.5, -0.1), 1, 2.1))
    rays = fan(np.linspace(60, 120, 121), np.linspace(-30, 5, 351))
    nearest = np.full(rays.dx.shape, np.inf)
    for body in bodies:
        t, _ = cast(body, rays)
        nearest = np.minimum(nearest, t)
    hit = np.isfinite(nearest)
    z = rays.z + np.where(hit, nearest, np.nan) * rays.dz
    x = np.where(hit, nearest, np.nan) * rays.dx
    assert np.nanmin(z) == pytest.approx(-0.1, abs=0.03)
    between_tyres = np.abs(x) < 0.7
    assert 0.15 < np.nanmin(z[between_tyres]) + 0.1 < 0.25
    assert 1.4 < np.nanmax(z) + 0.1 < 1.65
    assert 4.0 < np.nanmax(x) - np.nanmin(x) <= 4.2 + 1e-6
    # under the body a line sees the road before it sees the car, nearer than the car's far side
    column = int(np.argmin(np.abs(np.linspace(60, 120, 121) - 90)))
    lowest = int(np.flatnonzero(hit[column])[0])
    road_before = 1.75 / -rays.dz[column, lowest - 1] + 0.1 / -rays.dz[column, lowest - 1]
    assert road_before > nearest[column, lowest] + 0.2


@pytest.mark.parametrize("half", [1.9, 2.4, 2.5])
@pytest.mark.parametrize("heading", [1, -1])
def test_bodies_stay_within_their_bounds(half: float, heading: int) -> None:
    bodies: list[Body] = list(car(np.random.default_rng(5), (3.0, 4.5, -0.1), heading, half))
    bodies.append(Slab(Bounds((2, 3), (4, 5), (0, 1))))
    bodies.append(Foliage(Bounds((2, 5), (4, 6), (0, 3)), 0.5, 0.05, 1))
    bodies.append(House(Bounds((-5, 9), (9.1, 21), (-2, 12)), 1, 3, 0.1, 2.6, 0.2, False, 3))
    rays = fan(np.linspace(0, 180, 181), np.linspace(-40, 60, 301))
    for body in bodies:
        t, _ = cast(body, rays)
        hit = np.isfinite(t)
        assert hit.any()
        limits = body.bounds
        inside_x, inside_y, inside_z = limits.x, limits.y, limits.z
        if isinstance(body, House):
            inside_y = (inside_y[0], inside_y[1] + 5.0)
        for origin, step, (low, high) in (
            (rays.x, rays.dx, inside_x),
            (np.full(t.shape, rays.y), rays.dy, inside_y),
            (np.full(t.shape, rays.z), rays.dz, inside_z),
        ):
            place = (origin + np.where(hit, t, 0.0) * step)[hit]
            assert low - 1e-6 <= place.min()
            assert place.max() <= high + 1e-6


def test_glass_swallows_or_lets_through() -> None:
    body = next(b for b in car(np.random.default_rng(3), (0.0, 4.5, -0.1), 1, 2.1) if b.bounds.z[1] > 1.2)
    assert isinstance(body, Painted)
    rays = fan(np.linspace(80, 100, 21), np.linspace(-15, 0, 151))
    swallowed, behind = cast(body, rays, 0.2)[1], cast(body, rays, 0.95)
    assert np.count_nonzero(swallowed == Label.MISSING) > 200
    assert np.count_nonzero(behind[1] == Label.CAR) > 200
    assert np.nanmax(behind[0][np.isfinite(behind[0])] - cast(body, rays, 0.75)[0][np.isfinite(behind[0])]) > 0.3


def test_windows_are_recessed() -> None:
    house = House(Bounds((-8.0, 8.0), (9.0, 21.0), (-2.0, 10.0)), 1, 3, 0.0, 2.6, 0.2, False, 3)
    rays = fan(np.linspace(60, 120, 241), np.linspace(0, 40, 401))
    t, label = cast(house, rays)
    hit = np.isfinite(t)
    y = np.where(hit, t, np.nan) * rays.dy
    deep = y > 9.0 + 1e-6
    assert 0.03 < np.mean(deep[hit]) < 0.4
    assert np.nanmin(y) == pytest.approx(9.0)
    assert Label.HORIZONTAL in label[deep]  # lintels, seen from below
    assert Label.MISSING in label[deep]
    assert np.all(label[hit & ~deep] == Label.VERTICAL)


def test_leaves_thin_out_as_beer_says() -> None:
    box = Bounds((-50.0, 50.0), (5.0, 6.0), (-50.0, 50.0))
    rays = fan(np.linspace(85, 95, 200), np.linspace(-5, 5, 200))
    shape = rays.dx.shape
    depth = np.random.default_rng(1).standard_exponential(shape)
    for leaf_m in (0.0, 0.01):
        t, label = Foliage(box, 1.0, leaf_m, 1, box=True).cast(rays, np.zeros(shape), depth)
        assert label == Label.VEGETATION
        # clumps are 0.3 to 2.4 mean paths thick: between exp(-1 / 0.3) and exp(-1 / 2.4) get through a metre
        assert 0.1 < np.mean(np.isinf(t)) < 0.6
        assert np.min(t * np.abs(rays.dy)) >= 5.0 - 1e-6


def test_neighbouring_shots_share_a_leaf_only_close_by() -> None:
    def same(distance: float, leaf_m: float) -> float:
        box = Bounds((-50.0, 50.0), (distance, distance + 3.0), (-50.0, 50.0))
        rays = fan(np.array([90.0, 90.5]), np.arange(-5, 5, 0.1))
        depth = np.random.default_rng(1).standard_exponential(rays.dx.shape)
        t, _ = Foliage(box, 0.5, leaf_m, 1, box=True).cast(rays, depth, depth)
        step = np.abs(np.diff(t, axis=1))
        return float(np.mean(step[np.isfinite(step)] < 0.06))

    assert same(5.0, 0.05) > 0.6
    assert same(60.0, 0.05) < 0.2
    assert same(5.0, 0.0) < 0.2


def test_shares_of_the_street() -> None:
    range_m, labels, xyz = simulated(scan_of(seed=2, azimuth_step_deg=1.0))
    missing = np.isnan(range_m)
    assert 0.25 < missing.mean() < 0.55
    assert missing[:, -40:].mean() > 0.8  # sky
    share = np.bincount(labels[~missing], minlength=len(Label)) / np.count_nonzero(~missing)
    for label, low, high in (
        (Label.GROUND, 0.2, 0.5),
        (Label.VERTICAL, 0.2, 0.6),
        (Label.VEGETATION, 0.03, 0.4),
        (Label.CAR, 0.04, 0.25),
        (Label.HORIZONTAL, 0.01, 0.2),
        (Label.NOISE, 0.0, 0.01),
    ):
        assert low < share[label] < high, label.name
    car_tops = xyz[..., 2][labels == Label.CAR]
    assert car_tops.max() < 0.8


def test_nothing_stands_at_the_scanner() -> None:
    for seed in range(6):
        for across in (-6.5, 0.0, 4.0):
            range_m = simulated(scan_of(seed=seed, across_m=across, azimuth_step_deg=6.0, elevation_step_deg=1.0))[0]
            assert np.nanmin(range_m) > 0.7


@pytest.mark.parametrize(
    ("params", "where"),
    [
        ({"lowest_deg": 10.0, "highest_deg": 5.0}, "scan"),
        ({"elevation_step_deg": 0.0}, "elevation_step_deg"),
        ({"length": 3}, "length"),
    ],
)
def test_nonsense_is_refused(params: dict[str, float], where: str) -> None:
    with pytest.raises(ConfigError, match=where):
        build(StaticScanParams, params, "scan")


def test_blocks_of_no_lines_are_refused() -> None:
    with pytest.raises(ConfigError, match="lines"):
        next(scan_of().labelled_blocks(0))


def test_memory_does_not_grow_with_the_scan() -> None:
    def peak(azimuth_deg: float) -> int:
        scan = scan_of(azimuth_step_deg=0.5, azimuth_deg=azimuth_deg, elevation_step_deg=0.25)
        tracemalloc.start()
        for _ in scan.labelled_blocks():
            pass
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    peak(8.0)
    assert peak(360.0) < 2.0 * peak(90.0)
