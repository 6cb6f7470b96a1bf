"""Compiles loops into the cache on all cores, in one process of the user at a time.

After installation all loops are compiled once. Processes that start at the same time, such as those
of a batch, would all compile the same ones; so one of them does, with child processes, and the
others wait. If anything fails here, a loop is compiled when it is called.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path

from prc_cli.core.loop_cache import compiling_lock, loops_folder
from prc_cli.core.loops import Loops
from prc_cli.core.process import no_collecting
from prc_cli.core.threads import default_threads

PATIENCE_S = 30.0
"""Longest wait for other processes that compile, about the time to compile everything alone [s]."""


def compile_missing(loops: Loops) -> None:
    """Compile the loops that are not in the cache."""
    folder = loops_folder()
    if folder is None or is_compiling_off() or all(loop.is_compiled() for loop in loops):
        return
    with compiling_lock(folder, PATIENCE_S):
        missing = [loop for loop in loops if not loop.is_compiled()]
        missing.sort(key=lambda loop: -loop.source.stat().st_size)
        names = [f"{loop.module}:{loop.name}" for loop in missing]
        n_children = min(default_threads(), len(names)) - 1
        with (
            contextlib.suppress(OSError),
            tempfile.TemporaryDirectory(dir=folder) as claims,
            _children(n_children, [claims, *names]),
        ):
            compile_unclaimed(claims, *names)


def is_compiling_off() -> bool:
    """Whether the user has told numba to run loops as Python."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"


def compile_unclaimed(claims: str, *names: str) -> None:
    """Compile, of ``module:name``, those that no other process has claimed in a folder."""
    with no_collecting():
        for name in names:
            module, _, attribute = name.partition(":")
            with contextlib.suppress(FileExistsError):
                (Path(claims) / name.replace(":", ".")).touch(exist_ok=False)
                getattr(import_module(module), attribute).load()


@contextlib.contextmanager
def _children(n: int, arguments: Sequence[str]) -> Iterator[None]:
    """Start processes that compile, with this import path; end them after a while."""
    code = f"import sys; from {__name__} import compile_unclaimed as f; f(*sys.argv[1:])"
    # -P: nothing of the current folder
    command = [sys.executable, "-P", "-c", code, *arguments]
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    children: list[subprocess.Popen[bytes]] = []
    with contextlib.suppress(OSError, ValueError):
        for _ in range(n):
            child = subprocess.Popen(
                command,
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
