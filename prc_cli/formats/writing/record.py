"""The run record of an output: program, configuration, input and assumptions, as JSON.

Equal runs give equal bytes: sorted keys, no time stamps, no folders.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from prc_cli.core.brief import Brief
from prc_cli.core.errors import InputError
from prc_cli.core.files import read_small
from prc_cli.core.profile import stage, timed
from prc_cli.core.stream import Assumption, ReadTally
from prc_cli.core.version import __version__

PROGRAM = "prc-cli"
RECORD_SUFFIX = ".prc.json"
LARGEST_RECORD = 1 << 24
"""Largest run record that is read [bytes]."""
_READ_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ClassCount:
    """Number of records of an output with a code."""

    code: int
    """LAS class code."""
    name: str
    """Class name; ``class 12`` for codes unknown to this program."""
    count: int
    """Number of records (label files: entries)."""


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """Identity of a file."""

    name: str
    """File name, without its folder."""
    size: int
    """Size [bytes]."""
    sha256: str | None
    """SHA-256 of the content, hexadecimal; None if only a window of the file was read."""


@dataclass(frozen=True, slots=True, repr=False)
class RunRecord(Brief):
    """One run, stored in the output (VLR) and beside it (``<output>.prc.json``)."""

    config: Mapping[str, Any]
    """Effective configuration, nested tables."""
    input: Fingerprint
    """The file that was classified."""
    format: str
    """Reader name."""
    points_per_line: int
    """M, shots in a scan line."""
    n_lines: int | None = None
    """Scan lines read."""
    n_records: int | None = None
    """Records read; label files have as many entries if known."""
    n_missing: int | None = None
    """Shots without return."""
    trajectory: Fingerprint | None = None
    """The trajectory file; None if ranges do not need one."""
    assumptions: tuple[Assumption, ...] = ()
    """Assumptions of the reader."""
    tally: ReadTally = field(default_factory=ReadTally)
    """Counts of the reader."""
    classes: tuple[ClassCount, ...] = ()
    """Records by class code as written; filled in by the writer."""
    notices: tuple[str, ...] = ()
    """Notices on the input, and those of the writer."""
    engine: str = "compiled"
    """Form of the loops; written only if it is not ``compiled``."""
    output: Fingerprint | None = None
    """The finished output; only in the record beside it, because no file contains its own hash."""

    def as_dict(self) -> dict[str, Any]:
        """Return the record as nested plain values."""
        values = {
            "program": PROGRAM,
            "version": __version__,
            "config": _without_folders(self.config),
            "input": asdict(self.input),
            "trajectory": None if self.trajectory is None else asdict(self.trajectory),
            "format": self.format,
            "stream": {
                "points_per_line": self.points_per_line,
                "n_lines": self.n_lines,
                "n_records": self.n_records,
                "n_missing": self.n_missing,
            },
            "assumptions": [_without_folders(asdict(item)) for item in self.assumptions],
            "tally": asdict(self.tally),
            "classes": [asdict(item) for item in self.classes],
            "notices": list(self.notices),
        }
        if self.output is not None:
            values["output"] = {"size": self.output.size, "sha256": self.output.sha256}
        return values if self.engine == "compiled" else {**values, "engine": self.engine}

    def to_json(self) -> bytes:
        """Return the record as ASCII JSON, sorted keys, ending in a line feed."""
        return _dump(self.as_dict())

    def to_json_within(self, limit: int) -> bytes:
        """Return the record as JSON of at most ``limit`` bytes.

        In a record that is too long, SHA-256 and counts replace first the configuration, then
        assumptions and notices; ``complete`` names the file beside the output that has them. JSON
        is never cut.
        """
        complete = self.to_json()
        if len(complete) <= limit:
            return complete
        short = self.as_dict()
        short["complete"] = False
        for key in ("config", "assumptions", "notices"):
            value = short.pop(key)
            short[f"{key}_sha256"] = hashlib.sha256(_dump(value)).hexdigest()
            text = _dump(short)
            if len(text) <= limit:
                return text
        message = f"the run record takes {len(text)} bytes even in short form, limit {limit}"
        raise ValueError(message)


def dropped_of(record: Any) -> str:
    """Return the note of a run record on shots that ``prc thin`` left out; empty without one.

    >>> dropped_of({"program": PROGRAM, "notices": ["thinned: 3 of 9 returns were dropped"]})
    '3 of 9 returns were dropped'
    """
    if not isinstance(record, dict) or record.get("program") != PROGRAM:
        return ""
    notices = record.get("notices")
    for text in notices if isinstance(notices, list) else ():
        if not isinstance(text, str):
            continue
        # a file that was made of a thinned one has it as a doubt
        before, mark, note = text.partition("thinned: ")
        if mark and before in ("", "doubt ", "accepted doubt "):
            return note.partition(", expected")[0][:200]
    return ""


def read_record(output: Path) -> Any:
    """Return the run record beside an output, unchecked.

    Raises
    ------
    OSError, ValueError, RecursionError
        If it cannot be read.
    """
    return json.loads(read_small(record_path(output), LARGEST_RECORD))


def dense_line_beside(path: Path) -> int | None:
    """Return M if labels have a record for every cell, by the run record beside them."""
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        record = read_record(path)
        stream = record["stream"]
        tally = record["tally"]
        inputs = record["config"]["input"]
        m = stream["points_per_line"]
        is_part = bool({"only_lines", "only_time"} & set(inputs))
        has_others = any(tally[name] for name in ("n_collisions", "n_extra_returns", "n_unplaced"))
        is_dense = m * stream["n_lines"] == stream["n_records"] and m
        if record["program"] == PROGRAM and is_dense and not is_part and not has_others:
            return int(m)
    return None


def reading_beside(path: Path) -> dict[str, Any]:
    """Return the configuration of the input in the run record beside labels; empty without one."""
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        record = read_record(path)
        if record["program"] == PROGRAM:
            return {
                name: record["config"][name]
                for name in ("input", "layout")
                if record["config"].get(name)
            }
    return {}


def dropped_beside(path: Path) -> str:
    """Return :func:`dropped_of` for the run record beside a file."""
    with suppress(OSError, ValueError, RecursionError):
        return dropped_of(read_record(path))
    return ""


def record_path(output: Path) -> Path:
    """Return the name of the JSON beside an output.

    >>> record_path(Path("drive_classified.laz")).name
    'drive_classified.laz.prc.json'
    """
    return output.with_name(output.name + RECORD_SUFFIX)


def fingerprint(path: Path, *, hashes: bool = True) -> Fingerprint:
    """Return name, size and, if ``hashes``, SHA-256 of a file, which is read in pieces."""
    with FingerprintBeside(path, threads=1, hashes=hashes) as beside:
        return beside.result()


class FingerprintBeside:
    """Computes a fingerprint in a thread while the file is read, so that it comes from disk once.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "a.bin"
    >>> _ = path.write_bytes(b"abc")
    >>> with FingerprintBeside(path, threads=2) as beside:
    ...     beside.result() == fingerprint(path)
    True
    """

    def __init__(self, path: Path, *, threads: int, hashes: bool = True) -> None:
        self._path = path
        self._hashes = hashes
        self._stop = threading.Event()
        self._pool = ThreadPoolExecutor(1, "fingerprint") if threads > 1 else None
        self._future: Future[Fingerprint | None] | None = None

    def __enter__(self) -> FingerprintBeside:
        if self._pool is not None:
            self._future = self._pool.submit(self._read)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._pool is not None:
            self._pool.shutdown()

    def result(self) -> Fingerprint:
        """Wait for the fingerprint."""
        with timed("waiting for the fingerprint"):
            result = self._read() if self._future is None else self._future.result()
        assert result is not None
        return result

    @stage("fingerprint")
    def _read(self) -> Fingerprint | None:
        if not self._hashes:
            return Fingerprint(self._path.name, self._path.stat().st_size, None)
        digest = hashlib.sha256()
        size = 0
        piece = memoryview(bytearray(_READ_BYTES))
        try:
            with self._path.open("rb", buffering=0) as handle:
                while not self._stop.is_set() and (n := handle.readinto(piece)):
                    digest.update(piece[:n])
                    size += n
        except OSError as error:
            problem = f"cannot be read ({error.strerror or error})"
            raise InputError(
                str(self._path), problem, "check that the file exists and its permissions"
            ) from error
        return (
            None if self._stop.is_set() else Fingerprint(self._path.name, size, digest.hexdigest())
        )


def _dump(value: Any) -> bytes:
    return (
        json.dumps(value, sort_keys=True, indent=1, ensure_ascii=True, allow_nan=False) + "\n"
    ).encode("ascii")


def _without_folders(value: Any) -> Any:
    """Replace absolute paths by file names: records must not differ by machine."""
    if isinstance(value, Mapping):
        return {str(key): _without_folders(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_folders(item) for item in value]
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, str):
        head, separator, tail = value.partition(":")
        for prefix, path in (("", value), (head + separator, tail)):
            for kind in (PurePosixPath, PureWindowsPath):
                if path and kind(path).is_absolute():
                    return prefix + kind(path).name
    return value
