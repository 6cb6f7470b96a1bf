"""A run never fails because of the cache of compiled code."""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from collections import namedtuple
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numba
import pytest

from prc_cli.core.errors import PrcError
from prc_cli.kernels import cache
from tests import patience

MODULE = """
from prc_cli.kernels.cache import kernel

@kernel("int64(int64)")
def twice(number):
    return 2 * number
"""

needs_compiler = pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
posix_only = pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")


@pytest.fixture(autouse=True)
def _forget_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path / "user")
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    cache.writable_cache.cache_clear()
    yield
    cache.writable_cache.cache_clear()


def blocked(tmp_path: Path) -> Path:
    """A folder that nobody can create, root included."""
    (tmp_path / "file").write_text("")
    return tmp_path / "file" / "folder"


def compile_module(tmp_path: Path) -> ModuleType:
    path = tmp_path / "some_kernels.py"
    path.write_text(MODULE)
    specification = importlib.util.spec_from_file_location("some_kernels", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules["some_kernels"] = module
    try:
        specification.loader.exec_module(module)
    finally:
        del sys.modules["some_kernels"]
    return module


def compiled_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.nb?"))


@needs_compiler
def test_compiled_code_goes_to_the_users_cache_folder(tmp_path: Path) -> None:
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    assert compile_module(tmp_path).twice(21) == 42
    assert len(compiled_files(tmp_path / "user" / "numba")) == 2
    assert not compiled_files(tmp_path / "__pycache__")
    assert before == numba.config.CACHE_DIR, "the user's own functions are none of our business"  # type: ignore[attr-defined]


@needs_compiler
def test_a_second_process_takes_the_compiled_code(tmp_path: Path) -> None:
    (tmp_path / "some_kernels.py").write_text(MODULE)
    code = "import some_kernels; print(sum(some_kernels.twice.stats.cache_hits.values()))"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    hits = [
        patience.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert hits == ["0\n", "1\n"]


LIMITS = """
from typing import Annotated, NamedTuple
import numpy as np
from numpy.typing import NDArray

class Limits(NamedTuple):
    {fields}
    weights: Annotated[NDArray[np.float64], "float64[::1]"]
"""
WEIGHED = """
import numpy as np
from prc_cli.kernels.cache import kernel
from limits import Limits

@kernel("Tuple((float64, Limits))(Limits)", tuples=[Limits])
def weighed(limits):
    return limits.low * limits.weights.sum() - limits.high, Limits(limits.low, limits.high, limits.weights)

assert weighed(Limits(low=2.0, high=5.0, weights=np.ones(3)))[0] == 1.0
assert isinstance(weighed(Limits(low=2.0, high=5.0, weights=np.ones(3)))[1], Limits)
print(sum(weighed.stats.cache_hits.values()))
"""


@needs_compiler
def test_compiled_code_knows_the_fields_of_the_tuples_it_takes(tmp_path: Path) -> None:
    """Numba knows a NamedTuple by its class and the number of its fields, which are read by their places."""
    (tmp_path / "weighed.py").write_text(WEIGHED)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    hits = []
    for fields in ("low: float; high: float", "low: float; high: float", "high: float; low: float"):
        (tmp_path / "limits.py").write_text(LIMITS.format(fields=fields))
        done = patience.run(
            [sys.executable, "-B", "-c", "import weighed"], env=environment, capture_output=True, text=True, check=True
        )
        hits.append(done.stdout)
    assert hits == ["0\n", "1\n", "0\n"]


@needs_compiler
def test_users_choice_of_folder_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    assert compile_module(tmp_path).twice(21) == 42
    assert compiled_files(tmp_path / "chosen")
    assert not (tmp_path / "user").exists()


def test_users_choice_that_cannot_be_written_means_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocked(tmp_path)))
    assert compile_module(tmp_path).twice(21) == 42
    assert not (tmp_path / "user").exists()


def test_unwritable_cache_folder_falls_back_to_a_private_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "cache_folder", lambda: blocked(tmp_path))
    assert compile_module(tmp_path).twice(21) == 42
    folder = cache.writable_cache()
    assert folder is not None
    assert folder.parent == tmp_path / "temporary"
    if os.name != "nt":
        assert folder.stat().st_mode & 0o077 == 0


@posix_only
def test_temporary_folder_that_others_can_write_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "cache_folder", lambda: blocked(tmp_path))
    folder = cache._temporary_cache()
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    assert cache.writable_cache() is None


@posix_only
def test_temporary_folder_of_somebody_else_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "cache_folder", lambda: blocked(tmp_path))
    folder = cache._temporary_cache()
    folder.mkdir(parents=True)
    monkeypatch.setattr(cache, "_temporary_cache", lambda: folder)
    if os.getuid() == 0:
        os.chown(folder, 65534, 65534)
    else:
        me = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: me + 1)
    assert cache.writable_cache() is None


@posix_only
@pytest.mark.parametrize("mode", [0o777, 0o757])
def test_the_users_choice_that_others_can_write_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int
) -> None:
    """Its pickles ran, with whatever somebody had put into them."""
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    with pytest.raises(PrcError, match=f"others can put code there that would be run: its mode is {mode:o}"):
        cache.writable_cache()


@posix_only
def test_a_folder_above_that_others_can_write_is_no_better(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "open" / "cache"
    folder.mkdir(parents=True, mode=0o700)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    (tmp_path / "open").chmod(0o777)
    with pytest.raises(PrcError, match=r"open: its mode is 777"):
        cache.writable_cache()
    (tmp_path / "open").chmod(0o1777)  # as /tmp
    assert cache.writable_cache() == folder


@posix_only
@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="gives a file to somebody else")
def test_what_somebody_else_left_in_it_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "cache"
    (folder / "prc").mkdir(parents=True)
    os.chown(folder / "prc", 65534, 65534)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    with pytest.raises(PrcError, match="prc: it belongs to user 65534"):
        cache.writable_cache()
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    cache.writable_cache.cache_clear()
    monkeypatch.setattr(cache, "cache_folder", lambda: folder.parent)
    (folder.parent / "numba").mkdir()
    (folder.parent / "numba").chmod(0o777)
    assert cache.writable_cache() == cache._temporary_cache()


def test_nothing_writable_at_all_still_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "cache_folder", lambda: blocked(tmp_path))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(blocked(tmp_path)))
    assert compile_module(tmp_path).twice(21) == 42
    assert cache.writable_cache() is None


@needs_compiler
@pytest.mark.parametrize("damage", [b"", b"\x80", b"not a pickle at all"])
def test_damaged_cache_is_done_without(tmp_path: Path, damage: bytes) -> None:
    compile_module(tmp_path)
    files = compiled_files(tmp_path / "user")
    assert files
    for path in files:
        path.write_bytes(damage)
    assert compile_module(tmp_path).twice(21) == 42


@needs_compiler
def test_mistake_in_a_kernel_is_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "MODULE", MODULE.replace("2 * number", "number.spam"))
    with pytest.raises(numba.core.errors.TypingError):
        compile_module(tmp_path)


def test_a_class_that_moved_gets_a_folder_of_its_own() -> None:
    """Numba cannot read an index that names a class which is no longer there, and would compile in every run."""
    here, there = (namedtuple("Limits", "low high", module=name) for name in ("some.module", "another"))
    assert cache._fields_folder([here]) == cache._fields_folder([here])
    assert cache._fields_folder([here]) != cache._fields_folder([there])
