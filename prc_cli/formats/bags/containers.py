"""Messages of a bag in the order they were recorded, whatever the container: one record after the other.

The records are read in sequence and the index at the end is not used, so that a bag whose recorder crashed is read up
to its end, and memory holds one chunk. Nothing that a bag defines is executed: message definitions are not read.
"""

from __future__ import annotations

import bz2
import sqlite3
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import pyarrow as pa

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read, suffix_of
from prc_cli.core.limits import bounded

MAX_RECORD = 1 << 28
"""Longest record or chunk, also when unpacked [bytes]: one is held in memory."""
MAX_RATIO = 1030
"""Most bytes that a packed byte may become, beyond :data:`SPARE_BYTES`."""
SPARE_BYTES = 1 << 20
_PIECE = 1 << 20
_BAG_MAGIC, _MCAP_MAGIC = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n"
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_TOPICS = 10_000


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag."""

    name: str
    kind: str
    """Type of its messages without ``msg``: ``sensor_msgs/LaserScan``."""
    is_cdr: bool
    """Whether messages are written as CDR (ROS 2), else as in ROS 1."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message."""

    topic: Topic
    time_ns: int
    """When it was recorded."""
    data: bytes


@dataclass(slots=True)
class BagEnd:
    """How the reading of a bag ended."""

    problem: str = ""
    """Why it ended before the end of the recording; empty if it did not."""
    topics: list[Topic] = field(default_factory=list)
    """Topics met, with or without messages."""


class _CutError(Exception):
    """The file ends in the middle of a record."""


def read_messages(path: Path, end: BagEnd, wanted: Callable[[Topic], bool] | None = None) -> Iterator[Message]:
    """Yield the messages of a bag in the order they were recorded.

    Parameters
    ----------
    path : Path
        ``.bag``, ``.db3`` or ``.mcap``.
    end : BagEnd
        Filled while reading: the topics, and why the file ends too early.
    wanted : callable, optional
        Topics whose messages are yielded; the data of others need not be read.

    Raises
    ------
    InputError
        When the file is not such a bag, or is damaged other than by ending early.
    """
    kinds = {".bag": _read_ros1, ".mcap": _read_mcap, ".db3": _read_db3}
    yield from bounded(path, kinds[suffix_of(path)](path, end, wanted or (lambda topic: True)))


def _where(path: Path, at: int) -> str:
    return f"{path}: byte {at}"


def _damaged(path: Path, at: int, problem: str) -> InputError:
    return InputError(_where(path, at), problem, "copy it from the archive again or record it again")


def _take(handle: IO[bytes], n: int) -> bytes:
    data = handle.read(n)
    if len(data) < n:
        raise _CutError
    return data


def unpack(data: bytes | memoryview, how: str, where: str, size: int | None = None) -> bytes:
    """Unpack bytes of a bag.

    Parameters
    ----------
    data : bytes
    how : {"", "none", "bz2", "lz4", "zstd"}
    where : str
        For messages.
    size : int, optional
        Stated size of the result [bytes].

    Raises
    ------
    InputError
        When they cannot be unpacked, or to more than the limits.
    """
    if how in ("", "none"):
        return bytes(data)
    most = min(MAX_RECORD, MAX_RATIO * len(data) + SPARE_BYTES)
    if how not in ("bz2", "lz4", "zstd"):
        raise InputError(where, f"found compression {how[:20]!r}, expected bz2, lz4, zstd or none", "record it again")
    if size is not None and size > most:
        problem = f"found a chunk of {len(data)} bytes that says it holds {size}, expected at most {most}"
        raise InputError(where, problem, "copy it from the archive again")
    try:
        unpacked = _bunzip(bytes(data), most) if how == "bz2" else _unpack_arrow(data, how, most)
    except (OSError, EOFError, ValueError, pa.ArrowException) as error:
        text = str(error).strip().split("\n")[0][:80]
        raise InputError(where, f"{how} data are damaged ({text})", "copy it from the archive again") from None
    if len(unpacked) > most:
        raise InputError(where, f"{how} data grow to more than {most} bytes", "copy it from the archive again")
    return unpacked


def _bunzip(data: bytes, most: int) -> bytes:
    decoder = bz2.BZ2Decompressor()
    unpacked = decoder.decompress(data, most + 1)
    if not decoder.eof and len(unpacked) <= most:
        message = "the data end too early"
        raise EOFError(message)
    return unpacked


def _unpack_arrow(data: bytes | memoryview, how: str, most: int) -> bytes:
    parts, n = [], 0
    with pa.CompressedInputStream(pa.BufferReader(data), how) as stream:
        while n <= most and (part := stream.read(_PIECE)):
            parts.append(part)
            n += len(part)
    return b"".join(parts)


def _kind(name: str) -> str:
    return name.replace("/msg/", "/")


def _text(data: bytes) -> str:
    return data.decode("utf-8", errors="replace")


# ROS 1, format 2.0: records of a header (name=value fields) and data, http://wiki.ros.org/Bags/Format/2.0


def _read_ros1(path: Path, end: BagEnd, wanted: Callable[[Topic], bool]) -> Iterator[Message]:
    with open_to_read(path) as handle:
        if handle.read(len(_BAG_MAGIC)) != _BAG_MAGIC:
            problem = "found no '#ROSBAG V2.0' at the start, expected a ROS 1 bag of that version"
            raise InputError(str(path), problem, "bags of ROS 2 end in .db3 or .mcap; older ones: rosbag fix")
        reader = _Ros1(path, end, wanted)
        try:
            while True:
                at = handle.tell()
                first = handle.read(4)
                if not first:
                    return
                fields, n = reader.fields(handle, first, at)
                op = fields.get("op", b"\0")[0]
                if op == 5:
                    yield from reader.chunk(fields, _take(handle, n), at)
                elif op in (2, 7):
                    yield from reader.record(op, fields, _take(handle, n), at)
                else:
                    # the index and the header of the bag; they are not needed
                    _skip(handle, n)
        except _CutError:
            end.problem = f"the bag ends in the middle of a record at byte {at}"


def _skip(handle: IO[bytes], n: int) -> None:
    handle.seek(n - 1, 1) if n else None
    if n:
        _take(handle, 1)


class _Ros1:
    """Records of a ROS 1 bag."""

    def __init__(self, path: Path, end: BagEnd, wanted: Callable[[Topic], bool]) -> None:
        self._path, self._end, self._wanted = path, end, wanted
        self._topics: dict[int, Topic] = {}

    def fields(self, handle: IO[bytes], first: bytes, at: int) -> tuple[dict[str, bytes], int]:
        """Read the header of a record; return its fields and the length of its data."""
        if len(first) < 4:
            raise _CutError
        (n,) = struct.unpack("<I", first)
        if n > _PIECE:
            raise _damaged(self._path, at, f"found a header of {n} bytes, expected at most {_PIECE}")
        fields = self._parse(_take(handle, n), at)
        (n_data,) = struct.unpack("<I", _take(handle, 4))
        if n_data > MAX_RECORD:
            raise _damaged(self._path, at, f"found a record of {n_data} bytes, expected at most {MAX_RECORD}")
        return fields, n_data

    def _parse(self, header: bytes, at: int) -> dict[str, bytes]:
        fields, i = {}, 0
        while i < len(header):
            (n,) = struct.unpack_from("<I", header, i) if i + 4 <= len(header) else (0,)
            name, mark, value = header[i + 4 : i + 4 + n].partition(b"=")
            if not mark or i + 4 + n > len(header):
                raise _damaged(self._path, at, "found a record's header that is no list of name=value")
            fields[_text(name)] = value
            i += 4 + n
        if not fields.get("op"):
            raise _damaged(self._path, at, "found a record without 'op'")
        return fields

    def _number(self, fields: dict[str, bytes], name: str, form: str, at: int) -> tuple[int, ...]:
        try:
            return struct.unpack(form, fields.get(name, b""))
        except struct.error:
            raise _damaged(self._path, at, f"found a record without {name!r}") from None

    def chunk(self, fields: dict[str, bytes], data: bytes, at: int) -> Iterator[Message]:
        """Yield the messages of a chunk."""
        (size,) = self._number(fields, "size", "<I", at)
        plain = unpack(data, _text(fields.get("compression", b"none")), _where(self._path, at), size)
        i = 0
        while i < len(plain):
            if i + 4 > len(plain):
                raise _damaged(self._path, at, "found a chunk that ends in the middle of a record")
            (n,) = struct.unpack_from("<I", plain, i)
            inner = self._parse(plain[i + 4 : i + 4 + n], at)
            i += 4 + n
            if i + 4 > len(plain):
                raise _damaged(self._path, at, "found a chunk that ends in the middle of a record")
            (n,) = struct.unpack_from("<I", plain, i)
            if i + 4 + n > len(plain):
                raise _damaged(self._path, at, "found a chunk that ends in the middle of a record")
            yield from self.record(inner["op"][0], inner, plain[i + 4 : i + 4 + n], at)
            i += 4 + n

    def record(self, op: int, fields: dict[str, bytes], data: bytes, at: int) -> Iterator[Message]:
        """Take a connection, or yield a message."""
        if op == 7:
            (number,) = self._number(fields, "conn", "<I", at)
            # the data are a header themselves, without 'op'
            inner = self._parse(b"\x04\x00\x00\x00op=\x07" + data, at)
            topic = Topic(_text(fields.get("topic", b"")), _kind(_text(inner.get("type", b""))), False)
            if number not in self._topics:
                _note_topic(self._path, self._end, topic, at)
            self._topics.setdefault(number, topic)
        elif op == 2:
            (number,) = self._number(fields, "conn", "<I", at)
            seconds, nanoseconds = self._number(fields, "time", "<II", at)
            if number not in self._topics:
                raise _damaged(self._path, at, f"found a message of connection {number}, which is not there")
            topic = self._topics[number]
            if self._wanted(topic):
                yield Message(topic, seconds * 10**9 + nanoseconds, data)


def _note_topic(path: Path, end: BagEnd, topic: Topic, at: int) -> None:
    if topic not in end.topics:
        end.topics.append(topic)
    if len(end.topics) > MAX_TOPICS:
        raise _damaged(path, at, f"found more than {MAX_TOPICS} topics")


# MCAP: records of an opcode, a length and content, https://mcap.dev/spec


def _read_mcap(path: Path, end: BagEnd, wanted: Callable[[Topic], bool]) -> Iterator[Message]:
    with open_to_read(path) as handle:
        if handle.read(len(_MCAP_MAGIC)) != _MCAP_MAGIC:
            problem = "found no MCAP magic at the start, expected an MCAP file"
            raise InputError(str(path), problem, "copy it from the archive again")
        reader = _Mcap(path, end, wanted)
        try:
            while True:
                at = handle.tell()
                op, n = struct.unpack("<BQ", _take(handle, 9))
                if op in (0x02, 0x0F):
                    # the footer and the end of the data; what follows is an index
                    return
                if n > MAX_RECORD:
                    raise _damaged(path, at, f"found a record of {n} bytes, expected at most {MAX_RECORD}")
                if op == 0x06:
                    yield from reader.chunk(_take(handle, n), at)
                elif op in (0x03, 0x04, 0x05):
                    yield from reader.record(op, _take(handle, n), at)
                else:
                    _skip(handle, n)
        except _CutError:
            end.problem = f"the file ends in the middle of a record at byte {at}"


class _Mcap:
    """Records of an MCAP file."""

    def __init__(self, path: Path, end: BagEnd, wanted: Callable[[Topic], bool]) -> None:
        self._path, self._end, self._wanted = path, end, wanted
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, Topic] = {}

    def chunk(self, data: bytes, at: int) -> Iterator[Message]:
        """Yield the messages of a chunk: start and end time, size, CRC, compression, records."""
        try:
            size, _, n = struct.unpack_from("<QII", data, 16)
            how = _text(data[32 : 32 + n])
            (n_records,) = struct.unpack_from("<Q", data, 32 + n)
        except struct.error:
            raise _damaged(self._path, at, "found a chunk that is too short") from None
        start = 40 + n
        if start + n_records > len(data):
            raise _damaged(self._path, at, "found a chunk whose records are longer than itself")
        plain = unpack(memoryview(data)[start : start + n_records], how, _where(self._path, at), size)
        i = 0
        while i < len(plain):
            op, n = struct.unpack_from("<BQ", plain, i) if i + 9 <= len(plain) else (0, MAX_RECORD)
            if i + 9 + n > len(plain):
                raise _damaged(self._path, at, "found a chunk that ends in the middle of a record")
            yield from self.record(op, plain[i + 9 : i + 9 + n], at)
            i += 9 + n

    def record(self, op: int, data: bytes, at: int) -> Iterator[Message]:
        """Take a schema or a channel, or yield a message."""
        try:
            if op == 0x03:
                number, n = struct.unpack_from("<HI", data)
                self._schemas[number] = _kind(_text(data[6 : 6 + n]))
            elif op == 0x04:
                self._channel(data, at)
            elif op == 0x05:
                number, _, logged = struct.unpack_from("<HIQ", data)
                topic = self._topics.get(number)
                if topic is None:
                    raise _damaged(self._path, at, f"found a message of channel {number}, which is not there")
                if self._wanted(topic):
                    yield Message(topic, logged, data[22:])
        except struct.error:
            raise _damaged(self._path, at, "found a record that is too short") from None

    def _channel(self, data: bytes, at: int) -> None:
        number, schema, n = struct.unpack_from("<HHI", data)
        name = _text(data[8 : 8 + n])
        (n_encoding,) = struct.unpack_from("<I", data, 8 + n)
        encoding = data[12 + n : 12 + n + n_encoding]
        kind = self._schemas.get(schema, "") if encoding in (b"cdr", b"ros1") else _text(encoding)
        topic = Topic(name, kind, encoding == b"cdr")
        _note_topic(self._path, self._end, topic, at)
        self._topics[number] = topic


# SQLite of rosbag2


def _read_db3(path: Path, end: BagEnd, wanted: Callable[[Topic], bool]) -> Iterator[Message]:
    _check_pages(path)
    for suffix in ("-wal", "-journal"):
        beside = path.with_name(path.name + suffix)
        if beside.is_file() and beside.stat().st_size:
            end.problem = f"the recorder did not finish: {beside.name} holds more messages, which are not read"
    try:
        # immutable: nothing is written beside the bag
        base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    except (sqlite3.Error, UnicodeEncodeError) as error:
        raise InputError(str(path), f"cannot be opened as a bag ({error})", "copy it again") from None
    try:
        base.text_factory = _text
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD)
        base.execute("PRAGMA trusted_schema=OFF")
        _check_tables(path, base)
        topics = _topics_of(path, base, end)
        numbers = [number for number, topic in topics.items() if wanted(topic)]
        yield from _rows_of(path, base, {number: topics[number] for number in numbers}, end)
    except (sqlite3.Error, OverflowError, UnicodeError, MemoryError) as error:
        # sqlite3 cannot decode its own messages where they quote damaged bytes
        problem = f"the database is damaged ({_said(error)})"
        raise InputError(str(path), problem, "copy it again, or mend it: sqlite3 FILE .recover") from None
    finally:
        base.close()


def _said(error: Exception) -> str:
    return str(error)[:80] or "it asks for more memory than it may"


def _check_pages(path: Path) -> None:
    """Refuse a database that is cut: SQLite takes missing pages for zeros."""
    with open_to_read(path) as handle:
        head = handle.read(100)
    if head[:16] != b"SQLite format 3\0" or len(head) < 100:
        raise InputError(str(path), "found no SQLite header, expected a bag of ROS 2", "copy it again")
    (page,) = struct.unpack_from(">H", head, 16)
    changed, pages = struct.unpack_from(">II", head, 24)
    wanted, size = (1 << 16 if page == 1 else page) * pages, path.stat().st_size
    # the number of pages counts only where the program that wrote last knew of it
    if changed == struct.unpack_from(">I", head, 92)[0] and size < wanted:
        problem = f"the database is cut: found {size} bytes, its header says {wanted}"
        raise InputError(str(path), problem, "copy it again, or mend it: sqlite3 FILE .recover")


def _check_tables(path: Path, base: sqlite3.Connection) -> None:
    """Refuse anything but plain tables: a view can run for ever."""
    rows = base.execute("SELECT name, type, sql FROM sqlite_master WHERE name IN ('topics', 'messages') LIMIT 9")
    found = {str(name): (kind, str(sql).upper().split()[:2]) for name, kind, sql in rows}
    for name in ("topics", "messages"):
        plain = found.get(name) == ("table", ["CREATE", "TABLE"])
        columns = base.execute(f"PRAGMA table_xinfo({name})").fetchall() if plain else []
        # a hidden column is computed, which can take for ever; a row id of its own would say nothing about the order
        if not columns or any(column[-1] or column[1].lower() == "rowid" for column in columns):
            problem = f"found no plain table {name!r}, expected a bag that rosbag2 recorded"
            raise InputError(str(path), problem, "name a .db3 file of a ROS 2 bag")


def _topics_of(path: Path, base: sqlite3.Connection, end: BagEnd) -> dict[int, Topic]:
    topics: dict[int, Topic] = {}
    rows = base.execute("SELECT rowid, id, name, type, serialization_format FROM topics NOT INDEXED")
    for _, number, name, kind, form in _in_order(rows):
        kind = _kind(str(kind)) if form in ("cdr", "") else str(form)  # recorders of packets leave it blank
        topics[number] = Topic(str(name), kind, True)
        _note_topic(path, end, topics[number], 0)
    return topics


def _in_order(rows: Iterator[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
    """Yield rows whose first value, the row id, increases: where pages point to one another, rows have no end."""
    last = None
    for row in rows:
        if last is not None and not row[0] > last:
            raise sqlite3.DatabaseError(f"row {row[0]} comes after row {last}")
        last = row[0]
        yield row


def _rows_of(path: Path, base: sqlite3.Connection, topics: dict[int, Topic], end: BagEnd) -> Iterator[Message]:
    n = 0
    rows = _in_order(base.execute("SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED"))
    while True:
        try:
            row = next(rows, None)
        except (sqlite3.DatabaseError, UnicodeError, MemoryError) as error:
            if not n:
                raise
            end.problem = f"the database can be read up to message {n} ({_said(error)})"
            return
        if row is None:
            return
        n += 1
        _, number, time_ns, data = row
        if number not in topics:
            continue
        if not isinstance(data, bytes) or not isinstance(time_ns, int):
            raise InputError(f"{path}: message {n}", "found no bytes and time in it", "copy it again")
        if data[:4] == _ZSTD_MAGIC:
            data = unpack(data, "zstd", f"{path}: message {n}")
        yield Message(topics[number], time_ns, data)
