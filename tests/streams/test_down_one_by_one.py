"""The guess of straight down, direction by direction and shot by shot."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from prc_cli.core.types import F32, F64
from prc_cli.streams.down import DownGuess, guess_down

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


@pytest.mark.parametrize("seed", range(10))
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


@pytest.mark.parametrize("distance_m", [0.17, 8.0, 39.9, 40.3])
def test_planes_up_to_40_m_away_count(distance_m: float) -> None:
    beam = np.deg2rad(np.arange(-30.0, 30.0, 0.5))
    found = guess_down(beam, np.tile(distance_m / np.cos(beam), (5, 1)).astype(np.float32))
    if distance_m > 40:
        assert found is None or found.depth_m > 40.5 or abs(found.down_rad) > 0.05
    else:
        assert found is not None
        assert found.depth_m == pytest.approx(distance_m, rel=1e-3)
