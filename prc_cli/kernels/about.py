"""What the compiler makes of this machine, and what its cache holds; for ``prc doctor``."""

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
"""Features of processors that loops gain from, the best first."""


@dataclass(frozen=True, slots=True)
class About:
    """Processor and compiler."""

    processor: str
    """As the compiler calls it."""
    features: tuple[str, ...]
    """Those of :data:`VECTORS` that it uses."""
    compiles: bool
    """False where compiling is turned off (``NUMBA_DISABLE_JIT``)."""


@dataclass(frozen=True, slots=True)
class CacheState:
    """The folder of compiled kernels."""

    folder: Path | None
    """None if no folder can be written."""
    n_bytes: int
    n_compiled: int
    """Modules whose kernels are there for this source, compiler and processor."""
    n_modules: int


def about() -> About:
    """Return what the compiler makes of the processor."""
    has = llvmlite.binding.get_host_cpu_features()
    config = numba.config
    return About(
        llvmlite.binding.get_host_cpu_name(),
        tuple(name for name in VECTORS if has.get(name)),
        not config.DISABLE_JIT,  # type: ignore[attr-defined]
    )


def cache_state() -> CacheState:
    """Return what is in the cache."""
    modules = sorted(set(KERNELS.values()))
    folder = writable_cache()
    if folder is None:
        return CacheState(None, 0, 0, len(modules))
    n_bytes = 0
    for path in folder.rglob("*"):
        with contextlib.suppress(OSError):  # another process may take it away
            n_bytes += path.stat().st_size
    return CacheState(folder, n_bytes, sum(is_compiled(module, folder) for module in modules), len(modules))
