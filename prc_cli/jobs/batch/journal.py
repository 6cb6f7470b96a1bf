"""Journal of the finished files, in SQLite in the output folder: one for the whole archive, one per shard.

A row is written before a worker starts a file and when it has ended, each in a transaction that is on the disk when the
call returns. A kill at any moment leaves the journal as it was before or after one of these steps. A file whose output
may have been written without a final entry is still ``running``.

Only the owner of the lock writes (:mod:`prc_cli.jobs.batch.lock`). Readers open a copy, because another machine must
not open a journal in use: SQLite's WAL keeps its index in shared memory.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shlex
import shutil
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, get_args

from prc_cli import __version__
from prc_cli.core.errors import BusyError, InputError, OutputError
from prc_cli.core.files import make_folder, refuse_links, temporary_folder
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
)

SCHEMA = 1
"""Version of the tables; a journal with a newer version is refused."""
APPLICATION = 0x5052434A
"""``PRCJ`` in the header of the file, to recognise other databases."""
WAIT_S = 30.0
"""Time that a statement waits for another program that holds the file, such as a backup [s]."""
COPY_ATTEMPTS = 40
COPY_PAUSE_S = 0.05
DAMAGED_COPIES = 3
"""After this number of damaged copies the journal itself counts as damaged."""

_TABLES = """
CREATE TABLE runs (
    id TEXT PRIMARY KEY, shard TEXT NOT NULL, version TEXT NOT NULL, owner TEXT NOT NULL, started TEXT NOT NULL,
    finished TEXT, exit_code INTEGER, totals TEXT NOT NULL
);
CREATE TABLE files (
    name BLOB PRIMARY KEY, state TEXT NOT NULL, config_sha256 TEXT NOT NULL, version TEXT NOT NULL, run TEXT NOT NULL,
    attempts INTEGER NOT NULL, started TEXT NOT NULL, finished TEXT, owner TEXT NOT NULL, owns_output INTEGER NOT NULL,
    outcome TEXT, input_size INTEGER, input_mtime_ns INTEGER, input_sha256 TEXT, seconds REAL,
    output_size INTEGER, output_mtime_ns INTEGER, cpu_seconds REAL, peak_mib REAL,
    n_lines INTEGER, n_shots INTEGER, n_records INTEGER, labels TEXT, notices TEXT,
    output_name BLOB, output_sha256 TEXT,
    problem_kind TEXT, problem_where TEXT, problem TEXT, problem_hint TEXT
);
"""
_OUTCOME = (
    "outcome", "input_size", "input_mtime_ns", "input_sha256", "seconds", "output_size", "output_mtime_ns",
    "cpu_seconds", "peak_mib", "n_lines", "n_shots", "n_records", "labels", "notices", "output_name", "output_sha256",
    "problem_kind", "problem_where", "problem", "problem_hint",
)  # fmt: skip
"""Columns of the outcome of an attempt. These names are constants, so they can be put into a statement."""
_START = """
INSERT INTO files (name, state, config_sha256, version, run, attempts, started, owner, owns_output)
VALUES (:name, 'running', :config, :version, :run, 1, :now, :owner, 1)
ON CONFLICT (name) DO UPDATE SET
    attempts = CASE WHEN state = 'done' THEN 1 ELSE attempts + 1 END,
    state = 'running', config_sha256 = :config, version = :version, run = :run, started = :now, finished = NULL,
    owner = :owner, owns_output = 1
"""
_FINISH = f"""
INSERT INTO files (name, state, config_sha256, version, run, attempts, started, finished, owner, owns_output,
                   {", ".join(_OUTCOME)})
VALUES (:name, :state, '', :version, :run, 0, :now, :now, '', :owns, {", ".join(":" + key for key in _OUTCOME)})
ON CONFLICT (name) DO UPDATE SET
    state = :state, finished = :now, owns_output = min(owns_output, :owns),
    {", ".join(f"{key} = :{key}" for key in _OUTCOME)}
"""


def journal_path(folder: Path, shard: Shard | None = None) -> Path:
    """Return the journal file of a shard, or of the whole archive.

    >>> journal_path(Path(".prc"), Shard(3, 8)).name
    'journal.3-of-8.sqlite'
    """
    return folder / ("journal.sqlite" if shard is None else f"journal.{shard.index}-of-{shard.count}.sqlite")


def journal_paths(folder: Path) -> list[Path]:
    """Return all journals of an output folder, that of the whole archive first."""
    return sorted(folder.glob("journal*.sqlite"), key=lambda path: (path.name != "journal.sqlite", path.name))


class Journal:
    """The journal of one run; the only writer of its file.

    Entries of the other journals of the folder are used too, and the newest entry of a file counts: an archive may be
    classified as a whole in one month and in shards in the next. They are read once, when the journal is opened.
    """

    def __init__(self, folder: Path, shard: Shard | None = None) -> None:
        self.path = journal_path(folder, shard)
        self.notices: tuple[str, ...] = ()
        """What the user should know of how the journal is kept."""
        self.run = ""
        """Id of the run that was begun."""
        self._folder = folder
        self._shard = shard
        self._others: dict[str, Entry] = {}
        self._database: sqlite3.Connection | None = None

    def __enter__(self) -> Journal:
        refuse_links(self._folder, self.path)  # SQLite would make the target of a link to nothing
        make_folder(self._folder)
        with _errors(self.path):
            # autocommit: every statement is a transaction of its own, whole or not at all
            self._database = sqlite3.connect(self.path, timeout=WAIT_S, isolation_level=None)
            try:
                self._open(self._database)
                self._others = self._read_others()
            except BaseException:
                self.close()
                raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; also called by ``with``."""
        database, self._database = self._database, None
        if database is not None:
            with contextlib.suppress(sqlite3.Error):  # committed data is safe
                database.close()

    def _open(self, database: sqlite3.Connection) -> None:
        _check_schema(database, self.path)
        try:
            mode = database.execute("PRAGMA journal_mode = WAL").fetchone()[0]
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_IOERR, sqlite3.SQLITE_PROTOCOL):
                raise
            mode = database.execute("PRAGMA journal_mode = DELETE").fetchone()[0]
        if mode != "wal":
            self.notices += (f"{self.path}: this file system has no shared memory; a slower rollback journal is kept",)
        database.execute("PRAGMA synchronous = FULL")
        if database.execute("PRAGMA user_version").fetchone()[0] == 0:
            with _transaction(database):
                if not _n_tables(database):
                    for statement in _TABLES.split(";"):
                        database.execute(statement)
                    database.execute(f"PRAGMA application_id = {APPLICATION}")
                    database.execute(f"PRAGMA user_version = {SCHEMA}")
        _check_whole(database, self.path)

    def _read_others(self) -> dict[str, Entry]:
        """Read the journals of the whole archive or of other shard counts; shards of one count share no files."""
        count = None if self._shard is None else self._shard.count
        paths = []
        for path in journal_paths(self._folder):
            siblings = count is not None and path.name.endswith(f"-of-{count}.sqlite")
            if path != self.path and not siblings:
                paths.append(path)
        return _newest(entry for path in paths for entry in _copied_entries(path))

    @property
    def _open_database(self) -> sqlite3.Connection:
        if self._database is None:
            message = "the journal is not open"
            raise ValueError(message)
        return self._database

    def begin_run(self, owner: str) -> str:
        """Record that a run starts."""
        self.run = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}"
        shard = "" if self._shard is None else str(self._shard)
        with _errors(self.path):
            self._open_database.execute(
                "INSERT INTO runs (id, shard, version, owner, started, totals) VALUES (?, ?, ?, ?, ?, '{}')",
                (self.run, shard, __version__, _text(owner), _now()),
            )
        return self.run

    def end_run(self, exit_code: int, totals: Mapping[str, int] | None = None) -> None:
        """Record how the run ended; the exit code after a signal is 128 + its number."""
        with _errors(self.path):
            self._open_database.execute(
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
        with _errors(self.path):
            self._open_database.execute(_START, values)

    def finish(self, outcome: Outcome) -> None:
        """Record the outcome of a file, or that a file was refused before any work.

        An output that belongs to somebody else does not become ours.
        """
        foreign = isinstance(outcome, Failed) and outcome.problem.kind == "OutputExistsError"
        known = isinstance(outcome, Done) or self._has_begun(outcome.name)
        values = {
            "name": os.fsencode(outcome.name),
            "state": "done" if isinstance(outcome, Done) else "failed",
            "version": __version__,
            "run": self.run,
            "now": _now(),
            "owns": int(known and not foreign),
            **dict.fromkeys(_OUTCOME),
            **_columns(outcome),
        }
        with _errors(self.path):
            self._open_database.execute(_FINISH, values)

    def _has_begun(self, name: str) -> bool:
        entry = self.entry(name)
        return entry is not None and entry.owns_output

    def entry(self, name: str) -> Entry | None:
        """Return the newest entry of a file in all journals; None for a new file."""
        with _errors(self.path), _content(self.path):
            cursor = self._open_database.execute("SELECT * FROM files WHERE name = ?", (os.fsencode(name),))
            own = next(_entries(cursor), None)
        other = self._others.get(name)
        return next(iter(_newest(entry for entry in (other, own) if entry is not None).values()), None)

    def entries(self) -> list[Entry]:
        """Return all entries sorted by name; those of other journals as read when this one was opened."""
        with _errors(self.path), _content(self.path):
            own = list(_entries(self._open_database.execute("SELECT * FROM files")))
        found = _newest([*self._others.values(), *own])
        return [found[name] for name in sorted(found)]

    def forget(self, names: Iterable[str]) -> int:
        """Remove files from every journal of the folder; return how many were in one.

        The caller holds the lock of the whole archive if there are journals of shards.
        """
        keys = [(os.fsencode(name),) for name in names]
        forgotten = {name for (key,) in keys if self.entry(name := os.fsdecode(key)) is not None}
        with _errors(self.path), _transaction(self._open_database):
            self._open_database.executemany("DELETE FROM files WHERE name = ?", keys)
        mine = {entry.name for entry in self._others.values()} & forgotten
        for path in journal_paths(self._folder) if mine else ():
            if path != self.path:
                _delete(path, keys)
        for name in mine:
            del self._others[name]
        return len(forgotten)


def read_entries(folder: Path) -> list[Entry]:
    """Return the newest entry of every file in all journals of a folder, sorted by name; changes nothing."""
    found = _newest(entry for path in journal_paths(folder) for entry in _copied_entries(path))
    return [found[name] for name in sorted(found)]


def read_runs(folder: Path) -> list[Run]:
    """Return the runs of all journals of a folder, oldest first; changes nothing."""
    found: list[Run] = []
    for path in journal_paths(folder):
        with _copy(path) as database, _content(path):
            found.extend(_runs(database))
    return sorted(found, key=lambda run: (run.started, run.id))


def _delete(path: Path, keys: list[tuple[bytes]]) -> None:
    """Delete files from a journal that no process has open."""
    refuse_links(path)
    with _errors(path), contextlib.closing(sqlite3.connect(path, timeout=WAIT_S, isolation_level=None)) as database:
        _check_schema(database, path)
        with _transaction(database):
            database.executemany("DELETE FROM files WHERE name = ?", keys)


def _copied_entries(path: Path) -> list[Entry]:
    with _copy(path) as database, _content(path):
        return list(_entries(database.execute("SELECT * FROM files"))) if _n_tables(database) else []


@contextlib.contextmanager
def _copy(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a copy of a journal with its log, taken while no process wrote."""
    with temporary_folder("prc-journal-") as folder:
        database = _stable_copy(path, folder / "journal.sqlite")
        try:
            with _errors(path):
                yield database
        finally:
            database.close()


def _stable_copy(path: Path, copy: Path) -> sqlite3.Connection:
    n_damaged = 0
    for _ in range(COPY_ATTEMPTS):
        try:
            before = _versions(path)
            for suffix in before:
                shutil.copyfile(f"{path}{suffix}", f"{copy}{suffix}")
            same = before == _versions(path)
        except FileNotFoundError:  # the log was just removed by its writer
            same = False
        except OSError as error:
            problem = f"cannot be read ({error.strerror or error})"
            raise InputError(str(path), problem, "check its permissions") from error
        if same:
            try:
                return _opened_copy(path, copy)
            except OutputError:
                # writes within one tick of the file system clock go unnoticed; real damage is found again
                n_damaged += 1
                if n_damaged == DAMAGED_COPIES:
                    raise
        for suffix in ("", "-wal", "-journal", "-shm"):
            Path(f"{copy}{suffix}").unlink(missing_ok=True)
        time.sleep(COPY_PAUSE_S)
    raise BusyError(str(path), "changes faster than it can be read", "try again")


def _opened_copy(path: Path, copy: Path) -> sqlite3.Connection:
    database = sqlite3.connect(copy, isolation_level=None)
    try:
        with _errors(path):
            _check_schema(database, path)
            _check_whole(database, path)
    except BaseException:
        database.close()
        raise
    return database


def _check_whole(database: sqlite3.Connection, path: Path) -> None:
    found = database.execute("PRAGMA quick_check(1)").fetchone()
    if found is None or found[0] != "ok":
        raise _damaged(path, "it cannot be checked" if found is None else str(found[0]))


def _versions(path: Path) -> dict[str, tuple[int, int, int]]:
    """Return inode, size and time of a journal and its logs, by suffix of the file."""
    found = {}
    for suffix in ("", "-wal", "-journal"):
        with contextlib.suppress(FileNotFoundError):
            status = Path(f"{path}{suffix}").stat()
            found[suffix] = (status.st_ino, status.st_size, status.st_mtime_ns)
    return found


def _check_schema(database: sqlite3.Connection, path: Path) -> None:
    application = database.execute("PRAGMA application_id").fetchone()[0]
    version = database.execute("PRAGMA user_version").fetchone()[0]
    if application not in (0, APPLICATION) or (application == 0 and _n_tables(database)):
        raise OutputError(
            str(path),
            "is a database of another program",
            f"move it away: {shlex.join(['mv', str(path), f'{path}.other'])}",
        )
    if version > SCHEMA:
        problem = f"was written by a newer prc-cli (tables of version {version}, this program knows {SCHEMA})"
        raise OutputError(str(path), problem, "upgrade: pip install --upgrade prc-cli, or choose another output folder")


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
    """Turn SQLite's errors into ours."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            problem = f"is held by another program ({error})"
            raise BusyError(str(path), problem, "close what has the journal open, then run again") from error
        if code == sqlite3.SQLITE_FULL:
            raise OutputError(str(path), "the disk is full", "free space on the disk, then run again") from error
        if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR):
            problem = f"cannot be read or written ({error})"
            raise OutputError(str(path), problem, "check the disk, the folder and its permissions") from error
        raise _damaged(path, str(error)) from error
    except UnicodeDecodeError as error:  # what SQLite says of damage may itself be no text
        raise _damaged(path, f"a text makes no sense: {error.reason}") from error


@contextlib.contextmanager
def _content(path: Path) -> Iterator[None]:
    """Turn the errors of rows that SQLite can read and that make no sense into ours."""
    try:
        yield
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError, OverflowError) as error:
        raise _damaged(path, f"a row makes no sense: {str(error) or type(error).__name__}") from error


def _damaged(path: Path, found: str) -> OutputError:
    move = shlex.join(["mv", str(path), f"{path}.damaged"])
    hint = f"move it away ({move}) and run with --adopt: finished outputs are recognised"
    return OutputError(str(path), f"is no whole journal ({found.splitlines()[0]})", hint)


def _columns(outcome: Outcome) -> dict[str, Any]:
    columns: dict[str, Any] = {"outcome": "done" if isinstance(outcome, Done) else "failed", "seconds": outcome.seconds}
    if outcome.input is not None:
        columns["input_size"] = outcome.input.size
        columns["input_mtime_ns"] = outcome.input.mtime_ns
        columns["input_sha256"] = outcome.input.sha256
    if isinstance(outcome, Failed):
        problem = outcome.problem
        columns |= {
            "problem_kind": _text(problem.kind),
            "problem_where": _text(problem.where),
            "problem": _text(problem.problem),
            "problem_hint": _text(problem.hint),
        }
        return columns
    same = ("output_size", "output_mtime_ns", "output_sha256", "cpu_seconds", "peak_mib", "n_lines", "n_shots",
            "n_records")  # fmt: skip
    columns |= {key: getattr(outcome, key) for key in same}
    columns["output_name"] = os.fsencode(outcome.output_name)
    columns["labels"] = json.dumps(outcome.labels)
    columns["notices"] = json.dumps(outcome.notices)
    return columns


def _entries(cursor: sqlite3.Cursor) -> Iterator[Entry]:
    keys = [column[0] for column in cursor.description]
    for values in cursor:
        row = dict(zip(keys, values, strict=True))
        _check_row(row)
        state: State = row["state"]
        name = os.fsdecode(row["name"])
        yield Entry(
            name, state, row["config_sha256"], row["version"], row["run"], row["attempts"], row["started"],
            row["finished"], row["owner"], _outcome(name, row), bool(row["owns_output"]),
        )  # fmt: skip


_WORDS = ("config_sha256", "version", "run", "started", "owner")
_NUMBERS = (
    "input_size", "input_mtime_ns", "seconds", "output_size", "output_mtime_ns", "cpu_seconds", "n_lines", "n_shots",
    "n_records",
)  # fmt: skip
"""Columns that every file that was read, or is done, has."""
_STATES = get_args(State)


def _check_row(row: Mapping[str, Any]) -> None:
    """Refuse a row whose values are of other types than were written: SQLite stores any value in any column."""
    wanted: dict[str, tuple[type, ...]] = {"name": (bytes,), "attempts": (int,), "owns_output": (int,)}
    wanted |= dict.fromkeys(_WORDS, (str,))
    is_done, is_failed = row["outcome"] == "done", row["outcome"] == "failed"
    nothing: tuple[type, ...] = () if is_done else (type(None),)
    wanted |= dict.fromkeys(_NUMBERS, (int, float, *nothing))
    wanted |= {"peak_mib": (int, float, type(None)), "finished": (str, type(None)), "input_sha256": (str, type(None)),
               "output_sha256": (str, type(None)), "output_name": (bytes, *nothing)}  # fmt: skip
    if is_failed:
        wanted |= dict.fromkeys(("problem_kind", "problem_where", "problem", "problem_hint"), (str,))
        wanted["seconds"] = (int, float)
    for column, types in wanted.items():
        if not isinstance(row[column], types):
            message = f"{column} is {str(row[column])[:40]!r}"
            raise ValueError(message)
    if row["state"] not in _STATES or row["outcome"] not in (None, "done", "failed"):
        message = f"state {str(row['state'])[:40]!r}, outcome {str(row['outcome'])[:40]!r}"
        raise ValueError(message)


def _outcome(name: str, row: Mapping[str, Any]) -> Outcome | None:
    read = None
    if row["input_size"] is not None:
        read = InputPrint(row["input_size"], row["input_mtime_ns"], row["input_sha256"])
    if row["outcome"] == "failed":
        problem = Problem(row["problem_kind"], row["problem_where"], row["problem"], row["problem_hint"])
        return Failed(name, read, row["seconds"], problem)
    if row["outcome"] is None or read is None:
        return None
    return Done(
        name, read, row["output_size"], row["output_mtime_ns"], row["seconds"], row["cpu_seconds"], row["peak_mib"],
        row["n_lines"], row["n_shots"], row["n_records"],
        tuple((str(label), int(count)) for label, count in json.loads(row["labels"])),
        tuple(str(notice) for notice in json.loads(row["notices"])), os.fsdecode(row["output_name"]),
        row["output_sha256"],
    )  # fmt: skip


def _runs(database: sqlite3.Connection) -> Iterator[Run]:
    if not _n_tables(database):
        return
    columns = "id, shard, version, owner, started, finished, exit_code, totals"
    for row in database.execute(f"SELECT {columns} FROM runs ORDER BY started, id"):
        run, shard, version, owner, started, finished, exit_code, totals = row
        counts = tuple((str(key), int(count)) for key, count in json.loads(totals).items())
        texts_are = all(isinstance(text, str) for text in (run, shard, version, owner, started))
        if not texts_are or not isinstance(finished, str | None) or not isinstance(exit_code, int | None):
            message = f"run {str(run)[:40]!r}"
            raise ValueError(message)
        yield Run(run, shard, version, owner, started, finished, exit_code, counts)


def _newest(entries: Iterable[Entry]) -> dict[str, Entry]:
    """Return the entry of every file that was started last."""
    found: dict[str, Entry] = {}
    for entry in entries:
        if entry.name not in found or found[entry.name].started <= entry.started:
            found[entry.name] = entry
    return found


def _text(text: str) -> str:
    """Return text that SQLite accepts: bytes of names that are not UTF-8 are escaped."""
    return text.encode("utf-8", "backslashreplace").decode()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds")
