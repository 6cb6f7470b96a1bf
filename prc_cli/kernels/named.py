"""How a signature names the type of a ``NamedTuple``."""

from __future__ import annotations

from typing import Any

from numba import types


def named(thresholds: type[tuple[Any, ...]], number: Any) -> Any:
    """Return the numba type of a ``NamedTuple`` all of whose fields are numbers of one type.

    Parameters
    ----------
    thresholds : type
        The class.
    number : numba type
        Such as ``numba.float32``.
    """
    return types.NamedUniTuple(number, len(thresholds._fields), thresholds)  # type: ignore[attr-defined]
