"""What a batch run is asked for; values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prc_cli.jobs.batch.reference import ReferenceSettings
from prc_cli.jobs.batch.types import Shard


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
    """Format of the outputs, see :data:`prc_cli.jobs.batch.discovery.FORMATS`."""
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
    reference: ReferenceSettings | None = None
    """What the outputs are compared with, if anything."""
    drift: bool = True
    """Whether a file whose classes are unlike those of earlier ones raises an alarm."""
    keep_versions: tuple[str, ...] = ()
    """Outputs of these older versions of the program stay, whatever the configuration was, until the input changes."""
