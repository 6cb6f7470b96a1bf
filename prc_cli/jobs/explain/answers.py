"""Answers of the stages to one shot, ready to be printed."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Answer:
    """What one stage says of a shot."""

    stage: str
    found: str
    """What was measured."""
    so: str
    """What follows from it."""
    limits: tuple[tuple[str, Any], ...] = ()
    """Keys of the configuration or names of limits that decided, and their values."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**asdict(self), "limits": dict(self.limits)}


def metres(value: float, digits: int = 3) -> str:
    """Return a length for people.

    >>> metres(1.23456), metres(float("nan"))
    ('1.235 m', 'unknown')
    """
    return f"{value:.{digits}f} m" if value == value else "unknown"
