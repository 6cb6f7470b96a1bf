"""Contexts of classes: packed, read in other batches than written, and limited in memory."""

from __future__ import annotations

import numpy as np
import pytest

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
