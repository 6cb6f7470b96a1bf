"""Reader of captures: every scanner that sends packets is a scanner of the stream."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import Assumption, ScanBlock, StreamInfo
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised.scans import check_rules, check_width
from prc_cli.formats.packets.capture import CaptureCount, Datagram, read_datagrams
from prc_cli.formats.packets.ouster import Metadata, read_metadata
from prc_cli.formats.packets.scanners import PacketLines, is_scan, open_decoder

MAX_SCANNERS = 256
"""Most scanners of a capture."""
_USUAL_OUSTER = 7502


@dataclass(slots=True)
class _Scanner:
    """A scanner as the first pass finds it."""

    number: int
    first: bytes
    n: int = 0
    start_s: float = 0.0
    end_s: float = 0.0


@dataclass(slots=True)
class _Survey:
    """What the first pass finds."""

    count: CaptureCount = field(default_factory=CaptureCount)
    scanners: dict[str, _Scanner] = field(default_factory=dict)
    others: dict[tuple[int, int], int] = field(default_factory=dict)
    """Datagrams that are not read, by port and size."""


class PacketStream:
    """A capture as a :class:`prc_cli.core.stream.ScanStream`."""

    def __init__(self, path: Path, config: InputConfig) -> None:
        check_rules(path, config, "packets of scanners")
        self._path, self._config = path, config
        self._metadata = find_metadata(path, config)
        self._survey = self._look()
        self._names: dict[str, str] = {}
        widest, self._has_returns = 0, False
        for key, scanner in self._survey.scanners.items():
            decoder = open_decoder(self._where(key), scanner.first, self._metadata, config.return_)
            self._names[key] = decoder.name
            widest = max(widest, len(decoder.shift))
            self._has_returns = self._has_returns or decoder.n_returns > 1
        self._widest = widest
        check_width(path, widest, config)
        self._lost: list[str] = []

    def _where(self, key: str) -> str:
        return f"{self._path}: {key}"

    @property
    def info(self) -> StreamInfo:
        """What is known before reading, and afterwards also what was found while reading."""
        scanners = self._survey.scanners
        shown = "; ".join(f"{one.number}: {self._names[key]} at {key}" for key, one in scanners.items())
        assumed = [
            Assumption("input.lines", "firing columns", "rings from low to high are the shots of a line"),
            Assumption("input.scanner", "one a sender and port", shown[:500]),
        ]
        if self._metadata is not None:
            assumed.append(Assumption("input.metadata", Path(self._metadata.path).name, "angles of the beams"))
        return StreamInfo(
            path=str(self._path),
            format="packets",
            points_per_line=self._widest,
            n_records=None,
            n_lines=None,
            assumptions=tuple(assumed),
            facts=SourceFacts(
                has_line_times=True,
                has_returns=self._has_returns,
                notes=(*self._notes(), *self._lost),
                describe=self._describe,
            ),
        )

    def _notes(self) -> list[str]:
        count, notes = self._survey.count, []
        if count.end:
            notes.append(f"{count.end}: it was read up to there")
        if count.n_short:
            notes.append(
                f"{count.n_short:,} packets were not kept whole by the capture (its snapshot length): left out"
            )
        if count.n_fragments_lost:
            notes.append(f"{count.n_fragments_lost:,} datagrams lack a fragment: left out")
        return notes

    def _describe(self) -> dict[str, str]:
        told = {
            f"scanner {one.number}": f"{key}, {self._names[key]}, {one.n:,} packets from {one.start_s:.3f} s to "
            f"{one.end_s:.3f} s"
            for key, one in self._survey.scanners.items()
        }
        most = sorted(self._survey.others.items(), key=lambda item: -item[1])[:8]
        others = ", ".join(f"{n:,} of {size} bytes to port {port}" for (port, size), n in most)
        return {**told, "not read": others or "nothing"}

    def _look(self) -> _Survey:
        """Read the capture once: which scanners there are, and where it ends."""
        found = _Survey()
        for datagram in read_datagrams(self._path, found.count):
            if not is_scan(datagram.payload, self._metadata):
                key = (datagram.port, len(datagram.payload))
                if key in found.others or len(found.others) < MAX_SCANNERS:
                    found.others[key] = found.others.get(key, 0) + 1
                continue
            key_of = _key(datagram)
            one = found.scanners.get(key_of)
            if one is None:
                if len(found.scanners) == MAX_SCANNERS:
                    problem = f"more than {MAX_SCANNERS} senders, expected scanners"
                    raise InputError(str(self._path), problem, "capture the scanners' addresses alone")
                one = _Scanner(0, datagram.payload, start_s=datagram.time_s)
                found.scanners[key_of] = one
            one.n += 1
            one.end_s = datagram.time_s
        found.scanners = self._wanted(found)
        for number, key_of in enumerate(sorted(found.scanners)):
            found.scanners[key_of].number = number
        return found

    def _wanted(self, found: _Survey) -> dict[str, _Scanner]:
        """Return the scanners to read."""
        if not found.scanners:
            raise InputError(str(self._path), *self._nothing(found))
        if self._config.topic is None:
            return dict(sorted(found.scanners.items()))
        wanted = self._config.topic.split(",")
        for name in wanted:
            if name not in found.scanners:
                problem = f"found {name!r}, {self._path.name} has {', '.join(sorted(found.scanners))[:500]}"
                raise ConfigError("input.topic", problem, "name one of them")
        return {key: one for key, one in sorted(found.scanners.items()) if key in wanted}

    def _nothing(self, found: _Survey) -> tuple[str, str]:
        """Return why there is nothing to read, and what to do."""
        most = sorted(found.others.items(), key=lambda item: -item[1])[:5]
        shown = ", ".join(f"{n} of {size} bytes to port {port}" for (port, size), n in most) or "no datagram"
        end = f" ({found.count.end})" if found.count.end else ""
        problem = f"no packets of a known scanner{end}: {shown}, expected Velodyne, Ouster or Hesai XT"
        if self._metadata is not None:
            size = self._metadata.packet_size
            return f"{problem} (packets of {size} bytes, as the metadata say)", "check that the metadata belong to it"
        if any(port == _USUAL_OUSTER or size > 3000 for port, size in found.others):
            return problem, "packets of an Ouster need its metadata: give --metadata FILE.json"
        return problem, "capture the data port of the scanner"

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start."""
        scanners, record = self._survey.scanners, 0
        lines: dict[str, PacketLines] = {}
        for datagram in read_datagrams(self._path, CaptureCount()):
            if not is_scan(datagram.payload, self._metadata):
                continue
            key = _key(datagram)
            if key not in scanners:
                continue
            one = lines.get(key)
            if one is None:
                number = scanners[key].number
                where = self._where(key)
                one = lines[key] = PacketLines(where, number, datagram.payload, self._metadata, self._config)
            yield from one.add(datagram.payload, datagram.time_s, record)
            record += one.n_records
        for one in lines.values():
            yield from one.finish()
        self._lost = [f"{key}: {lost}" for key, one in lines.items() if (lost := one.lines.lost())]


def _key(datagram: Datagram) -> str:
    return f"{datagram.source}:{datagram.port}"


def find_metadata(path: Path, config: InputConfig) -> Metadata | None:
    """Return the metadata of an Ouster sensor: those named, else of the same name with ``.json``; None without."""
    if config.metadata is not None:
        return read_metadata(Path(config.metadata).expanduser())
    beside = path.with_suffix(".json")
    return read_metadata(beside) if beside.is_file() else None


def open_capture(path: Path, config: InputConfig, lines_at_once: int) -> PacketStream:
    """Open a capture, whose blocks are as long as its scans."""
    return PacketStream(path, config)
