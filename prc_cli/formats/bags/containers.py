"""Read the messages of a bag from every container: rosbags for ROS 1 and MCAP, sqlite3 for ROS 2.

This module reads databases row by row. Rosbags would count and sort all rows first: that never ends
if damaged pages point to one another, and takes memory or disk space. Nothing that a bag defines is
executed.
"""

from __future__ import annotations

import contextlib
import shlex
import sqlite3
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read, suffix_of
from prc_cli.core.process import bounded
from prc_cli.formats.bags import parts_of

MAX_MESSAGE = 1 << 28
"""Longest message of a database, also when unpacked [bytes]."""
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MEND = {
    ".bag": "copy it again, or, if its recorder crashed: rosbag reindex {}",
    ".mcap": "copy it again, or, if its recorder crashed: mcap recover {} -o NEW.mcap",
    ".db3": "copy it again, or mend it: sqlite3 {} .recover",
}


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag."""

    name: str
    kind: str
    """Type of its messages without ``msg``: ``sensor_msgs/LaserScan``."""
    is_cdr: bool
    """Whether messages are CDR (ROS 2); otherwise they are as in ROS 1."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message."""

    topic: Topic
    time_ns: int
    """Time of recording [ns]."""
    data: bytes
    connection: int
    """Id of its connection; several connections may have one topic."""


@dataclass(slots=True)
class Bag:
    """A bag: its topics, and its messages."""

    path: Path
    files: tuple[Path, ...] = ()
    """Files of one drive, in the order of recording; empty = the files of the path."""
    counts: dict[Topic, int] = field(default_factory=dict)
    """Number of messages of every topic."""
    start_ns: int = 0
    """First and last time of a message [ns]."""
    end_ns: int = 0
    packed: str = ""
    """Compression of messages or chunks: ``bz2``, ``lz4``, ``zstd`` or empty."""
    problem: str = ""
    """Why the bag ends before the end of the recording; empty if it does not."""

    def __post_init__(self) -> None:
        self.files = self.files or tuple(parts_of(self.path))
        for part in self.files:
            for _ in bounded(part, self._survey(part)):
                pass

    def messages(self, topics: Collection[Topic]) -> Iterator[Message]:
        """Yield the messages of some topics, in the order they were recorded."""
        for part in self.files:
            yield from bounded(
                part, _rows(self, part, topics) if _is_database(part) else _decoded(part, topics)
            )

    def connections(self) -> list[Any]:
        """Return the connections as rosbags has them, in the order of the file."""
        with _library(self.path, ()) as reader:
            return list(reader.connections)

    def _survey(self, part: Path) -> Iterator[None]:
        """Count the messages of a file; yield to be stopped by :func:`bounded`."""
        if _is_database(part):
            yield from _count_rows(self, part)
            return
        with _library(part, ()) as reader:
            topics = reader.topics
            # several connections share the count of their topic
            counts = {topic_of(link): topics[link.topic].msgcount for link in reader.connections}
            for topic, n in counts.items():
                self.counts[topic] = self.counts.get(topic, 0) + n
            if reader.message_count:
                self.start_ns = min(self.start_ns or reader.start_time, reader.start_time)
                self.end_ns = max(self.end_ns, reader.end_time - 1)
            self.packed = self.packed or _packed(reader)
        yield


def _is_database(path: Path) -> bool:
    return suffix_of(path) == ".db3"


def _kind(name: str) -> str:
    return name.replace("/msg/", "/")


def _mend(path: Path) -> str:
    return _MEND.get(suffix_of(path), "copy it again").format(shlex.quote(str(path)))


@contextlib.contextmanager
def bag_errors(path: Path) -> Iterator[None]:
    """Raise InputError for every exception of a library that reads a damaged bag."""
    try:
        yield
    except (InputError, ImportError):
        raise
    except MemoryError:
        raise InputError(
            str(path), "decoding it takes too much memory for its size", _mend(path)
        ) from None
    except Exception as error:
        said = " ".join(str(error).partition(": (")[0].split())[:120] or type(error).__name__
        raise InputError(str(path), f"the bag is damaged ({said})", _mend(path)) from error


# ROS 1 and MCAP


@contextlib.contextmanager
def _library(path: Path, topics: Collection[Topic]) -> Iterator[Any]:
    """Open a bag with rosbags; keep the index of these topics only."""
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError:
        problem = "reading bags needs rosbags, which is not installed"
        raise InputError(str(path), problem, 'pip install ".[ros]"') from None

    class Lean(rosbag1.Reader):
        def read_index_data(self, pos: int, indexes: dict[int, Any]) -> None:
            super().read_index_data(pos, indexes)
            for connection in self.connections:
                if topic_of(connection) not in topics:
                    indexes[connection.id].clear()

    with (
        bag_errors(path),
        Lean(path) if suffix_of(path) == ".bag" else rosbag2.Reader(path) as reader,
    ):
        yield reader


def _packed(reader: Any) -> str:
    if hasattr(reader, "storage"):
        return next((str(chunk.compression) for chunk in reader.storage.chunks), "")
    from rosbags.rosbag1.reader import decompressors

    names = (
        name
        for chunk in reader.chunks.values()
        for name, way in decompressors.items()
        if way is chunk.decompressor
    )
    return next(names, "").replace("none", "")


def topic_of(connection: Any) -> Topic:
    """Return the topic of a connection of rosbags."""
    form = getattr(connection.ext, "serialization_format", "ros1")
    kind = _kind(connection.msgtype) if form in ("cdr", "", "ros1") else str(form)
    return Topic(connection.topic, kind, form in ("cdr", ""))


def _decoded(path: Path, topics: Collection[Topic]) -> Iterator[Message]:
    with _library(path, topics) as reader:
        chosen = {
            connection.id: topic_of(connection)
            for connection in reader.connections
            if topic_of(connection) in topics
        }
        if chosen:
            for connection, time_ns, data in reader.messages(
                [connection for connection in reader.connections if connection.id in chosen]
            ):
                yield Message(chosen[connection.id], time_ns, data, connection.id)


# SQLite of rosbag2


@contextlib.contextmanager
def _database(bag: Bag, path: Path) -> Iterator[tuple[sqlite3.Connection, dict[int, Topic]]]:
    _check_pages(path)
    for suffix in ("-wal", "-journal"):
        beside = path.with_name(path.name + suffix)
        if beside.is_file() and beside.stat().st_size:
            bag.problem = f"the recorder did not finish: messages of {beside.name} are not read"
    with bag_errors(path):
        # immutable: nothing is written beside the bag
        base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            base.text_factory = lambda data: data.decode("utf-8", errors="replace")
            base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_MESSAGE)
            base.execute("PRAGMA trusted_schema=OFF")
            _check_tables(path, base)
            topics = {}
            rows = base.execute(
                "SELECT rowid, id, name, type, serialization_format FROM topics NOT INDEXED"
            )
            for _, number, name, kind, form in _in_order(rows):
                # recorders of packets leave the form blank
                kind = _kind(str(kind)) if form in ("cdr", "") else str(form)
                topics[number] = Topic(str(name), kind, True)
            yield base, topics
        finally:
            base.close()


def _check_pages(path: Path) -> None:
    """Refuse a database that is cut: SQLite takes missing pages for zeros."""
    with open_to_read(path) as handle:
        head = handle.read(100)
    if head[:16] != b"SQLite format 3\0" or len(head) < 100:
        raise InputError(
            str(path), "found no SQLite header, expected a bag of ROS 2", "copy it again"
        )
    (page,) = struct.unpack_from(">H", head, 16)
    changed, pages = struct.unpack_from(">II", head, 24)
    wanted = (1 << 16 if page == 1 else page) * pages
    size = path.stat().st_size
    # the number of pages is valid only if the last program that wrote kept it
    if changed == struct.unpack_from(">I", head, 92)[0] and size < wanted:
        problem = f"the database is cut: found {size} bytes, its header says {wanted}"
        raise InputError(str(path), problem, _mend(path))


def _check_tables(path: Path, base: sqlite3.Connection) -> None:
    """Refuse anything but plain tables: a view can run forever."""
    rows = base.execute(
        "SELECT name, type, sql FROM sqlite_master WHERE name IN ('topics', 'messages') LIMIT 9"
    )
    tables = {str(name): (kind, str(sql).upper().split()[:2]) for name, kind, sql in rows}
    for name in ("topics", "messages"):
        plain = tables.get(name) == ("table", ["CREATE", "TABLE"])
        columns = base.execute(f"PRAGMA table_xinfo({name})").fetchall() if plain else []
        # a hidden column is computed, which can take forever; a column named rowid hides the order
        if not columns or any(column[-1] or column[1].lower() == "rowid" for column in columns):
            problem = f"found no plain table {name!r}, expected a bag that rosbag2 recorded"
            raise InputError(str(path), problem, "name a .db3 file of a ROS 2 bag")


def _in_order(rows: Iterator[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
    """Yield rows while their first value, the row id, increases.

    If damaged pages point to one another, rows never end.
    """
    last = None
    for row in rows:
        if last is not None and not row[0] > last:
            raise sqlite3.DatabaseError(f"row {row[0]} comes after row {last}")
        last = row[0]
        yield row


def _walk(bag: Bag, rows: Iterator[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of messages up to the first that cannot be read."""
    n = 0
    try:
        for row in _in_order(rows):
            n += 1
            yield row
    except (sqlite3.Error, OverflowError, UnicodeError, MemoryError) as error:
        if not n:
            raise
        # sqlite3 cannot decode its own messages if they quote damaged bytes
        reason = str(error)[:80] or "it asks for more memory than allowed"
        bag.problem = f"the database can be read up to message {n} ({reason})"


def _count_rows(bag: Bag, path: Path) -> Iterator[None]:
    with _database(bag, path) as (base, topics):
        bag.counts = dict.fromkeys(topics.values(), 0) | bag.counts
        for (head,) in base.execute("SELECT substr(data, 1, 4) FROM messages NOT INDEXED LIMIT 1"):
            bag.packed = "zstd" if head == _ZSTD_MAGIC else bag.packed
        for _, number, time_ns in _walk(
            bag, base.execute("SELECT rowid, topic_id, timestamp FROM messages NOT INDEXED")
        ):
            if number in topics and isinstance(time_ns, int):
                bag.counts[topics[number]] += 1
                bag.start_ns = min(bag.start_ns or time_ns, time_ns)
                bag.end_ns = max(bag.end_ns, time_ns)
            yield


def _rows(bag: Bag, path: Path, topics: Collection[Topic]) -> Iterator[Message]:
    with _database(bag, path) as (base, every):
        rows = base.execute("SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED")
        for n, (_, number, time_ns, data) in enumerate(_walk(bag, rows), 1):
            if every.get(number) not in topics:
                continue
            where = f"{path}: message {n}"
            if not isinstance(data, bytes) or not isinstance(time_ns, int):
                raise InputError(where, "found no bytes and time in it", "copy it again")
            data = _unpack(data, where) if data[:4] == _ZSTD_MAGIC else data
            yield Message(every[number], time_ns, data, number)


def _unpack(data: bytes, where: str) -> bytes:
    import pyarrow as pa

    try:
        with pa.CompressedInputStream(pa.BufferReader(data), "zstd") as stream:
            unpacked = stream.read(MAX_MESSAGE)
            if not stream.read(1):
                return bytes(unpacked)
            reason = f"it grows to more than {MAX_MESSAGE} bytes"
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())[:80]
    raise InputError(where, f"zstd data are damaged ({reason})", "copy it from the archive again")
