"""Loads kernels: the compiled loops, or their plain twins in :mod:`prc_cli.reference`."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.process import absent, held, no_collecting

_TABLE = Path(__file__).with_name("__init__.pyi")
_REFERENCE = "prc_cli.reference."


def _read_table() -> dict[str, str]:
    """Read the module of every kernel from the imports of the table."""
    imports = (
        node
        for node in ast.parse(_TABLE.read_text("utf-8")).body
        if isinstance(node, ast.ImportFrom)
    )
    modules = {alias.name: str(node.module) for node in imports for alias in node.names}
    return {name: module for name, module in modules.items() if module != __name__}


KERNELS = _read_table()
"""Module of every kernel, by name."""

Engine: TypeAlias = Literal["compiled", "reference"]
"""Which form of the kernels runs: the compiled loops, or their plain twins."""
ENGINES: tuple[Engine, ...] = get_args(Engine)

PLAIN = frozenset({"clean_ranges"})
"""Kernels whose twins do until the compiler is loaded.

To look at a file takes half the time without it.
"""

# of a thread and what it starts: a run beside this one keeps its own
_engine: ContextVar[Engine] = ContextVar("engine", default="compiled")
_loaded: dict[tuple[Engine, str], Callable[..., Any]] = {}


@contextmanager
def use_engine(engine: Engine) -> Iterator[None]:
    """Let the kernels inside this context be of one engine.

    With ``reference`` the compiler is never loaded.
    """
    if engine not in ENGINES:
        raise ConfigError("engine", f"found {engine!r}, expected {' or '.join(ENGINES)}")
    before = _engine.set(engine)
    try:
        yield
    finally:
        _engine.reset(before)


def find_kernel(name: str) -> Callable[..., Any]:
    """Return a kernel, loaded at its first use, from the cache if compiled before."""
    engine = _engine.get()
    if name in PLAIN and "numba" not in sys.modules:
        engine = "reference"
    if (engine, name) not in _loaded:
        if engine == "compiled":
            load_compiler()
            with _unneeded_absent():  # which numba looks for when it first compiles
                kernel = getattr(import_module(KERNELS[name]), name)
        else:
            kernel = getattr(import_module(reference_home(name)), name)
        _loaded[engine, name] = held(kernel)
    return _loaded[engine, name]


def load_compiler() -> None:
    """Load numba."""
    try:
        with _unneeded_absent():
            import_module("numba")
    except (ImportError, OSError) as error:
        hint = (
            "pip install --force-reinstall numba; "
            "until then prc classify --engine reference is the slow way"
        )
        raise PrcError("numba", f"cannot be loaded ({error})", hint) from error


_SETTINGS = ("yaml",)
"""With it, numba reads a file of settings in the current folder, which may be anybody's."""
_UNNEEDED = ("cffi", "coverage", "scipy.linalg")
"""What numba looks for and does without in the command's own process: a fifth of a short run."""


def _unneeded_absent() -> AbstractContextManager[None]:
    """Let what numba is to do without seem not to be installed."""
    return absent(*_UNNEEDED, always=_SETTINGS)


def reference_home(name: str) -> str:
    """Return the module of a kernel's twin in :mod:`prc_cli.reference`.

    >>> reference_home("surface_image"), reference_home("dilate")
    ('prc_cli.reference.sequential_angle.coarse', 'prc_cli.reference.prc.stages')
    """
    method, module = short_name(KERNELS[name]).split(".")
    for home in (f"{_REFERENCE}{method}.{module}", f"{_REFERENCE}{method}.stages"):
        if (
            find_spec(f"{_REFERENCE}{method}")
            and find_spec(home)
            and hasattr(import_module(home), name)
        ):
            return home
    problem = f"found reference, but {method} is written as compiled loops alone ({module}.{name})"
    raise ConfigError(
        "engine", problem, "use --preset urban, forest or street-scan, or leave out --engine"
    )


def load_kernels(modules: frozenset[str] | None = None) -> None:
    """Compile kernels on all cores, one process at a time, or load them.

    Call it before threads start.
    """
    wanted = {
        name: home for name, home in KERNELS.items() if modules is None or _is_in(home, modules)
    }
    with no_collecting():
        if _engine.get() == "compiled":
            load_compiler()
            from prc_cli.kernels.compiling import compile_missing  # which loads the compiler

            with _unneeded_absent():
                compile_missing(sorted(set(wanted.values())))
        for name in wanted:
            find_kernel(name)


def short_name(home: str) -> str:
    """Return the short name of a module of loops.

    >>> short_name("prc_cli.methods.fused.votes_loops")
    'fused.votes'
    """
    return ".".join(home.removesuffix("_loops").split(".")[-2:])


def _is_in(home: str, modules: frozenset[str]) -> bool:
    """Whether a module, or its folder, is among short names."""
    name = short_name(home)
    return name in modules or name.partition(".")[0] in modules
