"""Streams from pipes, and windows of them."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig, Layout, LayoutField
from prc_cli.streams.filters import windowed
from prc_cli.streams.open import open_input
from prc_cli.streams.pipe import PipeSource, open_pipe
from prc_cli.streams.stream import Stream

RANGES = Layout(fields=(LayoutField(name="range", type="f4"),))
RECORDS = Layout(
    header_bytes=7,
    endian="big",
    record_bytes=16,
    fields=(
        LayoutField(name="range", type="u2", scale=0.01, missing=0),
        LayoutField(name="angle", type="i2", scale=0.01),
        LayoutField(name="time", type="f8"),
    ),
)


class Pieces:
    """A pipe whose writer writes pieces of the given sizes, again and again."""

    def __init__(self, data: bytes, sizes: list[int]) -> None:
        self._pieces = self._cut(data, sizes)
        self.n_reads = 0

    @staticmethod
    def _cut(data: bytes, sizes: list[int]) -> Iterator[bytes]:
        start = n = 0
        while start < len(data):
            size = sizes[n % len(sizes)]
            yield data[start : start + size]
            start = start + size
            n = n + 1

    def read(self, size: int = -1, /) -> bytes:
        self.n_reads += 1
        return next(self._pieces, b"")

    def fileno(self) -> int:
        raise OSError


def ranges_of(source: PipeSource) -> list[float]:
    return [float(value) for chunk in source.chunks(("range",)) for value in chunk.values["range"]]


@pytest.mark.parametrize("sizes", [[1], [5], [400]])
def test_the_same_stream_as_from_a_file(tmp_path, sizes):
    rng = np.random.default_rng(3)
    records = np.zeros(6 * 30, np.dtype([("r", ">u2"), ("a", ">i2"), ("t", ">f8"), ("pad", "V4")]))
    records["r"] = rng.integers(0, 3000, len(records)) * (rng.random(len(records)) < 0.8)
    records["a"] = np.tile(np.arange(30) * 100, 6)
    records["t"] = np.arange(len(records)) * 1e-3
    data = b"header!" + records.tobytes()
    (tmp_path / "drive.bin").write_bytes(data)
    config = InputConfig(points_per_line=30)
    whole = list(open_input(Input.of(tmp_path / "drive.bin", RECORDS), config).blocks())
    pipe, stream = open_pipe(Pieces(data, sizes), config, RECORDS)
    pipe.seal()
    blocks = list(stream.blocks())
    for name in ("range_m", "time_s"):
        expected = np.concatenate([getattr(block, name) for block in whole])
        np.testing.assert_array_equal(
            np.concatenate([getattr(block, name) for block in blocks]), expected
        )
    assert blocks[0].angle_rad is not None
    np.testing.assert_array_equal(blocks[0].angle_rad, whole[0].angle_rad)


def test_a_pipe_that_breaks():
    class Broken(Pieces):
        def read(self, size: int = -1, /) -> bytes:
            raise OSError(5, "Input/output error")

    with pytest.raises(InputError, match=r"stdin: cannot be read \(Input/output error\)"):
        ranges_of(PipeSource(Broken(b"", [1]), RANGES))


@dataclass
class ReadsAhead:
    """Two blocks of ten lines of eight shots; all records are read with the first one."""

    info: StreamInfo = field(default_factory=lambda: StreamInfo("d.npy", "array", 8, 160, 20))

    def blocks(self) -> Iterator[ScanBlock]:
        for first, n_read in ((0, 160), (10, 0)):
            tally = ReadTally(n_records=n_read)
            yield ScanBlock(first, np.ones((10, 8), np.float32), tally=tally, is_last=first > 0)


@pytest.mark.parametrize("lines, n_lines", [("0:10", 10), ("0:12", 12), ("3:20", 17), (":", 20)])
def test_records_of_the_window_are_counted_and_no_others(lines, n_lines):
    config = InputConfig(only_lines=lines)
    blocks = list(windowed(Stream.of(ReadsAhead()), config).blocks())
    assert sum(block.n_lines for block in blocks) == n_lines
    assert sum(block.tally.n_records for block in blocks) == 8 * n_lines
    assert [block.is_last for block in blocks] == [False] * (len(blocks) - 1) + [True]
