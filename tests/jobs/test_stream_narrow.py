"""Live streams of very short lines and blocks, in pieces of any size, against files, for any number of threads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.jobs.classify import classify
from prc_cli.jobs.stream import stream

NOISE = ClassCodes().lookup()[Label.NOISE]


class Dribble:
    """Gives out bytes in pieces of random size."""

    def __init__(self, data: bytes, rng: np.random.Generator) -> None:
        self._data, self._rng = data, rng

    def fileno(self) -> int:
        raise OSError

    def read(self, size: int = -1, /) -> bytes:
        n = min(int(self._rng.choice([1, 3, 7, 100, 5000])), size)
        piece, self._data = self._data[:n], self._data[n:]
        return piece


class SlowSink:
    """Takes some of the bytes at a time."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.data, self._rng = bytearray(), rng

    def write(self, data: memoryview, /) -> int:
        n = int(self._rng.integers(1, len(data) + 1))
        self.data += data[:n]
        return n


@pytest.mark.parametrize("seed", range(12))
def test_every_way_gives_the_same_bytes(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    width, k = int(rng.choice([1, 2, 3, 4, 9, 40])), int(rng.choice([1, 2, 3, 8]))
    n = int(rng.integers(1, 40)) * width + int(rng.integers(0, width))  # the last line may be cut short
    pool = np.array([5, 5.2, 10, 20, np.nan, -1, np.inf, 0, 1e9], np.float32)
    shots = np.repeat(rng.choice(pool, n, p=[0.3, 0.3, 0.1, 0.1, 0.1, 0.03, 0.02, 0.03, 0.02]), 4)[:n]
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
