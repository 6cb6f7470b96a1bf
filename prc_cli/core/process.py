"""Whose process this is: the command's own, or that of a program which imported the package."""

from __future__ import annotations

import os


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
