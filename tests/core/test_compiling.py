"""Many processes on an empty cache: one compiles, all succeed, and failures do not stop a run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock, Timeout

from prc_cli.core import compiling, loop_cache
from prc_cli.core.loops import load_loops, loops_of
from prc_cli.methods.sequential_angle import labels_loops
from tests import patience

pytestmark = pytest.mark.slow

needs_compiler = pytest.mark.skipif(
    bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled"
)
needs_locks = pytest.mark.skipif(os.name == "nt", reason="no file locks on this system")

LOAD = """
from prc_cli.core import compiling
from prc_cli.core.loops import load_loops
from prc_cli.methods.sequential_angle.labels_loops import first_high_verticals
compiling.PATIENCE_S = 600.0
load_loops([first_high_verticals])
print(sum(first_high_verticals.load().stats.cache_misses.values()))
"""


def python(code: str, folder: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return patience.popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True
    )


@needs_compiler
@needs_locks
def test_of_three_processes_on_an_empty_cache_one_compiles(tmp_path):
    started = [python(LOAD, tmp_path) for _ in range(3)]
    outputs = [process.communicate()[0] for process in started]
    assert [process.returncode for process in started] == [0] * 3
    assert sorted(outputs) == ["0\n", "0\n", "1\n"]


@needs_locks
def test_lock_of_a_dead_process_is_open(tmp_path):
    code = (
        "import sys, time; from filelock import FileLock; FileLock(sys.argv[1]).acquire(); "
        "print('mine', flush=True); time.sleep(3600)"
    )
    path = tmp_path / loop_cache._LOCK
    with patience.start(
        [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "mine\n"
        owner.kill()
    with loop_cache.compiling_lock(tmp_path, patience.HANGS_S), pytest.raises(Timeout):
        FileLock(path).acquire(timeout=0)


@needs_locks
def test_nobody_waits_for_ever(tmp_path):
    with loop_cache.compiling_lock(tmp_path, 0.1), loop_cache.compiling_lock(tmp_path, 0.1):
        pass


def test_no_lock_can_be_made(tmp_path):
    (tmp_path / "file").touch()
    with loop_cache.compiling_lock(tmp_path / "file" / "nowhere", 0.1):
        pass


LOOPS = loops_of(labels_loops)[:3]


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    """The cache is empty, and no loop is loaded."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for cached in (loop_cache.writable_cache, loop_cache.name_of_loops):
        cached.cache_clear()
    for loop in LOOPS:
        monkeypatch.setattr(loop, "_compiled", None)
    yield tmp_path
    for cached in (loop_cache.writable_cache, loop_cache.name_of_loops):
        cached.cache_clear()


@needs_compiler
def test_without_a_child_process_all_is_compiled_here(empty_cache, monkeypatch):
    """A program without an interpreter beside it, or one that fails."""
    monkeypatch.setattr(compiling, "default_threads", lambda: 2)
    monkeypatch.setattr(sys, "executable", str(empty_cache / "none"))
    load_loops(LOOPS)
    assert all(loop.is_compiled() for loop in LOOPS)


@needs_compiler
def test_child_processes_compile_what_is_not_claimed(empty_cache, monkeypatch):
    monkeypatch.setattr(compiling, "PATIENCE_S", patience.HANGS_S)
    names = [f"{loop.module}:{loop.name}" for loop in LOOPS]
    claims = empty_cache / "claims"
    claims.mkdir()
    (claims / names[0].replace(":", ".")).touch()
    with compiling._children(2, [str(claims), *names]):
        pass
    assert [loop.is_compiled() for loop in LOOPS] == [False, *[True] * (len(LOOPS) - 1)]
