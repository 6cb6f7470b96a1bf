"""Loads kernels: the compiled loops, or their plain twins in :mod:`prc_cli.reference`."""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from prc_cli.core.errors import ConfigError
from prc_cli.core.garbage import no_collecting
from prc_cli.core.interrupts import held

_TABLE = Path(__file__).with_name("__init__.pyi")
_HOME = "prc_cli.kernels."
_REFERENCE = "prc_cli.reference."


def _read_table() -> dict[str, str]:
    """Read the module of every kernel from the imports of the table."""
    imports = (node for node in ast.parse(_TABLE.read_text("utf-8")).body if isinstance(node, ast.ImportFrom))
    found = {alias.name: str(node.module) for node in imports for alias in node.names}
    return {name: module for name, module in found.items() if module != __name__}


KERNELS = _read_table()
"""Module of every kernel, by name."""

_loaded: dict[str, Callable[..., Any]] = {}
_find_home: Callable[[str], str] = KERNELS.__getitem__


def find_kernel(name: str) -> Callable[..., Any]:
    """Return a kernel, loaded at its first use, from the cache if compiled before.

    Raises
    ------
    ConfigError
        When :func:`use_reference` was called and the kernel has no twin there.
    """
    if name not in _loaded:
        _loaded[name] = held(getattr(import_module(_find_home(name)), name))
    return _loaded[name]


def use_reference() -> None:
    """Use the plain twin of every kernel in this process from now on, without loading the compiler."""
    global _find_home
    _find_home = reference_home
    _loaded.clear()


def reference_home(name: str) -> str:
    """Return the module of a kernel's twin in :mod:`prc_cli.reference`.

    >>> reference_home("surface_image"), reference_home("dilate")
    ('prc_cli.reference.sequential_angle.coarse', 'prc_cli.reference.prc.stages')
    """
    method, _, module = KERNELS[name].removeprefix(_HOME).partition(".")
    for home in (f"{_REFERENCE}{method}.{module}", f"{_REFERENCE}{method}.stages"):
        if find_spec(f"{_REFERENCE}{method}") and find_spec(home) and hasattr(import_module(home), name):
            return home
    problem = f"found reference, but {method}.{module}.{name} is written as a compiled loop alone"
    raise ConfigError("engine", problem, "choose prc or sequential-angle")


def load_kernels(modules: frozenset[str] | None = None) -> None:
    """Compile kernels, on all cores and in one process at a time, or load them from the cache.

    Call it before worker processes or threads start.

    Parameters
    ----------
    modules : set of str, optional
        Folders or modules of kernels, such as ``simulation`` or ``prc.support``; default: all.

    Raises
    ------
    ConfigError
        When :func:`use_reference` was called and a kernel has no twin there.
    """
    wanted = {name: home for name, home in KERNELS.items() if modules is None or _is_in(home, modules)}
    with no_collecting():
        if _find_home is not reference_home:
            from prc_cli.kernels.compiling import compile_missing  # which loads the compiler

            compile_missing(sorted(set(wanted.values())))
        for name in wanted:
            find_kernel(name)


def _is_in(home: str, modules: frozenset[str]) -> bool:
    """Whether a module, or one of its folders, is among the names."""
    inside = home.removeprefix(_HOME)
    return inside in modules or inside.partition(".")[0] in modules
