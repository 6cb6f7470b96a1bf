"""The sample of a stream and its figures."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import LabelledBlock, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.methods.base import UsualLabels
from prc_cli.streams.evidence import periods as estimates
from prc_cli.streams.evidence.figures import LineSample, Window, figures_of, fold, pieces
from prc_cli.streams.evidence.lines import LineRepeats, check_repeats, digests
from prc_cli.streams.evidence.periods import (
    RangeCorrelation,
)
from prc_cli.streams.evidence.result import ResultWatch
from prc_cli.streams.evidence.watch import EvidenceStream, LiveEvidence


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


def lines(n: int, m: int = 64, seed: int = 1) -> F32:
    return np.random.default_rng(seed).random((n, m), np.float32)


@pytest.mark.parametrize(
    ("m", "is_told"), [(31, False), (32, True), (64, True), (127, True), (128, True), (1000, True)]
)
def test_lines_that_come_twice(m: int, is_told: bool) -> None:
    found = LineRepeats()
    found.add(ScanBlock(0, lines(20, m)))
    found.add(ScanBlock(20, lines(20, m)[4:]))
    assert found.n_repeated == (16 if is_told else 0)
    # only every n-th of 64 columns stands for a line
    other = lines(20, m)
    other[:, 1 :: max(m // 64, 1)] += 1.0 if m >= 128 else 0.0
    assert digests(ScanBlock(0, other)).tolist() == digests(ScanBlock(0, lines(20, m))).tolist()


@pytest.mark.parametrize(
    ("n", "verdict", "said"),
    [
        (0, Verdict.FINE, "0"),
        (7, Verdict.FINE, "about 7"),
        (8, Verdict.DOUBTFUL, "about 8"),
        (1200, Verdict.DOUBTFUL, "about 1,200"),
    ],
)
def test_repeated_lines_are_told(n: int, verdict: Verdict, said: str) -> None:
    found = LineRepeats()
    found.add(ScanBlock(0, lines(1200)))
    found.add(ScanBlock(1200, lines(1200)[:n]))
    assert check_repeats(found) == Finding(
        "repeated-lines", verdict, f"{said} lines are copies of earlier lines, shot by shot", "fewer than 8",
        "leave out the part that is there twice",
    )  # fmt: skip
    assert LineRepeats().n_repeated == 0


def test_the_worst_finding_of_a_live_stream_stays_and_is_told_once() -> None:
    told: list[Finding] = []
    stream = EvidenceStream(SimpleNamespace(info=StreamInfo("a.npy", "array", 9, None, None)), ("times",))  # type: ignore[arg-type]
    live = LiveEvidence(stream, told.append)
    fine = Finding("units", Verdict.FINE, "2 m", "")
    doubt, again = Finding("units", Verdict.DOUBTFUL, "7 m", ""), Finding("units", Verdict.DOUBTFUL, "8 m", "")
    accepted = Finding("times", Verdict.AGAINST, "back", "")
    live.hear([fine])
    assert (live.findings(), told) == ((fine,), [])
    live.hear([doubt, accepted])
    live.hear([fine, again])
    live.hear([fine])
    assert live.findings() == (again, replace(accepted, is_accepted=True))
    assert told == [doubt]


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


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (0.299, "neighbouring shots have near ranges (ratio 0.3): as expected of shots in the order they were fired"),
        (
            0.3,
            "neighbouring ranges are only loosely alike (ratio 0.3): the order may be disturbed, or the "
            "scene very rough",
        ),
        (
            0.699,
            "neighbouring ranges are only loosely alike (ratio 0.7): the order may be disturbed, or the "
            "scene very rough",
        ),
        (
            0.7,
            "neighbouring ranges are as unlike as random pairs (ratio 0.7): the order carries no spatial correlation",
        ),
        (np.nan, "9 neighbouring ranges are too few, or too alike, to tell"),
    ],
)
def test_verdict_of_a_correlation(ratio: float, said: str) -> None:
    assert RangeCorrelation(ratio, 9).verdict == said


def test_labels_of_four_scanners_are_looked_at() -> None:
    watch = ResultWatch(UsualLabels(noise_share=0.5))
    for scanner in range(6):
        noisy = Label.NOISE if scanner in (1, 4) else Label.GROUND
        block = ScanBlock(0, np.full((32, 40), 5.0, np.float32), scanner=scanner)
        watch.see(LabelledBlock(block, np.full((32, 40), noisy, np.uint8), np.empty(0, np.uint8)))
    assert sorted(watch._scanners) == [0, 1, 2, 3]
    assert Counter(one.found.partition(":")[0] for one in watch.findings()) == {"scanner 1": 1}


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
