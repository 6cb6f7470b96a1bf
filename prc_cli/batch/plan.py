"""What a batch run will do with every file, and what that will take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from prc_cli.batch.summary import LeftOut
from prc_cli.batch.types import Done, Failed, Task

Reason: TypeAlias = Literal[
    "new", "unfinished", "failed before", "changed input", "changed config", "changed version", "output missing"
]
"""Why a file is to be done."""


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
