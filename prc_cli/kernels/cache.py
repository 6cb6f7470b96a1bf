"""Compiles loops with numba, and keeps the code in a cache that only this user can change.

The install folder may be read-only, a cron user may have no home, a disk may be full, a cache file
may be cut short. Whenever the cache fails, the kernel is compiled in memory, so that no run stops.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import llvmlite.binding  # type: ignore[import-untyped]
import numba
import numpy as np
from numba.core.errors import NumbaError

import prc_cli.core
from prc_cli.core.errors import PrcError
from prc_cli.core.files import cache_folder
from prc_cli.core.own_file import who_may_change

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

_HELPER = {
    "nogil": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
_jit: Any = numba.njit  # typed by some versions of numba and not by others
_types: Any = numba.types
boolean = _types.boolean
uint8 = _types.uint8
int32 = _types.int32
int64 = _types.int64
float32 = _types.float32
float64 = _types.float64
Tuple = _types.Tuple


def kernel(*signatures: Any) -> Callable[[FunctionT], FunctionT]:
    """Compile a function on import, for the types of its annotations or for numba signatures.

    No ``fastmath``: results are those of IEEE arithmetic, on every platform; a division by zero
    gives infinity as in NumPy, since a test for it keeps loops from being vectorised. The lock of
    the interpreter is released, so that blocks of several scanners or files run in parallel in
    threads.
    """

    def compiled(function: FunctionT) -> FunctionT:
        def jit(**cached: bool) -> FunctionT:
            options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **cached}
            return _jit(list(signatures) or [_signature(function)], **options)(function)  # type: ignore[no-any-return]

        if (folder := writable_cache()) is None:
            return jit()
        config: Any = numba.config
        before = config.CACHE_DIR
        config.CACHE_DIR = str(loops_folder(folder, Path(function.__code__.co_filename)))
        try:
            return jit(cache=True)
        except NumbaError:
            raise
        except Exception:  # the cache is damaged, full or gone: compile without it
            return jit()
        finally:
            config.CACHE_DIR = before

    return compiled


def _signature(function: Callable[..., Any]) -> Any:
    """Return the numba signature of a function, from its annotations."""
    types = {
        name: numba_type(annotation)
        for name, annotation in get_type_hints(function, include_extras=True).items()
    }
    returned = types.pop("return")
    return returned(*types.values())


def numba_type(annotation: Any) -> Any:
    """Return the numba type of a number, a contiguous array (``Annotated[F32, 2]``) or a tuple."""
    origin = get_origin(annotation)
    inner = get_args(annotation)
    if origin is Annotated and get_origin(inner[0]) is np.ndarray:
        return _types.Array(
            numba.from_dtype(np.dtype(get_args(get_args(inner[0])[1])[0])), inner[1], "C"
        )
    if origin is Annotated:
        return numba_type(inner[0])
    if origin is tuple:
        return _types.BaseTuple.from_types([numba_type(field_type) for field_type in inner])
    if annotation is type(None):
        return _types.void
    if issubclass(annotation, tuple):
        fields = get_type_hints(annotation, include_extras=True).values()
        return _types.BaseTuple.from_types(
            [numba_type(field_type) for field_type in fields], annotation
        )
    return numba.from_dtype(np.dtype(annotation))


record = numba_type


def helper(function: FunctionT) -> FunctionT:
    """Let kernels call a private function of their module.

    It is compiled with, and as, the kernel that calls it.

    Its types are those of the call, and its code is part of the compiled kernels, which are
    compiled again when their module changes. So never share one between modules, nor a constant;
    and to import another module of kernels is to compile it, in two processes at once. Python and C
    cannot call it, which saves compiling wrappers.
    """
    return _jit(**_HELPER)(function)  # type: ignore[no-any-return]


def inlined(function: FunctionT) -> FunctionT:
    """Inline a private function in every call: for short functions that a loop runs for every shot.

    As :func:`helper` otherwise. Passing an array takes seven words on the stack, more than most
    steps of a loop. Many calls take longer to compile.
    """
    return _jit(**_HELPER, forceinline=True)(function)  # type: ignore[no-any-return]


SOURCES = ("classes.py", "types.py")
"""What of ``core`` the loops use."""
BESIDE = ("thresholds.py", "records.py")
"""What of their own folder they use."""


@cache
def _surroundings() -> tuple[str, ...]:
    """Return what the compiled loops of all modules depend on."""
    core = Path(prc_cli.core.__path__[0])
    processor = (
        llvmlite.binding.get_host_cpu_name(),
        llvmlite.binding.get_host_cpu_features().flatten(),
    )
    read = [
        file.read_text("utf-8") for file in (Path(__file__), *(core / name for name in SOURCES))
    ]
    return (sys.version, numba.__version__, np.__version__, llvmlite.__version__, *processor, *read)


def loops_folder(folder: Path, source: Path) -> Path:
    """Return the folder of a module's compiled loops, another one for all that they are made of."""
    beside = (source.with_name(name) for name in BESIDE)
    files = [path for path in (source, *beside) if path.exists()]
    known = (
        _surroundings(),
        str(source),
        source.stat().st_mtime_ns,
        *(path.read_bytes() for path in files),
    )
    return (
        folder
        / f"{source.parent.name}-{source.stem}-{sha256(repr(known).encode()).hexdigest()[:16]}"
    )


@cache
def writable_cache() -> Path | None:
    """Return the folder for compiled kernels, which only this user may write to.

    Configured, cache, temporary.
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
    for folder in ((cache_folder() / "numba").resolve(), _temporary_cache().resolve()):
        if _is_writable(folder) and not open_to_others(folder):
            return folder
    return None


def open_to_others(folder: Path) -> str:
    """Return why others may change what lies in a folder, or exchange one above it.

    Empty if they may not.
    """
    try:
        if why := who_may_change(folder):
            return why
        for above in folder.parents:
            if why := who_may_change(above, may_add=True):
                return f"{above}: {why}"
        for path in folder.rglob("*"):
            with contextlib.suppress(
                FileNotFoundError
            ):  # another process, which compiles, has renamed it since
                if why := who_may_change(path):
                    return f"{path.relative_to(folder)}: {why}"
    except OSError as error:
        return f"it cannot be looked at ({error.strerror or error})"
    return ""


def _temporary_cache() -> Path:
    """Return the name of a private folder of this user in the shared temporary folder."""
    return (
        Path(tempfile.gettempdir()) / f"prc-cli-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    )


def _is_writable(folder: Path) -> bool:
    """Create the folder if needed and write a test file.

    Permissions do not show quotas and read-only mounts.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as handle:
            handle.write(b"x")
    except OSError:
        return False
    return True
