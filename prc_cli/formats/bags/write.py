"""Write streams as bags: firings of spinning scanners as clouds, lines of profilers as laser scans.

A cloud has the shots of one block, missing ones included, in the order of their times: ``x y z
intensity ring label time scan_line``. A laser scan is a line; its class codes are the intensities
of the scan of the same stamp on the topic beside.
"""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import OutputError
from prc_cli.core.files import suffix_of, temporary_name
from prc_cli.core.stream import MAX_RINGS, ScanBlock
from prc_cli.core.types import F64
from prc_cli.formats.bags import DATABASE, METADATA
from prc_cli.formats.bags.cloud import CLOUD, SCAN_LINE, TYPES
from prc_cli.formats.bags.laser import LASER
from prc_cli.formats.bags.read import LABELS
from prc_cli.formats.writing.base import StagedWriter, StreamItem, StreamShape, StreamWriter

_SCAN = "/scan"
_POINTS = "/points"
_FRAME = "scanner"
_REACH_M = 1e4
"""``range_max`` of laser scans [m]."""
_EVEN = 1e-3
"""In laser scans directions of a column change by less from line to line, and the step of the
angle by a smaller share."""
_POINT = np.dtype("<f4, <f4, <f4, <f4, <u2, <u2, <f4, <u4")
_POINT.names = ("x", "y", "z", "intensity", "ring", "label", "time", SCAN_LINE)


class BagOutput(StagedWriter):
    """Base of the writers of bags: opens the container, names ``metadata.yaml`` of a database."""

    _metadata: Path | None = None
    _packed = ""
    """Compression, as in the input; ROS 2 has zstd only."""

    def _name_metadata(self) -> None:
        """Register ``metadata.yaml`` beside a database, unless the folder has another bag."""
        if self.path.suffix.lower() != DATABASE:
            return
        metadata = self.path.with_name(METADATA)
        others = {
            suffix_of(path) for path in metadata.parent.iterdir() if path.name != self.path.name
        }
        if others & {DATABASE, ".mcap"} or (metadata.exists() and not self.path.exists()):
            self._notice(
                f"no {METADATA} was written: the folder has another bag (write to an empty folder)"
            )
            return
        self._metadata = self._output(metadata)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open a writer of rosbags; at the end move its files to the temporary names."""
        from rosbags import rosbag1, rosbag2

        suffix = self.path.suffix.lower()
        if suffix == ".bag":
            first = rosbag1.Writer(self._temporary)
            if self._packed:
                first.set_compression(first.CompressionFormat[self._packed.upper()])
            with first:
                yield first
            return
        plugin = rosbag2.StoragePlugin.SQLITE3 if suffix == DATABASE else rosbag2.StoragePlugin.MCAP
        folder = temporary_name(self.path)
        self._stack.callback(shutil.rmtree, folder, ignore_errors=True)
        # programs of ROS 2 from Humble on read this version
        sink = rosbag2.Writer(folder / self.path.stem, version=8, storage_plugin=plugin)
        if self._packed:
            mode = (
                rosbag2.CompressionMode.MESSAGE
                if suffix == DATABASE
                else rosbag2.CompressionMode.STORAGE
            )
            sink.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
        with sink:
            yield sink
        (sink.path / f"{self.path.stem}{suffix}").replace(self._temporary)
        if self._metadata is not None:
            (sink.path / METADATA).replace(self._metadata)


class BagStreamWriter(BagOutput, StreamWriter):
    """Writer of a stream as a bag."""

    one_scanner = "a bag"

    def __init__(self, path: Path, shape: StreamShape) -> None:
        from rosbags.typesys import Stores, get_typestore

        super().__init__(path, shape)
        if not shape.times:
            raise OutputError(
                str(path), "the stream has no times, which every message has", "write .npz"
            )
        self._is_first = path.suffix.lower() == ".bag"
        self._store = get_typestore(Stores.ROS1_NOETIC if self._is_first else Stores.LATEST)
        self._turns: bool | None = None
        self._waiting = np.empty(0, [*_POINT.descr[:-2], ("time", "<f8"), (SCAN_LINE, "<u4")])
        """Shots of a cloud that is not written yet."""
        self._name_metadata()

    def _start(self) -> None:
        self._messages = self._scratch()  # a database is written by one thread alone

    def _add(self, item: StreamItem) -> None:
        if self._turns is None:
            self._turns = self._judged(item.block)
        if self._turns:
            self._add_cloud(item)
        else:
            self._add_scans(item)

    def _judged(self, block: ScanBlock) -> bool:
        """Return whether the head turns from line to line; refuse lines that no message holds."""
        turns = block.angle_rad is None
        if block.xyz_m is not None:
            with np.errstate(invalid="ignore"):
                way = block.xyz_m / np.linalg.norm(block.xyz_m, axis=2, keepdims=True)
            turns = bool(np.nanmax(np.abs(way - way[:1]), initial=0.0) > _EVEN)
        if turns and (block.points_per_line > MAX_RINGS or block.xyz_m is None):
            problem = (
                f"lines of {block.points_per_line} shots turn, "
                f"expected lines of a profiler or of at most {MAX_RINGS} rings"
            )
            raise OutputError(str(self.path), problem, "write .npz")
        if not turns and block.angle_rad is not None:
            step = np.diff(block.angle_rad)
            if len(step) and np.abs(step - step.mean()).max() > _EVEN * np.abs(step.mean()):
                problem = "the angles of the beams have uneven steps, which laser scans cannot have"
                raise OutputError(str(self.path), problem, "write .npz")
        return turns

    # -- profilers

    def _add_scans(self, item: StreamItem) -> None:
        block = item.block
        codes = item.codes
        assert block.time_s is not None
        assert block.angle_rad is not None
        angle = block.angle_rad
        m = block.points_per_line
        angles = float(angle[0]), float(angle[-1]), float(angle[-1] - angle[0]) / max(m - 1, 1)
        ranges = np.where(np.isnan(block.range_m), np.float32(np.inf), block.range_m)
        lit = None if block.intensity is None else np.nan_to_num(block.intensity).astype("f4")
        for i, times in enumerate(block.time_s):
            begin_s, end_s = self._span_of(times, block.first_line + i)
            shot_s = (end_s - begin_s) / max(m - 1, 1)
            head = self._header(begin_s), *angles, shot_s, shot_s * m, 0.0, _REACH_M
            none = np.empty(0, "f4")
            self._send(_SCAN, LASER, end_s, *head, ranges[i], none if lit is None else lit[i])
            if codes is not None:
                self._send(
                    _SCAN + LABELS, LASER, end_s, *head, ranges[i], codes[i].clip(0).astype("f4")
                )

    def _span_of(self, times_s: F64, line: int) -> tuple[float, float]:
        """Return the times of the first and the last shot of a line [s].

        Shots without a time are evenly between the others.
        """
        known = np.flatnonzero(np.isfinite(times_s))
        if len(known) < min(len(times_s), 2):
            problem = (
                f"line {line} has {len(known)} shots with a time, expected 2: a message has a time"
            )
            raise OutputError(
                str(self.path), problem, "write .npz, which keeps times that are no numbers"
            )
        first = int(known[0])
        last = int(known[-1])
        shot_s = float(times_s[last] - times_s[first]) / max(last - first, 1)
        begin_s = float(times_s[first]) - first * shot_s
        if begin_s < 0 <= times_s[first]:  # before the zero of a clock there is no stamp
            begin_s = 0.0
        return begin_s, float(times_s[last]) + (len(times_s) - 1 - last) * shot_s

    # -- spinning scanners

    def _add_cloud(self, item: StreamItem) -> None:
        """Send the shots of a block that were fired before all later ones."""
        block = item.block
        assert block.time_s is not None
        assert block.xyz_m is not None
        fired = np.isfinite(block.time_s)
        n_lost = int(np.count_nonzero(~fired & ~np.isnan(block.range_m)))
        if n_lost:
            problem = f"{n_lost} returns from line {block.first_line} on have no time"
            raise OutputError(
                str(self.path), problem, "write .npz, which keeps times that are no numbers"
            )
        shots = np.zeros(int(fired.sum()), self._waiting.dtype)
        shots["time"] = block.time_s[fired]
        line, shots["ring"] = np.nonzero(fired)
        shots[SCAN_LINE] = block.first_line + line
        for axis, name in enumerate("xyz"):
            shots[name] = block.xyz_m[..., axis][fired]
        if block.intensity is not None:
            shots["intensity"] = np.nan_to_num(block.intensity[fired])
        if item.codes is not None:
            shots["label"] = item.codes[fired].clip(0)
        shots = np.concatenate([self._waiting, shots])
        shots = shots[np.argsort(shots["time"], kind="stable")]
        # lasers look to different azimuths at one time: later lines begin before this one ends
        end = (
            np.inf
            if block.is_last or not fired[-1].any()
            else float(block.time_s[-1][fired[-1]].min())
        )
        n = int(np.searchsorted(shots["time"], end))
        self._waiting = shots[n:]
        self._send_cloud(shots[:n])

    def _send_cloud(self, shots: NDArray[np.void]) -> None:
        if not len(shots):
            return
        head = self._header(float(shots["time"][0]))
        end_s = shots["time"][-1]
        shots["time"] -= shots["time"][0]
        data = shots.astype(_POINT).view(np.uint8)
        step = _POINT.itemsize
        kinds = {form: number for number, form in TYPES.items()}
        field = self._store.types["sensor_msgs/msg/PointField"]
        fields = [
            field(name, int(_POINT.fields[name][1]), kinds[_POINT[name].str[1:]], 1)  # type: ignore[index]
            for name in _POINT.names or ()
            if name != "label" or self.shape.codes
        ]
        self._send(
            _POINTS, CLOUD, end_s, head, 1, len(shots), fields, False, step, len(data), data, False
        )

    def _close(self) -> None:
        self._send_cloud(self._waiting)
        end = self._messages.tell()
        self._messages.seek(0)
        topics: dict[str, Any] = {}
        with self._opened() as sink:
            while self._messages.tell() < end:
                topic, name, time_ns, data = pickle.load(self._messages)
                if topic not in topics:
                    topics[topic] = sink.add_connection(topic, name, typestore=self._store)
                sink.write(topics[topic], time_ns, data)

    # -- messages

    def _header(self, time_s: float) -> Any:
        stamp = self._store.types["builtin_interfaces/msg/Time"](
            *divmod(self._nanoseconds(time_s), 10**9)
        )
        return self._store.types["std_msgs/msg/Header"](
            *([0] if self._is_first else []), stamp, _FRAME
        )

    def _nanoseconds(self, time_s: float) -> int:
        most_s = 1 << (32 if self._is_first else 31)
        if not 0 <= time_s < most_s:
            problem = (
                f"found the time {time_s:g} s, expected 0 to {most_s - 1}, which a message can have"
            )
            raise OutputError(str(self.path), problem, "write .npz, or look at the times")
        return round(time_s * 1e9)

    def _send(self, topic: str, kind: str, time_s: float, *values: Any) -> None:
        """Keep a message with the time of its last shot, at which it is complete."""
        name = kind.replace("/", "/msg/")
        pack = self._store.serialize_ros1 if self._is_first else self._store.serialize_cdr
        data = bytes(pack(self._store.types[name](*values), name))
        pickle.dump((topic, name, self._nanoseconds(float(time_s)), data), self._messages)
