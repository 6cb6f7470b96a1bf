"""Figures of a sample, compared with plain loops."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from prc_cli.core.types import F32, F64
from prc_cli.streams.evidence import figures
from prc_cli.streams.evidence.figures import Turned, Window, figures_of, fold, likeness, most_turned, pieces, spread


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


def test_few_pairs_tell_nothing() -> None:
    for n, is_known in ((999, False), (1000, True)):
        assert np.isfinite(likeness(np.arange(n), np.arange(n) + 2.0)) == is_known
        assert np.isfinite(figures._random_likeness(np.arange(1.0, n + 1.0, dtype=np.float32))) == is_known
    empty = figures_of(())
    assert empty.n_between == 0
    assert all(np.isnan(value) for value in (empty.random, *empty.line, *empty.moved, empty.lonely_missing))
    assert figures._lonely(np.ones((300, 4), np.float32)) == (0, 0)
    assert figures._lonely(np.ones((300, 5), np.float32)) == (0, 300)
    # a hundredth is not smooth, wherever it is
    step = np.float32(0.01)
    for line in ([0, 0, np.nan, step, step], [step, 0, np.nan, 0, 0], [0, 0, np.nan, 0, step]):
        assert figures._lonely(np.array([line], np.float32)) == (0, 0)
        assert figures._lonely(np.array([line], np.float32) * np.float32(0.99)) == (1, 1)


def numbered(n_lines: int, m: int, first: int = 0) -> Window:
    """Lines that hold their own number."""
    return Window(first, np.repeat(np.arange(first, first + n_lines, dtype=np.float32)[:, None], m, axis=1))


def runs_of(windows: tuple[Window, ...]) -> list[tuple[int, int]]:
    for rows in spread(windows):
        assert (np.diff(rows[:, 0]) == 1).all()
    return [(int(rows[0, 0]), len(rows)) for rows in spread(windows)]


@pytest.mark.parametrize(
    ("windows", "expected"),
    [
        # 32768 shots and 4 lines more of each of four of eight windows
        ([(60, 2000)] * 8, [(0, 20), (2000, 20), (5000, 20), (7000, 20)]),
        ([(60, 2000)] * 5, [(0, 20), (1000, 20), (3000, 20), (4000, 20)]),
        # a short stream is cut into as many, of the whole of which is used what is enough
        ([(60, 2000)], [(0, 15), (15, 15), (30, 15), (45, 15)]),
        ([(120, 2000)], [(0, 20), (30, 20), (60, 20), (90, 20)]),
        ([(60, 2000)] * 2, [(0, 20), (30, 20), (1000, 20), (1030, 20)]),
        ([(60, 2000)] * 3, [(0, 20), (30, 20), (1000, 20), (1030, 20), (2000, 20), (2030, 20)]),
        # at least 8 lines, of long lines too
        ([(60, 20000)] * 4, [(0, 8), (1000, 8), (2000, 8), (3000, 8)]),
        ([(20, 100)], [(0, 8), (8, 8)]),
        ([(21, 100)], [(0, 8), (8, 8), (16, 5)]),
        ([(4, 100)], []),
        ([(5, 100)], [(0, 5)]),
        ([], []),
    ],
)
def test_runs_of_lines_are_spread_over_the_stream(
    windows: list[tuple[int, int]], expected: list[tuple[int, int]]
) -> None:
    assert runs_of(tuple(numbered(n, m, 1000 * k) for k, (n, m) in enumerate(windows))) == expected


@pytest.mark.parametrize(
    ("n_windows", "n_lines", "expected"),
    [
        (8, 60, [31, 1012, 2043, 3024, 4004, 5036, 6016, 7048]),
        (1, 160, [6, 22, 49, 65, 80, 107, 123, 150]),
        (3, 40, [2, 13, 29, 1001, 1013, 1028, 2001, 2016, 2028]),
        (1, 72, [0, 9, 18, 27, 36, 45, 54, 63]),
        (1, 71, [0, 8, 16, 24, 32, 40, 48, 56]),
        (1, 64, [0, 8, 16, 24, 32, 40, 48]),
        (9, 9, [0, 1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000]),
        (9, 8, []),
        (0, 0, []),
    ],
)
def test_pieces_are_nine_lines_at_uneven_distances(n_windows: int, n_lines: int, expected: list[int]) -> None:
    found = pieces(tuple(numbered(n_lines, 3, 1000 * k) for k in range(n_windows)))
    assert [piece.first_line for piece in found] == expected
    assert all((piece.range_m[:, 0] == np.arange(9) + piece.first_line).all() for piece in found)


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


def test_of_long_lines_few_fit_in_a_piece() -> None:
    windows = tuple(Window(101 * k, rough(9, 100, k)) for k in range(8))
    # of the other length, 4 lines fit into each piece of 900 shots that begins well, 3 do not tell
    assert np.isfinite(fold(windows, 200))
    assert np.isnan(fold(windows, 301))


def test_profiles_of_few_columns_tell_nothing() -> None:
    for n, is_known in ((31, False), (32, True)):
        assert np.isfinite(figures._profile_off(np.zeros(n), np.zeros(n))) == is_known
    # what one side misses differs by the most, as do columns that differ by more
    one = np.zeros(40)
    other = np.array([np.nan] * 10 + [3.0] * 10 + [0.5] * 20)
    assert figures._profile_off(one, other) == figures._profile_off(other, -one) == 0.75


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


def test_shifts_that_are_small_or_help_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    line = rough(1, 200, 8, gone=0.0)

    def turned(step: int) -> Turned | None:
        image = np.concatenate([np.roll(np.tile(line, (9, 1)), -step * (k % 2), axis=1) for k in range(8)])
        image *= np.random.default_rng(1).normal(1.0, 0.01, image.shape).astype(np.float32)
        return most_turned((Window(0, image),))

    everywhere = turned(6)
    assert everywhere is not None
    assert everywhere.n_places == 7
    assert abs(everywhere.share) == pytest.approx(0.03)
    assert turned(5) is None
    assert most_turned(()) is most_turned((Window(0, np.tile(line, (9, 1))),)) is None
    # lines that do not differ at all are not shifted
    assert most_turned(tuple(Window(9 * k, np.tile(line, (9, 1))) for k in range(8))) is None
    assert most_turned(tuple(Window(9 * k, np.full((9, 200), np.nan, np.float32)) for k in range(8))) is None
