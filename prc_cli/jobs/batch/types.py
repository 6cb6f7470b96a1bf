"""What a batch run is asked to do: its settings, and the task of every file.

Plain values, so that they can be sent to other processes.

The *name* of a file is its path relative to the archive with POSIX slashes. Bytes of a name that
are not UTF-8 become surrogates, as in :func:`os.fsdecode`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from prc_cli.config import LoadedConfig
from prc_cli.core.errors import ConfigError

OWN_FOLDER = ".prc"
"""Folder in the output tree for journal and lock."""


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several equal shares of an archive, each classified by its own run."""

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
    verify: bool = False
    stall_s: float = 600.0
    """A file fails after this time without progress [s]."""
    memory_limit_mib: int | None = None
    reference: ReferenceSettings | None = None
    drift: bool = True
