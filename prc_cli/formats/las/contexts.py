"""Contexts of the class coder in LAZ files, kept from reading a file to rewrite it faster.

In LASzip's chunks of point formats 6-10 the code of a class depends on the class before it, on the scanner channel
and on whether the record is the only return of its shot. They are known once a file was decoded for its ranges; keeping
them saves the writer a second decompression of coordinates and returns, the slowest layer.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import U8

KEPT_BYTES = 32 << 20
"""Memory limit for contexts that differ from record to record, enough for 64 million records."""
_ONLY = 4
"""Bit of a context: single return; the two bits below hold the channel."""


@dataclass(frozen=True, slots=True)
class _Run:
    """Contexts of consecutive records: one value for all, or two per byte."""

    n: int
    value: int
    packed: U8 | None

    def contexts(self) -> U8:
        if self.packed is None:
            return np.full(self.n, self.value, np.uint8)
        both = np.stack([self.packed & 0x0F, self.packed >> 4], axis=1)
        every: U8 = both.reshape(-1)
        return every[: self.n]


def contexts_of(records: U8) -> U8:
    """Return the contexts of raw records.

    Return 1 of 1 in channel 2, return 1 of 3 in channel 0:

    >>> records = np.zeros((2, 30), np.uint8)
    >>> records[:, 14], records[:, 15] = (0x11, 0x31), (0x20, 0x00)
    >>> contexts_of(records)
    array([6, 0], dtype=uint8)
    """
    returns = records[:, 14]
    # return 1 of at most 1
    only = (returns & np.uint8(0xEF)) == 1
    channel = (records[:, 15] >> np.uint8(4)) & np.uint8(3)
    contexts: U8 = channel | (only.view(np.uint8) << np.uint8(2))
    return contexts


def records_of(contexts: U8, n_bytes: int) -> U8:
    """Return raw records with these contexts, else zero, (n, n_bytes) uint8; the inverse of :func:`contexts_of`."""
    records = np.zeros((len(contexts), n_bytes), np.uint8)
    records[:, 14] = np.where(contexts & _ONLY, 0x11, 0x21).astype(np.uint8)
    records[:, 15] = (contexts & 3) << np.uint8(4)
    return records


class LazContexts:
    """Contexts of the records of one file, from the first record on, as far as read and within the memory limit.

    Not locked: one thread adds at a time, and nobody reads before it has finished.

    >>> kept = LazContexts()
    >>> kept.see(0, np.array([4, 4, 4], np.uint8))
    >>> kept.see(3, np.array([4, 0, 1], np.uint8))
    >>> kept.see(0, np.array([7], np.uint8))  # read a second time
    >>> kept.n_seen, list(kept.take(4))
    (6, [array([4, 4, 4, 4], dtype=uint8), array([0, 1], dtype=uint8)])
    """

    def __init__(self) -> None:
        self.n_seen = 0
        self.n_checked = 0
        """Records of which every layer was decoded, from the first one."""
        self._runs: list[_Run] = []
        self._n_bytes = 0
        self._lock = threading.Lock()

    def see(self, first: int, contexts: U8) -> None:
        """Keep the contexts of records that follow those seen so far; others are ignored."""
        n = len(contexts)
        with self._lock:
            if first != self.n_seen or not n:
                return
            value, packed = int(contexts[0]), None
            if np.any(contexts != contexts[0]):
                if self._n_bytes + n // 2 > KEPT_BYTES:
                    return
                even = np.zeros(n + n % 2, np.uint8)
                even[:n] = contexts
                packed = even[::2] | (even[1::2] << np.uint8(4))
                self._n_bytes += len(packed)
            self._runs.append(_Run(n, value, packed))
            self.n_seen += n

    def check(self, first: int, n: int) -> None:
        """Note that every layer of ``n`` records could be decoded; only those that follow the last ones count."""
        with self._lock:
            if first == self.n_checked:
                self.n_checked += n

    def take(self, n: int) -> Iterator[U8]:
        """Yield the contexts kept, ``n`` at a time, fewer at the end."""
        waiting: list[U8] = []
        n_waiting = 0
        for run in self._runs:
            contexts = run.contexts()
            while n_waiting + len(contexts) >= n:
                cut = n - n_waiting
                yield np.concatenate([*waiting, contexts[:cut]])
                waiting, n_waiting, contexts = [], 0, contexts[cut:]
            if len(contexts):
                waiting.append(contexts)
                n_waiting += len(contexts)
        if waiting:
            yield np.concatenate(waiting)
