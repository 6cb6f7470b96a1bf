"""Reads compiled loops from numba's cache without loading what numba compiles with.

Numba prepares to compile whenever it looks into its cache: it loads its versions of NumPy's functions, and the form of
each loop from which other loops could inline it. A command whose loops are all in the cache needs neither, and that is
a fifth of a short run. What is not in the cache is compiled as ever; numba prepares itself then.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime.nrt import rtsys

from prc_cli.kernels.loading import UNNEEDED, absent


class _Loops(CompileResultCacheImpl):
    """What is kept of a compiled function."""

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Load machine code; the form for inlining is replaced by one that only names the entry point.

        A loop compiled later in this process that calls this one would then call its machine code.
        """
        (name, kind, (code, _)), described, *others = payload
        if kind != "object":
            raise ValueError(f"found {kind} in the cache of compiled loops, expected object code")
        entry = f'define void @"{described.llvm_cpython_wrapper_name}"() {{ ret void }}'
        named = llvm.parse_assembly(entry).as_bitcode()
        return super().rebuild(target_context, ((name, kind, (code, named)), described, *others))  # type: ignore[no-untyped-call]


class WarmCache(FunctionCache):
    """Cache of one function's compiled code, for a process that runs loops and lets nobody else compile with them."""

    _impl_class = _Loops

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function for a signature; None = it is not in the cache."""
        rtsys.initialize(target_context)  # memory of arrays that loops make
        with self._guard_against_spurious_io_errors():
            found = self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None:
                return found
        with absent(UNNEEDED):  # it is compiled next
            target_context.refresh()
        return None
