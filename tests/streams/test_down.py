"""Where down is: from coordinates, heights and the ground."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.classify import classify, classify_ranges
from prc_cli.streams.beams import with_beams
from prc_cli.streams.directions import fit_beams
from prc_cli.streams.down import DownGuess, NoDirectionError, fit_heights, guess_down, wrap
from tests.methods.fused.street_lines import BEAM, street_lines
from tests.streams.beam_lines import GEOMETRIES, is_strictly_monotone, lines, worst_deg


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


def off_deg(found: float, true: float = 0.0) -> float:
    """Return how far a direction is off [deg]."""
    return abs(math.degrees(math.remainder(found - true, 2 * math.pi)))


@pytest.mark.parametrize("turned_deg", [0.0, 75.0, 180.0, -120.0])
@pytest.mark.parametrize("way", [1, -1])
def test_a_street_tells_where_down_is(turned_deg: float, way: int) -> None:
    ranges, _ = street_lines(20)
    found = guess_down(way * BEAM + np.deg2rad(turned_deg), ranges)
    assert found is not None
    assert found.is_sure
    assert off_deg(found.down_rad, math.radians(turned_deg)) < 1.5


@dataclass(frozen=True)
class Lines:
    """A stream of one block."""

    info: StreamInfo
    block: ScanBlock

    def blocks(self) -> Iterator[ScanBlock]:
        yield replace(self.block)


def street() -> Lines:
    ranges, _ = street_lines(20)
    angle = BEAM + 1.0
    info = StreamInfo("street.npz", "array", len(BEAM), None, 20, angle_rad=angle)
    return Lines(info, ScanBlock(0, ranges, angle_rad=angle, is_last=True))


def test_beams_come_from_the_ground_where_nothing_else_tells() -> None:
    directed = with_beams(street(), InputConfig())
    beams = next(iter(directed.blocks())).beam_rad
    assert beams is not None
    assert np.abs(beams - BEAM).max() < np.deg2rad(1.5)
    said = [one for one in directed.info.assumptions if one.key == "input.nadir"]
    assert "level ground" in said[0].why
    assert "guessed from level ground" in said[0].value
    (note,) = directed.info.facts.notes
    assert note.startswith("straight down is taken to be at scan angle 5")


def test_a_guess_is_in_the_record_of_the_run(tmp_path: Path) -> None:
    np.savez(tmp_path / "street.npz", range_m=street_lines(40)[0], angle_deg=np.rad2deg(BEAM) + 20.0)
    loaded = load_config(preset="fused")
    guessed = classify(tmp_path / "street.npz", tmp_path / "labels.npy", loaded)
    (note,) = [one for one in guessed.record.notices if "straight down" in one]
    assert "20." in note or "19." in note
    told = load_config(preset="fused", options={"input": {"nadir": 20.0}})
    exact = classify(tmp_path / "street.npz", tmp_path / "exact.npy", told)
    assert not any("straight down" in one for one in exact.record.notices)


@pytest.mark.parametrize("first", [3, 150, 400])
def test_labels_do_not_depend_on_where_column_0_lies(first: int) -> None:
    """But for shots whose neighbours are at the other end of the line then."""
    side = np.rad2deg(BEAM) > 10
    ranges, beam = street_lines(40)[0][:, side], BEAM[side]
    loaded = load_config(preset="fused")
    labels = classify_ranges(ranges, loaded, beam_rad=beam).labels
    rolled = classify_ranges(np.roll(ranges, first, axis=1), loaded, beam_rad=np.roll(beam, first)).labels
    differ = np.roll(rolled, -first, axis=1) != labels
    assert differ.mean() < 0.01
    far = np.abs(np.arange(len(beam)) - (len(beam) - first)) > 60
    assert not differ[:, far].any()


TURN = 2 * math.pi


def slow_guess(angle_rad: F64, range_m: F32, few: int = 1) -> DownGuess | None:
    """Return what :func:`guess_down` finds, without arrays of all directions."""
    n, m = range_m.shape
    if n < 4:
        return None
    every = -(-m // (360 // few))
    angle = angle_rad[every // 2 :: every].tolist()
    rows = list(range(n)) if n <= 64 else [i * (n - 1) // 63 for i in range(64)]
    lines = range_m[rows][:, every // 2 :: every].astype(np.float64)
    held = [sorted(one for one in column if not math.isnan(one)) for column in lines.T.tolist()]
    middle = [one[len(one) // 2] if 2 * len(one) > len(lines) else math.nan for one in held]
    missing = [1 - len(one) / len(lines) if one else 0.5 for one in held]
    if sum(not math.isnan(one) for one in middle) < 3:
        return None
    step = float(np.median([abs(math.remainder(b - a, TURN)) for a, b in pairwise(angle)]))
    downs = [-math.pi + k * few * math.radians(0.5) for k in range(720 // few)]
    scores, planes = [], []
    for down in downs:
        near = [
            k for k, one in enumerate(angle)
            if math.cos(one - down) > math.cos(math.radians(65)) and not math.isnan(middle[k])
        ]  # fmt: skip
        depth = {k: middle[k] * math.cos(angle[k] - down) for k in near}
        bins = [int(one / 0.1) for one in depth.values()]
        counts = [bins.count(k) for k in range(400)]
        distance = 0.1 * (counts.index(max(counts)) + 0.5)
        inside = [k for k in near if abs(depth[k] - distance) < 0.1]
        above = [k for k, one in enumerate(angle) if math.cos(one - down) < -0.5]
        covered = min(len(above) * step / math.radians(120), 1.0)
        sky = covered * (sum(missing[k] for k in above) / max(len(above), 1)) + (1 - covered) * 0.5
        fill = len(inside) * step
        scores.append(fill / math.sqrt(distance) * (0.1 + sky) if fill >= math.radians(12) else 0.0)
        planes.append((distance, inside, fill))
    found, left = [], list(scores)
    for _ in range(8):
        at = left.index(max(left))
        if left[at] <= 0:
            break
        left = [
            0.0 if abs(math.remainder(one - downs[at], TURN)) < math.radians(10) else old
            for one, old in zip(downs, left, strict=True)
        ]
        distance, inside, fill = planes[at]
        good = [
            sum(abs(line[k] * math.cos(angle[k] - downs[at]) - distance) < 0.15 for k in inside) >= len(inside) / 2
            for line in lines.tolist()
        ]
        waves = np.array([[math.cos(angle[k]), math.sin(angle[k])] for k in inside])
        a, b = np.linalg.lstsq(waves, np.array([1 / middle[k] for k in inside]), rcond=None)[0]
        score = scores[at] * sum(good) / len(good)
        if score > 0:
            found.append((score, math.atan2(b, a), 1 / math.hypot(a, b), fill))
    found.sort(reverse=True)
    best = next((plane for plane in found if plane[3] >= math.radians(25)), None)
    if best is None:
        return None
    rival = next((one for one in found if abs(math.remainder(one[1] - best[1], TURN)) > math.radians(40)), None)
    return DownGuess(best[1], best[2]) if rival is None else DownGuess(best[1], best[2], rival[1], best[0] / rival[0])


def scene(seed: int, n_lines: int = 12, m: int = 180) -> tuple[F64, F32]:
    """Ground, a wall on either side, far things and gaps, seen over a part of a turn."""
    rng = np.random.default_rng(seed)
    beam = np.linspace(*np.deg2rad(rng.uniform([-170, 60], [-60, 170])), m)
    ground = rng.uniform(1.0, 3.0) / np.maximum(np.cos(beam), 1e-3)
    walls = rng.uniform(2.0, 9.0, 2)[(np.sin(beam) > 0).astype(int)] / np.maximum(np.abs(np.sin(beam)), 1e-3)
    line = np.minimum(np.where(np.cos(beam) > 0, ground, np.inf), walls)
    lines = line * rng.normal(1.0, 0.01, (n_lines, m))
    lines[: n_lines // 3] *= rng.uniform(0.6, 1.0)
    sky = np.abs(beam) > np.deg2rad(rng.uniform(70, 150))
    lines[rng.random(lines.shape) < np.where(sky, 0.8, 0.1)] = np.nan
    lines[:, slice(*sorted(rng.integers(0, m, 2) // 3))] = np.nan
    return beam + rng.uniform(-4, 4), lines.astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("few", [1, 3])
def test_the_guess_equals_one_by_one(seed: int, few: int) -> None:
    angle, lines = scene(seed, n_lines=(4, 12, 64, 65, 80)[seed % 5], m=(60, 119, 121, 240, 362)[seed // 2])
    found, expected = guess_down(angle, lines, is_coarse=few == 3), slow_guess(angle, lines, few)
    if expected is None:
        assert found is None
        return
    assert found is not None
    for one in ("down_rad", "depth_m", "ratio", "rival_rad"):
        value = getattr(expected, one)
        assert getattr(found, one) == (value if value is None else pytest.approx(value, abs=1e-8)), one
