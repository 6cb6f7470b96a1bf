"""How tests wait: for what is to happen, not for a time that a slower machine would need to be longer."""

from __future__ import annotations

import time
from collections.abc import Callable

HANGS_S = 600.0
"""What has not come by then never comes [s]. No test asks how fast a machine is: this only ends what hangs."""


def wait_until(is_so: Callable[[], object], what: str = "") -> None:
    """Look until something is so.

    Raises
    ------
    AssertionError
        When it never is.
    """
    end = time.monotonic() + HANGS_S
    while not is_so():
        assert time.monotonic() < end, f"never came: {what or is_so}"
        time.sleep(0.01)
