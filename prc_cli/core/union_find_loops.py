"""Sets of numbers, joined step by step by a forest of parents (Galler and Fischer 1964)."""

from __future__ import annotations

from prc_cli.core.loops import inlined
from prc_cli.core.types import I32


@inlined
def find_root(parent: I32, number: int) -> int:
    """Return the first number of the set of a number, and shorten the path to it."""
    while parent[number] != number:
        parent[number] = parent[parent[number]]
        number = parent[number]
    return number
