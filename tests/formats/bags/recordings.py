"""Bags made by code: with the writers of rosbags and mcap."""

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

from tests.clouds import seen

N_LINES = 12
M = 40
PERIOD_NS = 20_000_000
START_NS = 1_700_000_000 * 10**9
CLOUD = "sensor_msgs/msg/PointCloud2"
COLUMN_S = 5e-4
"""From one firing of a spinning scanner to the next [s]; a turn takes 200."""
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}


@dataclass
class Sent:
    """A message to be recorded."""

    topic: str
    kind: str
    time_ns: int
    message: Any


def header(store: Any, time_ns: int, frame: str) -> Any:
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    header_type = types["std_msgs/msg/Header"]
    return (
        header_type(seq=0, stamp=stamp, frame_id=frame)
        if "seq" in header_type.__annotations__
        else header_type(stamp, frame)
    )


def ranges(seed: int = 1) -> np.ndarray:
    """A floor and a wall, noisy, with shots that do not come back: (lines, M) float32."""
    rng = np.random.default_rng(seed)
    image = 4 + np.sin(np.linspace(0, 3, M)) + rng.normal(0, 0.01, (N_LINES, M))
    image[rng.random((N_LINES, M)) < 0.1] = np.inf
    image[0, 3] = np.nan
    image[1, 3] = 200.0
    image[2, 3] = 0.0
    return image.astype(np.float32)


def laser(
    store: Any, time_ns: int, range_m: np.ndarray, frame: str = "laser", **changes: Any
) -> Any:
    values = {
        "header": header(store, time_ns, frame),
        "angle_min": -1.5,
        "angle_max": 1.5,
        "angle_increment": 3.0 / (M - 1),
        "time_increment": 1e-5,
        "scan_time": 0.02,
        "range_min": 0.1,
        "range_max": 100.0,
        "ranges": range_m,
        "intensities": np.arange(len(range_m), dtype=np.float32),
    }
    return store.types["sensor_msgs/msg/LaserScan"](**{**values, **changes})


def echoes(
    version: int,
    ranges: list[list[float]],
    intensities: list[list[float]] | None = None,
    *,
    n: int = 3,
    topic: str = "/scan",
) -> list[Sent]:
    """Messages of shots with so many echoes; their intensities are the ranges unless given."""
    store = STORES[version]
    echo = store.types["sensor_msgs/msg/LaserEcho"]
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    shots = [
        [echo(np.array(values, np.float32)) for values in lists]
        for lists in (ranges, intensities or ranges)
    ]
    setup = (-1.5, 1.5, 0.1, 1e-5, 0.02, 0.1, 100.0)
    return [
        Sent(
            topic, kind, time_ns, store.types[kind](header(store, time_ns, "laser"), *setup, *shots)
        )
        for time_ns in range(START_NS, START_NS + n * PERIOD_NS, PERIOD_NS)
    ]


def lasers(
    version: int,
    topic: str = "/scan",
    frame: str = "laser",
    seed: int = 1,
) -> list[Sent]:
    store = STORES[version]
    return [
        Sent(
            topic,
            "sensor_msgs/msg/LaserScan",
            START_NS + i * PERIOD_NS,
            laser(store, START_NS + i * PERIOD_NS, row, frame),
        )
        for i, row in enumerate(ranges(seed))
    ]


def strings(version: int) -> list[Sent]:
    kind = "std_msgs/msg/String"
    return [
        Sent("/talk", kind, START_NS + i, STORES[version].types[kind](data="hello"))
        for i in range(3)
    ]


def write_bag(
    path: Path,
    sent: list[Sent],
    compression: str = "",
    chunk: int | None = None,
) -> Path:
    """Write a ROS 1 bag."""
    store = STORES[1]
    writer = Writer1(path)
    if chunk is not None:
        writer.chunk_threshold = chunk
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        kinds = {message.topic: message.kind for message in sent}
        topics = {
            name: writer.add_connection(name, kind, typestore=store) for name, kind in kinds.items()
        }
        for message in sorted(sent, key=lambda message: message.time_ns):
            writer.write(
                topics[message.topic],
                message.time_ns,
                store.serialize_ros1(message.message, message.kind),
            )
    return path


def write_mcap(
    path: Path,
    sent: list[Sent],
    compression: str = "none",
    chunk: int = 4096,
) -> Path:
    store = STORES[2]
    with path.open("wb") as handle:
        writer = McapWriter(
            handle, chunk_size=chunk, compression=CompressionType[compression.upper()]
        )
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for message in sorted(sent, key=lambda message: message.time_ns):
            if message.topic not in channels:
                schema = writer.register_schema(message.kind, "ros2msg", b"")
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            data = bytes(store.serialize_cdr(message.message, message.kind))
            writer.add_message(channels[message.topic], message.time_ns, data, message.time_ns)
        writer.finish()
    return path


def write_db3(path: Path, sent: list[Sent], *, packed: bool = False) -> Path:
    """Write a database as rosbag2 does."""
    base = sqlite3.connect(path)
    base.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,"
        "serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp "
        "INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    kinds = {message.topic: message.kind for message in sent}
    numbers = {topic: number for number, topic in enumerate(kinds, 1)}
    topics = [(numbers[topic], topic, kind) for topic, kind in kinds.items()]
    base.executemany("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')", topics)
    for message in sorted(sent, key=lambda message: message.time_ns):
        data = bytes(STORES[2].serialize_cdr(message.message, message.kind))
        row = (
            numbers[message.topic],
            message.time_ns,
            zstandard.compress(data) if packed else data,
        )
        base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", row)
    base.commit()
    base.close()
    return path


def cloud(
    version: int,
    time_ns: int,
    table: np.ndarray,
    *,
    height: int = 1,
) -> Any:
    """A ``PointCloud2`` of a structured array, with its fields and byte order."""
    types = STORES[version].types
    codes = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    assert table.dtype.fields is not None
    fields = [
        types["sensor_msgs/msg/PointField"](name, offset, codes[kind.str[1:]], 1)
        for name, (kind, offset, *_) in table.dtype.fields.items()
    ]
    is_big = any(kind.str[0] == ">" for kind, *_ in table.dtype.fields.values())
    data = np.frombuffer(table.tobytes(), np.uint8)
    step = table.dtype.itemsize
    width = len(table) // height
    cloud_type = types["sensor_msgs/msg/PointCloud2"]
    head = header(STORES[version], time_ns, "velodyne")
    return cloud_type(head, height, width, fields, is_big, step, step * width, data, True)


def kind_of(time: str, of_time: str, *, ring: str = "<u2", order: str = "<") -> np.dtype[Any]:
    """Return the type of the points of a spinning scanner, whose times have a name and a type."""
    types = dict.fromkeys(("x", "y", "z", "intensity"), "f4") | {"ring": ring, time: of_time}
    return np.dtype(list(types.items())).newbyteorder(order)


POINT = kind_of("t", "u4")


def drive(n: int = 300, *, together: bool = False) -> dict[str, np.ndarray]:
    """Return the shots of a scanner of 8 rings, which fire one after the other or together.

    A fifth did not return.
    """
    rng = np.random.default_rng(5)
    column, ring = (index.ravel() for index in np.indices((n, 8)))
    range_m = rng.uniform(5, 6, n * 8)
    range_m[rng.random(n * 8) < 0.2] = np.nan
    order = np.array([0, 4, 1, 5, 2, 6, 3, 7])
    time_s = COLUMN_S * column + (0.0 if together else 5e-5) * order[ring]
    azimuth = time_s * 2 * np.pi / 0.1
    elevation = np.deg2rad(-14 + 4 * ring)
    xyz_m = seen(range_m, -azimuth, elevation)
    return {"column": column, "ring": ring, "range": range_m, "xyz": xyz_m, "time": time_s}


def clouds(
    shots: dict[str, np.ndarray],
    kind: np.dtype[Any] = POINT,
    *,
    every: int = 100,
    version: int = 2,
    by_ring: bool = True,
    pause_s: float = 0.0,
    change: Callable[[np.ndarray, float], np.ndarray] | None = None,
) -> list[Sent]:
    """Return clouds of so many columns with the points that returned, ring after ring.

    All but the first come later by a pause. ``change`` gets the points and the time of a cloud.
    """
    sent = []
    for first in range(0, int(shots["column"].max()) + 1, every):
        is_here = shots["column"] // every == first // every
        use = np.flatnonzero(is_here & np.isfinite(shots["range"]))
        if by_ring:
            use = use[np.argsort(shots["ring"][use], kind="stable")]
        points = np.zeros(len(use), kind)
        for axis, name in enumerate("xyz"):
            points[name] = shots["xyz"][use, axis]
        points["ring"] = shots["ring"][use]
        points["intensity"] = shots["column"][use] % 250
        after_s = shots["time"][use] - first * COLUMN_S
        if "t" in kind.fields:
            points["t"] = np.rint(after_s * 1e9)
        else:
            points["time"] = after_s
        stamp_ns = START_NS + round((first * COLUMN_S + (pause_s if first else 0.0)) * 1e9)
        if change is not None:
            points = change(points, stamp_ns * 1e-9)
        sent.append(Sent("/points", CLOUD, stamp_ns, cloud(version, stamp_ns, points)))
    return sent
