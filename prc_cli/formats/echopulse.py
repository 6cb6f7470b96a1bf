"""Reader of folders with one array a file.

``pulse-TYPE-NAME.bin`` per shot, ``echo-TYPE-NAME.bin`` per return.

``pulse-uint8-n_echo.bin`` counts the returns of every shot. A shot without return is a record
without range, all other records are returns, in firing order.
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

from prc_cli.core.errors import InputError
from prc_cli.core.facts import KnownRule, SourceFacts
from prc_cli.core.files import open_to_read
from prc_cli.core.types import I64
from prc_cli.formats.binary import read_numbers
from prc_cli.formats.options import LayoutField
from prc_cli.formats.records import Column, FieldSource, shorten
from prc_cli.formats.text.dialect import to_number

COUNT = "n_echo"
"""Array with the number of returns of every shot."""
CHUNK_PULSES = 1 << 17
"""Shots decoded at a time."""
MAX_ECHOES = 255
"""Most returns of a shot: chunks are bounded by it."""
_NAME = re.compile(
    r"(?P<part>pulse|echo)-(?P<type>(?:u?int|float)(?:8|16|32|64))-(?P<name>[A-Za-z0-9_]+)\.bin"
)
_TIME = re.compile(
    r"\s*(?P<n>\d{1,16}) entries (?P<start>\S{1,40}) \+ (?P<step>\S{1,40}) pulse_index\s*"
)
_MAX_TIME_BYTES = 4096
_STANDARD = {"theta": "angle", "amplitude": "intensity"}
_MADE = ("return_number", "number_of_returns", "pulse")
_COPY = "copy the folder from the archive again"


@dataclass(frozen=True, slots=True)
class _Array:
    """One file."""

    path: Path
    dtype: np.dtype[Any]
    is_echo: bool

    @classmethod
    def of(cls, path: Path) -> _Array | None:
        match = _NAME.fullmatch(path.name)
        if match is None:
            return None
        return cls(path, np.dtype(match["type"]).newbyteorder("<"), match["part"] == "echo")

    @property
    def name(self) -> str:
        name = self.path.stem.split("-", 2)[2]
        return _STANDARD.get(name, name)

    @property
    def n(self) -> int:
        size = self.path.stat().st_size
        if size % self.dtype.itemsize:
            problem = f"{size} bytes are no multiple of {self.dtype.itemsize}, as the name says"
            raise InputError(str(self.path), problem, "copy it from the archive again")
        return size // self.dtype.itemsize

    def read(self, handle: IO[bytes], n: int) -> NDArray[Any]:
        values = read_numbers(self.path, handle, self.dtype, n, 0)
        if len(values) < n:
            problem = f"the file ends {n - len(values)} values too early"
            raise InputError(
                str(self.path),
                problem,
                "it was cut while being read; wait until its writer is done",
            )
        return values


def count_file(path: Path) -> Path | None:
    """Return the file of a folder that counts the returns; None if there is none."""
    files = sorted(path.glob(f"pulse-*-{COUNT}.bin")) if path.is_dir() else [path]
    return next((file for file in files if is_count_file(file)), None)


def is_count_file(path: Path) -> bool:
    """Whether a file counts the returns of a folder of pulses."""
    array = _Array.of(path)
    return (
        array is not None and not array.is_echo and array.name == COUNT and array.dtype.kind in "iu"
    )


class EchoPulseSource(FieldSource):
    """Pulses and echoes as a :class:`prc_cli.formats.records.Source`."""

    def __init__(self, path: Path) -> None:
        count = _Array.of(path)
        if count is None:
            raise InputError(
                str(path),
                f"expected a name such as pulse-uint8-{COUNT}.bin",
                "name the file that counts the returns",
            )
        self._count = count
        folder = path.parent
        arrays = [_Array.of(file) for file in sorted(folder.iterdir())]
        self._arrays = {array.name: array for array in arrays if array is not None}
        self._n_pulses = count.n
        self._time = _read_time(folder / "time.txt", self._n_pulses)
        n_echoes = n_empty = 0
        for counts in self._counts():
            n_echoes += int(counts.sum())
            n_empty += int(np.count_nonzero(counts == 0))
        for array in self._arrays.values():
            wanted = n_echoes if array.is_echo else self._n_pulses
            what = "returns" if array.is_echo else "shots"
            if array.n != wanted:
                problem = f"{array.n} values, expected {wanted}: the {what} of {path.name}"
                raise InputError(str(array.path), problem, _COPY)
        if "range" not in self._arrays or not self._arrays["range"].is_echo:
            raise InputError(str(folder), "no file echo-TYPE-range.bin", "copy the folder again")
        self.n_records = n_echoes + n_empty
        names = (*self._arrays, *(["time"] if self._time is not None else []), *_MADE)
        items = {
            name: LayoutField(name=name, unit="rad" if name == "angle" else "") for name in names
        }
        columns = {name: Column(name, name, item) for name, item in items.items()}
        super().__init__(path, "pulses and echoes", columns, self)
        empty = f"{n_empty} shots have none and are records without range"
        rules = (
            KnownRule("columns", "angle", "every shot has its scan angle"),
            KnownRule("turn", "whole", "every shot is there"),
        )
        self.facts = SourceFacts(
            notes=(f"{self._n_pulses} shots with {n_echoes} returns; {empty}",),
            rules=rules if "angle" in self._arrays else (),
            header={
                "shots": self._n_pulses,
                "arrays": sorted(array.path.name for array in self._arrays.values()),
            },
            time_name="time.txt",
        )

    def stored(self, keys: tuple[str, ...]) -> Iterator[tuple[int, dict[str, NDArray[Any]], int]]:
        """Yield index of the first record, values by dimension, and number of records."""
        arrays = {key: self._arrays[key] for key in keys if key in self._arrays}
        with ExitStack() as stack:
            handles = {
                key: stack.enter_context(open_to_read(array.path)) for key, array in arrays.items()
            }
            first_record = first = 0
            for count in self._counts():
                n_echoes = int(count.sum())
                n_rows = np.maximum(count, 1)
                shot = np.repeat(np.arange(len(count)), n_rows)
                values: dict[str, NDArray[Any]] = {
                    "pulse": first + shot,
                    "return_number": np.arange(len(shot)) - (np.cumsum(n_rows) - n_rows)[shot] + 1,
                    "number_of_returns": n_rows[shot],
                }
                if self._time is not None:
                    start_s, step_s = self._time
                    values["time"] = (start_s + step_s * (first + np.arange(len(count))))[shot]
                for key, array in arrays.items():
                    if array.is_echo:
                        returns = array.read(handles[key], n_echoes)
                        # NaN for shots without a return
                        kind = returns.dtype if returns.dtype.kind == "f" else np.float64
                        values[key] = np.full(len(shot), np.nan, kind)
                        values[key][count[shot] > 0] = returns
                    else:
                        values[key] = array.read(handles[key], len(count))[shot]
                yield first_record, values, len(shot)
                first_record += len(shot)
                first += len(count)

    def _counts(self) -> Iterator[I64]:
        with open_to_read(self._count.path) as handle:
            for first in range(0, self._n_pulses, CHUNK_PULSES):
                count = self._count.read(handle, min(CHUNK_PULSES, self._n_pulses - first))
                wrong = np.flatnonzero((count < 0) | (count > MAX_ECHOES))
                if len(wrong):
                    shot = first + wrong[0]
                    n_returns = count[wrong[0]]
                    problem = f"shot {shot} has {n_returns} returns, expected 0 to {MAX_ECHOES}"
                    raise InputError(str(self._count.path), problem, _COPY)
                yield count.astype(np.int64)


def _read_time(path: Path, n_pulses: int) -> tuple[float, float] | None:
    """Return time of the first shot and time between shots [s]; None without such a file."""
    if not path.is_file():
        return None
    with open_to_read(path) as handle:
        text = handle.read(_MAX_TIME_BYTES).decode("utf-8", errors="replace")
    match = _TIME.fullmatch(text)
    start_s = None if match is None else to_number(match["start"])
    step_s = None if match is None else to_number(match["step"])
    if (
        match is None
        or start_s is None
        or step_s is None
        or not np.isfinite([start_s, step_s]).all()
        or step_s <= 0
    ):
        problem = f"found {shorten(text.strip())!r}, expected N entries START + STEP pulse_index"
        raise InputError(str(path), problem, "correct the file, or remove it to read without times")
    if int(match["n"]) != n_pulses:
        raise InputError(str(path), f"{match['n']} entries, but {n_pulses} shots", _COPY)
    return start_s, step_s
