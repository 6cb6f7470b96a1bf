"""Settings of a batch run; values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prc_cli.jobs.batch.reference import ReferenceSettings
from prc_cli.jobs.batch.types import Shard


@dataclass(frozen=True, slots=True)
class ConfigLayers:
    """Sources of the configuration; each overrides the one before."""

    path: Path | None = None
    """TOML file, which may contain ``[[override]]`` tables."""
    preset: str | None = None
    """Replaces every preset that the file names."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Nested table that overrides everything else."""
    files: tuple[Path, ...] = ()
    """Further files of the configuration, such as a layout."""


@dataclass(frozen=True, slots=True)
class BatchSettings:
    """Settings of a batch run."""

    archive: Path
    """Folder of the inputs."""
    out: Path
    """Folder of the outputs."""
    config: ConfigLayers = field(default_factory=ConfigLayers)
    include: tuple[str, ...] = ()
    """Patterns of names to include; none: every file with a readable format."""
    exclude: tuple[str, ...] = ()
    """Patterns of names and folders to exclude."""
    since: str | None = None
    """Only inputs changed since a date, for a duration such as 7d, or since the time of a file."""
    limit: int | None = None
    """Largest number of files to classify."""
    only_failed: bool = False
    """Only files that are failed or unfinished in the journal."""
    shard: Shard | None = None
    to: str = "same"
    """Output format, see :data:`prc_cli.jobs.batch.discovery.FORMATS`."""
    jobs: int | None = None
    """Files at a time; default: one per core."""
    threads: int | None = None
    """Threads per file; default: the cores divided by the jobs."""
    retry: int = 0
    """Further attempts at a file in this run if the problem may pass."""
    fail_fast: bool = False
    """Start no more files after the first failure."""
    overwrite: bool = False
    """Replace outputs that are in no journal."""
    adopt: bool = False
    """Count outputs that are in no journal as done if their run record equals the one that would be written."""
    verify: bool = False
    """Compare the content of every input, not only size and time."""
    stall_s: float = 600.0
    """A file is given up after this time without progress [s]."""
    memory_limit_mib: int | None = None
    """Memory limit of a worker [MiB]."""
    reference: ReferenceSettings | None = None
    """Reference to compare the outputs with, if any."""
    drift: bool = True
    """Raise an alarm for files whose class shares are far from those of earlier files."""
    keep_versions: tuple[str, ...] = ()
    """Outputs of these older versions of the program stay, whatever the configuration was, until the input changes."""
