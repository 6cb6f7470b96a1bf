"""The choice of a method leaves no reader open but the one of the blocks that come next."""

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from prc_cli import load_config
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock, ScanStream, StreamInfo
from prc_cli.core.threads import read_ahead
from prc_cli.formats.input import Input
from prc_cli.jobs.choice import choose
from prc_cli.streams.open import open_input
from prc_cli.streams.stream import Stream
from tests.methods.fused.street_lines import BEAM, street_lines


class ThreadedStream:
    """A stream that is read in a thread; it keeps its iterators, so nothing else closes them."""

    def __init__(self, stream: ScanStream, *, fails: bool) -> None:
        self._stream = stream
        self._fails = fails
        self._iterators: list[Iterator[ScanBlock]] = []

    @property
    def info(self) -> StreamInfo:
        return self._stream.info

    def blocks(self) -> Iterator[ScanBlock]:
        self._iterators.append(read_ahead(self._read(), depth=1))
        return self._iterators[-1]

    def _read(self) -> Iterator[ScanBlock]:
        yield from self._stream.blocks()
        if self._fails:
            raise InputError("street.npz", "damaged")


@pytest.mark.parametrize("fails", [False, True])
def test_threads_of_readers_end_with_the_choice(tmp_path, fails):
    path = tmp_path / "street.npz"
    np.savez(path, range_m=street_lines(30)[0], angle_deg=np.rad2deg(BEAM))
    config = load_config().config
    stream = ThreadedStream(open_input(Input.of(path), config.input, lines_at_once=8), fails=fails)
    before = threading.active_count()
    choice, chosen = choose(Stream.of(stream), config)
    assert threading.active_count() <= before + (not fails)
    chosen.first.forget()
    assert threading.active_count() == before
    assert choice.preset == ("prc-2019-urban" if fails else "fused")
