"""The only home of compiled loops.

``__init__.pyi`` is the one table of kernels, for type checkers and for
:mod:`prc_cli.kernels.loading`. Every kernel of a published method has a slow and obvious
twin of the same name and arguments in :mod:`prc_cli.reference`; a test compares them bit for bit.
A kernel is loaded when it is first used, ``kernels.support_mask(...)``, so that
reading a configuration does not load the compiler.
"""

from __future__ import annotations

from typing import Any

from prc_cli.kernels.loading import (
    ENGINES,
    KERNELS,
    Engine,
    find_kernel,
    load_compiler,
    load_kernels,
    use_engine,
)

__all__ = ["ENGINES", "KERNELS", "Engine", "load_compiler", "load_kernels", "use_engine"]


def __getattr__(name: str) -> Any:
    if name not in KERNELS:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    return find_kernel(name)
