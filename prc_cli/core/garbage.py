"""Pauses Python's garbage collector while packages are loaded."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def no_collecting() -> Iterator[None]:
    """Switch the garbage collector off inside the ``with`` block.

    Loading packages and the compiler creates hundreds of thousands of permanent objects. Scanning them again and
    again takes a tenth of the time of a short command.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
