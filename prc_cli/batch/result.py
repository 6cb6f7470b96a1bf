"""What a batch run is asked for, what it plans, what it tells on the way and what it found; values only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

from prc_cli.batch.types import Done, Event, Failed, Outcome, Problem, Shard, Task

Reason: TypeAlias = Literal[
    "new",
    "unfinished",
    "failed before",
    "input changed",
    "configuration changed",
    "program changed",
    "output missing",
]
"""Why a file is to be done."""

PASSING = frozenset({"killed", "memory", "timeout", "interrupted", "ChangedInputError", "OSError"})
"""Kinds of problems that may be gone when a file is tried again; a damaged file stays damaged."""


@dataclass(frozen=True, slots=True)
class ConfigLayers:
    """Where the configuration comes from; each over the one before."""

    path: Path | None = None
    """TOML file; beside the keys of every run it may hold ``[[override]]`` tables."""
    preset: str | None = None
    """Wins over every preset that the file names."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Nested table, laid over everything else."""
    files: tuple[Path, ...] = ()
    """Further files that were read for it, such as a layout."""


@dataclass(frozen=True, slots=True)
class BatchSettings:
    """What a batch run is asked for."""

    archive: Path
    """Folder of the inputs."""
    out: Path
    """Folder of the outputs."""
    config: ConfigLayers = field(default_factory=ConfigLayers)
    include: tuple[str, ...] = ()
    """Patterns of names that are taken; none: all that a reader takes."""
    exclude: tuple[str, ...] = ()
    """Patterns of names, and of whole folders, that are not."""
    since: str | None = None
    """Only inputs changed since then: a date, a duration such as 7d, or a file, whose time it is."""
    limit: int | None = None
    """At most so many files are classified."""
    only_failed: bool = False
    """Only files that the journal calls failed or unfinished."""
    shard: Shard | None = None
    to: str = "same"
    """Format of the outputs, see :data:`prc_cli.batch.discovery.FORMATS`."""
    jobs: int | None = None
    """Files at a time; default: one for every core."""
    threads: int | None = None
    """Threads a file; default: the cores shared among the jobs."""
    retry: int = 0
    """How often a file is tried again in this run where the problem may pass."""
    fail_fast: bool = False
    """After the first failure no more files are begun."""
    overwrite: bool = False
    """Outputs that no journal knows may be replaced."""
    adopt: bool = False
    """Outputs that no journal knows are taken as done where their record says that they are what would be written."""
    verify: bool = False
    """Compare the content of every input, not only size and time."""
    stall_s: float = 600.0
    """A file without progress for so long is given up [s]."""
    memory_limit_mib: int | None = None
    """Memory that a worker may take [MiB]."""
    dry_run: bool = False
    """Only plan; nothing is written."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Something in the archive that is not taken, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Planned:
    """A file that is to be classified."""

    task: Task
    reason: Reason
    size: int
    """Of the input [bytes]."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a plan will take."""

    seconds: float | None
    """Wall time [s]; None where nothing is known of any format in the plan."""
    peak_mib: float | None
    """Memory of all workers together [MiB]; None where nothing is known."""
    sources: tuple[str, ...]
    """Where the figures come from, a sentence a format."""
    n_unknown: int = 0
    """Files that are not in the figures, because nothing is known of their format."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What a run will do."""

    todo: tuple[Planned, ...]
    """In the order of names."""
    done: tuple[str, ...]
    """Names of files that are done already, with the same input, configuration and program."""
    adopted: tuple[Done, ...]
    """Outputs that no journal knew and that are what would be written."""
    refused: tuple[Failed, ...]
    """Files that cannot be begun."""
    left_out: tuple[LeftOut, ...]
    """Things in the archive that no run takes."""
    n_beyond_limit: int = 0
    """Files to do that a limit leaves for another run."""
    n_vanished: int = 0
    """Files that the journal knows and the archive does not hold any more (or does not select)."""

    @property
    def n_bytes(self) -> int:
        """Size of the inputs to do [bytes]."""
        return sum(item.size for item in self.todo)


@dataclass(frozen=True, slots=True)
class Noted:
    """Something about the run that the operator should know."""

    text: str


@dataclass(frozen=True, slots=True)
class Ready:
    """The plan stands."""

    plan: Plan
    estimate: Estimate | None
    """Of a dry run."""
    jobs: int
    threads: int


@dataclass(frozen=True, slots=True)
class Again:
    """A file that failed will be tried again in this run."""

    name: str
    problem: Problem


@dataclass(frozen=True, slots=True)
class Drifted:
    """The classes of a file are unlike those of the archive's earlier files."""

    name: str
    text: str


RunEvent: TypeAlias = Ready | Event | Again | Drifted | Noted
"""What a listener hears; a :class:`Failed` that is followed by :class:`Again` is not final."""

Listener: TypeAlias = Callable[[RunEvent], None]


@dataclass(frozen=True, slots=True)
class BatchResult:
    """What a run did."""

    settings: BatchSettings
    run: str
    """Id in the journal; empty for a dry run."""
    started: str
    """UTC, ISO 8601."""
    seconds: float
    """Wall time [s]."""
    jobs: int
    threads: int
    plan: Plan
    outcomes: tuple[Outcome, ...]
    """One for every file that was begun or refused, in the order of names, whatever the order they ended in."""
    n_retries: int = 0
    """Attempts after the first."""
    not_begun: tuple[str, ...] = ()
    """Names of planned files that were not begun."""
    drifted: tuple[Drifted, ...] = ()
    notes: tuple[str, ...] = ()
    estimate: Estimate | None = None
    interrupted: bool = False

    @property
    def done(self) -> tuple[Done, ...]:
        """Files that were classified."""
        return tuple(item for item in self.outcomes if isinstance(item, Done))

    @property
    def failed(self) -> tuple[Failed, ...]:
        """Files that were not."""
        return tuple(item for item in self.outcomes if isinstance(item, Failed))
