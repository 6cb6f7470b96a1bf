"""Reader of folders with one array a file: ``pulse-TYPE-NAME.bin`` per shot, ``echo-TYPE-NAME.bin`` per return.

``pulse-uint8-n_echo.bin`` counts the returns of every shot. A shot without return is a record without range, all other
records are returns, in firing order.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import KnownRule, SourceFacts
from prc_cli.core.files import open_to_read
from prc_cli.core.types import I64
from prc_cli.formats.options import LayoutField, decode
from prc_cli.formats.records import RecordChunk, shorten, standard_first
from prc_cli.formats.text.dialect import to_number

COUNT = "n_echo"
"""Array with the number of returns of every shot."""
CHUNK_PULSES = 1 << 17
"""Shots decoded at a time."""
MAX_ECHOES = 255
"""Most returns of a shot: chunks are bounded by it."""
_NAME = re.compile(r"(?P<part>pulse|echo)-(?P<type>(?:u?int|float)(?:8|16|32|64))-(?P<name>[A-Za-z0-9_]+)\.bin")
_TIME = re.compile(r"\s*(?P<n>\d{1,16}) entries (?P<start>\S{1,40}) \+ (?P<step>\S{1,40}) pulse_index\s*")
_MAX_TIME_BYTES = 4096
_STANDARD = {"theta": "angle", "amplitude": "intensity", "range": "range"}
_MADE = ("return_number", "number_of_returns", "pulse")


@dataclass(frozen=True, slots=True)
class _Array:
    """One file."""

    path: Path
    dtype: np.dtype[Any]
    is_echo: bool
    item: LayoutField

    @property
    def n(self) -> int:
        size = self.path.stat().st_size
        if size % self.dtype.itemsize:
            problem = f"{size} bytes are no multiple of {self.dtype.itemsize}, as the name says"
            raise InputError(str(self.path), problem, "copy it from the archive again")
        return size // self.dtype.itemsize


def count_file(path: Path) -> Path | None:
    """Return the file that counts the returns, which stands for the folder; None if it is no such folder."""
    if not path.is_dir():
        return path if is_count_file(path) else None
    found = sorted(each for each in path.glob(f"pulse-*-{COUNT}.bin") if is_count_file(each))
    return found[0] if found else None


def is_count_file(path: Path) -> bool:
    """Tell whether a file counts the returns of such a folder."""
    match = _NAME.fullmatch(path.name)
    return match is not None and match["part"] == "pulse" and match["name"] == COUNT and "int" in match["type"]


class EchoPulseSource:
    """Pulses and echoes as a :class:`prc_cli.formats.records.RecordSource`."""

    format = "pulses and echoes"
    """Reader name, for messages and ``prc info``."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        """File name, for messages."""
        self._folder = path.parent
        found = [_NAME.fullmatch(each.name) for each in sorted(self._folder.iterdir())]
        self._arrays = {_own_name(match): _array(self._folder, match) for match in found if match is not None}
        match = _NAME.fullmatch(path.name)
        if match is None:
            problem = f"expected a name such as pulse-uint8-{COUNT}.bin"
            raise InputError(str(path), problem, "name the file that counts")
        self._count = _array(self._folder, match)
        self._n_pulses = self._count.n
        self._time = self._read_time()
        n_echoes, n_empty = self._totals()
        for array in self._arrays.values():
            wanted = n_echoes if array.is_echo else self._n_pulses
            if array.n != wanted:
                what = "returns" if array.is_echo else "shots"
                problem = f"holds {array.n} values, expected {wanted}, the {what} of {path.name}"
                raise InputError(str(array.path), problem, "copy the folder from the archive again")
        if "range" not in self._arrays or not self._arrays["range"].is_echo:
            raise InputError(str(self._folder), "no file echo-TYPE-range.bin", "copy the folder again")
        self.n_records = n_echoes + n_empty
        """Number of records: returns, and shots without one."""
        note = (
            f"{self._n_pulses} shots with {n_echoes} returns; {n_empty} shots have none and are records without range"
        )
        rules = (
            KnownRule("columns", "angle", "every shot has its scan angle"),
            KnownRule("turn", "whole", "every shot is there"),
        )
        self.facts = SourceFacts(
            notes=(note,), rules=rules if "angle" in self._arrays else (), describe=self.describe, time_name="time.txt"
        )
        """Metadata of the folder."""

    def describe(self) -> dict[str, Any]:
        """Return the arrays as plain values for JSON, for ``prc info``."""
        return {"shots": self._n_pulses, "arrays": sorted(array.path.name for array in self._arrays.values())}

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver, standard names first."""
        names = [*self._arrays, *(["time"] if self._time is not None else []), *_MADE]
        return standard_first(names)

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named arrays in bounded memory, in firing order."""
        unknown = [name for name in names if name not in self.dimensions]
        if unknown:
            problem = f"no dimension {unknown[0]!r} in the folder"
            raise ConfigError(self.path, problem, f"it has: {', '.join(self.dimensions)}")
        with ExitStack() as stack:
            handles = {
                name: stack.enter_context(open_to_read(self._arrays[name].path))
                for name in names
                if name in self._arrays
            }
            counting = stack.enter_context(open_to_read(self._count.path))
            first_record = 0
            for first in range(0, self._n_pulses, CHUNK_PULSES):
                count = _read(counting, self._count, min(CHUNK_PULSES, self._n_pulses - first)).astype(np.int64)
                chunk = self._chunk(names, handles, count, first, first_record)
                first_record += chunk.n
                yield chunk

    def _chunk(
        self, names: tuple[str, ...], handles: dict[str, IO[bytes]], count: I64, first: int, first_record: int
    ) -> RecordChunk:
        rows = np.maximum(count, 1)
        shot = np.repeat(np.arange(len(count)), rows)
        start = np.cumsum(rows) - rows
        ordinal = np.arange(len(shot)) - start[shot]
        has_return = count[shot] > 0
        values: dict[str, NDArray[Any]] = {}
        for name in names:
            if name == "time":
                assert self._time is not None
                values[name] = (self._time[0] + self._time[1] * (first + np.arange(len(count))))[shot]
            elif name == "pulse":
                values[name] = first + shot
            elif name == "return_number":
                values[name] = ordinal + 1
            elif name == "number_of_returns":
                values[name] = rows[shot]
            else:
                array = self._arrays[name]
                stored = _read(handles[name], array, int(count.sum()) if array.is_echo else len(count))
                found = decode(stored, array.item)
                values[name] = _spread(found, has_return) if array.is_echo else found[shot]
        return RecordChunk(first_record, values, len(shot))

    def _totals(self) -> tuple[int, int]:
        """Return the number of returns, and of shots without one."""
        n_echoes = n_empty = 0
        with open_to_read(self._count.path) as handle:
            for first in range(0, self._n_pulses, CHUNK_PULSES):
                count = _read(handle, self._count, min(CHUNK_PULSES, self._n_pulses - first))
                if count.min() < 0 or count.max() > MAX_ECHOES:
                    at = int(np.argmax((count < 0) | (count > MAX_ECHOES)))
                    problem = f"shot {first + at} has {count[at]} returns, expected 0 to {MAX_ECHOES}"
                    raise InputError(self.path, problem, "copy the folder from the archive again")
                n_echoes += int(count.sum(dtype=np.int64))
                n_empty += int(np.count_nonzero(count == 0))
        return n_echoes, n_empty

    def _read_time(self) -> tuple[float, float] | None:
        """Return time of the first shot and time between shots [s], from ``time.txt``."""
        path = self._folder / "time.txt"
        if not path.is_file():
            return None
        with open_to_read(path) as handle:
            text = handle.read(_MAX_TIME_BYTES).decode("utf-8", errors="replace")
        match = _TIME.fullmatch(text)
        start, step = (None, None) if match is None else (to_number(match["start"]), to_number(match["step"]))
        if match is None or start is None or step is None or not np.isfinite([start, step]).all() or step <= 0:
            problem = f"found {shorten(text.strip())!r}, expected N entries START + STEP pulse_index"
            raise InputError(str(path), problem, "correct it, or take it away: then there are no times")
        if int(match["n"]) != self._n_pulses:
            problem = f"{match['n']} entries, but {self._n_pulses} shots"
            raise InputError(str(path), problem, "copy the folder from the archive again")
        return start, step


def _own_name(match: re.Match[str]) -> str:
    return _STANDARD.get(match["name"], match["name"])


def _array(folder: Path, match: re.Match[str]) -> _Array:
    name = _own_name(match)
    item = LayoutField.model_validate({"name": name, "unit": "rad" if name == "angle" else ""})
    return _Array(folder / match.string, np.dtype(match["type"]).newbyteorder("<"), match["part"] == "echo", item)


def _read(handle: IO[bytes], array: _Array, n: int) -> NDArray[Any]:
    found = np.fromfile(handle, array.dtype, n)
    if len(found) < n:
        problem = f"the file ends {n - len(found)} values too early"
        raise InputError(str(array.path), problem, "it was cut while being read; wait until its writer is done")
    return found


def _spread(values: NDArray[Any], has_return: NDArray[np.bool_]) -> NDArray[Any]:
    """Return values of returns for all records; NaN for shots without one."""
    kind = values.dtype if values.dtype.kind == "f" else np.dtype(np.float64)
    out: NDArray[Any] = np.full(len(has_return), np.nan, kind)
    out[has_return] = values
    return out
