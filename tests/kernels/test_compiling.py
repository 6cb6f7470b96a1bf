"""Many processes on an empty cache: one compiles, all succeed, and failures do not stop a run."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from prc_cli import kernels
from prc_cli.kernels import cache, compiling
from tests import patience

pytestmark = pytest.mark.slow

needs_compiler = pytest.mark.skipif(
    bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled"
)
needs_locks = pytest.mark.skipif(os.name == "nt", reason="no file locks on this system")

LOAD = """
from prc_cli import kernels
from prc_cli.kernels import compiling
compiling.PATIENCE_S = 600.0
kernels.load_kernels(frozenset({"sequential_angle.labels"}))
from prc_cli.methods.sequential_angle.labels_loops import first_high_verticals
print(sum(first_high_verticals.stats.cache_misses.values()))
"""


def python(code: str, folder: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return patience.popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True
    )


@needs_compiler
@needs_locks
def test_of_four_processes_on_an_empty_cache_one_compiles(tmp_path: Path) -> None:
    started = [python(LOAD, tmp_path) for _ in range(4)]
    outputs = [process.communicate()[0] for process in started]
    assert [process.returncode for process in started] == [0] * 4
    assert sorted(outputs) == ["0\n", "0\n", "0\n", "1\n"]


@needs_locks
def test_lock_of_a_dead_process_is_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        "import fcntl, os, sys, time; handle = open(sys.argv[1], 'ab'); fcntl.flock(handle, "
        "fcntl.LOCK_EX)"
    )
    path = tmp_path / compiling._LOCK
    holding = f"{code}; print('mine', flush=True); time.sleep(3600)"
    with patience.start(
        [sys.executable, "-c", holding, str(path)], stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "mine\n"
        owner.kill()
    clock = SimpleNamespace(
        monotonic=time.monotonic, sleep=lambda seconds: pytest.fail("waited for a dead process")
    )
    monkeypatch.setattr(compiling, "time", clock)
    with compiling._alone(tmp_path):
        pass


@needs_locks
def test_nobody_waits_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock is the test's own: a wait that does not end by itself fails, and hangs no test."""
    now = [0.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds
        assert now[0] <= compiling.PATIENCE_S + 1, "waits beyond its patience"

    monkeypatch.setattr(compiling, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))
    with compiling._alone(tmp_path):
        assert now == [0.0]
        with compiling._alone(tmp_path):
            assert now[0] >= compiling.PATIENCE_S


def test_no_lock_can_be_made(tmp_path: Path) -> None:
    with compiling._alone(tmp_path / "nowhere"):
        pass


MODULES = [
    "prc_cli.methods.sequential_angle.labels_loops",
    "prc_cli.methods.sequential_angle.angles_loops",
]


@needs_compiler
def test_without_a_child_process_all_is_compiled_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program without an interpreter beside it, or one that fails."""
    monkeypatch.setattr(compiling, "writable_cache", lambda: tmp_path)
    monkeypatch.setattr(compiling, "_missing", lambda modules, folder: list(modules))
    monkeypatch.setattr(compiling, "default_threads", lambda: 2)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with compiling._alone(tmp_path):
        pass
    for module in MODULES:
        cache.loops_folder(tmp_path, compiling._source(module)).mkdir()
    compiling.compile_missing(MODULES)
    assert all(compiling.is_compiled(module, tmp_path) for module in MODULES)
    assert callable(kernels.first_high_verticals)


@needs_compiler
def test_child_processes_compile_their_share(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling, "PATIENCE_S", patience.HANGS_S)
    with compiling._children([MODULES[:1]]):
        pass
    assert compiling.is_compiled(MODULES[0], tmp_path)
