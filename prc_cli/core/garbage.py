"""A garbage collector that waits while there is no garbage."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def no_collecting() -> Iterator[None]:
    """Do not look for garbage meanwhile.

    Loading packages and the compiler makes hundreds of thousands of objects that stay. Looking through them again and
    again takes a tenth of the time of a short command, and finds little.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
