"""Journal of the finished files, in SQLite in the output folder.

One for the whole archive, one per shard.

A row is written before a worker starts a file and when it has ended, each in a transaction that is
on the disk when the call returns. A kill at any moment leaves the journal as it was before or after
one of these steps. A file whose output may have been written without a final entry is still
``running``.

Only the owner of the lock writes (:mod:`prc_cli.jobs.batch.lock`). Anybody may read meanwhile, also
from another machine: a rollback journal is kept, since SQLite's WAL needs memory that all who have
the file open share.
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
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, get_args

from prc_cli.core.errors import BusyError, InputError, OutputError
from prc_cli.core.files import make_folder, refuse_links, why_not_written
from prc_cli.core.version import __version__
from prc_cli.jobs.batch.types import (
    Done,
    Entry,
    Failed,
    InputPrint,
    Outcome,
    Problem,
    Run,
    Shard,
    State,
    Task,
    own_name,
)

SCHEMA = 2
"""Version of the tables; a journal with another version is refused."""
APPLICATION = 0x5052434A
"""``PRCJ`` in the header of the file, to recognise other databases."""
WAIT_S = 30.0
"""Time that a statement waits for another program that holds the file, such as a backup [s]."""

_TABLES = (
    """CREATE TABLE runs (
    id TEXT PRIMARY KEY, shard TEXT NOT NULL, version TEXT NOT NULL, owner TEXT NOT NULL, started TEXT NOT NULL,
    finished TEXT, exit_code INTEGER, totals TEXT NOT NULL)""",
    """CREATE TABLE files (
    name BLOB PRIMARY KEY, state TEXT NOT NULL, config_sha256 TEXT NOT NULL, version TEXT NOT NULL, run TEXT NOT NULL,
    attempts INTEGER NOT NULL, started TEXT NOT NULL, finished TEXT, owner TEXT NOT NULL, outcome TEXT,
    owns_output INTEGER NOT NULL)""",
)
_SOURCES = "CREATE TABLE IF NOT EXISTS sources (name BLOB PRIMARY KEY, path BLOB NOT NULL)"
"""Added in 1.2; versions before pass over it."""
_SOURCE = "INSERT OR REPLACE INTO sources (name, path) VALUES (:name, :source)"
_ENTRY = "name, state, config_sha256, version, run, attempts, started, finished, owner, outcome, owns_output"
_START = """
INSERT INTO files (name, state, config_sha256, version, run, attempts, started, owner, owns_output)
VALUES (:name, 'running', :config, :version, :run, 1, :now, :owner, 1)
ON CONFLICT (name) DO UPDATE SET
    attempts = CASE WHEN state = 'done' THEN 1 ELSE attempts + 1 END,
    state = 'running', config_sha256 = :config, version = :version, run = :run, started = :now, finished = NULL,
    owner = :owner, owns_output = 1
"""
_FINISH = """
INSERT INTO files (name, state, config_sha256, version, run, attempts, started, finished, owner, owns_output, outcome)
VALUES (:name, :state, '', :version, :run, 0, :now, :now, '', :owns, :outcome)
ON CONFLICT (name) DO UPDATE SET
    state = :state, finished = :now, owns_output = min(owns_output, :owns), outcome = :outcome
"""


def journal_paths(folder: Path) -> list[Path]:
    """Return all journals of an output folder, that of the whole archive first."""
    return sorted(
        folder.glob("journal*.sqlite"), key=lambda path: (path.name != "journal.sqlite", path.name)
    )


class Journal:
    """The journal of one run, written by it alone.

    Newer entries of the folder's other journals count, too.
    """

    def __init__(self, folder: Path, shard: Shard | None = None) -> None:
        self.path = folder / own_name("journal", shard, ".sqlite")
        self.run = ""
        """Id of the run that was begun."""
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
            others = (
                path for path in journal_paths(self._folder) if not path.name.endswith(siblings)
            )
            self._others = _newest(
                entry for path in others if path != self.path for entry in _all_entries(path)
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._stack.close()

    def begin_run(self, owner: str) -> str:
        """Record that a run starts."""
        self.run = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}"
        shard = "" if self._shard is None else str(self._shard)
        with _errors(self.path):
            self._database.execute(
                "INSERT INTO runs (id, shard, version, owner, started, totals) VALUES (?, ?, ?, ?, ?, '{}')",
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

        An output of somebody else does not become ours.
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
            "outcome": json.dumps(asdict(outcome)),
        }
        with _errors(self.path):
            self._database.execute(_FINISH, values)

    def entry(self, name: str) -> Entry | None:
        """Return the newest entry of a file in all journals; None for a new file."""
        with _errors(self.path):
            rows = _select(self._database, "WHERE name = ?", os.fsencode(name))
            found = [*map(_entry, rows), *([self._others[name]] if name in self._others else [])]
        return max(found, key=lambda entry: entry.started, default=None)

    def entries(self) -> list[Entry]:
        """Return all entries sorted by name.

        Those of other journals as read when this one was opened.
        """
        with _errors(self.path):
            own = list(map(_entry, _select(self._database)))
        found = _newest([*self._others.values(), *own])
        return [found[name] for name in sorted(found)]

    def forget(self, names: Iterable[str]) -> int:
        """Remove files from all journals, whose locks the caller holds.

        Return how many were in one.
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
    found = _newest(entry for path in journal_paths(folder) for entry in _all_entries(path))
    return [found[name] for name in sorted(found)]


def read_runs(folder: Path) -> list[Run]:
    """Return the runs of all journals of a folder, oldest first."""
    columns = "id, shard, version, owner, started, finished, exit_code, totals"
    found: list[Run] = []
    for path in journal_paths(folder):
        with _opened(path) as database, _errors(path):
            rows = database.execute(f"SELECT {columns} FROM runs") if _n_tables(database) else ()
            found.extend(map(_run, rows))
    return sorted(found, key=lambda run: (run.started, run.id))


def _all_entries(path: Path) -> list[Entry]:
    with _opened(path) as database, _errors(path):
        return list(map(_entry, _select(database))) if _n_tables(database) else []


def _select(database: sqlite3.Connection, condition: str = "", *values: bytes) -> sqlite3.Cursor:
    """Return the rows of files, the last column the path of the input where it is known."""
    is_known = database.execute(
        "SELECT count(*) FROM sqlite_master WHERE name = 'sources'"
    ).fetchone()[0]
    source = "(SELECT path FROM sources WHERE sources.name = files.name)" if is_known else "NULL"
    return database.execute(f"SELECT {_ENTRY}, {source} FROM files {condition}", values)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a journal; to read it, too, since a transaction that was cut off is rolled back by the next who comes."""
    if path.exists() and not path.is_file():
        raise InputError(str(path), "cannot be read (not a regular file)", "move it away")
    with _errors(path):
        # autocommit: every statement is a transaction of its own, whole or not at all
        database = sqlite3.connect(path, timeout=WAIT_S, isolation_level=None)
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
    """Refuse what is no journal, or one of another version, or a damaged one."""
    application = database.execute("PRAGMA application_id").fetchone()[0]
    version = database.execute("PRAGMA user_version").fetchone()[0]
    if not application and not _n_tables(
        database
    ):  # a run was killed when it had just made the file
        return
    if application != APPLICATION:
        hint = f"move it away: {shlex.join(['mv', str(path), f'{path}.other'])}"
        raise OutputError(str(path), "is a database of another program", hint)
    if version > SCHEMA:
        problem = f"was written by a newer prc-cli (tables of version {version}, this program knows {SCHEMA})"
        raise OutputError(
            str(path),
            problem,
            "upgrade: pip install --upgrade prc-cli, or choose another output folder",
        )
    found = database.execute("PRAGMA quick_check(1)").fetchone()
    if version < SCHEMA or found != ("ok",):
        raise _damaged(path, f"tables of version {version}" if version < SCHEMA else str(found))


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
    """Turn SQLite's errors, and those of rows that it can read and that make no sense, into ours."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            problem = f"is held by another program ({error})"
            raise BusyError(
                str(path), problem, "close what has the journal open, then run again"
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
        said = (
            error.reason
            if isinstance(error, UnicodeDecodeError)
            else str(error) or type(error).__name__
        )
        raise _damaged(path, f"a row makes no sense: {said}") from error


def _damaged(path: Path, found: str) -> OutputError:
    move = shlex.join(["mv", str(path), f"{path}.damaged"])
    hint = f"move it away ({move}) and run with --adopt: finished outputs are recognised"
    return OutputError(str(path), f"is no whole journal ({found.splitlines()[0]})", hint)


def _newest(entries: Iterable[Entry]) -> dict[str, Entry]:
    """Return the entry of every file that was started last."""
    found: dict[str, Entry] = {}
    for entry in entries:
        if entry.name not in found or found[entry.name].started <= entry.started:
            found[entry.name] = entry
    return found


_COUNTS = (
    "size",
    "mtime_ns",
    "output_size",
    "output_mtime_ns",
    "seconds",
    "cpu_seconds",
    "n_lines",
    "n_shots",
    "n_records",
)
_TEXTS = ("kind", "where", "hint", "output_name")


def _need(kind: type | tuple[type, ...], *values: Any) -> None:
    """Refuse values of other types than were written: SQLite stores any value in any column."""
    for value in values:
        if not isinstance(value, kind):
            message = f"found {str(value)[:40]!r}"
            raise ValueError(message)


def _sound(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table of an outcome if its values have the types that were written."""
    _need((int, float), *(table[key] for key in _COUNTS if key in table))
    _need(str, *(table[key] for key in _TEXTS if key in table))
    return table


def _entry(row: tuple[Any, ...]) -> Entry:
    (
        name,
        state,
        config_sha256,
        version,
        run,
        attempts,
        started,
        finished,
        owner,
        outcome,
        owns,
        source,
    ) = row
    _need(str, config_sha256, version, run, started, owner, finished or "")
    _need(int, attempts, owns)
    if state not in get_args(State):
        message = f"state {str(state)[:40]!r}"
        raise ValueError(message)
    found = None if outcome is None else _outcome(json.loads(outcome, object_hook=_sound))
    return Entry(
        os.fsdecode(name),
        state,
        config_sha256,
        version,
        run,
        attempts,
        started,
        finished,
        owner,
        found,
        bool(owns),
        os.fsdecode(source or b""),
    )


def _outcome(table: dict[str, Any]) -> Outcome:
    seen = None if table["input"] is None else InputPrint(**table["input"])
    if "problem" in table:
        return Failed(table["name"], seen, table["seconds"], Problem(**table["problem"]))
    labels = tuple((str(label), int(count)) for label, count in table["labels"])
    notices = tuple(map(str, table["notices"]))
    return Done(**table | {"input": seen, "labels": labels, "notices": notices})


def _run(row: tuple[Any, ...]) -> Run:
    run, shard, version, owner, started, finished, exit_code, totals = row
    _need(str, run, shard, version, owner, started, finished or "")
    _need(int, exit_code or 0)
    counts = tuple((str(key), int(count)) for key, count in json.loads(totals).items())
    return Run(run, shard, version, owner, started, finished, exit_code, counts)


def _text(text: str) -> str:
    """Return text that SQLite accepts: bytes of names that are not UTF-8 are escaped."""
    return text.encode("utf-8", "backslashreplace").decode()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds")
