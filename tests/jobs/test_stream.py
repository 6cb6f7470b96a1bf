"""Live streams: doubts, narrow pipes, progress."""

import io
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from prc_cli.config import MethodChoice, load_config
from prc_cli.core.errors import EvidenceError, InputError
from prc_cli.core.findings import CHECK_NAMES, Finding
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.classify import classify
from prc_cli.jobs.stream import stream
from prc_cli.streams.evidence.watch import LiveFindings, evidence_of, watched_live
from prc_cli.streams.stream import Stream
from tests.street import POINTS_PER_LINE, street

URBAN = load_config(
    preset="prc-2019-urban",
    options={"input": {"points_per_line": POINTS_PER_LINE}, "prc": {"lines_per_block": 16}},
)


@dataclass
class Endless:
    """A scanner that goes on until nobody listens: first some lines, then others for ever."""

    first: F32
    then: F32

    @property
    def info(self) -> StreamInfo:
        return StreamInfo("stdin", "raw binary", self.first.shape[1], None, None)

    def blocks(self) -> Iterator[ScanBlock]:
        yield ScanBlock(0, self.first)
        line = len(self.first)
        for _ in range(200_000):  # more than any test hears
            yield ScanBlock(line, self.then)
            line += len(self.then)


def shuffled(image: F32) -> F32:
    columns_shuffled: F32 = np.random.default_rng(3).permuted(image, axis=1)
    return columns_shuffled


def live_stream(source: Endless, accepted: tuple[str, ...] = ()) -> Stream:
    begin = evidence_of(source, InputConfig(accept_doubts=accepted))
    return watched_live(source, begin, LiveFindings("stdin", accepted, [].append))


def test_a_stream_without_an_end_is_refused_while_it_goes_on():
    bad = shuffled(street())
    live = live_stream(Endless(bad, bad))
    with pytest.raises(EvidenceError, match="stdin: ranges of neighbouring shots"):
        for _ in live.blocks():
            pass


def test_what_goes_wrong_later_is_found_as_the_stream_grows():
    good = street(7000)
    far = np.full((500, POINTS_PER_LINE), 40_000.0, np.float32)
    others = tuple(name for name in CHECK_NAMES if name != "ranges")
    live = live_stream(Endless(good, far), others)
    n_lines = 0
    with pytest.raises(EvidenceError, match="of the ranges are beyond"):
        for block in live.blocks():
            n_lines += block.n_lines
    assert n_lines > len(good)


def test_labels_have_left_when_the_input_is_refused_at_its_end():
    sink = io.BytesIO()
    with pytest.raises(EvidenceError):
        stream(io.BytesIO(shuffled(street()).tobytes()), sink, URBAN)
    assert len(sink.getvalue()) == street().size


def test_an_end_inside_a_record_loses_no_label_and_is_no_reason_for_a_method():
    choices = list[MethodChoice]()
    whole = io.BytesIO()
    cut = io.BytesIO()
    config = load_config(options={"input": {"points_per_line": POINTS_PER_LINE}})
    stream(io.BytesIO(street().tobytes()), whole, config, chosen=choices.append)
    with pytest.raises(
        InputError, match=f"stdin: ended inside record {street().size}: found 2 bytes of 4"
    ):
        stream(io.BytesIO(street().tobytes() + b"ab"), cut, config, chosen=choices.append)
    assert choices[0] == choices[1]
    assert cut.getvalue() == whole.getvalue()


def test_doubts_are_told_once_and_kept():
    thin = np.full((137, 18_000), np.nan, np.float32)
    thin[:, :POINTS_PER_LINE] = street()
    doubts: list[Finding] = []
    for accepts in ((), ("returns",)):
        options = {"input": {"points_per_line": 18_000, "accept_doubts": list(accepts)}}
        config = load_config(preset="prc-2019-urban", options=options)
        summary = stream(io.BytesIO(thin.tobytes()), io.BytesIO(), config, doubted=doubts.append)
        assert [doubt.check for doubt in summary.doubts] == ([] if accepts else ["returns"])
        assert [finding.check for finding in summary.findings if finding.is_accepted] == list(
            accepts
        )
    assert [doubt.check for doubt in doubts] == ["returns"]


def test_labels_are_checked_as_they_leave():
    stray = street(1100)
    stray[:, ::2] = np.random.default_rng(1).uniform(
        1, 80, stray[:, ::2].shape
    )  # noise, whatever the order may be
    others = [name for name in CHECK_NAMES if name != "noise-share"]
    options = {
        "input": {"points_per_line": POINTS_PER_LINE, "accept_doubts": others},
        "prc": {"lines_per_block": 16},
    }
    sink = io.BytesIO()
    with pytest.raises(EvidenceError, match="of the returns are noise"):
        stream(
            io.BytesIO(stray.tobytes()), sink, load_config(preset="prc-2019-urban", options=options)
        )
    assert 1024 * POINTS_PER_LINE <= len(sink.getvalue()) < stray.size


class Dribble:
    """Gives out bytes in pieces of random size."""

    def __init__(self, data: bytes, rng: np.random.Generator) -> None:
        self._data = data
        self._rng = rng

    def fileno(self) -> int:
        raise OSError

    def read(self, size: int = -1, /) -> bytes:
        n = min(int(self._rng.choice([1, 3, 7, 100, 5000])), size)
        piece = self._data[:n]
        self._data = self._data[n:]
        return piece


class SlowSink:
    """Takes some of the bytes at a time."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.data = bytearray()
        self._rng = rng

    def write(self, data: memoryview, /) -> int:
        n = int(self._rng.integers(1, len(data) + 1))
        self.data += data[:n]
        return n


@pytest.mark.parametrize("seed", range(4))
def test_every_way_gives_the_same_bytes(tmp_path, seed):
    rng = np.random.default_rng(seed)
    width = int(rng.choice([1, 2, 3, 4, 9, 40]))
    k = int(rng.choice([1, 2, 3, 8]))
    n = int(rng.integers(1, 40)) * width + int(
        rng.integers(0, width)
    )  # the last line may be cut short
    pool = np.array([5, 5.2, 10, 20, np.nan, -1, np.inf, 0, 1e9], np.float32)
    shots = np.repeat(rng.choice(pool, n, p=[0.3, 0.3, 0.1, 0.1, 0.1, 0.03, 0.02, 0.03, 0.02]), 4)[
        :n
    ]
    source = tmp_path / "in.bin"
    shots.tofile(source)
    environment = "forest" if seed % 4 == 3 else "urban"
    options = {
        "prc": {"lines_per_block": k, "surfaces": {"area": 3.0}},
        "input": {"points_per_line": width, "partial_line": "pad"},
    }
    config = load_config(preset=environment, options=options)
    outputs = []
    for threads in (1, 2, 8):
        output = tmp_path / f"{threads}.npy"
        classify(source, output, config, threads=threads)
        outputs.append(output.read_bytes())
    assert len(set(outputs)) == 1
    whole = np.load(output).ravel()[:n]
    sink = SlowSink(rng)
    stream(Dribble(shots.tobytes(), rng), sink, config)
    np.testing.assert_array_equal(np.frombuffer(bytes(sink.data), np.uint8), whole)
