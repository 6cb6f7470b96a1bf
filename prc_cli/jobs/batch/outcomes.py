"""How a file ended: what the worker reports, the journal stores and ``summary.json`` shows.

Plain values. Sizes are in bytes, times of files in nanoseconds since 1970, durations in seconds of
wall time. Hashes are SHA-256 in hexadecimal.
"""

from __future__ import annotations

import builtins
import contextlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias

from prc_cli.core.errors import PrcError
from prc_cli.core.files import is_same, parts_of, remove_unfinished
from prc_cli.core.findings import doubt_of
from prc_cli.formats.writing.record import RunRecord, fingerprint, read_record, record_path
from prc_cli.jobs.batch.types import Task
from prc_cli.jobs.choice import possible_configs
from prc_cli.jobs.drive import is_of_drive

MEMORY = "memory"
CHANGED = "changed"
VANISHED = "vanished"
"""Kinds of problems that the content of the file does not cause."""
_PASSING = frozenset({"killed", "timeout", "interrupted", "OutputError", MEMORY, CHANGED, VANISHED})


@dataclass(frozen=True, slots=True)
class InputPrint:
    """Size, time and hash of an input, to detect that it changed."""

    size: int
    mtime_ns: int
    sha256: str | None
    """Hash of the content, hexadecimal; None if the file was not read to its end."""

    @classmethod
    def of(cls, path: Path) -> InputPrint:
        """Return size and time of a file, which is not read."""
        status = path.stat()
        return cls(status.st_size, status.st_mtime_ns, None)


@dataclass(frozen=True, slots=True)
class Problem:
    """Why a file failed."""

    kind: str
    """Name of the exception, or ``killed``, ``timeout``, ``memory``, ``interrupted``."""
    where: str
    problem: str
    hint: str = ""

    @classmethod
    def of(cls, error: BaseException) -> Problem:
        """Return the problem that an exception describes."""
        if isinstance(error, PrcError):
            return cls(type(error).__name__, error.where, error.problem, error.hint)
        return cls(type(error).__name__, "", str(error) or type(error).__name__)

    def __str__(self) -> str:
        text = f"{self.where}: {self.problem}" if self.where else self.problem
        return text + (f"; {self.hint}" if self.hint else "")

    @property
    def may_pass(self) -> bool:
        """Whether another attempt may help: not for damaged files and wrong configurations.

        >>> Problem("killed", "a.laz", "").may_pass, Problem("InputError", "a.laz", "").may_pass
        (True, False)
        """
        if self.kind in _PASSING:
            return True
        exception = getattr(builtins, self.kind, object) if self.kind.isidentifier() else object
        return issubclass(exception, OSError)


@dataclass(frozen=True, slots=True)
class Doubted:
    """A doubt about a file whose labels are written, see :mod:`prc_cli.core.findings`."""

    name: str
    check: str
    """Name of the check, as for ``--accept-doubt``."""
    sentence: str
    """The check, what was found, what was expected, what to do."""


@dataclass(frozen=True, slots=True)
class Done:
    """A classified file; its output has its final name."""

    name: str
    input: InputPrint
    output_size: int
    output_mtime_ns: int
    seconds: float
    cpu_seconds: float
    peak_mib: float | None
    """Highest resident memory of the worker so far [MiB]; None if unknown."""
    n_lines: int
    n_shots: int
    """Shots, with and without return."""
    n_records: int
    labels: tuple[tuple[str, int], ...]
    """Records by label name."""
    notices: tuple[str, ...] = ()
    """Unusual properties of the input."""
    output_name: str = ""
    """Name of the output, in the folder of the same name as that of the input."""
    output_sha256: str | None = None

    @classmethod
    def of(
        cls,
        task: Task,
        record: Mapping[str, Any],
        input_mtime_ns: int,
        output_mtime_ns: int,
        *,
        n_shots: int,
        labels: tuple[tuple[str, int], ...],
        seconds: float = 0.0,
        cpu_seconds: float = 0.0,
        peak_mib: float | None = None,
    ) -> Done:
        """Return the outcome of a task by the run record of its output, as plain values."""
        stream = record["stream"]
        return cls(
            name=task.name,
            input=InputPrint(
                int(record["input"]["size"]), input_mtime_ns, record["input"]["sha256"]
            ),
            output_size=int(record["output"]["size"]),
            output_mtime_ns=output_mtime_ns,
            seconds=seconds,
            cpu_seconds=cpu_seconds,
            peak_mib=peak_mib,
            n_lines=int(stream["n_lines"]),
            n_shots=n_shots,
            n_records=int(stream["n_records"] or 0),
            labels=labels,
            notices=tuple(str(notice) for notice in record["notices"]),
            output_name=task.output.name,
            output_sha256=str(record["output"]["sha256"]),
        )

    @property
    def doubts(self) -> tuple[Doubted, ...]:
        """The doubts in the run record."""
        doubts = (doubt_of(notice) for notice in self.notices)
        return tuple(Doubted(self.name, *doubt) for doubt in doubts if doubt is not None)

    def as_dict(self) -> dict[str, Any]:
        """Return the file as ``summary.json`` shows it."""
        return {
            "name": self.name,
            "input": asdict(self.input),
            "output": self.output_name,
            "output_size": self.output_size,
            "output_sha256": self.output_sha256,
            "seconds": round(self.seconds, 3),
            "cpu_seconds": round(self.cpu_seconds, 3),
            "peak_mib": None if self.peak_mib is None else round(self.peak_mib, 1),
            "lines": self.n_lines,
            "shots": self.n_shots,
            "records": self.n_records,
            "labels": dict(self.labels),
            "notices": list(self.notices),
        }


@dataclass(frozen=True, slots=True)
class Failed:
    """A file that could not be classified; this attempt left no output."""

    name: str
    input: InputPrint | None
    """None if not even the size of the file could be read."""
    seconds: float
    problem: Problem

    def as_dict(self) -> dict[str, Any]:
        """Return the file as ``summary.json`` shows it."""
        return {"name": self.name, "seconds": round(self.seconds, 3), **asdict(self.problem)}


Outcome: TypeAlias = Done | Failed


# -- in the journal --------------------------------------------------------------------------------

_NUMBERS = (
    "size",
    "mtime_ns",
    "output_size",
    "output_mtime_ns",
    "seconds",
    "cpu_seconds",
    "n_lines",
    "n_shots",
    "n_records",
)
_TEXTS = ("kind", "where", "hint", "output_name")


def to_json(outcome: Outcome) -> str:
    """Return an outcome as JSON with all its fields."""
    return json.dumps(asdict(outcome))


def from_json(text: str) -> Outcome:
    """Return an outcome from its JSON.

    Raises
    ------
    ValueError, TypeError, KeyError, AttributeError, RecursionError
        If it is not that of an outcome.
    """
    table = json.loads(text, object_hook=_check_types)
    input_print = None if table["input"] is None else InputPrint(**table["input"])
    if "problem" in table:
        return Failed(table["name"], input_print, table["seconds"], Problem(**table["problem"]))
    labels = tuple((str(label), int(count)) for label, count in table["labels"])
    notices = tuple(map(str, table["notices"]))
    return Done(**table | {"input": input_print, "labels": labels, "notices": notices})


def _check_types(table: dict[str, Any]) -> dict[str, Any]:
    numbers = [table[key] for key in _NUMBERS if key in table]
    texts = [table[key] for key in _TEXTS if key in table]
    check_type((int, float), *numbers)
    check_type(str, *texts)
    return table


def check_type(kind: type | tuple[type, ...], *values: Any) -> None:
    """Refuse values of another type with a ``ValueError``: a damaged journal may hold any."""
    for value in values:
        if not isinstance(value, kind):
            message = f"found {str(value)[:40]!r}"
            raise ValueError(message)


# -- outputs that earlier processes left -----------------------------------------------------------


def recorded_outcome(task: Task, before: InputPrint, written: os.stat_result) -> Done | None:
    """Return the outcome of an existing output whose record equals the one of this run.

    The list of accepted doubts may differ. None = no record, another one, or a damaged one.
    """
    try:
        record = read_record(task.output)
        trajectory = None if task.config.trajectory is None else fingerprint(task.config.trajectory)
        content = fingerprint(task.source)
        records = [
            RunRecord(config.of_run(), content, "", 1, trajectory=trajectory).as_dict()
            for config in possible_configs(task.config)
        ]
        for table in (record, *records):
            table["config"].get("input", {}).pop("accept_doubts", None)
        keys = ("program", "version", "config", "input", "trajectory")
        if not any(all(record[key] == table[key] for key in keys) for table in records):
            return None
        if not is_of_drive(record["notices"], task.drive_files):
            return None
        stream = record["stream"]
        labels = [(str(count["name"]), int(count["count"])) for count in record["classes"]]
        return Done.of(
            task,
            record,
            before.mtime_ns,
            written.st_mtime_ns,
            n_shots=int(stream["n_lines"]) * int(stream["points_per_line"]),
            labels=(("missing", int(stream["n_missing"])), *labels),
        )
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        RecursionError,
        OverflowError,
    ):
        return None


def is_whole(output: Path, written: os.stat_result, done: Done) -> bool:
    """Check whether an output has the recorded size and content; reads it."""
    return written.st_size == done.output_size and fingerprint(output).sha256 == done.output_sha256


def remove_unplaced(task: Task) -> bool:
    """Remove an output that still has its temporary name, too; return whether there was one.

    Its process died just before it was finished (:func:`prc_cli.core.files.place_all`).
    """
    was_unfinished = False
    for path in (record_path(task.output), task.output):
        with contextlib.suppress(OSError):
            for temporary in tuple(parts_of(path)):
                if is_same(temporary, path):
                    path.unlink()
                    temporary.unlink()
                    was_unfinished = True
    return was_unfinished


def remove_left(task: Task) -> None:
    """Remove the temporary files of a task whose worker died."""
    outputs = [path for file in task.files for path in (file.output, record_path(file.output))]
    with contextlib.suppress(OSError):
        remove_unfinished(*outputs, keeps_whole=True)
