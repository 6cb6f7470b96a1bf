"""Contexts of classes: packed, read in other batches than written, and limited in memory."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.formats.las import splice as laz_contexts
from prc_cli.formats.las.splice import LazContexts, contexts_of, records_of


def test_every_return_byte_and_channel_comes_back() -> None:
    records = np.zeros((1024, 30), np.uint8)
    records[:, 14] = np.arange(1024) % 256
    records[:, 15] = np.arange(1024) // 256 << 4 | 0x8F
    contexts = contexts_of(records)
    number, count = records[:, 14] & 15, records[:, 14] >> 4
    assert np.array_equal(contexts >= 4, (number == 1) & (number >= count))
    assert np.array_equal(contexts & 3, np.arange(1024) // 256)
    assert np.array_equal(contexts_of(records_of(contexts)), contexts)


@pytest.mark.parametrize("n", [1, 7, 100, 1000])
def test_pieces_may_be_cut_anywhere(n: int) -> None:
    rng = np.random.default_rng(n)
    parts = [rng.integers(0, 8, size).astype(np.uint8) for size in (5, 1, 44, 0, 101)]
    parts.insert(2, np.full(33, 4, np.uint8))
    kept = LazContexts()
    for part in parts:
        kept.see(kept.n_seen, part)
    taken = list(kept.take(n))
    assert np.array_equal(np.concatenate(taken), np.concatenate(parts))
    assert all(len(piece) == n for piece in taken[:-1])


def test_what_does_not_follow_is_ignored() -> None:
    kept = LazContexts()
    kept.see(3, np.zeros(2, np.uint8))
    kept.see(0, np.zeros(2, np.uint8))
    kept.see(1, np.zeros(2, np.uint8))
    assert kept.n_seen == 2


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laz_contexts, "KEPT_BYTES", 20)
    kept = LazContexts()
    kept.see(0, np.arange(20, dtype=np.uint8) % 8)
    kept.see(20, np.full(1000, 4, np.uint8))
    kept.see(1020, np.arange(4, dtype=np.uint8))
    assert kept.n_seen == 1020
