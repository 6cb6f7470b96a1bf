"""What a stream shows of itself.

Rightly read scans are fine, and each way of misreading one is noticed.
"""

from functools import cache

import numpy as np
import pytest

from prc_cli.core.errors import EvidenceError
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F32
from prc_cli.formats.options import InputConfig
from prc_cli.streams.evidence.watch import watched
from tests.simulated import drive_scan

M = 600
LINES = 480


@cache
def scan(seed: int = 11) -> F32:
    return np.concatenate([block.range_m for block in drive_scan(LINES, M, seed).blocks()])


class Arrays:
    """A stream of a range image, in blocks of some lines."""

    def __init__(self, ranges: F32, lines: int = 100, tally: ReadTally | None = None) -> None:
        self.ranges = ranges
        self.lines = lines
        self.tally = tally or ReadTally()
        self.info = StreamInfo("drive.npy", "array", ranges.shape[1], None, None)

    def blocks(self):  # type: ignore[no-untyped-def]
        for first in range(0, len(self.ranges), self.lines):
            tally = self.tally if first == 0 else ReadTally()
            yield ScanBlock(
                first, np.ascontiguousarray(self.ranges[first : first + self.lines]), tally=tally
            )


def asked(ranges: F32, lines: int = 100, tally: ReadTally | None = None) -> dict[str, Finding]:
    stream = watched(Arrays(ranges, lines, tally), InputConfig(), refuses=False)
    for _ in stream.blocks():
        pass
    return {finding.check: finding for finding in stream.observed.findings}


def not_fine(ranges: F32, **options: object) -> dict[str, Verdict]:
    """Names and verdicts of all that is not fine."""
    return {
        name: finding.verdict
        for name, finding in asked(ranges, **options).items()
        if finding.verdict
    }  # type: ignore[arg-type]


def cut(ranges: F32, m: int) -> F32:
    """Read the same shots with another M."""
    flat = ranges.ravel()
    return flat[: len(flat) // m * m].reshape(-1, m)


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def swapped_bytes(ranges: F32) -> F32:
    odd = ranges.byteswap().view(np.float32)
    return np.where(np.isfinite(odd) & (odd > 0), odd, np.nan).astype(np.float32)


def zigzag(ranges: F32) -> F32:
    turned = ranges.copy()
    turned[1::2] = turned[1::2, ::-1]
    return turned


def two_scanners(ranges: F32) -> F32:
    """Lines of two scanners, in turns."""
    half = len(ranges) // 2
    both = np.empty((2 * half, ranges.shape[1]), np.float32)
    both[::2] = ranges[:half]
    both[1::2] = np.roll(ranges[half : 2 * half], M // 3, axis=1)
    return both


def shot_by_shot(ranges: F32) -> F32:
    """Shots of two scanners, in turns."""
    half = len(ranges) // 2
    both = np.empty((half, 2 * ranges.shape[1]), np.float32)
    both[:, ::2] = ranges[:half]
    both[:, 1::2] = np.roll(ranges[half : 2 * half], M // 3, axis=1)
    return both


def lost(ranges: F32, share: float) -> F32:
    return np.where(rng().random(ranges.shape) < share, np.nan, ranges).astype(np.float32)


def buffer_lost(ranges: F32) -> F32:
    return cut(np.delete(ranges.ravel(), slice(M * 240, M * 240 + 260)), M)


def standing(ranges: F32) -> F32:
    noise = rng().normal(1.0, 5e-4, (LINES, M))
    return (ranges[:1] * noise).astype(np.float32)


@pytest.mark.parametrize(
    "misread, check, words",
    [
        (
            lambda ranges: rng().permutation(ranges.ravel()).reshape(-1, M),
            "shot-order",
            "check the layout",
        ),
        (shot_by_shot, "shot-order", "every second shot"),
        (swapped_bytes, "ranges", "byte order"),
        (lambda ranges: ranges / 1000, "ranges", "median range"),
        (lambda ranges: cut(ranges, M + 1), "line-length", f"-M {M}"),
        (lambda ranges: cut(ranges, M - 1), "line-length", f"-M {M}"),
        (lambda ranges: cut(ranges, M // 2), "line-length", f"-M {M}"),
        (lambda ranges: cut(ranges, 2 * M), "line-length", f"-M {M}"),
        (lambda ranges: cut(ranges, 487), "line-length", f"-M {M}"),
        (lambda ranges: np.ascontiguousarray(ranges.T).reshape(-1, M), "line-length", ""),
        (zigzag, "line-length", "runs the other way"),
        (buffer_lost, "columns-along", "all columns shift"),
        (lambda ranges: ranges * np.float32(100), "units", "above the ground"),
        (two_scanners, "line-length", "--scanner"),
        (
            lambda ranges: rng().permutation(ranges),
            "line-order",
            "sort the lines by time of scan",
        ),
    ],
)
def test_a_misread_scan_is_refused(misread, check, words):
    finding = asked(misread(scan()))[check]
    assert finding.verdict is Verdict.AGAINST
    assert words in finding.sentence()


@pytest.mark.parametrize(
    "odd, check",
    [
        (standing, "standing"),
        (lambda ranges: lost(ranges, 0.1), "dropouts"),
        (lambda ranges: (np.round(ranges / 0.1) * 0.1).astype(np.float32), "rounding"),
        (lambda ranges: (np.round(ranges / 0.031) * 0.031).astype(np.float32), "rounding"),
        (lambda ranges: lost(ranges, 0.99), "returns"),
        (lambda ranges: np.where(np.isnan(ranges), np.float32(120.0), ranges), "missing-code"),
        (lambda ranges: ranges * np.float32(3.28084), "units"),
        (lambda ranges: ranges * np.float32(40), "ranges"),
        (lambda ranges: np.concatenate([ranges[:200], ranges[150:]]), "repeated-lines"),
    ],
)
def test_an_odd_scan_is_doubted(odd, check):
    assert not_fine(odd(scan())).get(check) is Verdict.DOUBTFUL


def test_the_first_evidence_ends_a_long_stream():
    """Long before its end: when the sample is full for the first time."""
    read = []

    class Long(Arrays):
        def blocks(self):  # type: ignore[no-untyped-def]
            for block in super().blocks():
                read.append(block.first_line)
                yield block

    ranges = rng().permutation(np.tile(scan(), (16, 1)).ravel()).reshape(-1, M)
    with pytest.raises(EvidenceError, match="to accept it: --accept-doubt shot-order"):
        for _ in watched(Long(ranges), InputConfig()).blocks():
            pass
    assert len(read) < len(ranges) / 100 / 2


@pytest.mark.data
@pytest.mark.parametrize(
    "name", ["kitti_train_3", "kitti_train_5", "nuscenes_train_18", "nuscenes_train_23"]
)
def test_a_frame_that_looks_another_way_at_every_line_has_its_length(real_data, name):
    with np.load(real_data / "rangeviews" / f"{name}.npz") as arrays:
        ranges = np.ascontiguousarray(arrays["range_m"].T)
    finding = asked(ranges)["line-length"]
    assert finding.verdict is Verdict.FINE, finding
    m = ranges.shape[1]
    for off in (-3, -1, 1, 2):
        wrong = asked(cut(ranges, m + off))["line-length"]
        assert (wrong.verdict, wrong.option) == (Verdict.AGAINST, f"-M {m}")
