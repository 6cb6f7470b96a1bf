"""One run at a time in an output folder, also when machines share it and any of them may be switched off.

A lock is a file that says who holds it. It is made whole and linked to its name, which only one of several rivals can
do. Its time of change is the heartbeat, set by the file system, so that clocks of machines do not matter.

The lock of a dead owner is inherited, not deleted: rivals that found it at the same moment could delete each other's.
Every lock has a token that never comes again. Its heir is whoever links ``<lock>.heir-<token>``, which again only one
can do; the heir may die too and leave the lock to the heir of its own token, and so on down a chain that begins with
the lock file. An heir then puts its own file in the place of the lock, and only after that removes the links. So who
has linked a name and finds the lock file still as it was when the chain was read is the one true heir; who finds
another there came too late.
"""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import json
import os
import platform
import random
import secrets
import subprocess
import threading
import time
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from prc_cli import __version__
from prc_cli.core.errors import BusyError, OutputError
from prc_cli.core.files import output_errors, remove_stale, temporary_name
from prc_cli.jobs.batch.types import Shard

BEAT_S = 10.0
"""Time between two heartbeats [s]."""
SILENT_S = 120.0
"""An owner on another machine that was silent for so long is dead [s]."""
REBOOTED_S = 30.0
"""The same for an owner on this machine before it was started anew: a name may belong to two machines [s]."""
ATTEMPTS = 200
"""How often a race is run again before it is given up; every attempt but the last was won by somebody."""
ATTEMPT_PAUSE_S = 0.05
CONFLICT_ATTEMPTS = 6
"""How often a run steps back from a run of another division of the archive that may be stepping back as well."""
CONFLICT_PAUSE_S = 0.3


@dataclass(frozen=True, slots=True)
class Owner:
    """Who holds a lock."""

    host: str
    boot: str
    """What tells starts of the machine apart; empty where it cannot be asked."""
    pid_space: str
    """What tells containers of a machine apart, whose process numbers mean other processes."""
    pid: int
    born: str
    """When the process was started, by the system's own count; empty where it cannot be asked."""
    user: str
    since: str
    """UTC, ISO 8601."""
    shard: str
    version: str
    token: str
    """Never the same again."""

    @classmethod
    def myself(cls, shard: Shard | None = None) -> Owner:
        """Return this process as owner of a new lock."""
        return cls(
            host=platform.node(),
            boot=_boot(),
            pid_space=_pid_space(),
            pid=os.getpid(),
            born=_born(os.getpid()) or "",
            user=_user(),
            since=datetime.now(UTC).isoformat(timespec="seconds"),
            shard="" if shard is None else str(shard),
            version=__version__,
            token=secrets.token_hex(16),
        )

    def __str__(self) -> str:
        part = f", shard {self.shard}" if self.shard else ""
        return f"process {self.pid} of {self.user} on {self.host} (since {self.since}{part})"


@dataclass(frozen=True, slots=True)
class Holder:
    """A lock that somebody holds, or held."""

    path: Path
    """The lock; its heir's file where one took it over a moment ago."""
    owner: Owner
    silent_s: float
    """Since the last heartbeat, by the clock of the file system [s]."""
    alive: bool


def lock_path(folder: Path, shard: Shard | None = None) -> Path:
    """Return the lock of a shard, or of runs over the whole archive.

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
    beat_s, silent_s, rebooted_s : float
        For tests: see :data:`BEAT_S`, :data:`SILENT_S`, :data:`REBOOTED_S`.

    Raises
    ------
    BusyError
        When a living owner holds it, or one that conflicts with it.
    OutputError
        When the folder cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        shard: Shard | None = None,
        *,
        beat_s: float = BEAT_S,
        silent_s: float = SILENT_S,
        rebooted_s: float = REBOOTED_S,
    ) -> None:
        self.path = lock_path(folder, shard)
        self.owner = Owner.myself(shard)
        self.inherited_from: Owner | None = None
        """The dead owner that the lock was taken over from."""
        self._folder = folder
        self._shard = shard
        self._beat_s = beat_s
        self._patience = _Patience(silent_s, rebooted_s)
        self._lost: str | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> Lock:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            problem = f"cannot be made ({error.strerror or error})"
            raise OutputError(str(self._folder), problem, "check the output folder and its permissions") from error
        try:
            self._acquire()
            self._thread.start()
        except BaseException:  # a signal may come just when the lock was taken
            self._release()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join()
        self._release()

    def check(self) -> None:
        """Raise when the lock was taken from us, as may happen after the machine slept; to be asked before each file.

        Raises
        ------
        BusyError
            When another run works here now, or the lock was removed.
        """
        if self._lost is not None:
            hint = "this run stopped; run again to do what is left"
            raise BusyError(str(self.path), f"the lock was lost: {self._lost}", hint)

    # taking

    def _acquire(self) -> None:
        """Take the lock, and step back where a run of another division of the archive is at work."""
        for attempt in range(CONFLICT_ATTEMPTS):
            self._take()
            other = self._conflicting()
            if other is None:
                return
            self._release()
            if attempt == CONFLICT_ATTEMPTS - 1:
                raise _busy(other)
            # two that saw each other and stepped back: one of them is to come first next time
            time.sleep(random.uniform(0, CONFLICT_PAUSE_S))
            self.owner = Owner.myself(self._shard)

    def _take(self) -> None:
        with output_errors(self.path):
            remove_stale(self.path)
            temporary = temporary_name(self.path)
            try:
                _write(temporary, self.owner)
                for _ in range(ATTEMPTS):
                    if self._try(temporary):
                        return
                    time.sleep(random.uniform(0, ATTEMPT_PAUSE_S))
            finally:
                temporary.unlink(missing_ok=True)
        problem = "changes hands faster than it can be read"
        raise BusyError(str(self.path), problem, "try again")

    def _try(self, temporary: Path) -> bool:
        """Try once to take or inherit the lock; False when a rival was quicker, who may have left since."""
        root = _read(self.path)
        # links of earlier owners; they are listed before the lock is ours, so none can belong to our own heirs
        spent = list(self.path.parent.glob(f"{self.path.name}.heir-*"))
        if root is None:
            if not _link(temporary, self.path):
                return False
        elif not self._inherit(root, temporary):
            return False
        for path in spent:
            path.unlink(missing_ok=True)
        return True

    def _inherit(self, root: Owner, temporary: Path) -> bool:
        """Take over the lock of a dead owner; False when a rival was quicker."""
        last_path, last = _chain(self.path, root)[-1]
        holder = _judge(last_path, last, temporary, self._patience)
        if holder is None or _read(self.path) != root:
            return False
        if holder.alive:
            raise _busy(holder)
        heir = _heir_path(self.path, last)
        if not _link(temporary, heir):
            return False
        if _read(self.path) != root:  # the lock went on to somebody else before the link was made
            heir.unlink(missing_ok=True)
            return False
        # the link stays until our own file is the lock: whoever finds the dead owner there finds us as its heir
        copy = temporary_name(self.path)
        _write(copy, self.owner)
        copy.replace(self.path)
        heir.unlink(missing_ok=True)
        self.inherited_from = last
        return True

    def _conflicting(self) -> Holder | None:
        """Return a living owner whose files overlap with ours."""
        count = None if self._shard is None else self._shard.count
        for holder in holders(self._folder, beside=self.path, patience=self._patience):
            own = holder.owner.token == self.owner.token
            sibling = count is not None and holder.owner.shard.endswith(f"/{count}")
            if holder.alive and not own and not sibling:
                return holder
        return None

    # holding

    def _beat(self) -> None:
        while not self._stop.wait(self._beat_s):
            try:
                found = _read(self.path)
                if found is None:
                    self._lost = "its file is gone"
                elif found.token != self.owner.token:
                    self._lost = f"taken over by {found}"
                elif (heir := _read(_heir_path(self.path, self.owner))) is not None:
                    self._lost = f"taken over by {heir}"
                else:
                    os.utime(self.path)  # without a time: that of the file server
                    continue
                return
            except OSError:  # a network that comes back; if it does not, the run has other troubles
                continue

    def _release(self) -> None:
        with contextlib.suppress(OSError):
            found = _read(self.path)
            if found is not None and found.token == self.owner.token:
                self.path.unlink()


@dataclass(frozen=True, slots=True)
class _Patience:
    """How long an owner may be silent before it is taken for dead [s]."""

    silent_s: float = SILENT_S
    rebooted_s: float = REBOOTED_S


def holders(folder: Path, *, beside: Path | None = None, patience: _Patience | None = None) -> list[Holder]:
    """Return who holds, or held, a lock of an output folder; for ``prc batch status``.

    Nothing is changed. Without a file of ours ``beside`` the locks, which tells what time it is there, heartbeats are
    compared with the clock of this machine.
    """
    found = []
    for path in sorted(folder.glob("lock*.json")):
        root = _read(path)
        if root is None:
            continue
        last_path, last = _chain(path, root)[-1]
        holder = _judge(last_path, last, beside, patience or _Patience())
        if holder is not None:
            found.append(holder)
    return found


def _chain(path: Path, root: Owner) -> list[tuple[Path, Owner]]:
    """Return the lock and its heirs, each the heir of the one before."""
    chain = [(path, root)]
    while (heir := _read(_heir_path(path, chain[-1][1]))) is not None:
        chain.append((_heir_path(path, chain[-1][1]), heir))
    return chain


def _heir_path(path: Path, owner: Owner) -> Path:
    return path.with_name(f"{path.name}.heir-{owner.token}")


def _write(path: Path, owner: Owner) -> None:
    with path.open("wb") as handle:
        handle.write(json.dumps(asdict(owner), sort_keys=True, indent=1).encode("ascii") + b"\n")
        handle.flush()
        os.fsync(handle.fileno())


def _read(path: Path) -> Owner | None:
    """Return the owner that a lock names; None if there is no such file.

    A file that is no lock (cut, or edited by hand) counts as that of an unknown owner of some other machine.
    """
    try:
        number = path.stat().st_ino
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except PermissionError:  # of a user who shares nothing but the heartbeat
        return _unknown(f"closed{number}")
    try:
        values = json.loads(content)
        owner = Owner(**values)
        if not all(isinstance(value, int if key == "pid" else str) for key, value in values.items()):
            raise TypeError
        if not owner.token.isalnum():  # it becomes part of a file name
            raise ValueError
    except (ValueError, TypeError, RecursionError):
        return _unknown(f"unreadable{number}x{hashlib.sha256(content).hexdigest()[:16]}")
    return owner


def _unknown(token: str) -> Owner:
    return Owner("an unknown machine", "", "", 0, "", "an unknown user", "an unknown time", "", "", token)


def _link(source: Path, target: Path) -> bool:
    """Give a file a second name unless the name is taken; tell whether it was free."""
    try:
        os.link(source, target)
    except FileExistsError:
        # a file server may have made the link and lost the answer
        return _is_same(source, target)
    except OSError:
        return _create(source, target)
    return True


def _is_same(one: Path, other: Path) -> bool:
    """Tell whether two names are of one file."""
    try:
        return one.samefile(other)
    except OSError:
        return False


def _create(source: Path, target: Path) -> bool:
    """Do the same where the file system has no second names (FAT, some network shares)."""
    try:
        handle = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        return False
    with os.fdopen(handle, "wb") as stream:
        stream.write(source.read_bytes())
        stream.flush()
        os.fsync(stream.fileno())
    return True


# dead or alive


def _judge(path: Path, owner: Owner, beside: Path | None, patience: _Patience) -> Holder | None:
    """Tell whether an owner lives; None when its file has gone meanwhile.

    Parameters
    ----------
    path : Path
        File whose time of change is the heartbeat.
    owner : Owner
        Who is named in it.
    beside : Path, optional
        A file of ours on the same file system, which tells what time it is there.
    patience : _Patience
        How long an owner may be silent.
    """
    try:
        if beside is not None:
            os.utime(beside)
        now = time.time() if beside is None else beside.stat().st_mtime
        silent = now - path.stat().st_mtime
    except FileNotFoundError:
        return None
    running = _is_running(owner)
    if running is None:
        rebooted = owner.host == platform.node() and "" not in (owner.boot, _boot()) and owner.boot != _boot()
        running = silent < (patience.rebooted_s if rebooted else patience.silent_s)
    return Holder(path, owner, silent, running)


def _is_running(owner: Owner) -> bool | None:
    """Tell whether the process of an owner runs; None where it cannot be known from here."""
    here = (platform.node(), _boot(), _pid_space())
    if (owner.host, owner.boot, owner.pid_space) != here or not owner.boot or os.name != "posix" or owner.pid <= 0:
        return None
    try:
        os.kill(owner.pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it runs, but belongs to somebody else
        pass
    born = _born(owner.pid)
    if born == "":  # ended, and waits for its parent to ask
        return False
    if born is None or not owner.born:
        return None
    # a number is given again; the same number at the same time is not
    return born == owner.born


def _born(pid: int) -> str | None:
    """Return when a process was started, by the system's count; empty if it has ended, None if it cannot be asked."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return _born_by_ps(pid)
    return "" if fields[0] in "ZX" else fields[19]


def _born_by_ps(pid: int) -> str | None:
    """Ask ``ps``, where there is no ``/proc`` (macOS)."""
    if os.name != "posix" or Path("/proc/self/stat").exists():
        return None
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        command = ["ps", "-o", "stat=,lstart=", "-p", str(pid)]
        found = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False).stdout.split(
            maxsplit=1
        )
        if len(found) == 2:
            return "" if found[0].startswith("Z") else found[1].strip()
    return None


def _boot() -> str:
    """Return what tells this start of the machine from others; empty where it cannot be asked."""
    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        command = ["sysctl", "-n", "kern.bootsessionuuid"]
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=False).stdout.strip()
    return ""


def _pid_space() -> str:
    try:
        return str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return ""


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a user without a name, as containers have
        return f"user {os.getuid()}" if hasattr(os, "getuid") else "unknown"


def _busy(holder: Holder) -> BusyError:
    problem = f"another run is at work here: {holder.owner}, last heard of {max(0.0, holder.silent_s):.0f} s ago"
    hint = "wait until it has ended"
    if holder.owner.host == platform.node():
        hint += f", or stop it: kill {holder.owner.pid}"
    return BusyError(str(holder.path), problem, hint)
