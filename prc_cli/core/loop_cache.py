"""The folder of compiled loops, which only this user can change: what lies in it is run.

The install folder may be read-only, a cron user may have no home, a disk may be full. Then loops
are compiled in memory, so that no run stops.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from hashlib import sha256
from pathlib import Path

from prc_cli.core.errors import PrcError
from prc_cli.core.files import cache_folder
from prc_cli.core.own_file import who_may_change

_PACKAGE = Path(__file__).parents[1]
_LOCK = "compiling.lock"
_TICK_S = 0.05
SOURCES = (
    "**/*_loops.py",
    "**/thresholds.py",
    "**/records.py",
    "core/classes.py",
    "core/types.py",
    "core/loops.py",
)
"""What compiled loops are made of."""


def loops_folder() -> Path | None:
    """Return the folder for loops of these sources, numba, NumPy and processor; None = nowhere."""
    folder = writable_cache()
    return None if folder is None else folder / name_of_loops()


@cache
def name_of_loops() -> str:
    """Return the name of the folder for loops of these sources, numba, NumPy and processor.

    Numba looks at the size and time of a loop's own file alone, and an upgrade may keep both.
    """
    import llvmlite.binding  # type: ignore[import-untyped]
    import numba
    import numpy as np

    digest = sha256(str(_PACKAGE).encode())
    for path in sorted(path for pattern in SOURCES for path in _PACKAGE.glob(pattern)):
        digest.update(path.read_bytes())
    versions = (sys.version, numba.__version__, np.__version__, llvmlite.__version__)
    processor = (
        llvmlite.binding.get_host_cpu_name(),
        llvmlite.binding.get_host_cpu_features().flatten(),
    )
    digest.update(repr((versions, processor)).encode())
    return digest.hexdigest()[:16]


@cache
def writable_cache() -> Path | None:
    """Return a folder that only this user may write to: configured, cache, or temporary.

    Raises
    ------
    PrcError
        If others may write to the configured one.
    """
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        folder = Path(named).resolve()
        if not _is_writable(folder):
            return None
        if why := open_to_others(folder):
            problem = (
                f"others can put code there that would be run: {why}, "
                "expected a folder of this user alone"
            )
            raise PrcError(
                str(folder), problem, "chmod -R go-w, or let NUMBA_CACHE_DIR name a new folder"
            )
        return folder
    for folder in ((cache_folder() / "numba").resolve(), temporary_cache().resolve()):
        if _is_writable(folder) and not open_to_others(folder):
            return folder
    return None


def open_to_others(folder: Path) -> str:
    """Return why others may change what lies in a folder, or exchange one above it.

    Empty if they may not. Loops of other versions, which are not run, are not looked at one by one.
    """
    try:
        if why := who_may_change(folder):
            return why
        for above in folder.parents:
            if why := who_may_change(above, may_add=True):
                return f"{above}: {why}"
        for path in itertools.chain(folder.iterdir(), (folder / name_of_loops()).rglob("*")):
            # another process, which compiles, may have renamed it since
            with contextlib.suppress(FileNotFoundError):
                if why := who_may_change(path):
                    return f"{path.relative_to(folder)}: {why}"
    except OSError as error:
        return f"it cannot be looked at ({error.strerror or error})"
    return ""


def temporary_cache() -> Path:
    """Return the name of a private folder of this user in the shared temporary folder."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    return Path(tempfile.gettempdir()) / f"prc-cli-{user}"


def _is_writable(folder: Path) -> bool:
    """Create the folder if needed and write a test file: permissions do not show full disks."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as handle:
            handle.write(b"x")
    except OSError:
        return False
    return True


@contextlib.contextmanager
def compiling_lock(folder: Path, patience_s: float) -> Iterator[None]:
    """Wait, with a time limit, until no other process compiles; locks end with their process."""
    from filelock import FileLock, Timeout

    with contextlib.ExitStack() as stack:
        # a file system without locks, or one that is full: processes then compile in parallel
        with contextlib.suppress(Timeout, OSError, NotImplementedError):
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(FileLock(folder / _LOCK, timeout=patience_s, poll_interval=_TICK_S))
        yield
