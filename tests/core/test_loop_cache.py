"""A run never fails because of the cache of compiled code."""

import ast
import errno
import importlib.util
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest

from prc_cli.core import loop_cache as cache
from prc_cli.core.errors import PrcError
from tests import patience

MODULE = """
from prc_cli.core.loops import loop

@loop()
def twice(number: int) -> int:
    return 2 * number
"""

needs_compiler = pytest.mark.skipif(
    bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled"
)
posix_only = pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")


@pytest.fixture(autouse=True)
def _forget_the_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path / "user")
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    forget()
    yield
    forget()


def forget() -> None:
    cache.writable_cache.cache_clear()
    cache.name_of_loops.cache_clear()


def blocked(tmp_path: Path) -> Path:
    """A folder that nobody can create, root included."""
    (tmp_path / "file").write_text("")
    return tmp_path / "file" / "folder"


def compile_module(tmp_path: Path) -> ModuleType:
    path = tmp_path / "some_loops.py"
    path.write_text(MODULE)
    specification = importlib.util.spec_from_file_location("some_loops", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules["some_loops"] = module
    try:
        specification.loader.exec_module(module)
    finally:
        del sys.modules["some_loops"]
    return module


def compiled_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.nb?"))


@needs_compiler
def test_compiled_code_goes_to_the_users_cache_folder(tmp_path):
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    assert compile_module(tmp_path).twice(21) == 42
    assert len(compiled_files(tmp_path / "user" / "numba")) == 2
    assert not compiled_files(tmp_path / "__pycache__")
    assert before == numba.config.CACHE_DIR, "the user's own functions are none of our business"  # type: ignore[attr-defined]


@pytest.mark.slow
@needs_compiler
def test_a_second_process_takes_the_compiled_code(tmp_path):
    (tmp_path / "some_loops.py").write_text(MODULE)
    code = "import some_loops; print(sum(some_loops.twice.load().stats.cache_hits.values()))"
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": str(tmp_path),
    }
    hits = [
        patience.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    assert hits == ["0\n", "1\n"]


def test_what_loops_are_made_of_names_their_folder(tmp_path, monkeypatch):
    """Numba looks at the size and time of the module's own file alone, and an upgrade may keep
    both."""
    source = tmp_path / "ground_loops.py"
    constants = tmp_path / "core" / "classes.py"
    constants.parent.mkdir()
    for path in (source, constants):
        path.write_text("NEAR_M = 1")
        os.utime(path, (0, 0))
    monkeypatch.setattr(cache, "_PACKAGE", tmp_path)

    def folder() -> Path | None:
        cache.name_of_loops.cache_clear()
        return cache.loops_folder()

    folders = [folder(), folder()]
    for path in (source, constants):
        path.write_text("NEAR_M = 2")
        os.utime(path, (0, 0))
        folders.append(folder())
    for versions in (np, numba):
        with monkeypatch.context() as patch:
            patch.setattr(versions, "__version__", "another")
            folders.append(folder())
    assert folders[0] == folders[1]
    assert len(set(folders)) == 5
    assert None not in folders


def test_loops_use_nothing_that_their_folder_is_not_named_by():
    package = Path(cache.__file__).parents[1]
    named = {path for pattern in cache.SOURCES for path in package.glob(pattern)}
    for file in package.rglob("*_loops.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("prc_cli"):
                module = package.parent / f"{str(node.module).replace('.', '/')}.py"
                assert module in named, f"{file}: {node.module}"


@posix_only
def test_temporary_folder_that_others_can_write_is_not_trusted(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "cache_folder", lambda: blocked(tmp_path))
    folder = cache.temporary_cache()
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    assert cache.writable_cache() is None


@posix_only
def test_a_file_that_is_renamed_meanwhile_is_no_danger(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "rglob", lambda folder, _: iter([folder / "gone.nbi.tmp"]))
    assert cache.open_to_others(tmp_path) == ""


@posix_only
def test_temporary_folder_of_somebody_else_is_not_trusted(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "cache_folder", lambda: blocked(tmp_path))
    folder = cache.temporary_cache()
    folder.mkdir(parents=True)
    monkeypatch.setattr(cache, "temporary_cache", lambda: folder)
    if os.getuid() == 0:
        os.chown(folder, 65534, 65534)
    else:
        me = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: me + 1)
    assert cache.writable_cache() is None


@posix_only
@pytest.mark.parametrize("mode", [0o777, 0o757])
def test_the_users_choice_that_others_can_write_is_refused(tmp_path, monkeypatch, mode):
    """Its pickles ran, with whatever somebody had put into them."""
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    with pytest.raises(
        PrcError, match=f"others can put code there that would be run: its mode is {mode:o}"
    ):
        cache.writable_cache()


@posix_only
def test_a_folder_above_that_others_can_write_is_no_better(tmp_path, monkeypatch):
    folder = tmp_path / "open" / "cache"
    folder.mkdir(parents=True, mode=0o700)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    (tmp_path / "open").chmod(0o777)
    with pytest.raises(PrcError, match=r"open: its mode is 777"):
        cache.writable_cache()
    (tmp_path / "open").chmod(0o1777)  # as /tmp
    assert cache.writable_cache() == folder


@posix_only
@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="gives a file to somebody else"
)
def test_what_somebody_else_left_in_it_is_not_run(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    loops = cache.loops_folder()
    assert loops is not None
    loop = loops / "support" / "count.nbc"
    loop.parent.mkdir(parents=True)
    loop.touch()
    for path in (loop, loops):
        os.chown(path, 65534, 65534)
        cache.writable_cache.cache_clear()
        with pytest.raises(PrcError, match=f"{path.name}: it belongs to user 65534"):
            cache.writable_cache()
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    cache.writable_cache.cache_clear()
    monkeypatch.setattr(cache, "cache_folder", lambda: folder.parent)
    (folder.parent / "numba").mkdir()
    (folder.parent / "numba").chmod(0o777)
    assert cache.writable_cache() == cache.temporary_cache()


@posix_only
@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="gives a folder to somebody else"
)
def test_the_owner_of_a_sticky_folder_above_may_exchange_what_is_in_it(tmp_path, monkeypatch):
    folder = tmp_path / "theirs" / "cache"
    folder.mkdir(parents=True, mode=0o700)
    (tmp_path / "theirs").chmod(0o1777)
    os.chown(tmp_path / "theirs", 65534, 65534)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    with pytest.raises(PrcError, match="theirs: it belongs to user 65534"):
        cache.writable_cache()


@posix_only
def test_the_folder_is_used_by_the_name_that_was_checked(tmp_path, monkeypatch):
    (tmp_path / "own").mkdir(mode=0o700)
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "open" / "link").symlink_to(tmp_path / "own")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "open" / "link"))
    assert cache.writable_cache() == tmp_path / "own", "a link there may be exchanged at any time"


@needs_compiler
@pytest.mark.parametrize("damage", [b"", b"\x80", b"not a pickle at all"])
def test_damaged_cache_is_done_without(tmp_path, damage):
    compile_module(tmp_path).twice.load()
    files = compiled_files(tmp_path / "user")
    assert files
    for path in files:
        path.write_bytes(damage)
    assert compile_module(tmp_path).twice(21) == 42


@needs_compiler
def test_a_full_disk_is_done_without(tmp_path, monkeypatch):
    def save(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", save)
    assert compile_module(tmp_path).twice(21) == 42
    assert not compiled_files(tmp_path / "user")
