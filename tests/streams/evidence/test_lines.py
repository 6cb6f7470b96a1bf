"""What a stream shows of itself; golden rows ``misread-...`` show what a misread one does."""

import numpy as np
import pytest

from prc_cli.core.errors import EvidenceError
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32
from prc_cli.formats.options import InputConfig
from prc_cli.streams.evidence.watch import watched
from tests.simulated import drive_arrays

M = 600
LINES = 480


class Arrays:
    """A stream of a range image, in blocks of 100 lines."""

    def __init__(self, ranges: F32) -> None:
        self.ranges = ranges
        self.info = StreamInfo("drive.npy", "array", ranges.shape[1], None, None)

    def blocks(self):  # type: ignore[no-untyped-def]
        for first in range(0, len(self.ranges), 100):
            yield ScanBlock(first, np.ascontiguousarray(self.ranges[first : first + 100]))


def asked(ranges: F32) -> dict[str, Finding]:
    stream = watched(Arrays(ranges), InputConfig(), refuses=False)
    for _ in stream.blocks():
        pass
    return {finding.check: finding for finding in stream.observed.findings}


def cut(ranges: F32, m: int) -> F32:
    """Read the same shots with another M."""
    flat = ranges.ravel()
    return flat[: len(flat) // m * m].reshape(-1, m)


def test_the_first_evidence_ends_a_long_stream():
    """Long before its end: when the sample is full for the first time."""
    read = []

    class Long(Arrays):
        def blocks(self):  # type: ignore[no-untyped-def]
            for block in super().blocks():
                read.append(block.first_line)
                yield block

    ranges = np.tile(drive_arrays(LINES, M, 11)[0].range_m, (16, 1)).ravel()
    ranges = np.random.default_rng(5).permutation(ranges).reshape(-1, M)
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
