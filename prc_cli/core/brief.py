"""Results in one line, as an interactive session shows them, and as plain values for JSON."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

LONGEST = 120
"""Longest representation of an object [characters], but for its last value."""


class Brief:
    """Base of dataclasses whose representation is a line; they are decorated with ``repr=False``.

    >>> from dataclasses import dataclass
    >>> @dataclass(repr=False)
    ... class Run(Brief):
    ...     output: Path
    ...     labels: np.ndarray
    ...     findings: tuple[str, ...]
    >>> Run(Path("a.laz"), np.zeros((3, 4)), ("x", "y"))
    Run(output='a.laz', labels=array (3, 4), findings=2)
    """

    __slots__ = ()

    def __repr__(self) -> str:
        shown = ""
        for field in fields(self):  # type: ignore[arg-type]
            if len(shown) > LONGEST:
                return f"{type(self).__name__}({shown}, ...)"
            if field.repr and not field.name.startswith("_"):
                shown += f"{', ' if shown else ''}{field.name}={_short(getattr(self, field.name))}"
        return f"{type(self).__name__}({shown})"


def _short(value: Any) -> str:
    """Return a value in few words: arrays by shape, lists by length, others by type."""
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    if isinstance(value, tuple | list | dict | set | frozenset):
        return str(len(value))
    if value is None or isinstance(value, str | Path | int | float | np.generic):
        text = repr(str(value)) if isinstance(value, str | Path) else str(value)
        return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
    return f"<{type(value).__name__}>"


def finite(value: Any) -> Any:
    """Return plain values for JSON: numbers that are not finite as None, tuples as lists.

    >>> finite({"a": (1.0, float("nan"))})
    {'a': [1.0, None]}
    """
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
