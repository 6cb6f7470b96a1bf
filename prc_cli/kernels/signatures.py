"""Numba types for signatures that name the type of a ``NamedTuple``, which no string can.

Their own types are left out: some versions of numba have them and others do not.
"""

from __future__ import annotations

from typing import Any

import numba

_types: Any = numba.types

Tuple, UniTuple = _types.Tuple, _types.UniTuple
boolean, uint8, uint64 = _types.boolean, _types.uint8, _types.uint64
int32, int64, float32, float64 = _types.int32, _types.int64, _types.float32, _types.float64


def named(thresholds: type[tuple[Any, ...]], number: Any) -> Any:
    """Return the numba type of a ``NamedTuple`` all of whose fields are numbers of one type.

    Parameters
    ----------
    thresholds : type
        The class.
    number : numba type
        Such as :data:`float32`.
    """
    fields: tuple[str, ...] = thresholds._fields  # type: ignore[attr-defined]
    return _types.NamedUniTuple(number, len(fields), thresholds)
