"""Lists of the few shots of a line that a loop looks at more closely."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.loops import helper
from prc_cli.core.types import I32

WORD = 8
"""Marks that are looked at together."""


@helper
def list_few(marks: NDArray[np.uint8] | NDArray[np.bool_], shots: I32) -> int:
    """List the marked shots of a line, return how many there are.

    Marks are 0 or 1, and most are 0: eight of them are skipped together. ``shots`` is longer than
    ``marks`` by one.
    """
    words = marks[: len(marks) // WORD * WORD].view(np.uint64)
    n = 0
    for k in range(len(words)):
        if words[k] != np.uint64(0):
            for i in range(WORD * k, WORD * k + WORD):
                shots[n] = i
                n += marks[i]
    for i in range(WORD * len(words), len(marks)):
        shots[n] = i
        n += marks[i]
    return n
