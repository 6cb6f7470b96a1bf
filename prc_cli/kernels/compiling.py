"""Fills the cache of compiled code, on all cores, by one process at a time.

After installation the loops are compiled once. Processes that start at the same time, such as those of a batch, would
all compile the same loops; so one of them does, with child processes on its share of the cores, and the others wait. If
anything fails here, a loop is compiled when it is used.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import llvmlite.binding  # type: ignore[import-untyped]
import numba

from prc_cli.core.garbage import no_collecting
from prc_cli.core.threads import default_threads
from prc_cli.kernels.cache import writable_cache

try:
    import fcntl
except ImportError:  # not on this system: processes then compile in parallel
    fcntl = None  # type: ignore[assignment]

PATIENCE_S = 30.0
"""Longest wait for another process to compile, about the time to compile everything alone [s]."""
_TICK_S = 0.05
_LOCK = "prc-compiling.lock"
_KERNELS, _THRESHOLDS = "prc_cli.kernels.", "prc_cli.core.thresholds."


def compile_missing(modules: Sequence[str]) -> None:
    """Compile the kernels of modules that are not in the cache.

    Parameters
    ----------
    modules : sequence of str
        Full names.
    """
    folder = writable_cache()
    if folder is None or numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return
    if not _missing(modules, folder):
        return
    with _alone(folder):
        missing = _largest_first(_missing(modules, folder))
        try:
            shares = Path(tempfile.mkdtemp(prefix="prc-shares-", dir=folder))
        except OSError:
            return
        children: list[subprocess.Popen[bytes]] = []
        try:
            started = (_start(shares, missing) for _ in range(min(default_threads(), len(missing)) - 1))
            children.extend(child for child in started if child is not None)
            _compile_unclaimed(shares, missing, folder)
            for child in children:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.wait(PATIENCE_S)
        finally:
            for child in children:
                if child.poll() is None:
                    child.kill()
                    child.wait()
            shutil.rmtree(shares, ignore_errors=True)


def _largest_first(modules: Sequence[str]) -> list[str]:
    """Sort modules by length of source, the longest first, so that short ones remain for the end."""
    return sorted(modules, key=lambda module: -_source(module).stat().st_size)


def _compile_unclaimed(shares: Path, modules: Sequence[str], folder: Path) -> None:
    """Compile the modules that no other process has claimed; faster processes take more."""
    for module in modules:
        try:
            (shares / module).open("xb").close()
        except OSError:  # claimed by another process, or the folder is not writable: compiled when used
            continue
        _compile(module, folder)


def _missing(modules: Sequence[str], folder: Path) -> list[str]:
    return [module for module in modules if module not in sys.modules and not is_compiled(module, folder)]


def is_compiled(module: str, folder: Path) -> bool:
    """Whether a cache folder holds the kernels of a module, given by its full name."""
    return _mark(module, folder).exists()


def _mark(module: str, folder: Path) -> Path:
    """File that says that the kernels of a module are in the cache, for these sources, compiler and processor."""
    known_by = (
        module, *(_state(source) for source in _sources(module)), sys.version, numba.__version__,
        llvmlite.binding.get_host_cpu_name(), llvmlite.binding.get_host_cpu_features().flatten(),
    )  # fmt: skip
    known = sha256(repr(known_by).encode()).hexdigest()[:16]
    return folder / f"prc-{module.removeprefix(_KERNELS)}-{known}.compiled"


def _sources(module: str) -> Iterator[Path]:
    """Yield the source of a module, and that of the thresholds of its method, whose fields its kernels read."""
    yield _source(module)
    method = module.removeprefix(_KERNELS).partition(".")[0]
    if find_spec(f"{_THRESHOLDS}{method}") is not None:
        yield _source(f"{_THRESHOLDS}{method}")


def _state(source: Path) -> tuple[Path, int, int]:
    """Return what changes when a file does."""
    status = source.stat()
    return source, status.st_mtime_ns, status.st_size


def _source(module: str) -> Path:
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin)


def _compile(module: str, folder: Path) -> None:
    """Compile a module."""
    import_module(module)
    with contextlib.suppress(OSError):
        _mark(module, folder).touch()


def _start(shares: Path, modules: Sequence[str]) -> subprocess.Popen[bytes] | None:
    """Start compiling in a child process, if possible; it uses the import path of this process."""
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    try:
        return subprocess.Popen(
            # -P: nothing is imported from the current folder
            [sys.executable, "-P", "-m", __name__, str(shares), *modules],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": path},
        )  # fmt: skip
    except (OSError, ValueError):
        return None


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


def main(shares: str, modules: Sequence[str]) -> None:
    """Compile, in this process, modules that no other process compiles."""
    folder = writable_cache()
    if folder is not None:
        with no_collecting():
            _compile_unclaimed(Path(shares), modules, folder)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
