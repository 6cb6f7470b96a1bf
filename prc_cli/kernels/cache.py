"""Compiles loops, and keeps the compiled code in a cache.

The install folder may be read-only, a cron user may have no home, a disk may be full, a cache file may be cut short.
Whenever the cache fails, the kernel is compiled in memory, so that no run stops.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numba
from numba.core.errors import NumbaError

from prc_cli.core.errors import PrcError
from prc_cli.core.files import cache_folder, who_may_change
from prc_cli.core.process import is_own_process

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

_HELPER = {"nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_SCALARS = {float: "float64", int: "int64", bool: "boolean"}

Tuples = Sequence[type[tuple[Any, ...]]]


def kernel(*signatures: str, tuples: Tuples = ()) -> Callable[[FunctionT], FunctionT]:
    """Compile a function for the given numba signatures when its module is imported.

    No ``fastmath``: results are those of IEEE arithmetic, on every platform; a division by zero gives infinity as in
    NumPy, since a test for it keeps loops from being vectorised. The lock of the interpreter is released,
    so that blocks of several scanners or files run in parallel in threads.

    Parameters
    ----------
    signatures : str
        Numba signatures; arguments of other types are converted or refused, never compiled anew.
    tuples : sequence of NamedTuple classes
        Those that the signatures name. Their fields are ``float``, ``int``, ``bool``, ``np.float32``, other tuples of
        the sequence before them, or arrays annotated with their numba type: ``Annotated[F32, "float32[:, ::1]"]``.

    Returns
    -------
    callable
        Decorator that keeps the signature of the function.
    """

    def compiled(function: FunctionT) -> FunctionT:
        jit: Any = numba.njit  # typed by some versions of numba and not by others
        options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
        folder = writable_cache()
        types = _numba_signatures(signatures, tuples)
        ways = (_compile_warm, _compile_cached) if is_own_process() else (_compile_cached,)
        if folder is not None:
            for compile_so in ways:
                try:
                    with _numba_cache(folder / _fields_folder(tuples)):
                        return compile_so(function, types, options)
                except NumbaError:
                    raise
                except Exception:  # the cache is damaged, full or gone: compile without it
                    continue
        in_memory: FunctionT = jit(types, **options)(function)
        return in_memory

    return compiled


def _compile_cached(function: FunctionT, types: list[Any], options: dict[str, Any]) -> FunctionT:
    """Return a function compiled for signatures, by numba's way from its cache or into it."""
    jit: Any = numba.njit
    compiled: FunctionT = jit(types, cache=True, **options)(function)
    return compiled


def _compile_warm(function: FunctionT, types: list[Any], options: dict[str, Any]) -> FunctionT:
    """As :func:`_compile_cached`, without loading what is not needed to run what is in the cache."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    from prc_cli.kernels.warm import WarmCache

    jit: Any = numba.njit
    cache: Any = WarmCache
    compiled: Any = jit(**options)(function)
    compiled._cache = cache(function)
    for signature in types:
        compiled.compile(signature)
    compiled.disable_compile()
    return cast("FunctionT", compiled)


def _numba_signatures(signatures: Sequence[str], tuples: Tuples) -> list[Any]:
    """Return signatures as numba takes them: strings, or what they stand for where they name tuples."""
    if not tuples:
        return list(signatures)
    names: dict[str, Any] = dict(vars(numba.types))
    for cls in tuples:
        fields = get_type_hints(cls, include_extras=True).values()
        names[cls.__name__] = names["BaseTuple"].from_types([_numba_type(field, names) for field in fields], cls)
    return [eval(signature, {}, names) for signature in signatures]  # as numba does


def _numba_type(field: Any, names: dict[str, Any]) -> Any:
    """Return the numba type of a field by its annotation."""
    if get_origin(field) is Annotated:
        return eval(get_args(field)[1], {}, names)
    return names[_SCALARS.get(field, field.__name__)]


def _fields_folder(tuples: Tuples) -> str:
    """Name the sub-folder of the cache for kernels that take tuples; empty without any.

    Numba tells NamedTuples apart by class and number of fields, and looks only at the kernel's own source for changes:
    without this, a cached loop would go on reading the places where fields were before they changed order. The module
    of a class is part of the name, because numba cannot read an index that names a class which has moved.
    """
    if not tuples:
        return ""
    known = repr([(cls.__module__, cls.__name__, getattr(cls, "_fields", ())) for cls in tuples])
    return f"tuples-{sha256(known.encode()).hexdigest()[:8]}"


def helper(function: FunctionT) -> FunctionT:
    """Let kernels call a private function of their module; it is compiled with, and as, the kernel that calls it.

    It has no signature and no cache file: its types are those of the call, and its code is part of the compiled
    kernels, which are compiled again when their module changes. So never share one between modules, nor a constant; and
    to import another module of kernels is to compile it, in two processes at once. The compiler inlines functions that
    are small or called once. Python and C cannot call it, which saves compiling wrappers.
    """
    jit: Any = numba.njit  # typed by some versions of numba and not by others
    compiled: FunctionT = jit(**_HELPER)(function)
    return compiled


def inlined(function: FunctionT) -> FunctionT:
    """Inline a private function in every call: for short functions that a loop runs for every shot.

    As :func:`helper` otherwise. Passing an array takes seven words on the stack, more than most steps of a loop. Many
    calls take longer to compile.
    """
    jit: Any = numba.njit  # typed by some versions of numba and not by others
    compiled: FunctionT = jit(**_HELPER, forceinline=True)(function)
    return compiled


@lru_cache(maxsize=1)
def writable_cache() -> Path | None:
    """Return the folder for compiled kernels: as configured, in the user's cache, temporary and private, or none.

    Compiled code is loaded from pickles, which run what is in them: only this user may be able to write there.

    Raises
    ------
    PrcError
        When others can write into the folder that ``NUMBA_CACHE_DIR`` names.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        folder = Path(given)
        if not _is_writable(folder):
            return None
        if why := open_to_others(folder):
            problem = f"others can put code there that would be run: {why}, expected a folder of this user alone"
            raise PrcError(str(folder), problem, "chmod -R go-w, or let NUMBA_CACHE_DIR name a new folder")
        return folder
    for folder in (cache_folder() / "numba", _temporary_cache()):
        if _is_writable(folder) and not open_to_others(folder):
            return folder
    return None


def open_to_others(folder: Path) -> str:
    """Return why others may change what lies in a folder; empty if they may not.

    Folders above it count, too, unless what is in them is protected from others (the sticky bit, as in /tmp); of what
    is in it, folders and files at its top do.
    """
    try:
        if why := who_may_change(folder.resolve()):
            return why
        for above in folder.resolve().parents:
            if not above.stat().st_mode & stat.S_ISVTX and (why := who_may_change(above)):
                return f"{above}: {why}"
        for path in folder.iterdir():
            if why := who_may_change(path):
                return f"{path.name}: {why}"
    except OSError as error:
        return f"it cannot be looked at ({error.strerror or error})"
    return ""


def _temporary_cache() -> Path:
    """Return the name of a private folder of this user in the shared temporary folder."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    return Path(tempfile.gettempdir()) / f"prc-cli-{user}"


def _is_writable(folder: Path) -> bool:
    """Create the folder if needed and write a test file: permissions do not show quotas and read-only mounts."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as handle:
            handle.write(b"x")
    except OSError:
        return False
    return True


@contextmanager
def _numba_cache(folder: Path) -> Iterator[None]:
    """Set the cache folder of numba while one function is compiled."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = before
