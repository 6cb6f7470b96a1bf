"""Names that were typed almost right."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")


def same_name(typed: str, names: Iterable[str]) -> str | None:
    """Return the name that differs from the typed one only by case, ``-`` and ``_``.

    >>> same_name("Sequential_Angle", ["prc", "sequential-angle"])
    'sequential-angle'
    """
    known = tuple(names)
    if typed in known:
        return typed
    return next((name for name in known if _plain(name) == _plain(typed)), None)


def nearest(typed: str, names: Iterable[str], cutoff: float = 0.6) -> str | None:
    """Return the most similar name, if one is similar enough.

    >>> nearest("fuzed", ["prc", "fused"])
    'fused'
    """
    by_plain = {_plain(name): name for name in names}
    near = difflib.get_close_matches(_plain(typed), by_plain, n=1, cutoff=cutoff)
    return by_plain[near[0]] if near else None


def did_you_mean(typed: str, names: Iterable[str]) -> str:
    """Return the question for a misspelt name; empty if no name is similar.

    >>> did_you_mean("fuzed", ["prc", "fused"])
    "did you mean 'fused'?"
    """
    near = nearest(typed, names)
    return f"did you mean {near!r}?" if near else ""
