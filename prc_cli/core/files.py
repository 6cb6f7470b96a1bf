"""Atomic output files: complete or absent. The only module that handles differences of operating systems.

A file is written under a temporary name in the folder of its destination, flushed to the disk and renamed.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import os
import platform
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from prc_cli.core.errors import InputError, OutputError, OutputExistsError

_TEMPORARY = re.compile(r"\..+\.(?P<machine>[0-9a-f]{8})-(?P<process>[0-9]{1,9})-[0-9a-f]{8}\.part", re.DOTALL)
"""Names that :func:`temporary_name` gives."""


@contextlib.contextmanager
def open_to_read(path: Path) -> Iterator[IO[bytes]]:
    """Open an input file.

    Raises
    ------
    InputError
        When it cannot be opened.
    """
    try:
        handle = path.open("rb")
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check the name and its permissions") from error
    with handle:
        yield handle


def suffix_of(path: Path) -> str:
    """Return the suffix that decides the format, in lower case, including the compression.

    >>> suffix_of(Path("drive.CSV.gz"))
    '.csv.gz'
    >>> suffix_of(Path("drive.1.csv.gz"))
    '.csv.gz'
    >>> suffix_of(Path("labels.npy.prc.json"))
    '.json'
    """
    suffixes = [suffix.lower() for suffix in path.suffixes]
    return "".join(suffixes[-2:] if suffixes[-1:] in ([".gz"], [".zst"]) else suffixes[-1:])


def check_output(path: Path, *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Refuse an output before any work is done.

    Raises
    ------
    OutputExistsError
        When the output exists and may not be replaced, or is one of the inputs.
    OutputError
        When its folder is missing or cannot be written.
    """
    for source in inputs:
        if path.exists() and source.exists() and path.samefile(source):
            problem = "the output is the input itself; inputs are never modified"
            raise OutputExistsError(str(path), problem, "choose another output name")
    if path.is_dir():
        raise OutputError(str(path), "is a folder, expected a file name", "name the file inside it")
    if path.exists() and not overwrite:
        raise OutputExistsError(str(path), "exists already", "choose another name or add --overwrite")
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(str(folder), "output folder does not exist", f"create it: mkdir -p {folder}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(str(folder), "output folder is not writable", "change its permissions or choose another")


def make_folder(folder: Path) -> None:
    """Make a folder of ours and those above it where they are missing.

    Raises
    ------
    OutputError
        When that fails.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made ({error.strerror or error})"
        raise OutputError(str(folder), problem, "check the output folder and its permissions") from error


def temporary_name(path: Path) -> Path:
    """Return a fresh hidden name beside ``path`` (same file system, so that a rename is atomic).

    It holds the machine and the process id, so that files left by a killed process can be recognised.
    """
    return path.with_name(f".{path.name}.{_machine()}-{os.getpid()}-{secrets.token_hex(4)}.part")


def remove_stale(path: Path) -> tuple[Path, ...]:
    """Remove temporary files of ``path`` left by dead processes of this machine; return what was removed.

    Files of other machines that share the folder, and of running processes, are kept.
    """
    removed = []
    for part in path.parent.glob(f".{glob.escape(path.name)}.{_machine()}-*.part"):
        if is_left_behind(part):
            with contextlib.suppress(OSError):
                part.unlink()
                removed.append(part)
    return tuple(removed)


def is_left_behind(part: Path) -> bool | None:
    """Tell whether a file is a temporary one whose process is dead; None if it is of another machine.

    >>> is_left_behind(Path("drive.laz")), is_left_behind(Path(".drive.laz.0123abcd-77-89abcdef.part"))
    (False, None)
    """
    found = _TEMPORARY.fullmatch(part.name)
    if found is None:
        return False
    return not _is_running(int(found["process"])) if found["machine"] == _machine() else None


def _machine() -> str:
    """Return a short name of this machine without folder separators and glob characters."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _is_running(process: int) -> bool:
    """Return whether a process runs; always True on Windows, where asking would end it."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it runs, but belongs to somebody else
        return True
    return True


@contextlib.contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """Give a temporary path to write; rename it to ``path`` on success, remove it on any failure.

    Raises
    ------
    OutputError
        When the file cannot be created, filled (disk full) or renamed.

    Examples
    --------
    >>> import tempfile
    >>> target = Path(tempfile.mkdtemp()) / "labels.bin"
    >>> with atomic_output(target) as temporary:
    ...     _ = temporary.write_bytes(b"abc")
    >>> target.read_bytes()
    b'abc'
    """
    temporary = temporary_name(path)
    try:
        with output_errors(path):
            yield temporary
            commit(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def commit(temporary: Path, path: Path) -> None:
    """Flush a finished temporary file to the disk and rename it to ``path``."""
    with temporary.open("rb+") as handle:
        os.fsync(handle.fileno())
    temporary.replace(path)
    _sync_folder(path.parent)


@contextlib.contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's write errors into :class:`OutputError`."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            free = "free space on the disk or choose another output folder"
            raise OutputError(str(path), "the disk is full; nothing was written under this name", free) from error
        # reading errors keep their own file name: they are not about the output
        if error.filename is not None and Path(os.fsdecode(error.filename)).parent != path.parent:
            raise
        problem = f"cannot be written ({error.strerror or error})"
        raise OutputError(str(path), problem, "check the folder and its permissions") from error


def begin_flush(handle: IO[bytes], first: int, stop: int) -> None:
    """Ask the system to start writing part of a file to the disk, without waiting; does nothing where unsupported.

    The final flush then has less to wait for. No guarantee is given.

    Parameters
    ----------
    handle : file
        Open; bytes still in its buffer are not included.
    first, stop : int
        Byte range, ``stop`` exclusive; name each byte only once.
    """
    advise = getattr(os, "posix_fadvise", None)
    if advise is not None:
        # DONTNEED makes Linux start writing dirty pages; only pages already written leave the cache
        with contextlib.suppress(OSError, ValueError):
            advise(handle.fileno(), first, stop - first, os.POSIX_FADV_DONTNEED)


def _sync_folder(folder: Path) -> None:
    """Make a rename durable where folders can be flushed (POSIX); elsewhere the rename is enough."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:  # some network file systems refuse; the rename is done anyway
        pass
    finally:
        os.close(handle)


def cache_folder() -> Path:
    """Return the user's cache folder of this program, whether it exists or not."""
    base = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME")
    try:
        root = Path(base) if base else Path.home() / ".cache"
    except RuntimeError:  # no home folder, as for some cron users
        import tempfile

        root = Path(tempfile.gettempdir())
    return root / "prc-cli"
