"""Fills the cache of compiled code, on all cores, by one process at a time.

After installation the loops are compiled once. Processes that start at the same time, such as those of a batch, would
all compile the same loops; so one of them does, with child processes on its share of the cores, and the others wait. If
anything fails here, a loop is compiled when it is used.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numba

from prc_cli.core.garbage import no_collecting
from prc_cli.core.threads import default_threads
from prc_cli.kernels.cache import loops_folder, writable_cache

try:
    import fcntl
except ImportError:  # not on this system: processes then compile in parallel
    fcntl = None  # type: ignore[assignment]
from dataclasses import dataclass

import llvmlite.binding  # type: ignore[import-untyped]

from prc_cli.kernels import KERNELS

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
    with _alone(folder), contextlib.suppress(OSError):
        # the longest first, so that short ones remain for the end
        missing = sorted(_missing(modules, folder), key=lambda module: -_source(module).stat().st_size)
        with (
            tempfile.TemporaryDirectory(prefix="prc-shares-", dir=folder, ignore_cleanup_errors=True) as shares,
            _children(min(default_threads(), len(missing)) - 1, shares, missing),
        ):
            compile_unclaimed(Path(shares), missing)


def compile_unclaimed(shares: Path, modules: Sequence[str]) -> None:
    """Compile the modules that no other process has claimed; faster processes take more."""
    folder = writable_cache()
    if folder is None:
        return
    for module in modules:
        try:
            (shares / module).open("xb").close()
        except OSError:  # claimed by another process, or the folder is not writable: compiled when used
            continue
        import_module(module)
        with contextlib.suppress(OSError):
            (loops_folder(folder, _source(module)) / _WHOLE).touch()


def _missing(modules: Sequence[str], folder: Path) -> list[str]:
    return [module for module in modules if module not in sys.modules and not is_compiled(module, folder)]


def is_compiled(module: str, folder: Path) -> bool:
    """Whether a cache folder holds the kernels of a module, given by its full name."""
    return (loops_folder(folder, _source(module)) / _WHOLE).exists()


def _source(module: str) -> Path:
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin)


@contextlib.contextmanager
def _children(n: int, shares: str, modules: Sequence[str]) -> Iterator[None]:
    """Start processes that compile, if possible, with the import path of this one; end them after a while."""
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    # -P: nothing is imported from the current folder
    code = f"from prc_cli.kernels import load_compiler as load; load(); from {__name__} import main; main()"
    command = [sys.executable, "-P", "-c", code, shares, *modules]
    children: list[subprocess.Popen[bytes]] = []
    with contextlib.suppress(OSError, ValueError):
        for _ in range(n):
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": path},
            )  # fmt: skip
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
    """Wait, with a time limit, until no other process compiles; the system releases locks of dead processes."""
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


def main() -> None:
    """Compile, in this process, modules that no other process compiles."""
    with no_collecting():
        compile_unclaimed(Path(sys.argv[1]), sys.argv[2:])


VECTORS = ("avx512f", "avx2", "avx", "sse4.2", "sve", "neon")
"""Vector extensions that speed up loops, the best first."""


@dataclass(frozen=True, slots=True)
class About:
    """Processor and compiler."""

    processor: str
    """Name by the compiler."""
    features: tuple[str, ...]
    """Extensions of :data:`VECTORS` in use."""
    compiles: bool
    """False where compiling is turned off (``NUMBA_DISABLE_JIT``)."""


@dataclass(frozen=True, slots=True)
class CacheState:
    """The folder of compiled kernels."""

    folder: Path | None
    """None if no folder is writable."""
    n_bytes: int
    n_compiled: int
    """Modules with kernels in the cache for this source, compiler and processor."""
    n_modules: int


def about() -> About:
    """Return the processor as the compiler sees it."""
    has = llvmlite.binding.get_host_cpu_features()
    config = numba.config
    return About(
        llvmlite.binding.get_host_cpu_name(),
        tuple(name for name in VECTORS if has.get(name)),
        not config.DISABLE_JIT,  # type: ignore[attr-defined]
    )


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
    return CacheState(folder, n_bytes, sum(is_compiled(module, folder) for module in modules), len(modules))
