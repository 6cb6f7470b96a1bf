"""Write and read class codes in bags: in a field of clouds, in a topic beside laser scans.

Messages of laser scans stay as they are. Their codes are the intensities of a second scan with the
same stamp, so that every viewer draws them in colours at the place of the scan.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.files import suffix_of
from prc_cli.core.types import I64, U8, Mask
from prc_cli.formats.bags.cloud import CLOUD, TYPES
from prc_cli.formats.bags.containers import Bag, Message, bag_errors, topic_of
from prc_cli.formats.bags.laser import ECHOES, parse_laser, read_echoes
from prc_cli.formats.bags.messages import PACKED, Cursor
from prc_cli.formats.bags.read import LABELS, LASERS, BagStream, is_labels
from prc_cli.formats.bags.write import BagOutput
from prc_cli.formats.records import CodeSource
from prc_cli.formats.writing.base import ScatterWriter
from prc_cli.formats.writing.columns import LabelOutput, asked_columns
from prc_cli.formats.writing.record import RunRecord

FIELD = "label"
_UINT8 = 2
"""Field of a point with its class code, and type of the field."""

Take: TypeAlias = Callable[[int], NDArray[Any]]
"""Returns the codes of the next n records, (n,) uint8, or int16 with negative = record left out."""


class CloudCodec:
    """Reads and writes the messages of clouds, as rosbags knows them."""

    def __init__(self, *, is_cdr: bool) -> None:
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.LATEST if is_cdr else Stores.ROS1_NOETIC)
        self._read = store.deserialize_cdr if is_cdr else store.deserialize_ros1
        self._write = store.serialize_cdr if is_cdr else store.serialize_ros1
        self._field = store.types["sensor_msgs/msg/PointField"]

    def points(self, data: bytes, name: str) -> tuple[Any, NDArray[np.void] | None]:
        """Return a message, and its points with a field as ``code``; None if they lack it."""
        cloud: Any = self._read(data, "sensor_msgs/msg/PointCloud2")
        field = next((candidate for candidate in cloud.fields if candidate.name == name), None)
        if field is None:
            return cloud, None
        form = ">" if cloud.is_bigendian else "<"
        point: Any = {
            "names": ["code"],
            "formats": [form + TYPES[field.datatype]],
            "offsets": [field.offset],
        }
        point["itemsize"] = cloud.point_step
        return cloud, self._rows(cloud).view(np.dtype(point))[:, 0]

    def _rows(self, cloud: Any) -> U8:
        """Return the bytes of every point, (n, bytes), without the padding of rows."""
        n_row = cloud.width * cloud.point_step
        rows: U8 = cloud.data[: cloud.height * max(cloud.row_step, n_row)].reshape(
            cloud.height, -1
        )[:, :n_row]
        return rows.reshape(-1, cloud.point_step).copy()

    def label(self, data: bytes, take: Take) -> bytes:
        """Return a message with codes in :data:`FIELD`, without points of negative codes."""
        cloud, points = self.points(data, FIELD)
        if points is None:
            # points of whole words stay aligned to them
            unlabelled = self._rows(cloud)
            step = cloud.point_step
            cloud.point_step += 1 if step % 4 else 4
            cloud.fields.append(self._field(FIELD, step, _UINT8, 1))
            rows = np.zeros((len(unlabelled), cloud.point_step), np.uint8)
            codes = take(len(unlabelled))
            rows[:, :step] = unlabelled
            rows[:, step] = codes.astype(np.uint8, copy=False)
        else:
            codes = take(len(points))
            points["code"] = codes.astype(np.uint8, copy=False)
            rows = points.view(np.uint8).reshape(-1, cloud.point_step)
        if not (kept := codes >= 0).all():
            rows = rows[kept]
            cloud.height = 1
            cloud.width = len(rows)
            cloud.is_dense = True
        cloud.data = rows.ravel()
        cloud.row_step = cloud.width * cloud.point_step
        return bytes(self._write(cloud, "sensor_msgs/msg/PointCloud2"))


def label_laser(message: Message, take: Take) -> bytes:
    """Return a scan whose intensities are the codes of its echoes."""
    cursor = Cursor(message.data, is_cdr=message.topic.is_cdr)
    cursor.header()
    cursor.numbers("f", 7)
    if message.topic.kind != ECHOES:
        n = len(cursor.array("f4"))
        words = take(n).astype(cursor.order + "f4")
    else:
        counts = read_echoes(cursor)[1]
        n = len(counts)
        words = np.empty(n + int(counts.sum()), cursor.order + "f4")
        is_code: Mask = np.ones(len(words), np.bool_)
        is_code[np.cumsum(counts + 1) - (counts + 1)] = False
        words.view(cursor.order + "u4")[~is_code] = counts
        words[is_code] = take(int(np.maximum(counts, 1).sum()))[_has_echo(counts)]
    return message.data[: cursor.position] + struct.pack(f"{cursor.order}I", n) + words.tobytes()


def _has_echo(n_echoes: I64) -> Mask:
    is_echo: Mask = np.repeat(n_echoes > 0, np.maximum(n_echoes, 1))
    return is_echo


class BagRewriter(BagOutput, ScatterWriter):
    """Writer of a copy of a bag with the class codes of its shots."""

    def __init__(self, labels: LabelOutput) -> None:
        source = labels.source.path
        path = labels.path
        if suffix_of(source) != path.suffix.lower():
            problem = (
                f"found {source.name}, expected a {path.suffix} to be written again with its "
                "classes"
            )
            again = (
                "write .laz, and from that the bag: prc convert"
                if labels.is_thinned
                else "write the labels alone: .npy"
            )
            raise OutputError(str(path), problem, again)
        self._stream = BagStream(source, labels.rules)
        self._packed = self._stream.bag.packed
        packed = [topic.name for topic in self._stream.topics if topic.kind in PACKED]
        refused = (
            f"{packed[0]} holds packets, which have no place for classes"
            if packed
            else self._stream.bag.problem
        )
        refused = refused or (
            "a bag holds whole messages, not a window of them" if labels.is_part else ""
        )
        if labels.is_thinned and any(topic.kind in LASERS for topic in self._stream.topics):
            refused = (
                refused or "laser scans have a place for every shot, so that none can be left out"
            )
        if refused:
            raise OutputError(
                str(path),
                refused,
                f"write {'.npz' if labels.is_thinned else 'the labels alone: .npy'}",
            )
        super().__init__(labels, (), labels.n_records)
        for column in asked_columns(labels.options):
            self._notice(
                f"bags hold class codes only; {column.what}s need .csv, .parquet, .las or .laz"
            )
        self._name_metadata()

    def _write(self, record: RunRecord) -> RunRecord:
        total = self._total(record)
        n_done = 0

        def take(n: int) -> NDArray[Any]:
            nonlocal n_done
            n_done += n
            codes: NDArray[Any] = (
                self._code_spool.span(n_done - n, n_done) if n else np.empty(0, np.uint8)
            )
            self._count(codes[codes >= 0].astype(np.uint8, copy=False))
            return codes

        try:
            with self._opened() as sink:
                self._copy(sink, take)
        except sqlite3.Error as error:
            raise OutputError(
                str(self.path), f"cannot be written ({error})", "free space on the disk"
            ) from error
        if n_done < total:
            problem = f"found {n_done} records, expected {total} as at the start of the run"
            raise InputError(
                str(self._stream.bag.path), problem, "run again when nothing else writes the input"
            )
        return self._completed(record)

    def _copy(self, sink: Any, take: Take) -> None:
        bag = self._stream.bag
        read = self._stream.topics
        old = [topic for topic in bag.counts if is_labels(topic, read)]
        if old:
            self._notice(
                f"the input has {', '.join(topic.name for topic in old)} already; they "
                "were replaced"
            )
        outs = {}
        for connection in bag.connections():
            # labels follow their scans: readers order messages of one time by connection
            has_labels = topic_of(connection) in read and topic_of(connection).kind in LASERS
            if topic_of(connection) not in old:
                outs[connection.id] = (
                    _connect(sink, connection),
                    _connect(sink, connection, LABELS) if has_labels else None,
                )
        codec = CloudCodec(is_cdr=any(topic.is_cdr for topic in read))
        for message in bag.messages([topic for topic in bag.counts if topic not in old]):
            data = message.data
            codes = b""
            (scans_out, labels_out) = outs[message.connection]
            with bag_errors(bag.path):
                if message.topic in read and message.topic.kind == CLOUD:
                    data = codec.label(data, take)
                elif labels_out is not None:
                    codes = label_laser(message, take)
            sink.write(scans_out, message.time_ns, data)
            if labels_out is not None:
                sink.write(labels_out, message.time_ns, codes)


def _connect(sink: Any, connection: Any, after: str = "") -> Any:
    # the writers' own methods refuse two connections of one publisher, and missing definitions
    added = connection._replace(
        id=len(sink.connections) + 1, topic=connection.topic + after, msgcount=0, owner=sink
    )
    if hasattr(sink, "chunks"):
        sink.write_connection(added, sink.chunks[-1].data)
    else:
        from rosbags.rosbag2.metadata import dump_qos_v8

        if connection.msgtype not in sink.added_types and (
            connection.msgdef.format.value or sink.storage_plugin.name == "MCAP"
        ):
            sink.storage.add_msgtype(added)
            sink.added_types.add(connection.msgtype)
        sink.storage.add_connection(added, dump_qos_v8(connection.ext.offered_qos_profiles))
        sink.counts[added.id] = 0
    sink.connections.append(added)
    return added


def open_bag_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open the codes of a bag: the field ``label`` of clouds, and labels beside laser scans."""
    bag = Bag(path)
    name = dimension or FIELD
    lasers = {topic for topic in bag.counts if name == FIELD and is_labels(topic, bag.counts)}
    topics = lasers | {topic for topic in bag.counts if topic.kind == CLOUD}

    def read() -> Iterator[NDArray[Any]]:
        n = 0
        codec = CloudCodec(is_cdr=any(topic.is_cdr for topic in topics))
        for message in bag.messages(topics) if topics else ():
            with bag_errors(path):
                codes = (
                    _laser_codes(message)
                    if message.topic in lasers
                    else codec.points(message.data, name)[1]
                )
            if codes is not None:
                n += len(codes)
                yield codes if codes.dtype.names is None else codes["code"]
        if not n:
            problem = (
                f"no field {name!r} in its clouds, and no laser scans with {LABELS} beside them"
            )
            raise InputError(str(path), problem, "name a bag that prc classify wrote")

    return CodeSource(path, None, read, name=name)


def _laser_codes(message: Message) -> NDArray[Any]:
    scan = parse_laser(
        message.data, is_cdr=message.topic.is_cdr, is_multi=message.topic.kind == ECHOES
    )
    if scan.n_echoes is None:
        return scan.intensity
    codes = np.zeros(scan.n_records, np.float32)
    codes[_has_echo(scan.n_echoes)] = scan.intensity
    return codes
