"""The first records of a source are decoded once, however many readers ask for them."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import InputConfig
from prc_cli.formats.records import RecordChunk
from prc_cli.streams import head as heads
from prc_cli.streams.grid import open_grid
from prc_cli.streams.head import Head
from tests.streams.record_lists import MemorySource, scene

N = 2_000


def numbers(*names: str) -> MemorySource:
    return MemorySource({name: np.arange(N) + 1000 * i for i, name in enumerate(names)}, 100)


@pytest.fixture
def short_head(monkeypatch):
    """Keep three chunks."""
    monkeypatch.setattr(heads, "HEAD_RECORDS", 300)


def read(head: Head, name: str, n_chunks: int | None = None) -> list[int]:
    chunks = islice(head.chunks((name,)), n_chunks)
    return [int(value) for chunk in chunks for value in chunk.values[name]]


def test_every_reader_may_go_on_to_the_end(short_head):
    source = numbers("time", "range")
    head = Head(source)
    for _ in range(3):
        assert read(head, "time") == list(range(N))
        assert read(head, "time", 3) == list(range(300))
    assert len(source.reads) == 3


@dataclass
class Damaged(MemorySource):
    """Records whose angle cannot be read from record 150 on."""

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        for chunk in super().chunks(names):
            if "angle" in names and chunk.first_record >= 100:
                raise InputError(self.path, "found 'x', expected a number")
            yield chunk


def test_damage_counts_only_in_dimensions_that_were_asked_for(short_head):
    head = Head(Damaged(numbers("time", "angle").values, 100), {"angle"})
    assert read(head, "time") == list(range(N))
    assert read(head, "time", 2) == list(range(200))
    for _ in range(2):
        with pytest.raises(InputError, match="expected a number"):
            read(head, "angle")


def test_rules_and_setup_decode_the_head_once():
    source = MemorySource(scene()[1], 100)
    stream = open_grid(source, InputConfig())
    assert len(source.reads) == 2  # and the pass that counts the columns
    list(stream.blocks())
    assert len(source.reads) == 3
    list(stream.blocks())
    assert len(source.reads) == 4
