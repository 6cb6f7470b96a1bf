"""Read bags: every frame of every scan topic is a scanner of the stream."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import Assumption, ScanBlock, StreamInfo
from prc_cli.formats.bags.cloud import CLOUD, parse_cloud
from prc_cli.formats.bags.cloud_lines import CloudLines
from prc_cli.formats.bags.containers import Bag, Message, Topic
from prc_cli.formats.bags.laser import ECHOES, LASER, LaserLines, LaserScan, parse_laser
from prc_cli.formats.bags.messages import OUSTER, PACKED, ShortMessageError, parse_packets
from prc_cli.formats.options import InputConfig, origin_of
from prc_cli.formats.organised.scans import RULED_OUT, check_rules, check_width
from prc_cli.formats.packets.read import PacketLines, find_metadata, is_scan
from prc_cli.formats.packets.repeats import Repeats
from prc_cli.formats.packets.spinning import KNOWN, NEEDED, describe
from prc_cli.formats.ranges import refuse_scale, scale_told

MAX_SCANNERS = 256
"""Most scanners of a bag."""
FIRST_SCANS = 256
"""Laser scans that show which beams there are."""
FIRST_CLOUDS = 9
USUAL_TURN_S = 0.1
"""Clouds whose stamps give the time of a turn, and the turn of most scanners [s]."""
LASERS = (LASER, ECHOES)
READABLE = (*PACKED, *LASERS, CLOUD)
"""Types of messages that hold scans."""
LABELS = "/labels"
"""Suffix of the topic of laser scans whose intensities are class codes."""


_REMEDY = "record the scanner's own topic, in its own frame"
_OR_ORIGIN = ", or give its place in the coordinates: --range origin:X,Y,Z"


def is_labels(topic: Topic, topics: Collection[Topic]) -> bool:
    """Return whether a topic of a bag has the class codes of another topic."""
    scans = replace(topic, name=topic.name.removesuffix(LABELS))
    return topic.kind in LASERS and scans != topic and scans in topics


class BagStream:
    """A bag as a :class:`prc_cli.core.stream.ScanStream`."""

    def __init__(
        self,
        path: Path,
        config: InputConfig,
        _lines_at_once: int = 1,
        parts: tuple[Path, ...] = (),
    ) -> None:  # scans are blocks
        check_rules(path, config, "a recording of scans", may_have_origin=True)
        self._path = path
        self._config = config
        self.bag = Bag(path, parts)
        self._scans: dict[Topic, list[LaserScan]] = {}
        self._left_out: dict[Topic, ShortMessageError] = {}
        """Why clouds cannot be read."""
        self._firsts = self._first_messages()
        self._frames = self._readable()
        self.topics = self._choose()
        """Topics that are read."""
        self._has_clouds = all(topic.kind == CLOUD for topic in self.topics)
        if not self._has_clouds:
            check_rules(path, config, "a recording of scans")
        self._notes: list[str] = []
        self._numbers: dict[str, int] = {}
        """Numbers of scanners, in the order they are met."""
        self._repeated = ""
        self._has_returns = False
        self._has_whole_lines = True
        self._widest = self._look()
        self._takes_scale = not any(topic.kind in PACKED for topic in self.topics)
        if not self._takes_scale:
            refuse_scale(config, str(path), "packets hold metres")
        check_width(path, self._widest, config)

    @property
    def info(self) -> StreamInfo:
        """Properties known before reading, and after reading also its notes."""
        counts = self.bag.counts
        names = ", ".join(topic.name for topic in self.topics)
        others = [
            topic.name for topic in counts if topic not in self.topics and topic in self._frames
        ]
        why = (
            "the bag has no other scans"
            if not others
            else f"other scans: {', '.join(others[:10])} (input.topic)"
        )
        if self._config.topic is not None:
            why = "input.topic names it"
        assumed = [Assumption("input.topic", names, why), *scale_told(self._config.range_scale)]
        if len(self._numbers) > 1:
            shown = "; ".join(f"{number}: {name}" for name, number in self._numbers.items())
            assumed.append(Assumption("input.scanner", "one a topic and frame", shown[:500]))
        notes = list(self._notes)
        if self.bag.problem:
            notes.insert(0, f"{self.bag.problem}: it was read up to there")
        refused = RULED_OUT - {"origin"} if self._has_clouds else RULED_OUT
        if not self._takes_scale:
            refused |= {"range_scale"}
        lasers = all(topic.kind in LASERS for topic in self.topics)
        return StreamInfo(
            path=str(self._path),
            format="bag",
            points_per_line=self._widest,
            n_records=None,
            n_lines=sum(counts[topic] for topic in self.topics)
            if lasers and self._has_whole_lines
            else None,
            assumptions=tuple(assumed),
            facts=SourceFacts(
                has_line_times=not lasers,
                refuses=refused,
                remedy=f"{_REMEDY}{_OR_ORIGIN if self._has_clouds else ''}",
                has_returns=self._has_returns,
                scanners=tuple(self._numbers) if len(self._numbers) > 1 else (),
                notes=tuple(notes),
                repeated=self._repeated,
                header=self._header(),
            ),
        )

    def _header(self) -> dict[str, str]:
        bag = self.bag
        topics = {
            f"topic {topic.name}": f"{topic.kind}, {n or 'no'} messages"
            for topic, n in bag.counts.items()
        }
        start_s = bag.start_ns * 1e-9
        return {"recorded": f"{bag.end_ns * 1e-9 - start_s:.3f} s from {start_s:.3f} s", **topics}

    def _first_messages(self) -> dict[Topic, Message]:
        counts = self.bag.counts
        wanted = {
            topic
            for topic, n in counts.items()
            if n and topic.kind in READABLE and not is_labels(topic, counts)
        }
        first_messages: dict[Topic, Message] = {}
        for message in self.bag.messages(wanted) if wanted else ():
            first_messages.setdefault(message.topic, message)
            if len(first_messages) == len(wanted):
                break
        return first_messages

    def _readable(self) -> dict[Topic, str]:
        """Return the topics of scans, of clouds only those with rings, with the frame of each."""
        frames = dict.fromkeys(self._firsts, "")
        for topic, first in self._firsts.items():
            try:
                if topic.kind == CLOUD:
                    frames[topic] = parse_cloud(first.data, is_cdr=topic.is_cdr).frame
                elif topic.kind in LASERS:
                    frames[topic] = parse_laser(
                        first.data, is_cdr=topic.is_cdr, is_multi=topic.kind == ECHOES
                    ).frame
            except ShortMessageError as error:
                if topic.kind == CLOUD:
                    del frames[topic]
                    self._left_out[topic] = error
        return frames

    def _choose(self) -> tuple[Topic, ...]:
        topics = {topic.name: topic for topic in self.bag.counts}
        shown = (
            ", ".join(f"{name} ({topic.kind})" for name, topic in topics.items())[:600] or "none"
        )
        if self._config.topic is not None:
            chosen = []
            for name in self._config.topic.split(","):
                topic = topics.get(name)
                if topic is None:
                    raise ConfigError(
                        "input.topic", f"found {name!r}, {self._path.name} has: {shown}", "name one"
                    )
                if topic.kind not in READABLE:
                    problem = f"{name} holds {topic.kind}, expected {', '.join(READABLE)}"
                    raise ConfigError("input.topic", problem, f"the bag has: {shown}")
                chosen.append(topic)
            return tuple(chosen)
        # drivers publish clouds of packets, and laser scans of clouds, in the frame of the scanner
        clouds = {frame for topic, frame in self._frames.items() if topic.kind == CLOUD}
        packed = [topic for topic in self._frames if topic.kind in PACKED]
        others = [
            name
            for name, frame in self._frames.items()
            if name.kind == CLOUD or frame not in clouds
        ]
        if packed or others:
            return tuple(sorted(packed or others, key=lambda topic: topic.name))
        if self._left_out:
            topic, error = next(iter(self._left_out.items()))
            raise InputError(
                f"{self._path}: {topic.name}",
                str(error),
                error.hint or "record the scanner's own topic",
            )
        ended = f" ({self.bag.problem})" if self.bag.problem else ""
        problem = f"no topic with scans{ended}, expected {', '.join(READABLE)}; it has: {shown}"
        raise InputError(str(self._path), problem, "record the scanner's own topic")

    def _look(self) -> int:
        """Return the length of the longest line in the first message of every topic."""
        widest = 0
        why = (
            "no message with shots, expected scans",
            "name another topic: --set input.topic=NAME",
        )
        for topic in self.topics:
            if topic in self._firsts:
                reader = self._reader(topic)
                for _ in reader.add(self._firsts[topic], 0):
                    pass
                widest = max([widest, *(lines.points_per_line for lines in reader.frames.values())])
                is_plain = all(getattr(lines, "is_plain", True) for lines in reader.frames.values())
                self._has_whole_lines = self._has_whole_lines and is_plain
                self._has_returns = self._has_returns or any(
                    lines.has_returns for lines in reader.frames.values()
                )
                why = reader.nothing()
        if not widest:
            names = ", ".join(topic.name for topic in self.topics)
            raise InputError(f"{self._path}: {names}", *why)
        return widest

    def _reader(self, topic: Topic) -> _TopicReader:
        return _TopicReader(
            self._path,
            topic,
            self._numbers,
            self._config,
            lambda: self._between_s(topic),
            lambda: self._first_scans(topic),
        )

    def _first_scans(self, topic: Topic) -> list[LaserScan]:
        if topic not in self._scans:
            self._scans[topic] = scans = []
            for message in self.bag.messages({topic}):
                scans.append(
                    parse_laser(message.data, is_cdr=topic.is_cdr, is_multi=topic.kind == ECHOES)
                )
                if len(scans) == FIRST_SCANS:
                    break
        return self._scans[topic]

    def _between_s(self, topic: Topic) -> float:
        """Return the median time between the first clouds of a topic, 0.1 s for one cloud [s]."""
        stamps: list[float] = []
        for message in self.bag.messages({topic}):
            stamps.append(parse_cloud(message.data, is_cdr=topic.is_cdr).stamp_s)
            if len(stamps) == FIRST_CLOUDS:
                break
        steps = np.diff(stamps)
        steps = steps[steps > 0]
        return float(np.median(steps)) if len(steps) else USUAL_TURN_S

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start."""
        readers = {topic: self._reader(topic) for topic in self.topics}
        record = 0
        for message in self.bag.messages(set(readers)):
            reader = readers[message.topic]
            yield from reader.add(message, record)
            record += reader.n_taken
        for reader in readers.values():
            yield from reader.finish()
        self._notes = [note for reader in readers.values() for note in reader.notes()]
        self._repeated = ""
        for topic, reader in readers.items():
            name = f"{'packets' if topic.kind in PACKED else 'messages'} of {topic.name}"
            self._repeated = self._repeated or reader.repeats.note(name)


_L = TypeVar("_L", CloudLines, LaserLines, PacketLines)


class _TopicReader:
    """Decodes the messages of a topic into blocks; every frame of it is a scanner."""

    def __init__(
        self,
        path: Path,
        topic: Topic,
        numbers: dict[str, int],
        config: InputConfig,
        between_s: Callable[[], float] = lambda: USUAL_TURN_S,
        first_scans: Callable[[], list[LaserScan]] = list,
    ) -> None:
        self._where = f"{path}: {topic.name}"
        self._topic = topic
        self._between_s = between_s
        self._first_scans = first_scans
        self._numbers = numbers
        self._config = config
        self._metadata = find_metadata(None, config) if topic.kind in PACKED else None
        self.frames: dict[str, Any] = {}
        """Gatherer of scans into blocks, by frame."""
        self._n = self._n_other = 0
        self._other = ""
        self.n_taken = 0
        """Records of the last message."""
        self.repeats = Repeats()
        self._origin_m = origin_of(config) or (0.0, 0.0, 0.0)

    def add(self, message: Message, first_record: int) -> Iterator[ScanBlock]:
        """Take a message and the number of its first record; yield complete blocks."""
        kind = self._topic.kind
        is_cdr = self._topic.is_cdr
        # ROS 1 counts the messages of a sender in their first four bytes
        content = message.data if is_cdr else message.data[4:]
        try:
            if kind in PACKED:
                yield from self._packets(message, first_record)
            elif kind == CLOUD:
                cloud = parse_cloud(
                    message.data,
                    is_cdr=is_cdr,
                    scale=self._config.range_scale,
                    origin_m=self._origin_m,
                )
                self.n_taken = cloud.n_records
                if self.repeats.is_again(content):
                    self._scanner(cloud.frame, CloudLines, cloud, self._between_s).skip(cloud)
                    return
                lines = self._scanner(cloud.frame, CloudLines, cloud, self._between_s)
                yield from lines.add(cloud, first_record)
            else:
                scale = self._config.range_scale
                scan = parse_laser(
                    message.data, is_cdr=is_cdr, is_multi=kind == ECHOES, scale=scale
                )
                self.n_taken = scan.n_records
                if self.repeats.is_again(content):
                    return
                yield from self._scanner(scan.frame, LaserLines, self._scans_of(scan)).add(
                    scan, first_record
                )
        except ShortMessageError as error:
            hint = error.hint or "copy the bag again"
            raise InputError(
                f"{self._where}: message {self._n}", f"the message {error}", hint
            ) from None
        self._n += 1

    def _scans_of(self, scan: LaserScan) -> Callable[[], list[LaserScan]]:
        """Return a function for the first scans with the frame of a scan, at least this scan."""
        return lambda: (
            [first_scan for first_scan in self._first_scans() if first_scan.frame == scan.frame]
            or [scan]
        )

    def _scanner(self, frame: str, gather: Callable[..., _L], *first: Any) -> _L:
        if frame not in self.frames:
            name = self._name(frame)
            n = len(self._numbers)
            if name not in self._numbers and n == MAX_SCANNERS:
                problem = f"more than {MAX_SCANNERS} topics and frames with scans, expected fewer"
                raise InputError(name, problem, "name the topics: --set input.topic=NAME")
            self.frames[frame] = gather(
                self._where, self._numbers.setdefault(name, n), *first, self._config
            )
        lines: _L = self.frames[frame]
        return lines

    def _name(self, frame: str) -> str:
        return f"{self._topic.name} ({frame})" if frame else self._topic.name

    def _packets(self, message: Message, first_record: int) -> Iterator[ScanBlock]:
        topic = self._topic
        self.n_taken = 0
        frame, packets = parse_packets(
            topic.kind, message.data, message.time_ns * 1e-9, is_cdr=topic.is_cdr
        )
        if topic.kind in OUSTER and self._metadata is None:
            raise InputError(
                self._where,
                "packets of an Ouster need its metadata",
                "give --set input.metadata=FILE.json",
            )
        for time_s, data in packets:
            if not is_scan(data, self._metadata):
                self._n_other += 1
                self._other = describe(data)
                continue
            lines = self._scanner(frame, PacketLines, data, self._metadata)
            if self.repeats.is_again(data):
                lines.skip()
                self.n_taken += lines.n_records
                continue
            yield from lines.add(data, time_s, first_record + self.n_taken)
            self.n_taken += lines.n_records

    def finish(self) -> Iterator[ScanBlock]:
        for lines in self.frames.values():
            yield from lines.finish()

    def notes(self) -> list[str]:
        notes = [
            f"{self._name(frame)}: {lost}"
            for frame, lines in self.frames.items()
            if (lost := lines.lost())
        ]
        if self._n_other:
            others = f"{self._n_other:,} packets of another kind left out ({self._other})"
            notes.append(f"{self._topic.name}: {others}")
        return notes

    def nothing(self) -> tuple[str, str]:
        """Return why the messages have no shots, and a hint."""
        if self._other:
            problem = f"packets of an unknown scanner ({self._other}), expected {KNOWN} or Ouster"
            return problem, NEEDED
        return "no message with shots, expected scans", "name another topic: --set input.topic=NAME"
