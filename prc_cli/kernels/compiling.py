"""Fills the cache of compiled code, on all cores, by one process at a time.

After installation the loops are compiled once. Processes that start at the same time, such as those
of a batch, would all compile the same loops; so one of them does, with child processes on its share
of the cores, and the others wait. If anything fails here, a loop is compiled when it is used.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import llvmlite.binding  # type: ignore[import-untyped]
import numba

from prc_cli.core.process import no_collecting
from prc_cli.core.threads import default_threads
from prc_cli.kernels import KERNELS
from prc_cli.kernels.cache import loops_folder, writable_cache

try:
    import fcntl
except ImportError:  # not on this system: processes then compile in parallel
    fcntl = None  # type: ignore[assignment]

PATIENCE_S = 30.0
"""Longest wait for another process to compile, about the time to compile everything alone [s]."""
_TICK_S = 0.05
_LOCK = "prc-compiling.lock"
_WHOLE = "compiled"
"""Empty file that says that all loops of a module are in its folder."""


def compile_missing(modules: Sequence[str]) -> None:
    """Compile the kernels of modules that are not in the cache."""
    folder = writable_cache()
    if folder is None or numba.config.DISABLE_JIT or not _missing(modules, folder):  # type: ignore[attr-defined]
        return
    with _alone(folder):
        # the largest first, dealt out in turns
        missing = sorted(
            _missing(modules, folder), key=lambda module: -_source(module).stat().st_size
        )
        n = max(1, min(default_threads(), len(missing)))
        with _children([missing[i::n] for i in range(1, n)]):
            compile_modules(missing[::n])
        compile_modules(
            [module for module in missing if not is_compiled(module, folder)]
        )  # what no child did


def compile_modules(modules: Sequence[str]) -> None:
    """Compile the kernels of modules in this process, into the cache."""
    with no_collecting():
        for module in modules:
            import_module(module)
            with contextlib.suppress(OSError):
                (loops_folder(writable_cache() or Path(), _source(module)) / _WHOLE).touch()


def _missing(modules: Sequence[str], folder: Path) -> list[str]:
    return [
        module
        for module in modules
        if module not in sys.modules and not is_compiled(module, folder)
    ]


def is_compiled(module: str, folder: Path) -> bool:
    """Whether a cache folder holds the kernels of a module, given by its full name."""
    return (loops_folder(folder, _source(module)) / _WHOLE).exists()


def _source(module: str) -> Path:
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin)


@contextlib.contextmanager
def _children(shares: Sequence[Sequence[str]]) -> Iterator[None]:
    """Start a process for each share of modules, if possible, with this import path.

    End them after a while.
    """
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    code = (
        "import sys; from prc_cli.kernels import load_compiler as load; load(); "
        f"from {__name__} import *; "
    )
    command = [
        sys.executable,
        "-P",
        "-c",
        f"{code}compile_modules(sys.argv[1:])",
    ]  # -P: nothing of the current folder
    children: list[subprocess.Popen[bytes]] = []
    with contextlib.suppress(OSError, ValueError):
        for share in shares:
            child = subprocess.Popen(
                [*command, *share],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": path},
            )
            children.append(child)
    try:
        yield
        for child in children:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(PATIENCE_S)
    finally:
        for child in children:
            child.kill()
            child.wait()


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait, with a time limit, until no other process compiles.

    The system releases locks of dead processes.
    """
    try:
        handle = (folder / _LOCK).open("ab")
    except OSError:
        yield
        return
    with handle:
        end = time.monotonic() + PATIENCE_S
        while fcntl is not None and time.monotonic() < end:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(_TICK_S)
            except OSError:  # a file system without locks
                break
            else:
                break
        yield


VECTORS = ("avx512f", "avx2", "avx", "sse4.2", "sve", "neon")
"""Vector extensions that speed up loops, the best first."""


class About(NamedTuple):
    """Processor and compiler: name, extensions of :data:`VECTORS` in use, whether it compiles."""

    processor: str
    features: tuple[str, ...]
    compiles: bool


class CacheState(NamedTuple):
    """The folder of compiled kernels (None = none is writable), its size, its modules, of all."""

    folder: Path | None
    n_bytes: int
    n_compiled: int
    n_modules: int


def about() -> About:
    """Return the processor as the compiler sees it."""
    has = llvmlite.binding.get_host_cpu_features()
    features = tuple(name for name in VECTORS if has.get(name))
    return About(llvmlite.binding.get_host_cpu_name(), features, not numba.config.DISABLE_JIT)  # type: ignore[attr-defined]


def cache_state() -> CacheState:
    """Return the contents of the cache."""
    modules = sorted(set(KERNELS.values()))
    folder = writable_cache()
    if folder is None:
        return CacheState(None, 0, 0, len(modules))
    n_bytes = 0
    for path in folder.rglob("*"):
        with contextlib.suppress(OSError):  # another process may remove it
            n_bytes += path.stat().st_size
    return CacheState(
        folder, n_bytes, sum(is_compiled(module, folder) for module in modules), len(modules)
    )
