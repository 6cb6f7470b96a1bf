"""What runs the tasks of a batch: the interface of an engine, and the events that it yields."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias

from prc_cli.jobs.batch.outcomes import Done, Failed, Problem
from prc_cli.jobs.batch.types import Task

if TYPE_CHECKING:
    from prc_cli.evaluation.confusion import ConfusionMatrix
    from prc_cli.evaluation.mapping import ClassMapping
    from prc_cli.jobs.evaluate.options import EvaluateOptions


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Settings of an engine. They do not change the outputs."""

    jobs: int = 1
    threads: int = 1
    stall_s: float = 600.0
    """A file fails after this time without progress [s]."""
    memory_limit_mib: int | None = None


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


class Engine(Protocol):
    """Runs the tasks."""

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        """Run tasks; an error in one does not stop the others.

        Closing the iterator stops all workers within seconds.
        """
        ...


def failures(task: Task | Comparison, seconds: float, problem: Problem) -> Iterator[Failed]:
    """Yield a failure of every file of a task, all for one reason."""
    for name in task.names:
        yield Failed(name, None, seconds, problem)
