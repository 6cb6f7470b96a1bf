"""What the compiler does twice or for nothing when it compiles a loop, left out.

Two things, a quarter of the time of a first run, by classes and methods of numba that are not part of its interface:

- The compiler optimises every function that a loop calls together with what it calls, and turns it into machine code,
  those of NumPy too, though nothing but the loop calls it; linked into the loop it is optimised and translated once
  more. Here that waits until somebody asks for the address of such a function, which for a private one nobody does.
  Each function is still simplified by itself: without that, loops come out that no vector instruction fits.
- For every operation in a loop it looks up what it knows under its own settings, and builds a table of all of them
  each time, to compare.

Neither changes what is computed. Where numba is built otherwise than expected, its own way is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from threading import RLock
from typing import Any


def _of_numba(module: str, name: str) -> Any:
    """Return something of numba, ``object`` where it has no such thing."""
    try:
        return getattr(import_module(f"numba.core.{module}"), name, object)
    except ImportError:
        return object


_Library, _Settings = _of_numba("codegen", "JITCodeLibrary"), _of_numba("targetconfig", "TargetConfig")
_NEEDED = (
    "_finalize_final_module", "_get_module_for_linking", "_optimize_final_module", "_optimize_functions",
    "_raise_if_finalized", "get_pointer_to_function",
)  # fmt: skip
_KNOWN = all(hasattr(_Library, name) for name in _NEEDED) and hasattr(_Settings, "options")


class _Once(_Library):  # type: ignore[misc, valid-type]
    """Code of a function and of what it calls, which becomes machine code when its address is asked for."""

    _waits = False

    def finalize(self) -> None:
        """Put together what belongs to it."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = self._waits = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function, 0 if it is not among these."""
        self._ensure_finalized()
        if self._waits:
            if name not in (each.name for each in self._final_module.functions if not each.is_declaration):
                return 0
            self._waits = False
            self._optimize_final_module()
            self._final_module.verify()
            self._finalize_final_module()
        address: int = super().get_pointer_to_function(name)
        return address


_environments: dict[str, Any] = {}
"""What functions without machine code need at run time, by name, for the loop that they become part of."""
_hashes: dict[type, int] = {}
_alone = RLock()


@contextmanager
def lean_compiler() -> Iterator[None]:
    """Compile without double work as long as this lasts, in one thread at a time."""
    with _alone:
        yield from _lean()


def _lean() -> Iterator[None]:
    target = _of_numba("registry", "cpu_target")
    try:
        codegen = target.target_context.codegen()
        plain = codegen._library_class, codegen.set_env
        is_defined = codegen._engine.is_symbol_defined
    except AttributeError:
        codegen = None
    if codegen is None or not _KNOWN:
        yield
        return
    hash_of, equals = _Settings.__hash__, _Settings.__eq__

    def set_where_defined(name: str, environment: Any) -> None:
        _environments[name] = environment
        for each in [each for each in _environments if is_defined(each)]:
            plain[1](each, _environments.pop(each))

    codegen._library_class, codegen.set_env = _Once, set_where_defined
    _Settings.__hash__, _Settings.__eq__ = _hash(hash_of), _same(equals)
    try:
        yield
    finally:
        codegen._library_class, codegen.set_env = plain
        _Settings.__hash__, _Settings.__eq__ = hash_of, equals


def _hash(plain: Callable[[Any], int]) -> Callable[[Any], int]:
    """One hash for all settings of a kind, as numba's own comes out too: it takes their names."""

    def found(settings: Any) -> int:
        kind = type(settings)
        if kind not in _hashes:
            _hashes[kind] = plain(settings)
        return _hashes[kind]

    return found


def _same(plain: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Compare settings of a kind by what is not as by default; numba looks at all of them."""

    def found(settings: Any, other: Any) -> Any:
        if type(settings) is not type(other):
            return plain(settings, other)
        return settings._values == other._values or _changed(settings) == _changed(other)

    return found


def _changed(settings: Any) -> dict[str, Any]:
    """Return the settings that are not as by default."""
    options = settings.options
    return {name: value for name, value in settings._values.items() if value != options[name].default}
