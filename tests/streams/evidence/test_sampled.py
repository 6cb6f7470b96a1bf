"""The sample of a stream and its figures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64
from prc_cli.streams.evidence import periods as estimates
from prc_cli.streams.evidence.figures import LineSample, Window, figures_of


@pytest.mark.parametrize("chunk", [1, 31, 32, 33, 300])
@pytest.mark.parametrize("n_lines", [32 * 8 - 1, 32 * 8, 32 * 9 + 5, 32 * 41])
def test_a_sample_is_even_whatever_the_blocks(chunk: int, n_lines: int) -> None:
    """Windows of 32 lines: every first, second, fourth of them, at most 8."""
    m = 8192
    sample = LineSample(m)
    n_full = []
    for first in range(0, n_lines, chunk):
        stop = min(first + chunk, n_lines)
        sample.add(
            ScanBlock(first, np.broadcast_to(np.arange(first, stop, dtype=np.float32)[:, None], (stop - first, m)))
        )
        n_full.append(sample.n_full)
    stride = 1
    while len(range(0, n_lines, 32 * stride)) > 8:
        stride *= 2
    assert [one.first_line for one in sample.windows()] == list(range(0, n_lines, 32 * stride))
    for one in sample.windows():
        stop = min(one.first_line + 32, n_lines)
        assert one.range_m[:, -1].tolist() == list(range(one.first_line, stop))
    # full at 8 windows of 32 lines, and whenever every second of twice as many is kept
    assert n_full[-1] == sum(n_lines >= 32 * (7 * stride + 1) for stride in (1, 2, 4))


# -- estimates ---------------------------------------------------------------------------------------------------------


def slow_correlation(signal: F64, valid: F64, lag: int) -> float:
    pairs = [(a, b) for a, b, u, v in zip(signal, signal[lag:], valid, valid[lag:], strict=False) if u and v]
    energy = (sum(a * a for a, _ in pairs) * sum(b * b for _, b in pairs)) ** 0.5
    whole = sum(a * a for a, u in zip(signal, valid, strict=True) if u)
    return sum(a * b for a, b in pairs) / energy if energy > 1e-6 * whole else 0.0


def test_autocorrelation_equals_a_plain_one() -> None:
    rng = np.random.default_rng(2)
    valid = (rng.random(90) < 0.7).astype(np.float64)
    signal = np.where(valid, rng.normal(size=90), 0.0)
    found = estimates._autocorrelation(signal, 60, valid)
    np.testing.assert_allclose(found, [slow_correlation(signal, valid, lag) for lag in range(61)], atol=1e-9)
    assert found.shape == (61,)


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
