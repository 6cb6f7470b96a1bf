"""What is kept of a stream, and what is estimated from it, compared with plain loops."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.errors import EvidenceError
from prc_cli.core.findings import CHECK_NAMES, Finding, Verdict
from prc_cli.core.stream import LabelledBlock, ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.methods.base import UsualLabels
from prc_cli.streams.evidence import lines as repeats
from prc_cli.streams.evidence import periods as estimates
from prc_cli.streams.evidence.figures import LineSample, Seen, lines_of_window
from prc_cli.streams.evidence.lines import LineRepeats, check_repeats, digests
from prc_cli.streams.evidence.periods import (
    RangeCorrelation,
    estimate_line_frequency,
    estimate_points_per_line,
    range_correlation,
)
from prc_cli.streams.evidence.result import ResultWatch
from prc_cli.streams.evidence.table import check_table
from prc_cli.streams.evidence.watch import EvidenceStream, LiveEvidence


@pytest.mark.parametrize(
    ("m", "n_lines"),
    [
        (1, 4096),
        (32, 4096),
        (33, 3971),
        (4096, 32),
        (100_000, 32),
        (131_072, 32),
        (131_073, 31),
        (1 << 22, 1),
        (1 << 23, 1),
    ],
)
def test_lines_of_a_window(m: int, n_lines: int) -> None:
    assert lines_of_window(m) == n_lines


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


def test_points_per_line_are_those_of_the_windows() -> None:
    one = Seen(StreamInfo("a.npy", "array", 7, None, None), 0, ())
    assert one.points_per_line == 7
    sample = LineSample(5)
    sample.add(ScanBlock(0, np.ones((2, 5), np.float32)))
    assert replace(one, windows=sample.windows()).points_per_line == 5


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


@pytest.mark.parametrize(("n_values", "is_told"), [(31, False), (32, True)])
@pytest.mark.parametrize("kind", ["missing", "equal"])
def test_lines_of_few_different_ranges_are_not_told(n_values: int, is_told: bool, kind: str) -> None:
    image = lines(10)
    image[:, n_values:] = np.nan if kind == "missing" else image[:, :1]
    assert len(digests(ScanBlock(0, image))) == (10 if is_told else 0)


def test_digests_differ_by_place_and_scanner() -> None:
    image = lines(500)
    moved, changed = np.roll(image, 1, axis=1), image.copy()
    changed[:, 63] = np.nextafter(changed[:, 63], np.float32(9))
    every = [digests(ScanBlock(0, one, scanner=scanner)) for one in (image, moved, changed) for scanner in (0, 1)]
    assert len(set(np.concatenate(every).tolist())) == 3000


@pytest.mark.parametrize(("times", "expected"), [(1, 0), (2, 3), (4, 9), (5, 0)])
def test_lines_that_come_often_are_of_a_standing_scanner(times: int, expected: int) -> None:
    found = LineRepeats()
    for _ in range(times):
        found.add(ScanBlock(0, lines(3)))
    assert found.n_repeated == expected


def test_of_many_lines_a_part_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repeats, "MOST_KEPT", 100)
    found = LineRepeats()
    image = lines(250)
    for first in (0, 250):
        for k in range(0, 250, 50):
            found.add(ScanBlock(first + k, image[k : k + 50]))
    kept = digests(ScanBlock(0, image))
    mask = 0
    while np.count_nonzero(kept & np.uint64(mask) == 0) > 100:
        mask = 2 * mask + 1
    assert mask in (3, 7)
    assert found.n_repeated == (mask + 1) * np.count_nonzero(kept & np.uint64(mask) == 0)


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


def test_counts_of_all_scanners_and_lines_of_four() -> None:
    """Evidence of many scanners: the lines of four are looked at, the counts hold all."""

    class Many:
        info = StreamInfo("a.npz", "array", 40, None, None, angle_rad=np.arange(40.0))

        def blocks(self):  # type: ignore[no-untyped-def]
            for scanner in (5, 3, 9, 1, 7, 8):
                image = lines(30, 40, scanner)
                image[: scanner + 1, 0] = np.nan
                beam = np.full(40, float(scanner))
                yield ScanBlock(0, image, scanner=scanner, beam_rad=beam, tally=ReadTally(n_unplaced=scanner))

    stream = EvidenceStream(Many(), refuses=False, most_noise_m=0.5)
    assert stream.findings() == ()
    for _ in range(2):
        assert len(list(stream.blocks())) == 6
    seen = stream.seen()
    assert [one.scanner for one in seen] == [1, 3, 5, 7]
    for one in seen:
        assert (one.n_lines, one.n_shots, one.n_missing) == (30, 6 * 30 * 40, 33 + 6)
        assert one.tally.n_unplaced == 33
        assert one.beam_rad is not None
        assert one.beam_rad[0] == one.scanner
        assert one.angle_rad is Many.info.angle_rad
        assert one.most_noise_m == 0.5
        assert sum(len(window.range_m) for window in one.windows) == (0 if one.scanner == 7 else 30)


def test_checks_are_asked_when_the_sample_is_full_for_the_first_time() -> None:
    """Eight windows of 32 lines."""
    read = []
    shots = np.random.default_rng(1).uniform(2.0, 90.0, (32, 8192)).astype(np.float32)

    class Wide:
        info = StreamInfo("a.npy", "array", 8192, None, None)

        def blocks(self):  # type: ignore[no-untyped-def]
            for first in range(0, 640, 32):
                read.append(first)
                yield ScanBlock(first, shots)

    with pytest.raises(EvidenceError):
        for _ in EvidenceStream(Wide()).blocks():
            pass
    assert read[-1] == 224


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


def test_every_check_has_its_row_once() -> None:
    assert [one.name for one in check_table()] == list(CHECK_NAMES)


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


@pytest.mark.parametrize("seed", range(6))
def test_rise_at_multiples_equals_a_plain_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    period = (7, 49, 50, 100, 120, 200)[seed]
    correlation = rng.uniform(-1, 1, (period * 5, period * 18)[seed % 2] + seed)
    reach = max(period // 50, 1)
    rises = [
        max(correlation[max(k * period - reach, 1) : k * period + reach + 1])
        - min(correlation[(k - 1) * period : k * period])
        for k in range(1, 17)
        if k * period + reach < len(correlation)
    ]
    assert estimates._comb(correlation, period) == min(rises)
    peaks = [k for k in range(1, len(correlation) - 1) if correlation[k - 1] <= correlation[k] > correlation[k + 1]]
    assert estimates._peaks(correlation).tolist() == peaks


@pytest.mark.parametrize(
    ("rises", "expected"),
    [
        # the first that rises to nine tenths, at the highest point before it falls to seven tenths
        ({10: 0.9, 20: 1.0}, 10), ({10: 0.89, 20: 1.0, 30: 0.95}, 20), ({10: 0.91, 20: 1.0}, 10),
        ({10: 0.92, 12: 0.95, 20: 1.0}, 12),
        ({10: 0.92, 11: 0.67, 12: 0.95}, 12), ({10: 0.92, 11: 0.66, 12: 0.95}, 10), ({}, 0),
    ],
)  # fmt: skip
def test_the_fundamental_is_the_first_high_rise(rises: dict[int, float], expected: int) -> None:
    correlation = np.full(40, -0.25)
    correlation[0] = 1.0
    for lag, rise in rises.items():
        correlation[lag] = rise - 0.25
        if lag + 1 not in rises:
            correlation[lag + 1] = 0.71 - 0.25 if lag + 2 in rises else -0.25
    correlation[1:5] = np.linspace(0.5, -0.25, 4)
    assert estimates._fundamental(correlation) == expected


@pytest.mark.parametrize(
    ("true", "first", "expected"),
    [(100.3, 100, 100), (100.45, 100, 100), (99.6, 100, 100), (100.8, 100, 101), (11.2, 11, 11)],
)
def test_the_period_follows_its_multiples(true: float, first: int, expected: int) -> None:
    lag = np.arange(1700)
    correlation = np.cos(2 * np.pi * lag / true)
    assert estimates._refine(correlation, first) == expected
    assert estimates._refine(0.6 * correlation, first) == expected
    # not beyond those that are seen
    assert estimates._refine(np.where(lag > 150, 0.0, correlation), first) == first


def test_streams_that_are_too_short_for_a_period() -> None:
    line = np.array([3, 4, 5, 4, 2, 2, 1], np.float32)
    for n, is_short in ((99, True), (100, False)):
        found = estimate_points_per_line(np.append(np.resize(line, n), np.full(20, np.nan)).astype(np.float32))
        assert (found.reason == f"too few ranges: {n} of {n + 20} shots") is is_short
    for n_max, is_short in ((3, True), (4, False)):
        assert estimate_points_per_line(np.resize(line, 160), n_max).reason.startswith("too few") is is_short
    found = estimate_points_per_line(np.append(np.resize(line, 7 * 32), np.nan).astype(np.float32))
    assert (found.points_per_line, found.n_shots_used) == (7, 225)
    assert found.reason == "the ranges repeat after 7 shots (225 shots, lines of up to 14)"
    assert (
        estimate_points_per_line(np.append(np.resize(line, 7 * 16 - 2), np.nan).astype(np.float32)).points_per_line
        is None
    )


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


def test_correlation_needs_100_pairs() -> None:
    rng = np.random.default_rng(3)
    ranges = np.insert(rng.random(101), 50, np.nan)
    found = range_correlation(ranges.astype(np.float32))
    assert found.n_pairs == 99
    assert np.isnan(found.ratio)
    full = range_correlation(rng.random(101).astype(np.float32))
    assert full.n_pairs == 100
    assert 0.5 < full.ratio < 2.0
    # exactly the median step over that of the pairs of the seed
    flat = rng.random(5000).astype(np.float32)
    pairs = np.random.default_rng(4).integers(0, 5000, size=(2, 5000))
    expected = np.median(np.abs(np.diff(flat))) / np.median(np.abs(flat[pairs[0]] - flat[pairs[1]]))
    assert range_correlation(flat, seed=4).ratio == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([0.02, 0.02], 50.0), ([0.02], None), ([0.02, 0.0, -1.0, 0.02], 50.0),
        ([0.02, 0.02, 0.02, 0.02, 0.03], 50.0),
        ([0.02, 0.02, 0.02, 0.03], None), ([0.02, 0.02, 0.0218, 0.02, 0.02], 5 / 0.1018),
        ([0.02, 0.02, 0.0222, 0.02, 0.02], 50.0),
        # two tenths of a step over two lines, one over one
        ([0.02, 0.02, 0.02, 0.0436, 0.02], 6 / 0.1236),
        ([0.02, 0.02, 0.02, 0.0444, 0.02], 50.0),
        ([0.02, 0.02, 0.02, 0.02, 0.008], 50.0),
    ],
)  # fmt: skip
def test_line_frequency_at_its_limits(steps: list[float], expected: float | None) -> None:
    found = estimate_line_frequency(np.concatenate([[5.0], 5.0 + np.cumsum(steps)]))
    assert found == (None if expected is None else pytest.approx(expected, abs=1e-6))


def test_labels_of_four_scanners_are_looked_at() -> None:
    watch = ResultWatch(UsualLabels(noise_share=0.5))
    for scanner in range(6):
        noisy = Label.NOISE if scanner in (1, 4) else Label.GROUND
        block = ScanBlock(0, np.full((32, 40), 5.0, np.float32), scanner=scanner)
        watch.see(LabelledBlock(block, np.full((32, 40), noisy, np.uint8), np.empty(0, np.uint8)))
    assert sorted(watch._scanners) == [0, 1, 2, 3]
    assert Counter(one.found.partition(":")[0] for one in watch.findings()) == {"scanner 1": 1}


def test_equal_ranges_are_told_whatever_they_are() -> None:
    """The middle is taken off before the mean, which is not exact."""
    for value in np.random.default_rng(1).uniform(0.1, 99.0, 40).astype(np.float32).tolist():
        found = estimate_points_per_line(np.full(1003, value, np.float32))
        assert found.reason == "all ranges are equal"
