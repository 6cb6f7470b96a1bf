"""One run at a time in an output folder, also when several machines share it.

A run holds a lock of the operating system on the empty file ``lock``, a shard on ``lock.I-of-N`` (:mod:`filelock`).
The lock ends with its process, however that ends. A JSON file beside it names the owner, for messages and for
``prc batch status``. Both files are removed when the lock is released.

A run takes its own lock, writes the JSON file, and then looks for other runs that have files in common with it. Of two
that start together at least one sees the other and stops.

Some file systems have no locks. There the JSON file is the lock: its owner touches it every few seconds, and another
run replaces it when it is old. If two runs do so at the same moment, the first finds the name of the other in the file
before its next input and stops. Until then both write the same bytes.
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
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType

from filelock import FileLock, Timeout

from prc_cli import __version__
from prc_cli.core.errors import BusyError
from prc_cli.core.files import (
    atomic_output,
    make_folder,
    output_errors,
    read_small,
    refuse_links,
    remove_stale,
    temporary_name,
)
from prc_cli.jobs.batch.types import Shard

LOOK_S = 0.5
"""How long to wait for a lock, because a process that only looks whether it is held holds it for a moment [s]."""
STATUS_S = 0.02
"""The same where the answer is only shown, and for a shard that started together with another run [s]."""
BEAT_S = 10.0
"""Time between two heartbeats where the file system has no locks [s]."""
SILENT_S = 120.0
"""An owner without heartbeat for so long is dead [s]."""
_NO_LOCKS = frozenset({errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS, errno.EINVAL})
"""What systems answer where a file system has no locks, or its lock server does not run."""
_POLL_S = 0.01
_MOST_BYTES = 1 << 16
"""Largest JSON file that is read [bytes]."""
_file_lock = partial(FileLock, thread_local=False, poll_interval=_POLL_S, fallback_to_soft=False)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a user without a name, as in containers
        return f"user {os.getuid()}" if hasattr(os, "getuid") else "unknown"


@dataclass(frozen=True, slots=True)
class Owner:
    """Who holds a lock; by default this process."""

    host: str = field(default_factory=platform.node)
    pid: int = field(default_factory=os.getpid)
    user: str = field(default_factory=_user)
    since: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    """UTC, ISO 8601."""
    shard: str = ""
    """``i/n``; empty for the whole archive."""
    version: str = __version__
    token: str = field(default_factory=lambda: secrets.token_hex(16))
    """Differs from that of every other lock."""
    beats: bool = False
    """The JSON file itself is the lock and is touched while its owner lives."""

    def __str__(self) -> str:
        part = f", shard {self.shard}" if self.shard else ""
        return f"process {self.pid} of {self.user} on {self.host} (since {self.since}{part})"


_UNKNOWN = Owner("an unknown machine", 0, "an unknown user", "an unknown time", version="", token="")


@dataclass(frozen=True, slots=True)
class Holder:
    """A lock that a run holds, or held when its process was killed."""

    path: Path
    """The JSON file."""
    owner: Owner
    silent_s: float | None
    """Time since the last heartbeat [s]; None where the operating system holds the lock."""
    alive: bool


def lock_path(folder: Path, shard: Shard | None = None) -> Path:
    """Return the file that names the owner of the lock of a shard, or of the whole archive.

    >>> lock_path(Path(".prc"), Shard(3, 8)).name
    'lock.3-of-8.json'
    """
    return folder / ("lock.json" if shard is None else f"lock.{shard.index}-of-{shard.count}.json")


class Lock:
    """The right to work in an output folder, held while the ``with`` block runs.

    Shards of the same number work side by side. A run over the whole archive, or one with another number of shards,
    has files in common with them, so these exclude each other.
    """

    def __init__(self, folder: Path, shard: Shard | None = None) -> None:
        self.path = lock_path(folder, shard)
        self.owner = Owner(shard="" if shard is None else str(shard))
        self.inherited_from: Owner | None = None
        """The dead owner that the lock was taken over from."""
        self._folder = folder
        self._shard = shard
        self._lock = _file_lock(self.path.with_suffix(""))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> Lock:
        refuse_links(self._folder, Path(self._lock.lock_file))
        make_folder(self._folder)
        try:
            with output_errors(self.path):
                self._take()
        except BaseException:  # a signal may come just after the lock was taken
            self._release()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._release()

    def check(self) -> None:
        """Make sure that the lock is still ours; called before each file."""
        try:
            found = _read(self.path)
        except OSError:  # the network may come back; if it does not, reading or writing fails with its own message
            return
        if found is None or found.token != self.owner.token:
            how = "its file is gone" if found is None else f"taken over by {found}"
            hint = "this run stopped; run again to do what is left"
            raise BusyError(str(self.path), f"the lock was lost: {how}", hint)

    def _take(self) -> None:
        remove_stale(self.path)
        self._refuse(LOOK_S)
        try:
            self._lock.acquire(LOOK_S)
        except Timeout:
            raise _busy(Holder(self.path, _read(self.path) or _UNKNOWN, None, alive=True)) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            self.owner = replace(self.owner, beats=True)
        self.inherited_from = _read(self.path)
        self._sign()
        self._refuse(LOOK_S if self._shard is None else STATUS_S)  # so that a shard gives way to the whole archive
        if self.owner.beats:
            self._thread.start()

    def _refuse(self, wait_s: float) -> None:
        """Raise if a living run has files in common with this one."""
        now = _file_system_time(self.path)
        for path in self._folder.glob("lock*.json"):
            if path != self.path and self._shard is not None and path.name.endswith(f"-of-{self._shard.count}.json"):
                continue
            holder = _holder(path, now, wait_s, self.owner)
            if holder is not None and holder.alive:
                raise _busy(holder)

    def _sign(self) -> None:
        """Write the name of this run into the JSON file."""
        with atomic_output(self.path, overwrite=True) as temporary:
            temporary.write_text(json.dumps(asdict(self.owner), sort_keys=True, indent=1) + "\n", encoding="ascii")

    def _beat(self) -> None:
        while not self._stop.wait(BEAT_S):
            with contextlib.suppress(OSError):
                found = _read(self.path)
                if found is None or found.token != self.owner.token:
                    return
                os.utime(self.path)  # without a time, so that the file server sets its own

    def _release(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        with contextlib.suppress(OSError):  # Windows keeps files that are open
            found = _read(self.path)
            if found is not None and found.token == self.owner.token:
                self.path.unlink()
                # before the release: filelock notices that the file it waited for was removed
                Path(self._lock.lock_file).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._lock.release(force=True)


def holders(folder: Path) -> list[Holder]:
    """Return who holds, or held, a lock of an output folder; for ``prc batch status``.

    Heartbeats are compared with the clock of this machine.
    """
    found = (_holder(path, time.time(), STATUS_S) for path in sorted(folder.glob("lock*.json")))
    return [holder for holder in found if holder is not None]


def has_locks(folder: Path) -> bool:
    """Tell whether the file system of an empty folder has locks; for ``prc doctor``."""
    (folder / "lock").touch()
    return _is_held(folder / "lock", LOOK_S) is not None


def _holder(path: Path, now: float, wait_s: float, myself: Owner | None = None) -> Holder | None:
    """Return who is named in a file, and whether that process lives; None without such a file, or if it names us.

    ``now`` is the time of the file system [s], ``wait_s`` how long to wait for the lock [s].
    """
    try:
        owner, silent = _read(path), max(0.0, now - path.stat().st_mtime)
    except FileNotFoundError:
        return None
    if owner is None or (myself is not None and owner.token == myself.token):
        return None
    held = None if owner.beats else _is_held(path.with_suffix(""), wait_s)
    if held is None:
        return Holder(path, owner, silent, silent < SILENT_S)
    return Holder(path, owner, None, held)


def _is_held(path: Path, wait_s: float) -> bool | None:
    """Tell whether a process holds a lock; None where the file system has no locks."""
    if not path.exists():
        return False
    try:
        with _file_lock(path).acquire(wait_s):
            return False
    except Timeout:
        return True
    except OSError as error:  # without permission to open the lock, what the JSON file says counts
        return None if error.errno in _NO_LOCKS else True


def _file_system_time(path: Path) -> float:
    """Return the time of the file system of a path [s], which may be that of a server."""
    trial = temporary_name(path)
    try:
        trial.touch()
        return trial.stat().st_mtime
    finally:
        trial.unlink(missing_ok=True)


def _read(path: Path) -> Owner | None:
    """Return the owner that a file names; None if there is no such file.

    A file that is cut, or was edited by hand, has an unknown owner. Versions before 3 wrote heartbeats, and no
    ``beats``.
    """
    try:
        values = {"beats": True} | json.loads(read_small(path, _MOST_BYTES))
        owner = Owner(**{item.name: values[item.name] for item in fields(Owner)})
        if any(type(getattr(owner, item.name)) is not type(getattr(_UNKNOWN, item.name)) for item in fields(Owner)):
            return _UNKNOWN
        return owner
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EPERM, errno.EINVAL, errno.EFBIG, errno.EISDIR, errno.ENXIO):
            return _UNKNOWN
        raise
    except (ValueError, TypeError, KeyError, RecursionError):
        return _UNKNOWN


def _busy(holder: Holder) -> BusyError:
    problem = f"another run is at work here: {holder.owner}"
    hint = "wait until it has ended"
    if holder.owner.host == platform.node():
        hint += f", or stop it: kill {holder.owner.pid}"
    if holder.silent_s is not None:
        problem += f", last heard of {holder.silent_s:.0f} s ago"
        hint += f" (a dead one counts for {SILENT_S:.0f} s); where the file system has no locks, as here, give every"
        hint += " machine a part of its own: --shard I/N"
    return BusyError(str(holder.path), problem, hint)
