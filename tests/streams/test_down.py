"""Where down is: from coordinates, heights and the ground."""

import numpy as np
import pytest

from prc_cli.core.types import F64, I64
from prc_cli.streams.directions import fit_beams
from prc_cli.streams.down import NoDirectionError, fit_heights
from tests.clouds import seen
from tests.streams.beam_lines import GEOMETRIES, is_strictly_monotone, lines, worst_deg


@pytest.mark.slow
@pytest.mark.parametrize("name", GEOMETRIES)
@pytest.mark.parametrize("tilt_deg", [0.0, 4.0, -30.0])
def test_beams_of_every_geometry_are_found(name, tilt_deg):
    true = GEOMETRIES[name]
    block = lines(true, seed=len(name), tilt_deg=tilt_deg)
    assert block.xyz_m is not None
    beams = fit_beams(block.xyz_m)
    assert worst_deg(beams.beam_rad, true) < 0.25
    assert is_strictly_monotone(beams.beam_rad)
    assert np.all((beams.beam_rad > -np.pi) & (beams.beam_rad <= np.pi))
    assert beams.is_straight is (name != "rings")
    # angles grow with the column, whichever way the scanner turns
    assert np.unwrap(beams.beam_rad)[-1] > np.unwrap(beams.beam_rad)[0]


@pytest.mark.parametrize(
    "xyz, message",
    [
        (np.full((3, 5, 3), np.nan), "no shot has a return"),
        (np.zeros((3, 5, 3)), "no shot has a return"),
        (
            np.where(np.arange(5)[None, :, None] == 2, 1.0, np.full((3, 5, 3), np.nan)),
            "no line has two returns",
        ),
        (np.ones((3, 5, 3)), "spans less than"),
        (np.random.default_rng(0).normal(size=(20, 50, 3)), "off a plane through the origin"),
        (
            np.random.default_rng(0).uniform(50, 90, (20, 50, 3)) * [1, 1, 0.1],
            "look different ways|do not turn|rise",
        ),
    ],
)
def test_coordinates_that_do_not_tell(xyz, message):
    with pytest.raises(NoDirectionError, match=message):
        fit_beams(xyz)


def room(n_lines: int = 120) -> F64:
    """Vertical lines of a scanner in the middle of a round room, 2 m above its floor."""
    elevation = np.deg2rad(np.linspace(-60, 60, 200))
    azimuth = np.deg2rad(np.arange(n_lines, dtype=float))[:, None]
    length = np.minimum(2 / np.sin(np.maximum(-elevation, 1e-3)), 15 / np.cos(elevation))
    return seen(length, azimuth, elevation)


@pytest.mark.parametrize(
    "offset_m, message",
    [
        (
            (1.5, 0.5, 0.1),
            "not relative to the scanner: the shots of a line lie .* deg off a plane",
        ),
        (
            (5.0, 5.0, 5.0),
            "not relative to the scanner: the shots of a line lie .* deg off a plane",
        ),
        ((0.0, 30.0, 0.0), "not relative to the scanner|not vertical lines"),
        ((1000.0, 1000.0, 100.0), "not relative to the scanner|not vertical lines"),
        ((5e5, 4e6, 100.0), "not relative to the scanner: its ranges are 4031 km in the middle"),
    ],
)
def test_another_origin_than_the_scanner_is_refused(offset_m, message):
    assert fit_beams(room()).is_straight
    with pytest.raises(NoDirectionError, match=message):
        fit_beams(room() + np.array(offset_m))


def shots(
    seed: int,
    nadir_deg: float,
    *,
    n_lines: int = 20,
    tilt_deg: float = 3.0,
) -> tuple[F64, F64, F64, I64]:
    """Return angle, range, height and line of a profiler that drives over hills."""
    rng = np.random.default_rng(seed)
    line = np.repeat(np.arange(n_lines), 180)
    angle = np.tile(np.deg2rad(np.linspace(-60.0, 119.0, 180)), n_lines) + np.deg2rad(nadir_deg)
    range_m = rng.uniform(2, 50, len(line))
    hill = 300 + np.cumsum(rng.normal(0, 0.4, n_lines))
    cos_tilt = np.cos(np.deg2rad(tilt_deg))
    z = hill[line] - range_m * np.cos(angle - np.deg2rad(nadir_deg)) * cos_tilt
    return angle, range_m + rng.normal(0, 0.005, len(line)), np.round(z, 2), line


def test_heights_that_do_not_belong_to_the_angles_are_refused():
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


@pytest.mark.filterwarnings("error")
def test_any_heights_are_fitted_or_refused():
    rng = np.random.default_rng(5)
    for _ in range(300):
        n = int(rng.integers(0, 300))
        scale = 10.0 ** float(rng.integers(-30, 30))
        angle = rng.uniform(-4, 4, n) * rng.choice([0.0, 1e-9, 1.0])
        range_m = rng.uniform(-1, 9, n) * scale
        z = rng.normal(size=n) * 10.0 ** float(rng.integers(-30, 30))
        for values in (angle, range_m, z):
            values[rng.random(n) < 0.1] = rng.choice([np.nan, np.inf, 0.0])
        try:
            fit = fit_heights(angle, range_m, z, rng.integers(0, 9, n))
        except NoDirectionError:
            continue
        assert -np.pi <= fit.down_rad <= np.pi
