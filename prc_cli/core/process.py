"""Whose process this is: the command's own, or that of a program which imported the package."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class _State:
    own = False


def claim_process() -> None:
    """Say that this process is the command's own; for the command line.

    Then packages may be loaded without what prc never uses of them. In the process of somebody else they are loaded
    whole, since he may use the rest.
    """
    _State.own = True
    # pydantic then does not look through all installed packages for plugins
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")


def is_own_process() -> bool:
    """Whether :func:`claim_process` was called.

    >>> is_own_process()
    False
    """
    return _State.own


@contextmanager
def absent(*unneeded: str, always: tuple[str, ...] = ()) -> Iterator[None]:
    """Let modules seem not to be installed while a package is loaded that does without them.

    Those that are unneeded are only hidden in the command's own process, and where nobody has loaded them.
    """
    modules: dict[str, Any] = sys.modules
    hidden = always + tuple(name for name in unneeded if is_own_process() and name not in modules)
    before = {name: modules[name] for name in hidden if name in modules}
    modules.update(dict.fromkeys(hidden))
    try:
        yield
    finally:
        for name in hidden:
            modules.pop(name, None)
        modules.update(before)
