"""Compiling without double work gives the same loops, and leaves the compiler as it was."""

from __future__ import annotations

import os
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.compiler import Flags
from numba.core.registry import cpu_target
from numba.core.targetconfig import TargetConfig

from prc_cli.kernels import lean
from prc_cli.kernels.cache import helper

pytestmark = pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")


@helper
def _inverse(value: float) -> float:
    if value == 0.0:
        raise ValueError(value)
    return 1.0 / value


def _inverses(values: object, n: int) -> object:
    found = np.empty(n, np.float64)
    for i in range(n):
        found[i] = _inverse(values[i])  # type: ignore[index]
    return found


def _internals() -> tuple[object, ...]:
    codegen = cpu_target.target_context.codegen()
    return codegen._library_class, codegen.set_env, TargetConfig.__hash__, TargetConfig.__eq__


def test_function_that_calls_another_and_makes_an_array() -> None:
    before = _internals()
    with lean.lean_compiler():
        assert lean._Once is cpu_target.target_context.codegen()._library_class
        compiled = numba.njit("float64[::1](float64[::1], int64)")(_inverses)
    assert _internals() == before
    np.testing.assert_array_equal(compiled(np.array([2.0, 4.0]), 2), [0.5, 0.25])
    # what it raises is made at run time, from what the private function brought along
    with pytest.raises(ValueError, match="0"):
        compiled(np.array([2.0, 0.0]), 2)


def test_internals_are_put_back_after_an_error() -> None:
    before = _internals()
    with pytest.raises(RuntimeError), lean.lean_compiler():
        raise RuntimeError
    assert _internals() == before


def test_another_numba_compiles_its_own_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lean, "_KNOWN", False)
    before = _internals()
    with lean.lean_compiler():
        assert _internals() == before


def test_settings_are_equal_as_the_compiler_says() -> None:
    flags: Any = Flags  # whose settings come to be while it is made
    plain, same, other = flags(), flags(), flags()
    same.nrt = plain.options["nrt"].default  # said, but nothing new
    other.nrt = not plain.options["nrt"].default
    expected = [[one == two for one in (plain, same, other)] for two in (plain, same, other)]
    hashes = [hash(plain), hash(same), hash(other)]
    with lean.lean_compiler():
        assert [[one == two for one in (plain, same, other)] for two in (plain, same, other)] == expected
        assert [hash(plain), hash(same), hash(other)] == hashes
        assert plain != "flags"
