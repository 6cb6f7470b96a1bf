"""What other packages add to this one, by entry points: formats and methods."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from typing import Any


@cache
def installed() -> Any:
    """Return the entry points of all installed packages, which takes 15 ms to read."""
    return entry_points()


def load_plugins(group: str) -> tuple[Any, ...]:
    """Load what other packages name in a group of entry points."""
    return tuple(entry.load() for entry in installed().select(group=group))
