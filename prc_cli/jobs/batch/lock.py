"""One run at a time in an output folder, also when several machines share it.

A run holds a lock of the operating system on the empty file ``lock``; a shard holds one on
``lock.I-of-N`` (:mod:`filelock`). The lock ends with its process, in any case. A JSON file beside
it names the owner, for messages and for ``prc batch status``. Both files are removed when the lock
is released.

A run acquires its lock, writes the JSON file, and then looks for other runs that have files in
common with it. If two runs start together, at least one of them sees the other and stops.
"""

from __future__ import annotations

import contextlib
import errno
import getpass
import json
import os
import platform
import secrets
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType

from filelock import FileLock, Timeout

from prc_cli.core.errors import BusyError, OutputError
from prc_cli.core.files import output_errors, read_small
from prc_cli.core.own_file import make_folder, refuse_links, write_own
from prc_cli.core.version import __version__
from prc_cli.jobs.batch.types import Shard, own_name

LOOK_S = 0.5
"""How long to wait for a lock [s]: a process that checks a lock holds it for a moment."""
STATUS_S = 0.02
"""How long to wait if the answer is only shown, or if a shard starts beside another run [s]."""
_NO_LOCKS = frozenset({errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS, errno.EINVAL})
"""Errors of a file system without locks, or whose lock server does not run."""
_MOST_BYTES = 1 << 16
"""Largest JSON file that is read [bytes]."""
_file_lock = partial(FileLock, thread_local=False, poll_interval=0.01, fallback_to_soft=False)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a user without a name, as in containers
        return f"user {os.getuid()}" if hasattr(os, "getuid") else "unknown"


@dataclass(frozen=True, slots=True)
class Owner:
    """The process that holds a lock; by default this one."""

    host: str = field(default_factory=platform.node)
    pid: int = field(default_factory=os.getpid)
    user: str = field(default_factory=_user)
    since: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    """UTC, ISO 8601."""
    shard: str = ""
    """``i/n``; empty for the whole archive."""
    version: str = __version__
    token: str = field(default_factory=lambda: secrets.token_hex(16))
    """Random number that no other lock has."""

    def __str__(self) -> str:
        shard = f", shard {self.shard}" if self.shard else ""
        return f"process {self.pid} of {self.user} on {self.host} (since {self.since}{shard})"


_UNKNOWN = Owner(
    "an unknown machine", 0, "an unknown user", "an unknown time", version="", token=""
)


@dataclass(frozen=True, slots=True)
class Holder:
    """A lock that a run holds, or held when its process was killed."""

    path: Path
    """The JSON file."""
    owner: Owner
    alive: bool


class Lock:
    """The right to work in an output folder, as a context manager.

    Shards of the same number may run at the same time.
    """

    def __init__(self, folder: Path, shard: Shard | None = None) -> None:
        self.path = folder / own_name("lock", shard, ".json")
        self.owner = Owner(shard="" if shard is None else str(shard))
        self.inherited_from: Owner | None = None
        """The dead run whose lock was taken over."""
        self._folder = folder
        self._shard = shard
        self._lock = _file_lock(self.path.with_suffix(""))

    def __enter__(self) -> Lock:
        refuse_links(self._folder, Path(self._lock.lock_file))
        make_folder(self._folder)
        try:
            with output_errors(self.path):
                self._acquire()
        except BaseException:  # a signal may come just after the lock was acquired
            self._release()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._release()

    def check(self) -> None:
        """Raise if this run has lost the lock; called before each file."""
        try:
            owner = _read(self.path)
        except OSError:
            # the network may come back; if it does not, reading or writing fails later
            return
        if owner is None or owner.token != self.owner.token:
            cause = "its file is gone" if owner is None else f"taken over by {owner}"
            hint = "this run stopped; run again to do the other files"
            raise BusyError(str(self.path), f"the lock was lost: {cause}", hint)

    def _acquire(self) -> None:
        self._refuse(LOOK_S)
        try:
            self._lock.acquire(LOOK_S)
        except Timeout:
            raise _busy(self.path, _read(self.path) or _UNKNOWN) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            problem = (
                f"this file system has no file locks ({error.strerror}), "
                "which keep a second run out"
            )
            hint = "choose an output folder on another disk; Lustre: mount it with -o flock"
            raise OutputError(str(self._folder), problem, hint) from error
        self.inherited_from = _read(self.path)
        write_own(self.path, json.dumps(asdict(self.owner), sort_keys=True, indent=1) + "\n")
        # a shard waits less, so that it gives way to a run of the whole archive
        self._refuse(LOOK_S if self._shard is None else STATUS_S)

    def _refuse(self, wait_s: float) -> None:
        """Raise if a living run has files in common with this one."""
        for path in self._folder.glob("lock*.json"):
            if (
                path != self.path
                and self._shard is not None
                and path.name.endswith(f"-of-{self._shard.count}.json")
            ):
                continue
            owner = _read(path)
            if owner is not None and owner.token != self.owner.token and _is_held(path, wait_s):
                raise _busy(path, owner)

    def _release(self) -> None:
        with contextlib.suppress(OSError):  # Windows keeps files that are open
            owner = _read(self.path)
            if owner is not None and owner.token == self.owner.token:
                self.path.unlink()
                # before the release: filelock notices that the file it waited for was removed
                Path(self._lock.lock_file).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._lock.release(force=True)


def holders(folder: Path) -> list[Holder]:
    """Return the present and past owners of the locks of a folder, for ``prc batch status``."""
    owners = ((path, _read(path)) for path in sorted(folder.glob("lock*.json")))
    return [
        Holder(path, owner, _is_held(path, STATUS_S)) for path, owner in owners if owner is not None
    ]


def has_locks(folder: Path) -> bool:
    """Check whether the file system of an empty folder has locks; for ``prc doctor``."""
    try:
        with _file_lock(folder / "lock").acquire(LOOK_S):
            return True
    except OSError as error:
        return error.errno not in _NO_LOCKS


def _is_held(path: Path, wait_s: float) -> bool:
    # whether a process holds the lock beside a JSON file; False on a file system without locks
    lock = path.with_suffix("")
    if not lock.exists():
        return False
    try:
        with _file_lock(lock).acquire(wait_s):
            return False
    except Timeout:
        return True
    except OSError as error:  # without permission to open the lock, the JSON file counts
        return error.errno not in _NO_LOCKS


def _read(path: Path) -> Owner | None:
    """Return the owner that a file names, unknown if it was cut or edited; None without a file."""
    try:
        values = json.loads(read_small(path, _MOST_BYTES))
        owner = Owner(**{key.name: values[key.name] for key in fields(Owner)})
        for key in fields(Owner):
            if type(getattr(owner, key.name)) is not type(getattr(_UNKNOWN, key.name)):
                return _UNKNOWN
        return owner
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno in (
            errno.EACCES,
            errno.EPERM,
            errno.EINVAL,
            errno.EFBIG,
            errno.EISDIR,
            errno.ENXIO,
        ):
            return _UNKNOWN
        raise
    except (ValueError, TypeError, KeyError, RecursionError):
        return _UNKNOWN


def _busy(path: Path, owner: Owner) -> BusyError:
    stop = f", or stop it: kill {owner.pid}" if owner.host == platform.node() else ""
    return BusyError(
        str(path), f"another run is at work here: {owner}", f"wait until it has ended{stop}"
    )
