from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.types import F64, I64
from prc_cli.streams.directions import fit_beams
from prc_cli.streams.down import (
    LevelLinesError,
    NoDirectionError,
    fit_heights,
    wrap,
)
from tests.streams.beam_lines import (
    GEOMETRIES,
    gone,
    is_strictly_monotone,
    lines,
    worst_deg,
)


@pytest.mark.parametrize("name", GEOMETRIES)
@pytest.mark.parametrize("tilt_deg", [0.0, 4.0, -30.0])
def test_beams_of_every_geometry_are_found(name: str, tilt_deg: float) -> None:
    true = GEOMETRIES[name]
    block = lines(true, seed=len(name), tilt_deg=tilt_deg)
    assert block.xyz_m is not None
    found = fit_beams(block.xyz_m)
    assert worst_deg(found.beam_rad, true) < 0.25
    assert is_strictly_monotone(found.beam_rad)
    assert np.all((found.beam_rad > -np.pi) & (found.beam_rad <= np.pi))
    assert found.is_straight is (name != "rings")
    # angles grow with the column, whichever way the scanner turns
    assert np.unwrap(found.beam_rad)[-1] > np.unwrap(found.beam_rad)[0]


ROLLED = ["half circle", "low to high", "high to low", "through the zenith", "through the zenith, backwards"]


@pytest.mark.parametrize("name", ROLLED)
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_column_0_may_lie_anywhere(name: str, share: float) -> None:
    true = GEOMETRIES[name]
    first = round(share * len(true))
    block = lines(true, seed=len(name))
    assert block.xyz_m is not None
    found = fit_beams(np.roll(block.xyz_m, first, axis=1))
    assert worst_deg(found.beam_rad, np.roll(true, first)) < 0.25
    assert found.is_straight
    assert is_strictly_monotone(found.beam_rad)
    # columns beside the dead angle that are never seen continue the nearer side
    hidden = np.roll(np.arange(len(true)) % 7 == 3, 2)
    hidden[:3] = hidden[-3:] = True
    block = gone(lines(true, seed=5), hidden)
    assert block.xyz_m is not None
    assert worst_deg(fit_beams(np.roll(block.xyz_m, first, axis=1)).beam_rad, np.roll(true, first)) < 2.5


def test_shots_anywhere_and_a_line_or_two_of_nonsense_do_no_harm() -> None:
    true = GEOMETRIES["whole circle"]
    rng = np.random.default_rng(4)
    xyz = lines(true, 64).xyz_m
    assert xyz is not None
    stray = rng.random(xyz.shape[:2]) < 0.05
    xyz[stray] = rng.uniform(-20, 20, (int(stray.sum()), 3))
    xyz[[10, 40]] = rng.uniform(-20, 20, (2, len(true), 3))
    assert worst_deg(fit_beams(xyz).beam_rad, true) < 0.5


def horizontal(tilt_deg: float) -> F64:
    angle, tilt = np.deg2rad(np.arange(360.0)), np.deg2rad(tilt_deg)
    ring = np.stack([np.cos(angle) * np.cos(tilt), np.sin(angle), np.cos(angle) * np.sin(tilt)], axis=-1)
    return np.repeat(8.0 * ring[None], 20, axis=0)


@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 9.5])
def test_horizontal_lines_are_refused(tilt_deg: float) -> None:
    with pytest.raises(NoDirectionError, match=r"the lines do not rise: their planes are .* deg from horizontal"):
        fit_beams(horizontal(tilt_deg))


@pytest.mark.parametrize(
    ("xyz", "message"),
    [
        (np.full((3, 5, 3), np.nan), "no shot has a return"),
        (np.zeros((3, 5, 3)), "no shot has a return"),
        (np.where(np.arange(5)[None, :, None] == 2, 1.0, np.full((3, 5, 3), np.nan)), "no line has two returns"),
        (np.ones((3, 5, 3)), "spans less than"),
        (np.random.default_rng(0).normal(size=(20, 50, 3)), "off a plane through the origin"),
        (np.random.default_rng(0).uniform(50, 90, (20, 50, 3)) * [1, 1, 0.1], "look different ways|do not turn|rise"),
    ],
)
def test_coordinates_that_do_not_tell(xyz: F64, message: str) -> None:
    with pytest.raises(NoDirectionError, match=message):
        fit_beams(xyz)


def room(n_lines: int = 120) -> F64:
    """Vertical lines of a scanner in the middle of a round room, 2 m above its floor."""
    elevation, azimuth = np.deg2rad(np.linspace(-60, 60, 200)), np.deg2rad(np.arange(n_lines, dtype=float))[:, None]
    length = np.minimum(2 / np.sin(np.maximum(-elevation, 1e-3)), 15 / np.cos(elevation)) + 0 * azimuth
    flat = length * np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), length * np.sin(elevation)], axis=-1)


@pytest.mark.parametrize(
    ("offset_m", "message"),
    [
        ((1.5, 0.5, 0.1), "not relative to the scanner: the shots of a line lie .* deg off a plane"),
        ((5.0, 5.0, 5.0), "not relative to the scanner: the shots of a line lie .* deg off a plane"),
        ((0.0, 30.0, 0.0), "not relative to the scanner|not vertical lines"),
        ((1000.0, 1000.0, 100.0), "not relative to the scanner|not vertical lines"),
        ((5e5, 4e6, 100.0), "not relative to the scanner: its ranges are 4031 km in the middle"),
    ],
)
def test_another_origin_than_the_scanner_is_refused(offset_m: tuple[float, ...], message: str) -> None:
    assert fit_beams(room()).is_straight
    with pytest.raises(NoDirectionError, match=message):
        fit_beams(room() + np.array(offset_m))


@pytest.mark.parametrize("n_lines", [20, 90, 180])
def test_rows_and_columns_exchanged_are_refused(n_lines: int) -> None:
    with pytest.raises(LevelLinesError, match="the lines do not rise: most run sideways"):
        fit_beams(room(n_lines).transpose(1, 0, 2))


def shots(seed: int, nadir_deg: float, *, n_lines: int = 20, tilt_deg: float = 3.0) -> tuple[F64, F64, F64, I64]:
    """Return angle, range, height and line of a profiler that drives over hills."""
    rng = np.random.default_rng(seed)
    line = np.repeat(np.arange(n_lines), 180)
    angle = np.tile(np.deg2rad(np.linspace(-60.0, 119.0, 180)), n_lines) + np.deg2rad(nadir_deg)
    range_m = rng.uniform(2, 50, len(line))
    hill = 300 + np.cumsum(rng.normal(0, 0.4, n_lines))
    cos_tilt = np.cos(np.deg2rad(tilt_deg))
    z = hill[line] - range_m * np.cos(angle - np.deg2rad(nadir_deg)) * cos_tilt
    return angle, range_m + rng.normal(0, 0.005, len(line)), np.round(z, 2), line


@pytest.mark.parametrize("nadir_deg", [0.0, 90.0, -135.0, 180.0, 400.0])
def test_down_is_found_in_registered_heights(nadir_deg: float) -> None:
    angle, range_m, z, line = shots(3, nadir_deg)
    fit = fit_heights(angle, range_m, z, line)
    assert abs(np.rad2deg(wrap(np.array([fit.down_rad - np.deg2rad(nadir_deg)]))[0])) < 0.02
    assert fit.off_m < 0.02
    # a tenth of the shots wrong, some not finite
    rng = np.random.default_rng(2)
    z[rng.random(len(z)) < 0.1] += 7.0
    range_m[::31], z[::37], angle[::41] = np.nan, np.nan, np.nan
    fit = fit_heights(angle, range_m, z, line)
    assert abs(np.rad2deg(wrap(np.array([fit.down_rad - np.deg2rad(nadir_deg)]))[0])) < 0.05


@pytest.mark.parametrize("lean_deg", [0.0, 20.0, 45.0, 70.0])
def test_the_lean_of_the_scan_plane_is_found(lean_deg: float) -> None:
    rng = np.random.default_rng(3)
    angle, line = np.tile(np.linspace(-1.2, 1.2, 200), 10), np.repeat(np.arange(10), 200)
    ranges = rng.uniform(2, 30, 2000)
    cos_tilt = np.cos(np.deg2rad(lean_deg))
    fit = fit_heights(angle, ranges, 100 - ranges * np.cos(angle) * cos_tilt + rng.normal(0, 0.01, 2000), line)
    assert fit.cos_tilt == pytest.approx(cos_tilt, abs=0.001)
    assert fit.cos_tilt <= 1


def test_heights_that_do_not_belong_to_the_angles_are_refused() -> None:
    angle, range_m, z, line = shots(3, 0.0)
    rng = np.random.default_rng(0)
    with pytest.raises(NoDirectionError, match="off what range and scan angle say"):
        fit_heights(angle, range_m, rng.permutation(z), line)
    with pytest.raises(NoDirectionError, match="m a metre of range"):
        fit_heights(angle, range_m, 3 * z, line)
    with pytest.raises(NoDirectionError, match="m a metre of range"):
        fit_heights(angle, range_m, np.full(len(z), 7.0), line)
    with pytest.raises(NoDirectionError, match="too few shots"):
        fit_heights(angle[:30], range_m[:30], z[:30], line[:30])
    with pytest.raises(NoDirectionError, match="too few shots"):
        fit_heights(angle, np.full(len(z), np.nan), z, line)
    with pytest.raises(NoDirectionError, match="span too little"):
        fit_heights(np.full(len(z), 0.2), range_m, 300 - range_m * np.cos(0.2), line)


def falling(fall: float = 1.0, *, off_m: float = 0.0, n: int = 400, span: float = 2.4) -> tuple[F64, F64, F64, I64]:
    """Return two lines whose heights fall by ``fall`` a metre of range straight down, half of them off by ``off_m``."""
    angle = np.tile(np.linspace(-span / 2, span / 2, n // 2), 2)
    range_m = np.random.default_rng(6).uniform(2, 30, n)
    off = np.where(np.arange(n) % 2, off_m, -off_m)
    return angle, range_m, 90 - fall * range_m * np.cos(angle) + off, np.repeat([4, 7], n // 2)


@pytest.mark.parametrize(("fall", "is_taken"), [(0.170, False), (0.177, True), (1.04, True), (1.06, False)])
def test_heights_fall_by_the_cosine_of_a_tilt(fall: float, is_taken: bool) -> None:
    """A plane within ten degrees of the horizontal has a cosine below 0.1736; rounding leaves a little more than 1."""
    if is_taken:
        assert fit_heights(*falling(fall)).cos_tilt == pytest.approx(min(fall, 1.0))
    else:
        with pytest.raises(NoDirectionError, match=f"the heights fall {fall:.2f} m a metre of range"):
            fit_heights(*falling(fall))


@pytest.mark.filterwarnings("error")
def test_any_heights_are_fitted_or_refused() -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        n = int(rng.integers(0, 300))
        scale = 10.0 ** float(rng.integers(-30, 30))
        angle = rng.uniform(-4, 4, n) * rng.choice([0.0, 1e-9, 1.0])
        range_m, z = rng.uniform(-1, 9, n) * scale, rng.normal(size=n) * 10.0 ** float(rng.integers(-30, 30))
        for values in (angle, range_m, z):
            values[rng.random(n) < 0.1] = rng.choice([np.nan, np.inf, 0.0])
        try:
            fit = fit_heights(angle, range_m, z, rng.integers(0, 9, n))
        except NoDirectionError:
            continue
        assert -np.pi <= fit.down_rad <= np.pi
