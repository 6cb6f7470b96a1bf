"""Class codes in bags: clouds with a field of them, laser scans with a topic of them beside; written and read.

The messages of laser scans stay as they are. Their codes are the intensities of a scan of the same kind, so that every
viewer draws them in colours at the place of the scan, and their stamps bring both together.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.files import remove_stale, suffix_of, temporary_name
from prc_cli.core.types import I64, U8, Mask
from prc_cli.formats.bags.cloud import CLOUD, TYPES, unpack_cloud
from prc_cli.formats.bags.containers import Bag, Topic, topic_of
from prc_cli.formats.bags.laser import ECHOES, parse_laser, read_echoes
from prc_cli.formats.bags.messages import PACKED, Builder, Cursor, ShortMessageError, expect
from prc_cli.formats.bags.read import LABELS, LASERS, BagStream, is_labels
from prc_cli.formats.labels import CodeSource
from prc_cli.formats.writing.base import ScatterWriter
from prc_cli.formats.writing.columns import LabelOutput, asked_columns
from prc_cli.formats.writing.record import RunRecord

FIELD = "label"
"""Field of a point that holds its class code."""
_UINT8 = 2
"""Type of this field in a cloud."""
_DATABASE, _METADATA = ".db3", "metadata.yaml"
_PARTS = (_DATABASE, ".mcap")

Take: TypeAlias = Callable[[int], U8]
"""Gives the codes of the next n records, (n,) uint8."""


def label_cloud(data: bytes, take: Take, *, is_cdr: bool) -> bytes:
    """Return a cloud with the codes of its points; a field of this name keeps its place and type.

    Points of whole words stay aligned to them.
    """
    held = unpack_cloud(data, is_cdr=is_cdr)
    begin, end = held.fields_at
    n = len(held.points) // held.step
    offset, kind = held.fields.get(FIELD, (held.step, _UINT8))
    is_place = kind in TYPES and offset + np.dtype(TYPES[kind]).itemsize <= held.step
    expect(is_place or FIELD not in held.fields, f"has a field {FIELD!r} that is not in its points")
    message = Builder(data[:begin], Cursor(data, is_cdr=is_cdr))
    message.put("I", held.n_fields + (FIELD not in held.fields))
    message.data += data[begin + 4 : end]
    step = held.step
    if FIELD not in held.fields:
        step += 1 if step % 4 else 4
        name = FIELD.encode() + b"\0" * is_cdr
        message.put("I", len(name))
        message.data += name
        message.put("IBI", offset, kind, 1)
    labelled: U8 = np.zeros((n, step), np.uint8)
    labelled[:, : held.step] = np.frombuffer(held.points, np.uint8).reshape(n, held.step)
    codes = take(n).astype(np.dtype(held.order + TYPES[kind]))
    labelled[:, offset : offset + codes.itemsize] = codes.view(np.uint8).reshape(n, codes.itemsize)
    message.put("BIII", held.order == ">", step, step * held.width, labelled.nbytes)
    return bytes(message.data) + labelled.tobytes() + held.is_dense


def label_laser(data: bytes, take: Take, *, is_cdr: bool, is_multi: bool) -> bytes:
    """Return a scan whose intensities are the codes of its echoes; beams without any have none."""
    cursor = Cursor(data, is_cdr=is_cdr)
    cursor.header()
    cursor.numbers("f", 7)
    if not is_multi:
        n = len(cursor.array("f4"))
        section = take(n).astype(np.dtype(cursor.order + "f4"))
    else:
        counts = read_echoes(cursor)[1]
        n = len(counts)
        section = np.empty(n + int(counts.sum()), np.dtype(cursor.order + "f4"))
        starts = np.cumsum(counts + 1) - (counts + 1)
        is_code = np.ones(len(section), np.bool_)
        is_code[starts] = False
        section.view(cursor.order + "u4")[starts] = counts
        section[is_code] = take(int(np.maximum(counts, 1).sum()))[_has_echo(counts)]
    return data[: cursor.at] + struct.pack(f"{cursor.order}I", n) + section.tobytes()


def _has_echo(n_echoes: I64) -> Mask:
    """Return which records of a scan are echoes, (records,)."""
    found: Mask = np.repeat(n_echoes > 0, np.maximum(n_echoes, 1))
    return found


class BagRewriter(ScatterWriter):
    """Writer of a bag with everything that the input has, and the class codes of what was read."""

    def __init__(self, labels: LabelOutput) -> None:
        source, path = labels.source, labels.path
        if suffix_of(source) != path.suffix.lower():
            problem = f"found {source.name}, expected a {path.suffix} to be written again with its classes"
            raise OutputError(str(path), problem, "write .npy, or another kind of file")
        self._stream = BagStream(source, labels.rules)
        packed = [topic.name for topic in self._stream.topics if topic.kind in PACKED]
        refused = f"{packed[0]} holds packets, which have no place for classes" if packed else ""
        refused = refused or ("a bag holds whole messages, not a window of them" if labels.is_part else "")
        refused = refused or self._stream.bag.problem
        if refused:
            raise OutputError(str(path), refused, "write the labels alone: .npy")
        super().__init__(labels, (), labels.n_records)
        for column in asked_columns(labels.options):
            self._notice(f"bags hold class codes only; {column.what}s need .csv, .parquet, .las or .laz")
        self._metadata = self._metadata_temporary()

    def _metadata_temporary(self) -> Path | None:
        """Return the temporary name of what makes a bag of the folder of a database; None where there is another."""
        path = self.path.with_name(_METADATA)
        if self.path.suffix.lower() != _DATABASE:
            return None
        others = [one.name for one in path.parent.iterdir() if suffix_of(one) in _PARTS and one.name != self.path.name]
        if others or (path.exists() and not self.path.exists()):
            self._notice(f"no {_METADATA} was written: the folder has another bag; a folder of its own would get one")
            return None
        remove_stale(path)
        return self._output(path)

    def _write(self, record: RunRecord) -> RunRecord:
        total, bag, n_done = self._total(record), self._stream.bag, 0

        def take(n: int) -> U8:
            nonlocal n_done
            n_done += n
            codes: U8 = self._code_spool.span(n_done - n, n_done) if n else np.empty(0, np.uint8)
            self._count(codes)
            return codes

        try:
            with self._opened() as sink:
                self._copy(sink, bag, take)
        except ShortMessageError as error:
            raise InputError(str(bag.path), f"a message {error}", "copy the bag again") from None
        except sqlite3.Error as error:
            raise OutputError(str(self.path), f"cannot be written ({error})", "free space on the disk") from error
        if n_done < total:
            problem = f"found {n_done} records, expected {total} as at the start of the run"
            raise InputError(str(bag.path), problem, "run again when nothing else writes the input")
        return self._completed(record)

    def _copy(self, sink: Any, bag: Bag, take: Take) -> None:
        """Copy every message, those that were read with their codes."""
        read = self._stream.topics
        old = [topic for topic in bag.counts if is_labels(topic, read)]
        if old:
            self._notice(f"the input has {', '.join(topic.name for topic in old)} already; they were replaced")
        outs = {}
        for one in bag.connections():
            topic = topic_of(one)
            if topic not in old:
                # beside that of the scan: readers take what has one time in the order of connections
                has_labels = topic in read and topic.kind in LASERS
                outs[one.id] = _connect(sink, one), _connect(sink, one, LABELS) if has_labels else None
        for message in bag.messages([topic for topic in bag.counts if topic not in old]):
            topic, data = message.topic, message.data
            own, beside = outs[message.connection]
            if topic in read and topic.kind == CLOUD:
                data = label_cloud(data, take, is_cdr=topic.is_cdr)
            sink.write(own, message.time_ns, data)
            if beside is not None:
                codes = label_laser(data, take, is_cdr=topic.is_cdr, is_multi=topic.kind == ECHOES)
                sink.write(beside, message.time_ns, codes)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open a writer of rosbags, and bring what it wrote under the temporary names at the end."""
        from rosbags import rosbag1, rosbag2

        suffix = self.path.suffix.lower()
        if suffix not in _PARTS:
            with rosbag1.Writer(self._temporary) as first:
                yield first
            return
        plugin = rosbag2.StoragePlugin.SQLITE3 if suffix == _DATABASE else rosbag2.StoragePlugin.MCAP
        folder = temporary_name(self.path)
        self._stack.callback(shutil.rmtree, folder, ignore_errors=True)
        # programs of ROS 2 from Humble on read this version
        with rosbag2.Writer(folder / self.path.stem, version=8, storage_plugin=plugin) as sink:
            yield sink
        (sink.path / f"{self.path.stem}{suffix}").replace(self._temporary)
        if self._metadata is not None:
            (sink.path / _METADATA).replace(self._metadata)


def _connect(sink: Any, one: Any, after: str = "") -> Any:
    """Add a connection as it was in the input, its topic with something behind its name."""
    topic = one.topic + after
    if not hasattr(sink, "storage"):
        same = [has for has in sink.connections if (*has[1:5], has.ext) == (topic, *one[2:5], one.ext)]
        ext = {"callerid": one.ext.callerid, "latching": one.ext.latching}
        made = {"msgdef": one.msgdef.data, "md5sum": one.digest, **ext}
        return same[0] if same else sink.add_connection(topic, one.msgtype, **made)
    from rosbags.rosbag2.metadata import dump_qos_v8

    # its own way of adding wants a definition and its hash, which older bags do not have
    added = one._replace(id=len(sink.connections) + 1, topic=topic, msgcount=0, owner=sink)
    if one.msgtype not in sink.added_types and (one.msgdef.format.value or sink.storage_plugin.name == "MCAP"):
        sink.storage.add_msgtype(added)
        sink.added_types.add(one.msgtype)
    sink.storage.add_connection(added, dump_qos_v8(one.ext.offered_qos_profiles))
    sink.connections.append(added)
    sink.counts[added.id] = 0
    return added


def open_bag_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open the codes of a bag: a field of its clouds (``label``), and the labels beside its laser scans."""
    bag, name = Bag(path), dimension or FIELD
    lasers = {topic for topic in bag.counts if is_labels(topic, bag.counts) and dimension in (None, FIELD)}
    topics = lasers | {topic for topic in bag.counts if topic.kind == CLOUD}

    def read() -> Iterator[NDArray[Any]]:
        n = 0
        for message in bag.messages(topics) if topics else ():
            try:
                codes = (_laser_codes if message.topic in lasers else _cloud_codes)(message.data, message.topic, name)
            except ShortMessageError as error:
                problem = f"a message of {message.topic.name} {error}"
                raise InputError(str(path), problem, "copy the bag again") from None
            n += len(codes)
            yield codes
        if not n:
            problem = f"no field {name!r} in its clouds, and no laser scans with {LABELS} beside them"
            raise InputError(str(path), problem, "name a bag that prc classify wrote")

    return CodeSource(path, None, read, name=name)


def _cloud_codes(data: bytes, topic: Topic, name: str) -> NDArray[Any]:
    held = unpack_cloud(data, is_cdr=topic.is_cdr)
    if name not in held.fields:
        return np.empty(0, np.uint8)
    offset, kind = held.fields[name]
    code = np.dtype(held.order + TYPES.get(kind, "u1"))
    expect(kind in TYPES and offset + code.itemsize <= held.step, f"has a field {name!r} that is not in its points")
    form = {"names": ["code"], "formats": [code], "offsets": [offset], "itemsize": held.step}
    codes: NDArray[Any] = np.frombuffer(held.points, np.dtype(form))["code"]  # type: ignore[call-overload]
    return codes


def _laser_codes(data: bytes, topic: Topic, name: str) -> NDArray[Any]:
    scan = parse_laser(data, is_cdr=topic.is_cdr, is_multi=topic.kind == ECHOES)
    if scan.n_echoes is None:
        return scan.intensity
    codes = np.zeros(scan.n_records, np.float32)
    codes[_has_echo(scan.n_echoes)] = scan.intensity
    return codes
