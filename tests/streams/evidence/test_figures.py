"""Figures of a sample, compared with plain loops."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from prc_cli.core.types import F32, F64
from prc_cli.streams.evidence.figures import Window, figures_of, fold, most_turned, pieces


def rough(n_lines: int, m: int, seed: int = 3, gone: float = 0.1) -> F32:
    """Lines of a profile that drifts, with steps of smooth and rough shots, some missing."""
    rng = np.random.default_rng(seed)
    profile = 2.0 + np.cumsum(rng.normal(0.0, 0.02, m))
    profile[m // 3 : m // 2] = 2.5
    image = profile + np.cumsum(rng.normal(0.0, 0.01, (n_lines, 1)), axis=0) + rng.normal(0.0, 0.002, (n_lines, m))
    image[rng.random(image.shape) < gone] = np.nan
    return np.exp(image).astype(np.float32)


def slow_quantile(pairs: list[tuple[float, float]], share: float = 0.5) -> float:
    """Take the element of that rank; an average of two would not be an element."""
    offs = sorted(abs(a - b) for a, b in pairs if np.isfinite(a) and np.isfinite(b))
    return offs[int(share * (len(offs) - 1))] if len(offs) >= 1000 else np.nan


def slow_middle(values: list[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.median(known)) if known else np.nan


@pytest.mark.parametrize(("m", "seed"), [(60, 1), (61, 2)])
def test_figures_equal_plain_loops(m: int, seed: int) -> None:
    windows = tuple(Window(500 * k, rough(40, m, seed + k)) for k in range(4))
    logs = [np.log(window.range_m) for window in windows]
    found = figures_of(windows)

    def of(pairs_of, share: float = 0.5) -> float:  # type: ignore[no-untyped-def]
        return slow_middle([slow_quantile(pairs_of(rows), share) for rows in logs])

    def apart(lag: int):  # type: ignore[no-untyped-def]
        return lambda rows: list(zip(rows.ravel()[:-lag].tolist(), rows.ravel()[lag:].tolist(), strict=True))

    def columns(lag: int):  # type: ignore[no-untyped-def]
        return lambda rows: [
            (a, b) for i in range(len(rows) - lag) for a, b in zip(rows[i], rows[i + lag], strict=True)
        ]

    def amid(rows: F32) -> list[tuple[float, float]]:
        return [(row[k], (row[k - 1] + row[k + 1]) / 2) for row in rows for k in range(1, m - 1)]

    assert found.shot == pytest.approx((of(apart(1)), of(apart(2))))
    assert found.line == pytest.approx(tuple(of(columns(lag)) for lag in (1, 2, 3, 4)))
    turned_round = of(lambda rows: [(a, b) for x, y in pairwise(rows) for a, b in zip(x, y[::-1], strict=True)])
    assert found.reversed_line == pytest.approx(turned_round)
    assert found.roughness == pytest.approx(of(amid))
    # the first and the third, the second and the last
    far = [[(a, b) for a, b in zip(logs[i].ravel(), logs[i + 2].ravel(), strict=True)] for i in (0, 1)]
    moved = of(columns(1), 0.9), float(np.median([slow_quantile(pairs, 0.9) for pairs in far]))
    assert found.moved == pytest.approx(moved)
    noise = [slow_quantile(amid(np.asarray(window.range_m)), 0.05) for window in windows]
    assert found.noise_m == pytest.approx(np.median(noise) / (0.0627 * 1.5**0.5))
    assert 0.5 < found.random / of(lambda rows: [(a, b) for a in rows.ravel()[::7] for b in rows.ravel()[::11]]) < 2.0
    n, lonely = 0, 0
    for row in (row for rows in logs for row in rows):
        for k in range(2, m - 2):
            beside = [(k - 2, k - 1), (k - 1, k + 1), (k + 1, k + 2)]
            if all(abs(row[a] - row[b]) < 0.01 for a, b in beside):
                n, lonely = n + 1, lonely + bool(np.isnan(row[k]))
    assert 50 < lonely < n == found.n_between
    assert found.lonely_missing == lonely / n


def test_noise_of_a_smooth_wall_is_its_standard_deviation() -> None:
    wall = 20.0 + np.random.default_rng(4).normal(0.0, 0.01, (40, 500))
    assert figures_of((Window(0, wall.astype(np.float32)),)).noise_m == pytest.approx(0.01, rel=0.1)


def slow_profile(lines: F32) -> F64:
    """Return the logarithm of the lower median of every column that most lines have."""
    found = []
    for column in lines.T.tolist():
        held = sorted(value for value in column if np.isfinite(value))
        found.append(np.log(held[(len(held) - 1) // 2]) if 2 * len(held) > len(lines) else np.nan)
    return np.array(found)


def slow_off(first: F64, second: F64) -> float:
    offs = []
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        if np.isfinite(a) or np.isfinite(b):
            offs.append(min(abs(a - b), 1.0) if np.isfinite(a) and np.isfinite(b) else 1.0)
    return float(np.mean(offs)) if len(offs) >= 32 else np.nan


@pytest.mark.parametrize("m", [97, 1023, 2100])
@pytest.mark.parametrize("off", [-3, 0, 1])
def test_fold_equals_plain_loops(m: int, off: int) -> None:
    stream = rough(400, m, 5, gone=0.45)
    windows = tuple(Window(k, stream[k : k + 30]) for k in (0, 101, 350))
    flat, length = stream.ravel(), m + off
    profiles = []
    for piece in pieces(windows):
        begin, end = piece.first_line * m, (piece.first_line + 9) * m
        starts = [at for at in range(-(-begin // length) * length, end, length) if at + length <= end][:8]
        if len(starts) >= 4:
            every = max(length // 512, 1)
            profiles.append(slow_profile(np.array([flat[at : at + length : every] for at in starts])))
    assert len(profiles) == 9
    expected = np.median([slow_off(a, b) for i, a in enumerate(profiles) for b in profiles[i + 1 :]])
    assert fold(windows, length) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("m", "lost", "expected"),
    [(200, 50, 0.25), (200, -50, -0.25), (1024, 256, 0.25), (200, 100, 0.5), (201, 99, 99 / 201)],
)
def test_the_place_where_all_columns_shift(m: int, lost: int, expected: float) -> None:
    line = rough(1, m, 8, gone=0.0)
    image = np.tile(line, (400, 1))
    image[200:] = np.roll(image[200:], -lost, axis=1)
    # the other pieces do not differ at all without some noise, and then nothing helps
    image *= np.random.default_rng(1).normal(1.0, 0.01, image.shape).astype(np.float32)
    windows = tuple(Window(50 * k, image[50 * k : 50 * k + 20]) for k in range(8))
    found = most_turned(windows)
    assert found is not None
    places = [piece.first_line for piece in pieces(windows)]
    at = next(i for i, line in enumerate(places) if line >= 200)
    assert (found.line, found.distance, found.n_places) == (places[at], places[at] - places[at - 1], 1)
    assert found.share == pytest.approx(-expected)
    first, second = (
        slow_profile(image[place : place + 8, :: max(m // 256, 1)]) for place in (places[at - 1], places[at])
    )
    # all columns are known: missing ones do not shift
    offs = [slow_off(first, np.roll(second, shift)) for shift in range(len(first))]
    assert found.gain == pytest.approx(min(offs) / offs[0], rel=1e-5)
