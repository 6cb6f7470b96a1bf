"""Loops that numba compiles when they are first called; those of the papers have a plain form too.

A loop is typed by its annotations, and its code is kept for the next process. There is no
``fastmath``: results are those of IEEE arithmetic, on every platform. A division by zero gives
infinity as in NumPy, since a test for it keeps loops from being vectorised. The lock of the
interpreter is released, so that blocks run in parallel in threads.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property, update_wrapper
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import (
    Annotated,
    Any,
    Generic,
    Literal,
    ParamSpec,
    TypeAlias,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.interrupts import signals_wait
from prc_cli.core.loop_cache import loops_folder
from prc_cli.core.process import no_collecting

_P = ParamSpec("_P")
_T = TypeVar("_T")
_FunctionT = TypeVar("_FunctionT", bound=Callable[..., Any])

Engine: TypeAlias = Literal["compiled", "reference"]
"""Which form of the loops runs: the compiled one, or the plain one of the papers' methods."""
ENGINES: tuple[Engine, ...] = get_args(Engine)
# of a thread and what it starts: a run beside this one keeps its own
_engine: ContextVar[Engine] = ContextVar("engine", default="compiled")
_LOADING = threading.RLock()
_OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_SETTINGS = ".numba_config.yaml"


class Loop(Generic[_P, _T]):
    """A function that is compiled when it is first called, or taken from the cache.

    Parameters
    ----------
    function : callable
        Of contiguous arrays (``Annotated[F32, 2]``), numbers and named tuples of these.
    plain : str
        Module of the plain function of the same name and arguments, for ``--engine reference``.
    """

    def __init__(self, function: Callable[_P, _T], plain: str) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self.module = function.__module__
        self.name = function.__name__
        self.source = Path(function.__code__.co_filename)
        self._plain = plain
        self._compiled: Callable[_P, _T] | None = None

    def __call__(self, *arguments: _P.args, **named: _P.kwargs) -> _T:
        """Run the form that the engine asks for."""
        if _engine.get() == "reference":
            return self.reference()(*arguments, **named)
        compiled = self._compiled or self.load()
        with signals_wait:
            return compiled(*arguments, **named)

    def reference(self) -> Callable[_P, _T]:
        """Return the plain form."""
        if not self._plain:
            method, module = self.module.removesuffix("_loops").split(".")[-2:]
            problem = f"{method} is written as compiled loops alone ({module}.{self.name})"
            hint = "use --method prc or sequential-angle, or leave out --engine"
            raise ConfigError("engine", f"found reference, but {problem}", hint)
        reference: Callable[_P, _T] = getattr(import_module(self._plain), self.name)
        return reference

    def load(self) -> Callable[_P, _T]:
        """Return the compiled form."""
        load_compiler()
        with _LOADING:
            if self._compiled is None:
                self._compiled = self._from_cache() or _compile(self.py_func)
            return self._compiled

    def _from_cache(self) -> Callable[_P, _T] | None:
        """Take it from the cache or compile it into it; None if that is damaged, full or gone."""
        import numba
        from numba.core.errors import NumbaError

        folder = loops_folder()
        if folder is None:
            return None
        config: Any = numba.config
        before = config.CACHE_DIR
        config.CACHE_DIR = str(folder)
        try:
            return _compile(self.py_func, cache=True)
        except NumbaError:
            raise
        except Exception:
            return None
        finally:
            config.CACHE_DIR = before

    def is_compiled(self) -> bool:
        """Whether it is in the cache."""
        index = f"{self.source.parent.name}_*/{self.source.stem}.{self.name}-*.nbi"
        folder = loops_folder()
        return folder is not None and any(folder.glob(index))

    @property
    def _numba_type_(self) -> Any:
        """The type by which numba knows it in other loops."""
        compiled: Any = self.load()
        return compiled._numba_type_


Loops: TypeAlias = tuple[Loop[..., Any], ...]


def loop(plain: str = "") -> Callable[[Callable[_P, _T]], Loop[_P, _T]]:
    """Make a function a :class:`Loop`."""
    return lambda function: Loop(function, plain)


class _Helper:
    """A function that loops call: compiled with, and as part of, each of them.

    Its types are those of the call. Only compiled code can call its compiled form, which saves
    compiling wrappers.
    """

    def __init__(self, function: Callable[..., Any], **options: bool) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._options = {**_OPTIONS, "no_cpython_wrapper": True, **options}

    def __call__(self, *arguments: Any) -> Any:
        """Run it as Python."""
        return self.py_func(*arguments)

    @cached_property
    def _dispatcher(self) -> Any:
        import numba

        jit: Any = numba.njit
        return jit(**self._options)(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """The type by which numba knows it in loops."""
        return self._dispatcher._numba_type_


def helper(function: _FunctionT) -> _FunctionT:
    """Let loops call a function."""
    helper: Any = _Helper(function)
    return helper  # type: ignore[no-any-return]


def inlined(function: _FunctionT) -> _FunctionT:
    """Inline a function in every loop that calls it: a short one, that runs for every shot.

    Passing an array takes seven words on the stack, more than most steps of a loop. Many calls take
    longer to compile.
    """
    helper: Any = _Helper(function, forceinline=True)
    return helper  # type: ignore[no-any-return]


def _compile(function: Callable[_P, _T], *, cache: bool = False) -> Callable[_P, _T]:
    """Compile a function for the types of its annotations."""
    import numba

    hints = get_type_hints(function, include_extras=True)
    returned = hints.pop("return")
    signature = numba_type(returned)(*map(numba_type, hints.values()))
    jit: Any = numba.njit
    compiled: Callable[_P, _T] = jit([signature], cache=cache, **_OPTIONS)(function)
    return compiled


def numba_type(annotation: Any) -> Any:
    """Return the numba type of a number, a contiguous array (``Annotated[F32, 2]``) or a tuple."""
    import numba

    types: Any = numba.types
    origin = get_origin(annotation)
    inner = get_args(annotation)
    if origin is Annotated and get_origin(inner[0]) is np.ndarray:
        dtype = get_args(get_args(inner[0])[1])[0]
        return types.Array(numba_type(dtype), inner[1], "C")
    if origin is Annotated:
        return numba_type(inner[0])
    if origin is tuple:
        return types.BaseTuple.from_types([numba_type(part) for part in inner])
    if annotation is type(None):
        return types.void
    if issubclass(annotation, tuple):
        fields = get_type_hints(annotation, include_extras=True).values()
        return types.BaseTuple.from_types([numba_type(field) for field in fields], annotation)
    return numba.from_dtype(np.dtype(annotation))


def load_compiler() -> None:
    """Load numba."""
    if Path(_SETTINGS).exists():
        problem = "numba would take its settings from it, which may be anybody's"
        raise PrcError(_SETTINGS, problem, "remove it, or start prc in another folder")
    try:
        import_module("numba")
    except (ImportError, OSError) as error:
        hint = (
            "pip install --force-reinstall numba; "
            "until then prc classify --engine reference is the slow way"
        )
        raise PrcError("numba", f"cannot be loaded ({error})", hint) from error


@contextmanager
def use_engine(engine: Engine) -> Iterator[None]:
    """Let loops inside this context run in one form; the reference never loads numba."""
    if engine not in ENGINES:
        raise ConfigError("engine", f"found {engine!r}, expected {' or '.join(ENGINES)}")
    before = _engine.set(engine)
    try:
        yield
    finally:
        _engine.reset(before)


def loops_of(*modules: ModuleType) -> Loops:
    """Return the public loops that modules define."""
    return tuple(
        value
        for module in modules
        for value in vars(module).values()
        if isinstance(value, Loop)
        and value.module == module.__name__
        and not value.name.startswith("_")
    )


def load_loops(loops: Loops) -> None:
    """Load loops, before threads start; new ones are compiled on all cores."""
    with no_collecting():
        if _engine.get() == "reference":
            for wanted in loops:
                wanted.reference()
            return
        load_compiler()
        from prc_cli.core.compiling import compile_missing

        compile_missing(loops)
        for wanted in loops:
            wanted.load()
