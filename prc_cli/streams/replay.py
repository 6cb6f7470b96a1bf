"""The first items of what can be read again and again, read once for several readers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Generic, TypeVar

from prc_cli.core.threads import close_items, closing_items

_Item = TypeVar("_Item")


class Replay(Generic[_Item]):
    """Readings whose first items are kept, for readers that come one after the other."""

    def __init__(
        self,
        begin: Callable[[], Iterator[_Item]],
        size_of: Callable[[_Item], int],
        most: int,
    ) -> None:
        self._begin = begin
        self._size_of = size_of
        self._most = most
        self._kept: deque[_Item] = deque()
        self._size = 0
        self._n_read = 0
        self._rest: Iterator[_Item] | None = None

    def forget(self) -> None:
        """Keep nothing: the next reader begins anew."""
        _, rest = self._take()
        if rest is not None:
            close_items(rest)

    def read_head(self) -> Iterator[_Item]:
        """Yield the items from the start, and keep the first ones, up to ``most`` of their size."""
        yield from tuple(self._kept)
        n_kept = len(self._kept)
        if n_kept < self._n_read:
            # another reader has gone on behind the kept items
            yield from islice(self._begin(), n_kept, None)
            return
        if self._rest is None:
            self._rest = self._begin()
        try:
            for item in self._rest:
                self._n_read += 1
                if self._size < self._most:
                    self._kept.append(item)
                    self._size += self._size_of(item)
                yield item
        except Exception:
            self.forget()
            raise

    def read_all(self) -> Iterator[_Item]:
        """Yield all items, the kept ones for the last time."""
        kept, rest = self._take()
        if rest is None:
            rest = self._begin()
        with closing_items(rest):
            while kept:
                yield kept.popleft()
            yield from rest

    def _take(self) -> tuple[deque[_Item], Iterator[_Item] | None]:
        """Return the kept items and what follows them, and keep nothing."""
        kept = self._kept
        rest = self._rest
        if len(kept) < self._n_read and rest is not None:
            close_items(rest)
            kept, rest = deque(), None
        self._kept = deque()
        self._size = 0
        self._n_read = 0
        self._rest = None
        return kept, rest
