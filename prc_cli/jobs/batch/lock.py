"""One run at a time in an output folder, also when several machines share it.

The lock is a lock of the operating system on an empty file (:mod:`filelock`). It ends with its process, however that
ends. A JSON file beside it says who holds it, for messages and for ``prc batch status``.

All that take a lock first take the *gate*, a second lock, for a moment. So nobody else takes a lock between the look at
the other locks of the folder and the lock of one's own. Both files are removed before they are released.

Some file systems have no locks. There the JSON file is the lock: its owner touches it every few seconds, and whoever
finds it old takes it over. Two rivals may do that at the same moment; the first then finds the name of the other in
the file and stops. Until then both write the same bytes.
"""

from __future__ import annotations

import contextlib
import errno
import getpass
import json
import os
import platform
import secrets
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from filelock import FileLock, Timeout

from prc_cli import __version__
from prc_cli.core.errors import BusyError, OutputError
from prc_cli.core.files import output_errors, remove_stale, temporary_name
from prc_cli.jobs.batch.types import Shard

GATE = "lock.gate"
GATE_S = 30.0
"""How long to wait for others that take their locks, such as all tasks of a job array [s]."""
LOOK_S = 0.5
"""How long to wait for a lock: whoever asks whether it is held has it for an instant [s]."""
STATUS_S = 0.02
"""The same for who asks only to show it [s]."""
POLL_S = 0.01
BEAT_S = 10.0
"""Time between two heartbeats where the file system has no locks [s]."""
SILENT_S = 120.0
"""An owner without heartbeat for so long is dead [s]."""
_NO_LOCKS = frozenset({errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS, errno.EINVAL})
"""What systems answer where a file system has no locks, or its lock server does not run."""


@dataclass(frozen=True, slots=True)
class Owner:
    """Who holds a lock."""

    host: str
    pid: int
    user: str
    since: str
    """UTC, ISO 8601."""
    shard: str
    """``i/n``; empty for the whole archive."""
    version: str
    token: str
    """Never the same again."""
    beats: bool
    """The file itself is the lock, and is touched as long as its owner lives."""

    @classmethod
    def myself(cls, shard: Shard | None = None, *, beats: bool = False) -> Owner:
        """Return this process as owner of a new lock."""
        return cls(
            host=platform.node(),
            pid=os.getpid(),
            user=_user(),
            since=datetime.now(UTC).isoformat(timespec="seconds"),
            shard="" if shard is None else str(shard),
            version=__version__,
            token=secrets.token_hex(16),
            beats=beats,
        )

    def __str__(self) -> str:
        part = f", shard {self.shard}" if self.shard else ""
        return f"process {self.pid} of {self.user} on {self.host} (since {self.since}{part})"


@dataclass(frozen=True, slots=True)
class Holder:
    """A lock that somebody holds, or held when its process was killed."""

    path: Path
    """The JSON file."""
    owner: Owner
    silent_s: float | None
    """Since the last heartbeat [s]; None where the system holds the lock."""
    alive: bool


def lock_path(folder: Path, shard: Shard | None = None) -> Path:
    """Return the file that says who holds the lock of a shard, or of the whole archive.

    >>> lock_path(Path(".prc"), Shard(3, 8)).name
    'lock.3-of-8.json'
    """
    return folder / ("lock.json" if shard is None else f"lock.{shard.index}-of-{shard.count}.json")


class Lock:
    """The right to work in an output folder, held while the ``with`` block runs.

    Shards of the same number work side by side. A run over the whole archive, or one with another number of shards,
    has files in common with them, so these exclude each other.

    Parameters
    ----------
    folder : Path
        Our own folder in the output tree; made if it is missing.
    shard : Shard, optional
        The part of the archive that this run works on.
    beat_s, silent_s : float
        For tests: see :data:`BEAT_S`, :data:`SILENT_S`.

    Raises
    ------
    BusyError
        When a living owner holds it, or one that has files in common.
    OutputError
        When the folder cannot be written.
    """

    def __init__(
        self, folder: Path, shard: Shard | None = None, *, beat_s: float = BEAT_S, silent_s: float = SILENT_S
    ) -> None:
        self.path = lock_path(folder, shard)
        self.owner = Owner.myself(shard)
        self.inherited_from: Owner | None = None
        """The dead owner that the lock was taken over from."""
        self._folder = folder
        self._shard = shard
        self._beat_s = beat_s
        self._silent_s = silent_s
        self._lock = _LockFile(_locked_file(self.path))
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Lock:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            problem = f"cannot be made ({error.strerror or error})"
            raise OutputError(str(self._folder), problem, "check the output folder and its permissions") from error
        try:
            with output_errors(self.path):
                self._take()
        except BaseException:  # a signal may come just when the lock was taken
            self._release()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._release()

    def check(self) -> None:
        """Make sure that the lock is still ours; to be asked before each file.

        Raises
        ------
        BusyError
            When another run works here now, or somebody removed the lock.
        """
        try:
            found = _read(self.path)
        except OSError:  # a network that comes back; if it does not, the run has other troubles
            return
        if found is None or found.token != self.owner.token:
            how = "its file is gone" if found is None else f"taken over by {found}"
            raise BusyError(
                str(self.path), f"the lock was lost: {how}", "this run stopped; run again to do what is left"
            )

    def _take(self) -> None:
        remove_stale(self.path)
        try:
            with _gate(self._folder):
                self._refuse(by_locks=True)
                try:
                    self._lock.acquire(LOOK_S)
                except Timeout:
                    raise _busy(self.path, _read(self.path) or _unknown(), None) from None
                self.inherited_from = _read(self.path)
                self._sign()
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            (self._folder / GATE).unlink(missing_ok=True)
            self._take_by_heartbeat()

    def _take_by_heartbeat(self) -> None:
        """Take the lock where the file system has none."""
        self.owner = Owner.myself(self._shard, beats=True)
        self._refuse(by_locks=False)
        self.inherited_from = _read(self.path)
        self.path.unlink(missing_ok=True)
        try:
            self.path.touch(exist_ok=False)
        except FileExistsError:
            raise _busy(self.path, _read(self.path) or _unknown(), 0.0) from None
        self._sign()
        self._refuse(by_locks=False)
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
        self._thread.start()

    def _refuse(self, *, by_locks: bool) -> None:
        """Raise where somebody works on files of ours."""
        now = _file_system_time(self.path)
        for path in _lock_paths(self._folder):
            if path != self.path and self._shard is not None and path.name.endswith(f"-of-{self._shard.count}.json"):
                continue
            holder = _holder(path, now, self._silent_s, LOOK_S if by_locks else None)
            if holder is not None and holder.alive and holder.owner.token != self.owner.token:
                raise _busy(holder.path, holder.owner, holder.silent_s)

    def _sign(self) -> None:
        """Say that the lock is ours."""
        temporary = temporary_name(self.path)
        try:
            temporary.write_text(json.dumps(asdict(self.owner), sort_keys=True, indent=1) + "\n", encoding="ascii")
            temporary.replace(self.path)
        finally:
            temporary.unlink(missing_ok=True)

    def _beat(self) -> None:
        while not self._stop.wait(self._beat_s):
            with contextlib.suppress(OSError):
                found = _read(self.path)
                if found is None or found.token != self.owner.token:
                    return
                os.utime(self.path)  # without a time: that of the file server

    def _release(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        with contextlib.suppress(OSError):
            found = _read(self.path)
            if found is not None and found.token == self.owner.token:
                self.path.unlink()
        self._lock.release()


def holders(folder: Path) -> list[Holder]:
    """Return who holds, or held, a lock of an output folder; for ``prc batch status``.

    Heartbeats, where there are any, are compared with the clock of this machine.
    """
    found = (_holder(path, time.time(), SILENT_S, STATUS_S) for path in _lock_paths(folder))
    return [holder for holder in found if holder is not None]


def _lock_paths(folder: Path) -> list[Path]:
    return sorted(folder.glob("lock*.json"))


def _holder(path: Path, now: float, silent_s: float, wait_s: float | None) -> Holder | None:
    """Return who is named in a file, and whether that process lives; None if there is no such file.

    Parameters
    ----------
    path : Path
    now : float
        What time it is for the file system [s].
    silent_s : float
        An owner without heartbeat for so long is dead [s].
    wait_s : float or None
        How long to wait for the lock [s]; None: only heartbeats count.
    """
    try:
        owner, silent = _read(path), max(0.0, now - path.stat().st_mtime)
    except FileNotFoundError:
        return None
    if owner is None:
        return None
    held = None if wait_s is None or owner.beats else _is_held(_locked_file(path), wait_s)
    if held is None:
        return Holder(path, owner, silent, silent < silent_s)
    return Holder(path, owner, None, held)


def has_locks(folder: Path) -> bool:
    """Tell whether the file system of a folder has locks; for ``prc doctor``.

    Raises
    ------
    OSError
        When a file cannot be made there.
    """
    lock = _LockFile(folder / GATE)
    try:
        lock.acquire(LOOK_S)
    except Timeout:
        return True
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return False
        raise
    lock.release()
    return True


@contextlib.contextmanager
def _gate(folder: Path) -> Iterator[None]:
    """Keep others from taking locks of a folder."""
    gate = _LockFile(folder / GATE)
    try:
        gate.acquire(GATE_S)
    except Timeout:
        problem = f"another run has been taking its lock for {GATE_S:g} s"
        raise BusyError(str(folder / GATE), problem, "try again") from None
    try:
        yield
    finally:
        gate.release()


class _LockFile:
    """A lock of the system on an empty file, which is removed when it is released.

    Who waits for the lock may have opened the file before it was removed, and then holds a lock that no one else can
    find. So the file is compared with that of its name after the lock was taken.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._number = 0
        """Of the file that is locked."""
        self._lock = FileLock(
            path, thread_local=False, poll_interval=POLL_S, fallback_to_soft=False, on_acquired=self._keep_number
        )

    def acquire(self, timeout_s: float) -> None:
        """Take the lock.

        Raises
        ------
        Timeout
            When another process holds it for so long.
        OSError
            When the file cannot be opened, or the file system has no locks.
        """
        end = time.monotonic() + timeout_s
        while True:
            self._lock.acquire(timeout=max(0.0, end - time.monotonic()))
            if self._has_its_name():
                return
            self._lock.release()

    def release(self) -> None:
        """Remove the file and release the lock, if it is held."""
        if self._lock.is_locked:
            with contextlib.suppress(OSError):  # Windows keeps files that are open
                if self._has_its_name():
                    self._path.unlink()
        with contextlib.suppress(OSError):
            self._lock.release(force=True)

    def _keep_number(self, handle: int) -> None:
        self._number = os.fstat(handle).st_ino

    def _has_its_name(self) -> bool:
        try:
            return self._path.stat().st_ino == self._number
        except FileNotFoundError:
            return False


def _locked_file(path: Path) -> Path:
    """Return the file that is locked, by that which says who did it.

    >>> _locked_file(Path("lock.3-of-8.json")).name
    'lock.3-of-8'
    """
    return path.with_suffix("")


def _is_held(path: Path, wait_s: float) -> bool | None:
    """Tell whether a process holds a lock; None where the file system has no locks."""
    if not path.exists():
        return False
    lock = FileLock(path, thread_local=False, poll_interval=POLL_S, fallback_to_soft=False)
    try:
        lock.acquire(timeout=wait_s)
    except Timeout:
        return True
    except OSError as error:  # of a user who shares only the outputs: what the file says is believed
        return None if error.errno in _NO_LOCKS else True
    lock.release()
    return False


def _file_system_time(path: Path) -> float:
    """Return what time it is for the file system of a path, whose clock may be that of a server."""
    trial = temporary_name(path)
    try:
        trial.touch()
        return trial.stat().st_mtime
    finally:
        trial.unlink(missing_ok=True)


def _read(path: Path) -> Owner | None:
    """Return the owner that a file names; None if there is no such file.

    A file that is no lock (cut, or edited by hand) is of an unknown owner. Versions before this kind of lock wrote a
    heartbeat, but not that they do.
    """
    try:
        values = json.loads(path.read_bytes())
        known = {key: values[key] for key in _KINDS if key != "beats"} | {"beats": values.get("beats", True)}
        if not all(type(known[key]) is kind for key, kind in _KINDS.items()):
            raise TypeError
        return Owner(**known)
    except FileNotFoundError:
        return None
    except (PermissionError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return _unknown()


_KINDS = {item.name: {"pid": int, "beats": bool}.get(item.name, str) for item in fields(Owner)}


def _unknown() -> Owner:
    return Owner("an unknown machine", 0, "an unknown user", "an unknown time", "", "", "", beats=False)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a user without a name, as containers have
        return f"user {os.getuid()}" if hasattr(os, "getuid") else "unknown"


def _busy(path: Path, owner: Owner, silent_s: float | None) -> BusyError:
    problem = f"another run is at work here: {owner}"
    hint = "wait until it has ended"
    if owner.host == platform.node():
        hint += f", or stop it: kill {owner.pid}"
    if silent_s is not None:
        problem += f", last heard of {silent_s:.0f} s ago"
        hint += f" (a dead one counts for {SILENT_S:.0f} s); where the file system has no locks, as here, give every"
        hint += " machine a part of its own: --shard I/N"
    return BusyError(str(path), problem, hint)
