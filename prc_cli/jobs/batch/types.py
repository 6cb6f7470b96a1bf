"""Data types shared by the parts of a batch run.

Plain values, so that they can be sent to other processes.

The *name* of a file is its path relative to the archive with POSIX slashes. Bytes of a name that
are not UTF-8 become surrogates, as in :func:`os.fsdecode`. Sizes are in bytes, times of files in
nanoseconds since 1970, durations in seconds of wall time. Hashes are SHA-256 in hexadecimal,
moments are UTC in ISO 8601.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

from prc_cli.config import LoadedConfig
from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.findings import doubt_of

if TYPE_CHECKING:
    from prc_cli.evaluation.confusion import ConfusionMatrix
    from prc_cli.evaluation.mapping import ClassMapping
    from prc_cli.jobs.evaluate.options import EvaluateOptions

OWN_FOLDER = ".prc"
"""Folder in the output tree for journal and lock."""

State: TypeAlias = Literal["running", "done", "failed"]
"""State of a file in the journal.

``running`` without a living run means that the run was stopped or killed.
"""


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several equal parts of an archive, each classified by its own run."""

    index: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.index <= self.count:
            problem = f"{self.index}/{self.count}, expected a part from 1 to the number of parts"
            raise ConfigError("--shard", problem, "for example 3/8, the third of eight parts")

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse ``i/n``.

        >>> Shard.parse("3/8")
        Shard(index=3, count=8)
        """
        match = re.fullmatch(r"\s*([0-9]{1,9})\s*/\s*([0-9]{1,9})\s*", text)
        if match is None:
            problem = f"{text!r}, expected i/n"
            raise ConfigError("--shard", problem, "for example 3/8, the third of eight parts")
        return cls(int(match[1]), int(match[2]))

    def holds(self, name: str) -> bool:
        """Check whether a file belongs to this shard; the same on every machine and version."""
        number = int.from_bytes(sha256(os.fsencode(name)).digest()[:8], "big")
        return number % self.count == self.index - 1

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"


def own_name(stem: str, shard: Shard | None, suffix: str) -> str:
    """Return the name of a file that every shard has for itself: shards run at the same time.

    >>> own_name("journal", Shard(3, 8), ".sqlite"), own_name("lock", None, ".json")
    ('journal.3-of-8.sqlite', 'lock.json')
    """
    return f"{stem}{suffix}" if shard is None else f"{stem}.{shard.index}-of-{shard.count}{suffix}"


@dataclass(frozen=True, slots=True)
class Task:
    """One file to classify."""

    name: str
    source: Path
    output: Path
    config: LoadedConfig
    config_sha256: str
    """Hash of the effective configuration, including the fingerprints of the files it names."""
    overwrite: bool = False
    """Whether the output may be replaced: the journal lists it, or the user allows it."""
    drive: tuple[str, ...] = ()
    """Names of the files of its drive, in order; empty for a file by itself."""
    others: tuple[Task, ...] = ()
    """The later files of its drive, which are classified with it as one stream."""

    @property
    def files(self) -> tuple[Task, ...]:
        """All files that are classified together, this one first."""
        return (self, *self.others)

    @property
    def drive_files(self) -> list[str]:
        """Names of the files of its drive without their folder, as run records have them."""
        return [name.rpartition("/")[2] for name in self.drive]

    @property
    def names(self) -> list[str]:
        """Names of all files that are classified together."""
        return [task.name for task in self.files]


@dataclass(frozen=True, slots=True)
class InputPrint:
    """Size, time and hash of an input, to detect that it changed."""

    size: int
    mtime_ns: int
    sha256: str | None
    """Hash of the content, hexadecimal; None if the file was not read to its end."""


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


@dataclass(frozen=True, slots=True)
class Failed:
    """A file that could not be classified; this attempt left no output."""

    name: str
    input: InputPrint | None
    """None if not even the size of the file could be read."""
    seconds: float
    problem: Problem


Outcome: TypeAlias = Done | Failed


@dataclass(frozen=True, slots=True)
class Started:
    """A worker has started a file."""

    name: str
    worker: str


@dataclass(frozen=True, slots=True)
class Progress:
    """A worker has finished some more scan lines of a file."""

    name: str
    n_lines: int
    """Scan lines since the last such event."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """An output to compare with its reference."""

    name: str
    predicted: Path
    reference: Path
    shown: str
    """Path of the reference in its tree."""
    mapping: ClassMapping
    options: EvaluateOptions

    @property
    def names(self) -> list[str]:
        """The name of the output, in a list."""
        return [self.name]


def failed(task: Task | Comparison, seconds: float, problem: Problem) -> Iterator[Failed]:
    """Yield a failure of every file of a task, all for one reason."""
    for name in task.names:
        yield Failed(name, None, seconds, problem)


@dataclass(frozen=True, slots=True)
class Compared:
    """One output and its reference."""

    name: str
    reference: str | None
    """File of reference classes, its path in the tree; None if there is none."""
    matrix: ConfusionMatrix | None
    """None if it could not be compared."""
    problem: Problem | None = None


Event: TypeAlias = Started | Progress | Done | Failed | Compared


@dataclass(frozen=True, slots=True)
class Entry:
    """Journal entry of one file."""

    name: str
    state: State
    config_sha256: str
    version: str
    run: str
    attempts: int
    """Number of attempts since the file was last done, including the current one."""
    started: str
    finished: str | None
    """None while running."""
    owner: str
    outcome: Outcome | None
    """Outcome of the last attempt that ended; a later attempt may have been cut off."""
    owns_output: bool = True
    """Whether a worker of this program was sent to write the output; False for refused files."""
    source: str = ""
    """Real path of the input of the output; empty in journals of versions before 1.2."""


@dataclass(frozen=True, slots=True)
class Run:
    """Journal entry of one run."""

    id: str
    shard: str
    """``i/n``; empty for the whole archive."""
    version: str
    owner: str
    started: str
    finished: str | None
    """None for a run that is running or was killed."""
    exit_code: int | None
    totals: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True)
class Alarm:
    """A file whose classes are unlike those of earlier ones."""

    name: str
    sentence: str
    """What is unusual, with the class and both shares."""


@dataclass(frozen=True, slots=True)
class Doubted:
    """A doubt about a file whose labels are written, see :mod:`prc_cli.core.findings`."""

    name: str
    check: str
    """Name of the check, as for ``--accept-doubt``."""
    sentence: str
    """The check, what was found, what was expected, what to do."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A file or folder of the archive that prc does not read, although the user might expect it."""

    name: str
    reason: str


def doubts_of(file: Done | Entry) -> tuple[Doubted, ...]:
    """Return the doubts in the run record of a finished file; none for other entries."""
    outcome = file.outcome if isinstance(file, Entry) else file
    if not isinstance(outcome, Done) or (isinstance(file, Entry) and file.state != "done"):
        return ()
    doubts = (doubt_of(notice) for notice in outcome.notices)
    return tuple(Doubted(file.name, *doubt) for doubt in doubts if doubt is not None)


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Settings of an engine. They do not change the outputs."""

    jobs: int = 1
    threads: int = 1
    stall_s: float = 600.0
    """A file fails after this time without progress [s]."""
    memory_limit_mib: int | None = None


class Engine(Protocol):
    """Runs the tasks."""

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        """Run tasks; an error in one does not stop the others.

        Closing the iterator stops all workers within seconds.
        """
        ...


@dataclass(frozen=True, slots=True)
class ReferenceSettings:
    """The reference of a run and the scores to reach."""

    tree: Path
    """Folder of reference classes that mirrors the archive.

    Its files have the names of the inputs, with any suffix.
    """
    mapping_name: str | None = None
    """Preset or file of the class mapping.

    None = the mapping of the method in the run records of the outputs, as in ``prc evaluate``.
    """
    match: str = "order"
    """How records find their partner, as ``prc evaluate --match``."""
    gates: tuple[str, ...] = ()
    """Scores that all files together must reach, such as ``recall.ground=0.95``."""


@dataclass(frozen=True, slots=True)
class ConfigLayers:
    """Sources of the configuration; each overrides the one before."""

    path: Path | None = None
    """TOML file, which may contain ``[[override]]`` tables."""
    preset: str | None = None
    """Replaces the presets of the file."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Nested table that overrides everything else."""
    files: tuple[Path, ...] = ()
    """Further files of the configuration, such as a layout."""


@dataclass(frozen=True, slots=True)
class BatchSettings:
    """Settings of a batch run, as the options of ``prc batch`` of the same names."""

    archive: Path
    out: Path
    config: ConfigLayers = field(default_factory=ConfigLayers)
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    since: str | None = None
    drives: tuple[str, ...] = ()
    """Patterns of the files of drives, see :class:`prc_cli.jobs.batch.discovery.Drives`."""
    limit: int | None = None
    only_failed: bool = False
    shard: Shard | None = None
    to: str = "same"
    """Output format, see :data:`prc_cli.jobs.drive.FORMATS`."""
    jobs: int | None = None
    threads: int | None = None
    retry: int = 0
    fail_fast: bool = False
    overwrite: bool = False
    adopt: bool = False
    verify: bool = False
    stall_s: float = 600.0
    """A file fails after this time without progress [s]."""
    memory_limit_mib: int | None = None
    reference: ReferenceSettings | None = None
    drift: bool = True
    keep_versions: tuple[str, ...] = ()
