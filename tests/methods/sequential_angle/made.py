"""Thresholds with values of the types that the compiled loops take."""

from __future__ import annotations

from typing import Any, TypeVar

TupleT = TypeVar("TupleT", bound=tuple[Any, ...])


def made(kind: type[TupleT], **values: Any) -> TupleT:
    defaults: Any = kind()
    found: TupleT = defaults._replace(**{name: _like(getattr(defaults, name), values[name]) for name in values})
    return found


def _like(default: Any, value: Any) -> Any:
    if hasattr(default, "_fields"):
        return value
    if isinstance(default, tuple):
        return tuple(_like(one, other) for one, other in zip(default, value, strict=True))
    return type(default)(value)
