"""Facts about processor, compiler and cache, for ``prc doctor``."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

import llvmlite.binding  # type: ignore[import-untyped]
import numba

from prc_cli.kernels import KERNELS
from prc_cli.kernels.cache import writable_cache
from prc_cli.kernels.compiling import is_compiled

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
