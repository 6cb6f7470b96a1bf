"""Journal of the finished files, in SQLite in the output folder.

There is one for the whole archive, or one for every shard.

prc writes a row before a worker starts a file and after it has ended. Each write is a transaction
that is on the disk when the call returns. A kill at any moment leaves the journal as it was before
or after one of these steps. If an output may have been written without a final entry, its file is
still ``running``.

Only the owner of the lock writes (:mod:`prc_cli.jobs.batch.lock`). Other programs may read at the
same time, also from another machine. So the journal has a rollback journal instead of SQLite's WAL,
which needs memory that all readers and writers share.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import secrets
import shlex
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Literal, TypeAlias, get_args

from prc_cli.core.errors import BusyError, InputError, OutputError
from prc_cli.core.files import why_not_written
from prc_cli.core.own_file import make_folder, refuse_links
from prc_cli.core.version import __version__
from prc_cli.jobs.batch.outcomes import (
    Done,
    Doubted,
    Failed,
    Outcome,
    check_type,
    from_json,
    to_json,
)
from prc_cli.jobs.batch.types import Shard, Task, own_name

SCHEMA = 2
"""Version of the tables; prc refuses a journal with another version."""
APPLICATION = 0x5052434A
"""``PRCJ`` in the header of the file, to recognise other databases."""
WAIT_S = 30.0
"""How long a statement waits for another program that has locked the file, as a backup [s]."""

_TABLES = (
    """CREATE TABLE runs (
    id TEXT PRIMARY KEY, shard TEXT NOT NULL, version TEXT NOT NULL, owner TEXT NOT NULL,
    started TEXT NOT NULL, finished TEXT, exit_code INTEGER, totals TEXT NOT NULL)""",
    """CREATE TABLE files (
    name BLOB PRIMARY KEY, state TEXT NOT NULL, config_sha256 TEXT NOT NULL, version TEXT NOT NULL,
    run TEXT NOT NULL, attempts INTEGER NOT NULL, started TEXT NOT NULL, finished TEXT,
    owner TEXT NOT NULL, outcome TEXT, owns_output INTEGER NOT NULL)""",
)
_SOURCES = "CREATE TABLE IF NOT EXISTS sources (name BLOB PRIMARY KEY, path BLOB NOT NULL)"
"""Added in 1.2; earlier versions ignore it."""
_SOURCE = "INSERT OR REPLACE INTO sources (name, path) VALUES (:name, :source)"
_ENTRY = (
    "name, state, config_sha256, version, run, attempts, started, finished, owner, outcome, "
    "owns_output"
)
_START = """
INSERT INTO files (name, state, config_sha256, version, run, attempts, started, owner, owns_output)
VALUES (:name, 'running', :config, :version, :run, 1, :now, :owner, 1)
ON CONFLICT (name) DO UPDATE SET
    attempts = CASE WHEN state = 'done' THEN 1 ELSE attempts + 1 END,
    state = 'running', config_sha256 = :config, version = :version, run = :run, started = :now,
    finished = NULL, owner = :owner, owns_output = 1
"""
_FINISH = """
INSERT INTO files (name, state, config_sha256, version, run, attempts, started, finished, owner,
    owns_output, outcome)
VALUES (:name, :state, '', :version, :run, 0, :now, :now, '', :owns, :outcome)
ON CONFLICT (name) DO UPDATE SET
    state = :state, finished = :now, owns_output = min(owns_output, :owns), outcome = :outcome
"""


State: TypeAlias = Literal["running", "done", "failed"]
"""State of a file in the journal.

``running`` without a living run means that the run was stopped or killed.
"""


@dataclass(frozen=True, slots=True)
class Entry:
    """Journal entry of one file."""

    name: str
    state: State
    config_sha256: str
    version: str
    run: str
    attempts: int
    """Number of attempts since the file was last done, including the current one."""
    started: str
    finished: str | None
    """None while running."""
    owner: str
    outcome: Outcome | None
    """Outcome of the last attempt that ended; a later attempt may have been cut off."""
    owns_output: bool = True
    """Whether a worker of this program was sent to write the output; False for refused files."""
    source: str = ""
    """Real path of the input of the output; empty in journals of versions before 1.2."""

    @property
    def doubts(self) -> tuple[Doubted, ...]:
        """The doubts about its output; none for files that are not done."""
        if self.state == "done" and isinstance(self.outcome, Done):
            return self.outcome.doubts
        return ()


@dataclass(frozen=True, slots=True)
class Run:
    """Journal entry of one run."""

    id: str
    shard: str
    """``i/n``; empty for the whole archive."""
    version: str
    owner: str
    started: str
    finished: str | None
    """None for a run that is running or was killed."""
    exit_code: int | None
    totals: tuple[tuple[str, int], ...] = ()


def journal_paths(folder: Path) -> list[Path]:
    """Return all journals of an output folder, the journal of the whole archive first."""
    return sorted(
        folder.glob("journal*.sqlite"), key=lambda path: (path.name != "journal.sqlite", path.name)
    )


class Journal:
    """The journal of one run, which only this run writes.

    Newer entries in the other journals of the folder count, too.
    """

    def __init__(self, folder: Path, shard: Shard | None = None) -> None:
        self.path = folder / own_name("journal", shard, ".sqlite")
        self.run = ""
        """Id of the run, once it has begun."""
        self._folder = folder
        self._shard = shard
        self._others: dict[str, Entry] = {}
        self._stack = contextlib.ExitStack()
        self._database: sqlite3.Connection

    def __enter__(self) -> Journal:
        refuse_links(self._folder, self.path)  # SQLite would make the target of a link to nothing
        make_folder(self._folder)
        with contextlib.ExitStack() as stack:
            self._database = stack.enter_context(_opened(self.path))
            with _errors(self.path):
                self._database.execute("PRAGMA synchronous = EXTRA")
                if not _n_tables(self._database):
                    with _transaction(self._database):
                        for statement in _TABLES:
                            self._database.execute(statement)
                        self._database.execute(f"PRAGMA application_id = {APPLICATION}")
                        self._database.execute(f"PRAGMA user_version = {SCHEMA}")
                self._database.execute(_SOURCES)
            # shards of one count share no files
            siblings = "/" if self._shard is None else f"-of-{self._shard.count}.sqlite"
            others = [
                path
                for path in journal_paths(self._folder)
                if path != self.path and not path.name.endswith(siblings)
            ]
            self._others = _newest(entry for path in others for entry in _all_entries(path))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.close()

    def begin_run(self, owner: str) -> str:
        """Record that a run starts."""
        self.run = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}"
        shard = "" if self._shard is None else str(self._shard)
        with _errors(self.path):
            self._database.execute(
                "INSERT INTO runs (id, shard, version, owner, started, totals) "
                "VALUES (?, ?, ?, ?, ?, '{}')",
                (self.run, shard, __version__, _text(owner), _now()),
            )
        return self.run

    def end_run(self, exit_code: int, totals: Mapping[str, int] | None = None) -> None:
        """Record how the run ended; the exit code after a signal is 128 + its number."""
        with _errors(self.path):
            self._database.execute(
                "UPDATE runs SET finished = ?, exit_code = ?, totals = ? WHERE id = ?",
                (_now(), exit_code, json.dumps(dict(totals or {}), sort_keys=True), self.run),
            )

    def start(self, task: Task, owner: str) -> None:
        """Record that a worker will write an output; called before the worker gets the task."""
        values = {
            "name": os.fsencode(task.name),
            "config": task.config_sha256,
            "version": __version__,
            "run": self.run,
            "now": _now(),
            "owner": _text(owner),
        }
        source = {"name": values["name"], "source": os.fsencode(os.path.realpath(task.source))}
        with _errors(self.path), _transaction(self._database):
            self._database.execute(_START, values)
            self._database.execute(_SOURCE, source)

    def finish(self, outcome: Outcome) -> None:
        """Record the outcome of a file, tried or refused.

        A file that failed because its output exists does not own that output.
        """
        foreign = isinstance(outcome, Failed) and outcome.problem.kind == "OutputExistsError"
        entry = None if isinstance(outcome, Done) else self.entry(outcome.name)
        known = isinstance(outcome, Done) or (entry is not None and entry.owns_output)
        values = {
            "name": os.fsencode(outcome.name),
            "state": "done" if isinstance(outcome, Done) else "failed",
            "version": __version__,
            "run": self.run,
            "now": _now(),
            "owns": int(known and not foreign),
            "outcome": to_json(outcome),
        }
        with _errors(self.path):
            self._database.execute(_FINISH, values)

    def entry(self, name: str) -> Entry | None:
        """Return the newest entry of a file in all journals; None for a new file."""
        with _errors(self.path):
            rows = _select(self._database, "WHERE name = ?", os.fsencode(name))
            entries = list(map(_entry, rows))
        if name in self._others:
            entries.append(self._others[name])
        return max(entries, key=lambda entry: entry.started, default=None)

    def entries(self) -> list[Entry]:
        """Return all entries sorted by name.

        Entries of other journals are as they were when this journal was opened.
        """
        with _errors(self.path):
            own_entries = list(map(_entry, _select(self._database)))
        newest = _newest([*self._others.values(), *own_entries])
        return [newest[name] for name in sorted(newest)]

    def forget(self, names: Iterable[str]) -> int:
        """Remove files from all journals, and return how many of them a journal had.

        The caller holds the locks of all journals.
        """
        known = {entry.name for entry in self.entries()}.intersection(names)
        keys = [(os.fsencode(name),) for name in known]
        for path in journal_paths(self._folder):
            refuse_links(path)
            with _opened(path) as database, _errors(path), _transaction(database):
                database.executemany("DELETE FROM files WHERE name = ?", keys)
                database.execute(_SOURCES)
                database.executemany("DELETE FROM sources WHERE name = ?", keys)
        self._others = {name: entry for name, entry in self._others.items() if name not in known}
        return len(known)


def read_entries(folder: Path) -> list[Entry]:
    """Return the newest entry of every file in all journals of a folder, sorted by name."""
    newest = _newest(entry for path in journal_paths(folder) for entry in _all_entries(path))
    return [newest[name] for name in sorted(newest)]


def read_runs(folder: Path) -> list[Run]:
    """Return the runs of all journals of a folder, oldest first."""
    runs: list[Run] = []
    for path in journal_paths(folder):
        with _opened(path) as database, _errors(path):
            rows = database.execute("SELECT * FROM runs") if _n_tables(database) else ()
            runs.extend(map(_run, rows))
    return sorted(runs, key=lambda run: (run.started, run.id))


def _all_entries(path: Path) -> list[Entry]:
    with _opened(path) as database, _errors(path):
        return list(map(_entry, _select(database))) if _n_tables(database) else []


def _select(database: sqlite3.Connection, condition: str = "", *values: bytes) -> sqlite3.Cursor:
    # with the path of the input, if the journal has it
    is_known = database.execute(
        "SELECT count(*) FROM sqlite_master WHERE name = 'sources'"
    ).fetchone()[0]
    source = "(SELECT path FROM sources WHERE sources.name = files.name)" if is_known else "NULL"
    return database.execute(f"SELECT {_ENTRY}, {source} AS source FROM files {condition}", values)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    # for reading and writing, since the next program that opens it rolls back a broken transaction
    if path.exists() and not path.is_file():
        raise InputError(str(path), "cannot be read (not a regular file)", "move it away")
    with _errors(path):
        # autocommit: every statement is a transaction
        database = sqlite3.connect(path, timeout=WAIT_S, isolation_level=None)
        database.row_factory = sqlite3.Row
        try:
            _check(database, path)
        except BaseException:
            database.close()
            raise
    try:
        yield database
    finally:
        with contextlib.suppress(sqlite3.Error):  # committed data is safe
            database.close()


def _check(database: sqlite3.Connection, path: Path) -> None:
    application = database.execute("PRAGMA application_id").fetchone()[0]
    version = database.execute("PRAGMA user_version").fetchone()[0]
    if not application and not _n_tables(database):
        # a run was killed just after it had created the file
        return
    if application != APPLICATION:
        hint = f"move it away: {shlex.join(['mv', str(path), f'{path}.other'])}"
        raise OutputError(str(path), "is a database of another program", hint)
    if version > SCHEMA:
        problem = (
            f"was written by a newer prc-cli (tables of version {version}, "
            f"this program knows {SCHEMA})"
        )
        hint = "upgrade: pip install --upgrade prc-cli, or choose another output folder"
        raise OutputError(str(path), problem, hint)
    check = tuple(database.execute("PRAGMA quick_check(1)").fetchone())
    if version < SCHEMA or check != ("ok",):
        raise _damaged(path, f"tables of version {version}" if version < SCHEMA else str(check))


def _n_tables(database: sqlite3.Connection) -> int:
    count: int = database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    return count


@contextlib.contextmanager
def _transaction(database: sqlite3.Connection) -> Iterator[None]:
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
    except BaseException:
        if database.in_transaction:
            database.execute("ROLLBACK")
        raise
    database.execute("COMMIT")


@contextlib.contextmanager
def _errors(path: Path) -> Iterator[None]:
    """Turn the errors of SQLite, and of rows with wrong values, into errors of prc."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            problem = f"is held by another program ({error})"
            raise BusyError(
                str(path), problem, "close the program that has the journal open, then run again"
            ) from error
        why = why_not_written(path) if code == sqlite3.SQLITE_IOERR else 0
        if code == sqlite3.SQLITE_FULL or why == errno.ENOSPC:
            raise OutputError(
                str(path), "the disk is full", "free space on the disk, then run again"
            ) from error
        if why == errno.EFBIG:
            problem = "the system's limit for the size of a file is too small"
            raise OutputError(str(path), problem, "raise it: ulimit -f unlimited") from error
        if code in (
            sqlite3.SQLITE_READONLY,
            sqlite3.SQLITE_CANTOPEN,
            sqlite3.SQLITE_PERM,
            sqlite3.SQLITE_IOERR,
        ):
            problem = f"cannot be read or written ({error})"
            raise OutputError(
                str(path), problem, "check the disk, the folder and its permissions"
            ) from error
        raise _damaged(path, str(error)) from error
    except (
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        RecursionError,
        OverflowError,
    ) as error:
        message = str(error) or type(error).__name__
        if isinstance(error, UnicodeDecodeError):
            message = error.reason
        raise _damaged(path, f"a row makes no sense: {message}") from error


def _damaged(path: Path, damage: str) -> OutputError:
    move = shlex.join(["mv", str(path), f"{path}.damaged"])
    hint = f"move it away ({move}) and run with --overwrite: all files are classified again"
    return OutputError(str(path), f"is no whole journal ({damage.splitlines()[0]})", hint)


def _newest(entries: Iterable[Entry]) -> dict[str, Entry]:
    """Return the entry of every file with the latest start."""
    newest: dict[str, Entry] = {}
    for entry in entries:
        if entry.name not in newest or newest[entry.name].started <= entry.started:
            newest[entry.name] = entry
    return newest


def _entry(row: sqlite3.Row) -> Entry:
    state = row["state"]
    if state not in get_args(State):
        message = f"state {str(state)[:40]!r}"
        raise ValueError(message)
    texts = [row[key] for key in ("config_sha256", "version", "run", "started", "owner")]
    check_type(str, *texts, row["finished"] or "")
    check_type(int, row["attempts"], row["owns_output"])
    return Entry(
        name=os.fsdecode(row["name"]),
        state=state,
        config_sha256=row["config_sha256"],
        version=row["version"],
        run=row["run"],
        attempts=row["attempts"],
        started=row["started"],
        finished=row["finished"],
        owner=row["owner"],
        outcome=None if row["outcome"] is None else from_json(row["outcome"]),
        owns_output=bool(row["owns_output"]),
        source=os.fsdecode(row["source"] or b""),
    )


def _run(row: sqlite3.Row) -> Run:
    texts = [row[key] for key in ("id", "shard", "version", "owner", "started")]
    check_type(str, *texts, row["finished"] or "")
    check_type(int, row["exit_code"] or 0)
    totals = json.loads(row["totals"])
    return Run(
        id=row["id"],
        shard=row["shard"],
        version=row["version"],
        owner=row["owner"],
        started=row["started"],
        finished=row["finished"],
        exit_code=row["exit_code"],
        totals=tuple((str(key), int(count)) for key, count in totals.items()),
    )


def _text(text: str) -> str:
    # SQLite refuses the surrogates of names that are not UTF-8
    return text.encode("utf-8", "backslashreplace").decode()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds")
