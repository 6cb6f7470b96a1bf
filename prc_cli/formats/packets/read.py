"""Read captures: every sender of packets is a scanner of the stream."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import Assumption, ScanBlock, StreamInfo
from prc_cli.core.types import U8
from prc_cli.formats.firings import ColumnLines
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised.scans import RULED_OUT, check_rules, check_width
from prc_cli.formats.packets.capture import CaptureCount, Datagram, read_datagrams
from prc_cli.formats.packets.ouster import Metadata, OusterDecoder, read_metadata
from prc_cli.formats.packets.repeats import Repeats
from prc_cli.formats.packets.spinning import (
    KNOWN,
    NEEDED,
    SpinningDecoder,
    describe,
    is_hesai,
    is_spinning,
)

BATCH_SHOTS = 1 << 17
"""Shots decoded at a time."""
MAX_SCANNERS = 256
"""Most scanners of a capture."""
_USUAL_OUSTER = 7502


Decoder: TypeAlias = SpinningDecoder | OusterDecoder


def is_scan(packet: bytes, metadata: Metadata | None) -> bool:
    """Return whether a packet has shots of a known scanner."""
    return is_spinning(packet) or (metadata is not None and len(packet) == metadata.packet_size)


def open_decoder(
    where: str,
    first: bytes,
    metadata: Metadata | None,
    config: InputConfig,
) -> Decoder:
    """Return the decoder for a scanner's first packet."""
    if metadata is not None and len(first) == metadata.packet_size:
        return OusterDecoder(where, metadata, config.return_)
    calibration = None if config.metadata is None else Path(config.metadata).expanduser()
    return SpinningDecoder(where, first, calibration, config.return_)


class PacketLines:
    """Gathers the packets of one scanner into blocks."""

    def __init__(
        self,
        where: str,
        scanner: int,
        first: bytes,
        metadata: Metadata | None,
        config: InputConfig,
    ) -> None:
        self._where = where
        self._scanner = scanner
        self._config = config
        self.decoder = open_decoder(where, first, metadata, config)
        self.points_per_line = self.decoder.points_per_line
        self.n_records = self.decoder.n_records
        self.has_returns = self.decoder.n_returns > 1
        self._lines: ColumnLines | None = None
        self._size = len(first)
        self._packets: list[tuple[bytes, float, int]] = []
        self._n_skipped = 0
        """Records of packets that are copies of earlier ones."""
        self._enough = max(1, BATCH_SHOTS // max(1, self.n_records))

    def add(self, packet: bytes, time_s: float, first_record: int) -> Iterator[ScanBlock]:
        """Take a packet; yield complete blocks."""
        if len(packet) != self._size:
            problem = f"found a packet of {len(packet)} bytes, expected {self._size} as before"
            raise InputError(self._where, problem, "split the capture where the set-up changed")
        self._packets.append((packet, time_s, first_record))
        if len(self._packets) == self._enough:
            yield from self._decode()

    def finish(self) -> Iterator[ScanBlock]:
        """Yield the last blocks."""
        yield from self._decode()
        if self._lines is not None:
            yield from self._lines.finish()

    def lost(self) -> str:
        """Return a sentence on lost columns, empty if there are none."""
        return "" if self._lines is None else self._lines.lost()

    def skip(self) -> None:
        """Count the records of a packet that is a copy of an earlier one."""
        self._n_skipped += self.n_records

    def _decode(self) -> Iterator[ScanBlock]:
        if not self._packets:
            return
        packets, times, records = zip(*self._packets, strict=True)
        self._packets = []
        data: U8 = np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), self._size)
        columns = self.decoder.decode(data, np.array(times), np.array(records, np.int64))
        if self._lines is None:
            self._lines = ColumnLines(self._where, self._scanner, self.decoder.shift, self._config)
        per_column = self.n_records // self.decoder.n_columns
        self._lines.count_not_fired(self._n_skipped)
        self._n_skipped = 0
        self._lines.count_not_fired(len(data) * self.n_records - columns.n * per_column)
        if columns.n:
            yield from self._lines.add(columns)


@dataclass(slots=True)
class _Scanner:
    """A scanner in the first pass over the capture."""

    first: bytes
    start_s: float
    end_s: float = 0.0
    n: int = 0
    number: int = 0
    name: str = ""


class PacketStream:
    """A capture as a :class:`prc_cli.core.stream.ScanStream`."""

    def __init__(
        self,
        path: Path,
        config: InputConfig,
        _lines_at_once: int = 1,
        parts: tuple[Path, ...] = (),
    ) -> None:  # scans are blocks
        check_rules(path, config, "packets of scanners")
        self._path = path
        self._config = config
        self._files = parts or (path,)
        self._metadata = find_metadata(path, config)
        self._count = CaptureCount()
        self._others: dict[tuple[int, int], int] = {}
        """Datagrams that are not read, by port and size."""
        self._unknown = ""
        """Description of an unknown scanner."""
        self._scanners = self._wanted(self._look())
        decoders = [
            open_decoder(f"{path}: {key}", scanner.first, self._metadata, config)
            for key, scanner in self._scanners.items()
        ]
        for number, (scanner, decoder) in enumerate(
            zip(self._scanners.values(), decoders, strict=True)
        ):
            scanner.number = number
            scanner.name = decoder.name
        self._has_returns = any(decoder.n_returns > 1 for decoder in decoders)
        self._widest = max(decoder.points_per_line for decoder in decoders)
        check_width(path, self._widest, config)
        self._lost: list[str] = []
        self._repeated = ""

    @property
    def info(self) -> StreamInfo:
        """Properties known before reading, and after reading also its notes."""
        shown = "; ".join(
            f"{scanner.number}: {scanner.name} at {key}" for key, scanner in self._scanners.items()
        )
        assumed = [
            Assumption(
                "input.lines", "firing columns", "rings from low to high are the shots of a line"
            ),
            Assumption("input.scanner", "one a sender and port", shown[:500]),
        ]
        if self._metadata is not None:
            assumed.append(
                Assumption("input.metadata", Path(self._metadata.path).name, "angles of the beams")
            )
        return StreamInfo(
            path=str(self._path),
            format="packets",
            points_per_line=self._widest,
            n_records=None,
            n_lines=None,
            assumptions=tuple(assumed),
            facts=SourceFacts(
                has_line_times=True,
                refuses=RULED_OUT | {"range_scale"},
                remedy="check the model of the scanner and its metadata",
                has_returns=self._has_returns,
                scanners=tuple(self._scanners) if len(self._scanners) > 1 else (),
                notes=(*self._notes(), *self._lost),
                repeated=self._repeated,
                header=self._header(),
            ),
        )

    def _notes(self) -> list[str]:
        count = self._count
        notes = []
        if count.end:
            notes.append(f"{count.end}: it was read up to there")
        if count.n_short:
            short = f"{count.n_short:,} packets were not kept whole by the capture"
            notes.append(f"{short} (its snapshot length): left out")
        if count.n_fragments_lost:
            notes.append(f"{count.n_fragments_lost:,} datagrams lack a fragment: left out")
        return notes

    def _header(self) -> dict[str, str]:
        scanners = {
            f"scanner {scanner.number}": f"{key}, {scanner.name}, {scanner.n:,} packets "
            f"from {scanner.start_s:.3f} s to {scanner.end_s:.3f} s"
            for key, scanner in self._scanners.items()
        }
        return {**scanners, "not read": self._shown_others(8) or "nothing"}

    def _shown_others(self, most: int) -> str:
        others = sorted(self._others.items(), key=lambda item: -item[1])[:most]
        return ", ".join(f"{n:,} of {size} bytes to port {port}" for (port, size), n in others)

    def _datagrams(self, count: CaptureCount) -> Iterator[Datagram]:
        for path in self._files:
            yield from read_datagrams(path, count)

    def _look(self) -> dict[str, _Scanner]:
        """Read the capture once for its scanners and its end."""
        scanners: dict[str, _Scanner] = {}
        for datagram in self._datagrams(self._count):
            if not is_scan(datagram.payload, self._metadata):
                key = (datagram.port, len(datagram.payload))
                if key in self._others or len(self._others) < MAX_SCANNERS:
                    self._others[key] = self._others.get(key, 0) + 1
                if is_hesai(datagram.payload):
                    self._unknown = describe(datagram.payload)
                continue
            scanner = scanners.get(_key(datagram))
            if scanner is None:
                if len(scanners) == MAX_SCANNERS:
                    problem = f"more than {MAX_SCANNERS} senders, expected scanners"
                    raise InputError(
                        str(self._path), problem, "capture the scanners' addresses alone"
                    )
                scanner = scanners[_key(datagram)] = _Scanner(datagram.payload, datagram.time_s)
            scanner.n += 1
            scanner.end_s = datagram.time_s
        return dict(sorted(scanners.items()))

    def _wanted(self, scanners: dict[str, _Scanner]) -> dict[str, _Scanner]:
        if not scanners:
            raise InputError(str(self._path), *self._nothing())
        wanted = list(scanners) if self._config.topic is None else self._config.topic.split(",")
        for name in wanted:
            if name not in scanners:
                problem = f"found {name!r}, {self._path.name} has {', '.join(scanners)[:500]}"
                raise ConfigError("input.topic", problem, "name one of them")
        return {key: scanner for key, scanner in scanners.items() if key in wanted}

    def _nothing(self) -> tuple[str, str]:
        end = f" ({self._count.end})" if self._count.end else ""
        problem = f"no packets of a known scanner{end}: {self._shown_others(5) or 'no datagram'}"
        if self._unknown:
            return f"{problem} ({self._unknown}), expected {KNOWN}", NEEDED
        if self._metadata is not None:
            size = self._metadata.packet_size
            return (
                f"{problem} (packets of {size} bytes, as the metadata say)",
                "check that the metadata belong to it",
            )
        problem += ", expected Velodyne, Ouster or Hesai"
        if any(port == _USUAL_OUSTER or size > 3000 for port, size in self._others):
            return (
                problem,
                "packets of an Ouster need its metadata: give --set input.metadata=FILE.json",
            )
        return problem, "capture the data port of the scanner"

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start."""
        lines: dict[str, PacketLines] = {}
        repeats = {key: Repeats() for key in self._scanners}
        record = 0
        for datagram in self._datagrams(CaptureCount()):
            key = _key(datagram)
            if key not in self._scanners or not is_scan(datagram.payload, self._metadata):
                continue
            scan_lines = lines.get(key)
            if scan_lines is None:
                number = self._scanners[key].number
                scan_lines = PacketLines(
                    f"{self._path}: {key}", number, datagram.payload, self._metadata, self._config
                )
                lines[key] = scan_lines
            if repeats[key].is_again(datagram.payload):
                scan_lines.skip()
            else:
                yield from scan_lines.add(datagram.payload, datagram.time_s, record)
            record += scan_lines.n_records
        for scan_lines in lines.values():
            yield from scan_lines.finish()
        notes = [copies.note(f"packets of {key}") for key, copies in repeats.items()]
        self._repeated = next((note for note in notes if note), "")
        self._lost = [
            f"{key}: {lost}" for key, scan_lines in lines.items() if (lost := scan_lines.lost())
        ]


def _key(datagram: Datagram) -> str:
    return f"{datagram.source}:{datagram.port}"


def find_metadata(path: Path | None, config: InputConfig) -> Metadata | None:
    """Return the metadata of an Ouster: as configured, else beside ``path`` with ``.json``."""
    if config.metadata is not None:
        named = Path(config.metadata).expanduser()
        # the calibration of a Velodyne is not JSON
        return None if named.suffix in (".yml", ".yaml") else read_metadata(named)
    beside = None if path is None else path.with_suffix(".json")
    return read_metadata(beside) if beside is not None and beside.is_file() else None
