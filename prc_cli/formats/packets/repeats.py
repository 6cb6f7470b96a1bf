"""Count messages and packets that a recording has twice.

Of two recorders, or of parts that overlap.
"""

from __future__ import annotations

from dataclasses import dataclass, field

MOST_KEPT = 4096
"""Messages that are remembered."""
LEAST_SHARE = 0.01
"""Smaller shares of repeats are no warning."""


@dataclass(slots=True)
class Repeats:
    """Remembers the last messages of a topic, or packets of a scanner."""

    n: int = 0
    """Messages, all of them."""
    n_again: int = 0
    """Messages that are copies of earlier ones."""
    _known: dict[int, None] = field(default_factory=dict)

    def is_again(self, data: bytes) -> bool:
        """Take a message; return whether it is a copy of one of the last ones.

        >>> repeats = Repeats()
        >>> [repeats.is_again(data) for data in (b"one", b"two", b"one")]
        [False, False, True]
        """
        self.n += 1
        digest = hash(data)
        if digest in self._known:
            self.n_again += 1
            return True
        self._known[digest] = None
        if len(self._known) > MOST_KEPT:
            del self._known[next(iter(self._known))]
        return False

    def note(self, name: str) -> str:
        """Return a sentence on repeats; empty if there are few."""
        if self.n_again <= LEAST_SHARE * self.n:
            return ""
        return f"{self.n_again:,} of {self.n:,} {name} had come before, byte by byte"
