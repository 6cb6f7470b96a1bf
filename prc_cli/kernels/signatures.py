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


def named(kind: type[tuple[Any, ...]], number: Any, /, **others: Any) -> Any:
    """Return the numba type of a ``NamedTuple``.

    Parameters
    ----------
    kind : type
        The class.
    number : numba type
        Of its fields, such as :data:`float32` ...
    others : numba type
        ... but for these.
    """
    fields: tuple[str, ...] = kind._fields  # type: ignore[attr-defined]
    # as numba.typeof has it
    if not others:
        return _types.NamedUniTuple(number, len(fields), kind)
    return _types.NamedTuple([others.get(field, number) for field in fields], kind)
