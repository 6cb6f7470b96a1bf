"""Atomic output files: complete or absent.

The only module that handles differences of operating systems.

A file is written under a temporary name in the folder of its destination, flushed to the disk and
renamed. The files of one run are a set: all are written first, then all get their names, in the
order in which they were prepared, and only then their temporary names go. So a set that a killed
run left shows by the temporary names which of its files were already placed, and the next run of
the same command and inputs removes them (:func:`remove_unfinished`).
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
import shutil
import stat
import time
from collections.abc import Collection, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import IO, TypeAlias

from prc_cli.core.errors import InputError, OutputError, OutputExistsError
from prc_cli.core.interrupts import signals_wait
from prc_cli.core.paths import is_one_file, refuse_read, run_key

_TEMPORARY = re.compile(
    r"\..+\.(?P<machine>[0-9a-f]{8})-(?P<process>[0-9]{1,9})-(?P<run>[0-9a-f]{8})?[0-9a-f]{8}\.part",
    re.DOTALL,
)
"""Names that :func:`temporary_name` gives; ``run`` names the command and its inputs."""
NAME_BYTES = 255
"""Longest name of a file [bytes], on all usual file systems."""
_OWN_BYTES = 48
"""What :func:`temporary_name` adds to a name at most [bytes], rounded up."""
CLOCK_S = 300.0
"""The clocks of this machine and of a file server differ by less: Kerberos demands it [s]."""
_Finished: TypeAlias = tuple[Path, Path, bool]
"""Temporary name, name, and whether a file of this name is replaced."""
_NO_LINKS = frozenset(
    {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL}
)
"""What systems answer where a file system has no hard links."""


@contextlib.contextmanager
def open_to_read(path: Path) -> Iterator[IO[bytes]]:
    """Open an input file."""
    try:
        handle = _open_regular(path)
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check the name and its permissions") from error
    with handle:
        yield handle


def _open_regular(path: Path) -> IO[bytes]:
    """Open a regular file and nothing else: a pipe would stop the run, a device never end."""
    descriptor = os.open(
        path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    )
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "is no regular file", str(path))
    return open(descriptor, "rb")  # noqa: PTH123 - a descriptor


def read_small(path: Path, limit: int) -> bytes:
    """Return the content of a small file."""
    with _open_regular(path) as handle:
        content = handle.read(limit + 1)
    if len(content) > limit:
        raise OSError(errno.EFBIG, f"is longer than {limit} bytes", str(path))
    return content


def file_state(path: Path | int) -> tuple[int, int, int, int]:
    """Return size, mtime [ns], ctime [ns] and inode; one of them changes when a file does."""
    status = os.fstat(path) if isinstance(path, int) else path.stat()
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino


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
    """Refuse an output before any work is done."""
    n_bytes = len(os.fsencode(path.name))
    if n_bytes > NAME_BYTES:
        problem = f"a name of {n_bytes} bytes, expected at most {NAME_BYTES}"
        raise OutputError(
            str(path), problem, "choose a shorter one; its record has .prc.json at the end"
        )
    _refuse_inputs(path, inputs)
    if path.is_dir():
        raise OutputError(str(path), "is a folder, expected a file name", "name the file inside it")
    if path.exists() and not path.is_file():
        raise OutputError(
            str(path), "is a pipe or a device, expected the name of a file", "choose another name"
        )
    if path.exists() and not overwrite:
        problem = "exists already"
        if any(is_same(part, path) for part in _dead_parts(path)):
            problem += ", left by a killed run of another command or input"
        raise OutputExistsError(str(path), problem, "choose another name or add --overwrite")
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(
            str(folder), "output folder does not exist", f"create it: mkdir -p {folder}"
        )
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(
            str(folder), "output folder is not writable", "change its permissions or choose another"
        )


def _refuse_inputs(path: Path, inputs: Sequence[Path]) -> None:
    refuse_read(path)
    for source in inputs:
        if path.exists() and source.exists() and is_one_file(path, source):
            problem = "the output is the input itself; inputs are never modified"
            raise OutputExistsError(str(path), problem, "choose another output name")


def prepare_outputs(
    *paths: Path,
    overwrite: bool,
    inputs: tuple[Path, ...] = (),
    folders: tuple[Path, ...] = (),
    beside: tuple[Path, ...] = (),
) -> None:
    """Refuse the outputs of a run before any work is done, and remove what dead runs left of them.

    They get their names in this order: folders, which must not be there, the paths, and files
    ``beside`` that the run may write or leave as they are.
    """
    members = (*folders, *paths, *beside)
    for path in members:
        _refuse_inputs(path, inputs)
    key = run_key(*inputs)
    _RUN.set(key)
    _ORDER.set({path.absolute(): number for number, path in enumerate(members)})
    for path in members:
        _note(_BESIDE if path in beside else _OUTPUT, path)
    remove_unfinished(*members, key=key, beside=beside)
    for folder in folders:
        if os.path.lexists(folder):
            raise OutputExistsError(
                str(folder), "exists already", "choose another name for the folder"
            )
    for path in paths:
        check_output(path, overwrite=overwrite, inputs=inputs)
    for path in members:
        for part in _dead_parts(path):
            _remove(part)


_RUN: ContextVar[str] = ContextVar("run", default="0" * 8)
"""Key of the run that prepared its outputs last."""
_ORDER: ContextVar[dict[Path, int]] = ContextVar("order")
"""Number of every output of that run."""
_PENDING: ContextVar[list[_Finished] | None] = ContextVar("pending", default=None)
"""Finished files of a set that is not whole yet; None outside of :func:`whole_set`."""


def check_unchanged(source: Path, before: tuple[int, ...]) -> None:
    """Refuse an input that changed while it was read; ``before`` is its :func:`file_state`."""
    if file_state(source) != before:
        raise InputError(
            str(source), "changed while it was read", "run again when the copy is complete"
        )


def temporary_name(path: Path) -> Path:
    """Return a new hidden name beside ``path`` with the machine and the process id."""
    _note(_OUTPUT, path)
    number = f"{_RUN.get()}{secrets.token_hex(4)}"
    name = path.with_name(f".{_stem(path.name)}.{_machine()}-{os.getpid()}-{number}.part")
    if _State.keeps_proofs:
        _MADE.append(name)
    return name


@contextlib.contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """Make a folder for temporary files where the system has them; remove it at the end."""
    import tempfile  # here, as below: it takes 20 ms to load

    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name:
        _note(_FOLDER, Path(name))
        yield Path(name)


_OUTPUT = b"o"
_BESIDE = b"b"
"""An output that may have been there before."""
_PLACED = b"p"
"""An output that replaced another."""
_PROOF = b"t"
"""The temporary name that shows who made an output."""
_FOLDER = b"f"
"""A temporary folder."""
_notes: list[int] = []


def note_outputs(descriptor: int) -> None:
    """Note outputs in an open file, each with its kind, for the clean-up after a crash."""
    _notes[:] = [descriptor]


def _note(kind: bytes, path: Path) -> None:
    for descriptor in _notes:
        with contextlib.suppress(OSError):
            os.write(descriptor, kind + os.fsencode(path.absolute()) + b"\0")


def _noted(notes: bytes, kind: bytes) -> list[Path]:
    names = dict.fromkeys(note[1:] for note in notes.split(b"\0") if note[:1] == kind)
    return [Path(os.fsdecode(name)) for name in names]


def clean_up(notes: bytes) -> str:
    """Remove what a crashed process left unfinished; return a sentence about its outputs."""
    for folder in _noted(notes, _FOLDER):
        shutil.rmtree(folder, ignore_errors=True)
    beside = _noted(notes, _BESIDE)
    outputs = [path for path in _noted(notes, _OUTPUT) if path not in beside]
    with contextlib.suppress(OSError):
        remove_unfinished(*outputs, *beside, beside=beside)
    return left_words(_noted(notes, _PLACED))


def drop_noted_proofs(notes: bytes) -> None:
    """Remove the temporary names that a process kept, which has ended (:func:`keep_proofs`)."""
    for proof in _noted(notes, _PROOF):
        _remove(proof)


def _stem(name: str) -> str:
    """Return a name, shortened where a temporary one made of it would be too long."""
    raw = os.fsencode(name)
    if len(raw) <= NAME_BYTES - _OWN_BYTES:
        return name
    kept = raw[: NAME_BYTES - _OWN_BYTES - 17].decode("utf-8", "ignore")
    return f"{kept}~{hashlib.sha256(raw).hexdigest()[:16]}"


def parts_of(path: Path, machine: str = "*") -> Iterator[Path]:
    """Yield the temporary files of ``path``, of all machines and processes, or of one machine."""
    yield from path.parent.glob(f".{glob.escape(_stem(path.name))}.{machine}-*.part")


def remove_stale(path: Path) -> tuple[Path, ...]:
    """Remove and return what dead processes of this machine left of an output."""
    return remove_unfinished(path)


def remove_unfinished(
    *paths: Path, key: str | None = None, keeps_whole: bool = False, beside: Collection[Path] = ()
) -> tuple[Path, ...]:
    """Remove what dead processes here left of a set of outputs; return the temporary files.

    Parameters
    ----------
    paths : Path
        The set, in the order in which its files get their names.
    key : str, optional
        Only outputs of this command and these inputs are removed; default: of any.
    keeps_whole : bool
        Keep the outputs if all of them had got their names.
    beside : collection of Path
        Those that may have been there before: each is removed only if its own temporary name shows
        whose it is.
    """
    stale: list[Path] = []
    proven: set[Path] = set()
    n_placed = 0
    for number, path in enumerate(paths, 1):
        for part in _dead_parts(path):
            if is_same(part, path):
                name = _TEMPORARY.fullmatch(part.name)
                if key is not None and name is not None and name["run"] not in (key, None):
                    continue
                n_placed = number
                proven.add(path)
            stale.append(part)
    # names are given and temporary ones removed in this order: all before the last pair were
    # placed, too
    n_sure = sum(path not in beside for path in paths)
    if not (keeps_whole and n_placed >= n_sure):
        for path in paths[:n_placed]:
            if path in proven or path not in beside:
                _remove(path)
    for part in stale:
        _remove(part)
    return tuple(stale)


def _dead_parts(path: Path) -> Iterator[Path]:
    for part in tuple(parts_of(path, _machine())):
        if is_left_behind(part):
            yield part


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def discard(temporary: Path) -> None:
    """Remove a temporary file or folder, unless it waits for its name in a set, or is a proof."""
    pending = _PENDING.get() or ()
    if temporary not in _PROOFS and all(temporary != waiting for waiting, _, _ in pending):
        _remove(temporary)


def is_same(first: Path, second: Path) -> bool:
    """Return whether two names are those of one file; links are not followed."""
    try:
        return os.path.samestat(first.lstat(), second.lstat())
    except OSError:
        return False


def is_left_behind(part: Path) -> bool | None:
    """Return whether a file is the temporary one of a dead process; None = of another machine."""
    name = _TEMPORARY.fullmatch(part.name)
    if name is None:
        return False
    if name["machine"] != _machine():
        return None
    process = int(name["process"])
    return not _is_running(process) or is_younger(process, part, CLOCK_S)


def _machine() -> str:
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _is_running(process: int) -> bool:
    if os.name != "posix":  # on Windows the question would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it runs, but belongs to somebody else
        return True
    # a dead process exists until its parent waits for it; first processes of containers never do
    with contextlib.suppress(OSError, IndexError):
        state = Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()[0]
        return state not in (b"Z", b"X")
    return True


def is_younger(process: int, path: Path, by_s: float = 0.0) -> bool:
    """Return whether a process is younger than a file: then its number was used before."""
    try:
        ticks = int(Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()[19])
        runs_s = float(Path("/proc/uptime").read_text().split()[0]) - ticks / os.sysconf(
            "SC_CLK_TCK"
        )
        return time.time() - path.lstat().st_mtime > runs_s + by_s
    except (OSError, ValueError, IndexError):
        return False


@contextlib.contextmanager
def atomic_output(path: Path, *, overwrite: bool | None = None) -> Iterator[Path]:
    """Give a temporary path to write; give it its name on success, remove it on any failure."""
    with atomic_outputs(path, overwrite=overwrite) as (temporary,):
        yield temporary


@contextlib.contextmanager
def atomic_outputs(*paths: Path, overwrite: bool | None = None) -> Iterator[tuple[Path, ...]]:
    """Give temporary paths to write; all get their names, in this order, or none does."""
    temporaries = tuple(temporary_name(path) for path in paths)
    replaced = tuple(os.path.lexists(path) if overwrite is None else overwrite for path in paths)
    try:
        with output_errors(paths[0]):
            yield temporaries
            place_all(tuple(zip(temporaries, paths, replaced, strict=True)))
    finally:
        for temporary in temporaries:
            discard(temporary)


@contextlib.contextmanager
def whole_set() -> Iterator[None]:
    """Give all files that are finished inside their names at the end; none on any failure."""
    if _PENDING.get() is not None:  # a part of a larger set
        yield
        return
    pending: list[_Finished] = []
    token = _PENDING.set(pending)
    try:
        try:
            yield
        finally:
            _PENDING.reset(token)
        if pending:
            with output_errors(pending[0][1]):
                place_all(pending)
    finally:
        for temporary, _, _ in pending:
            discard(temporary)


def place_all(files: Sequence[_Finished]) -> None:
    """Flush finished temporary files and give them their names, all or none.

    Unless it replaces a file, each keeps its temporary name beside the new one until all are in
    place. So a process that dies in between leaves a proof that the outputs are its own.
    """
    for temporary, path, _ in files:
        refuse_read(path)
        flush(temporary)
    pending = _PENDING.get()
    if pending is not None:
        pending.extend(files)
        return
    order = _ORDER.get({})
    with signals_wait:
        _give_names(sorted(files, key=lambda file: order.get(file[1].absolute(), len(order))))


def _give_names(files: Sequence[_Finished]) -> None:
    made: list[Path] = []
    try:
        for temporary, path, overwrite in files:
            if overwrite:
                temporary.replace(path)
            else:
                _link(temporary, path)
                made.append(path)
    except BaseException:
        for path in made:
            _remove(path)
        raise
    for folder in {path.parent for _, path, _ in files}:
        _sync_folder(folder)
    *others, last = (temporary for temporary, _, _ in files)
    for temporary in others:
        _remove(temporary)
    if _State.keeps_proofs and last.is_file():
        _PROOFS.append(last)
        _note(_PROOF, last)
    else:
        _remove(last)
    _NEW.extend(made)
    for _, path, overwrite in files:
        if overwrite:
            _REPLACED.append(path)
            _note(_PLACED, path)


class _State:
    keeps_proofs = False


_PROOFS: list[Path] = []
"""Temporary names of outputs that are whole, of a command that has not ended yet."""


def keep_proofs() -> None:
    """Keep one temporary name of every set until :func:`drop_proofs`.

    It shows that a run was killed at its end.
    """
    _State.keeps_proofs = True


def drop_proofs() -> None:
    """Remove the temporary names that were kept; the command has ended."""
    for proof in _PROOFS:
        _remove(proof)
    _PROOFS.clear()


def name_folder(temporary: Path, path: Path) -> None:
    """Give a complete folder its name, without the temporary names that were kept in it.

    Nobody could find them afterwards, since their paths change with the folder's.

    Raises
    ------
    OutputError
        If the system refuses.
    """
    for proof in [proof for proof in _PROOFS if temporary in proof.parents]:
        _remove(proof)
        _PROOFS.remove(proof)
    with output_errors(path):
        temporary.rename(path)


_MADE: list[Path] = []
"""Temporary names of a command; a signal may have kept their files from being removed."""


def remove_own() -> None:
    """Remove the temporary files of a command that has ended, but for the names that were kept."""
    for temporary in _MADE:
        if temporary not in _PROOFS:
            _remove(temporary)
    _MADE.clear()


def why_not_written(temporary: Path) -> int:
    """Return the system's error number for a library that could not write, 0 = unknown."""
    with contextlib.suppress(OSError, ImportError):
        import resource

        most = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        if most != resource.RLIM_INFINITY and temporary.stat().st_size + _LEAST_FREE > most:
            return errno.EFBIG
    with contextlib.suppress(OSError):
        if shutil.disk_usage(temporary.parent).free < _LEAST_FREE:
            return errno.ENOSPC
    return 0


_NEW: list[Path] = []
"""Outputs of the running command, where there were none before."""
_REPLACED: list[Path] = []
"""Outputs of the running command that replaced others."""
_MOST_NAMED = 2
_LEAST_FREE = 1 << 20
"""Less is as good as nothing for a library that writes in pieces [bytes]."""


def forget_placed() -> None:
    """Begin a command, which has no outputs yet."""
    _NEW.clear()
    _REPLACED.clear()


def take_back() -> None:
    """Remove the outputs of a command that is interrupted; what replaced others stays."""
    for path in _NEW:
        _remove(path)
    _NEW.clear()


def left_words(placed: Sequence[Path] = _REPLACED) -> str:
    """Return a sentence on the outputs of a run that was cut off.

    >>> left_words([]), left_words([Path("out/a.npy"), Path("b.npy"), Path("c.npy")])
    ('no output was left behind', 'a.npy, b.npy and 1 more are whole and stay')
    """
    if not placed:
        return "no output was left behind"
    names = ", ".join(path.name for path in placed[:_MOST_NAMED])
    more = f" and {len(placed) - _MOST_NAMED} more" * (len(placed) > _MOST_NAMED)
    if len(placed) > 1:
        return f"{names}{more} are whole and stay"
    return f"{names} is whole and stays"


def flush(temporary: Path) -> None:
    """Flush a finished temporary file to the disk."""
    if temporary.is_dir():
        return
    with temporary.open("rb+") as handle:
        os.fsync(handle.fileno())


def _link(temporary: Path, path: Path) -> None:
    # a rename would replace a file that has appeared under this name
    try:
        if os.name == "nt":  # where a rename never replaces
            temporary.rename(path)
        else:
            os.link(temporary, path)
    except FileExistsError as error:
        # the answer of a file server was lost, and the request repeated
        if is_same(temporary, path):
            return
        problem = "appeared while it was being written, and was not replaced"
        raise OutputExistsError(
            str(path), problem, "choose another name or add --overwrite"
        ) from error
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        check_output(path, overwrite=False)
        temporary.rename(path)


@contextlib.contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's write errors into :class:`OutputError`."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            free = "free space on the disk or choose another output folder"
            raise OutputError(
                str(path), "the disk is full; nothing was written under this name", free
            ) from error
        if error.errno == errno.EFBIG:
            problem = (
                "the system's limit for the size of a file is too small; "
                "nothing was written under this name"
            )
            raise OutputError(str(path), problem, "raise it: ulimit -f unlimited") from error
        # reading errors keep their own file name: they are not about the output
        if error.filename is not None and Path(os.fsdecode(error.filename)).parent != path.parent:
            raise
        problem = f"cannot be written ({error.strerror or error})"
        raise OutputError(str(path), problem, "check the folder and its permissions") from error


def begin_flush(handle: IO[bytes], first: int, stop: int) -> None:
    """Ask the system to write part of a file to the disk, so that the final flush is short."""
    advise = getattr(os, "posix_fadvise", None)
    if advise is not None:
        # DONTNEED makes Linux start writing dirty pages; only pages already written leave the cache
        with contextlib.suppress(OSError, ValueError):
            advise(handle.fileno(), first, stop - first, os.POSIX_FADV_DONTNEED)


def _sync_folder(folder: Path) -> None:
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
