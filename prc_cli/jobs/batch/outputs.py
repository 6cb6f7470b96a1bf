"""The contents of an output folder: files that dead runs left, and changed outputs."""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import is_left_behind, read_small
from prc_cli.core.own_file import refuse_links
from prc_cli.formats.writing.record import LARGEST_RECORD, RECORD_SUFFIX, fingerprint
from prc_cli.jobs.batch.journal import Journal, journal_paths, read_entries
from prc_cli.jobs.batch.lock import Lock
from prc_cli.jobs.batch.outcomes import Done
from prc_cli.jobs.batch.types import OWN_FOLDER

_SHARED = re.compile(r"shared-[0-9a-f]{16}")
"""Empty files with which a run on Dask checks whether its workers see OUT."""
OTHER_MACHINE_S = 86_400.0
"""A temporary file of another machine that did not change for this time is removed [s]."""


@dataclass(frozen=True, slots=True)
class Cleaned:
    """Files that were removed, or would be."""

    files: tuple[Path, ...]
    """Temporary files."""
    n_bytes: int
    forgotten: tuple[str, ...]
    """Names that were removed from the journal."""
    kept: tuple[Path, ...]
    """Temporary files of other machines, which may still be working."""


def own_folder(out: Path) -> Path:
    """Return the folder of prc in an output folder."""
    folder = out / OWN_FOLDER
    refuse_links(folder)
    if not journal_paths(folder):
        raise InputError(str(out), "has no journal of prc batch", "name the output folder of a run")
    return folder


def clean(out: Path, *, archive: Path | None = None, dry_run: bool = False) -> Cleaned:
    """Remove the files that dead runs left; outputs stay."""
    folder = own_folder(out)
    # a dry run needs the lock, too: the files of a living run look like left ones
    with Lock(folder):
        forgotten = () if archive is None else tuple(_vanished(folder, archive))
        stale = []
        kept = []
        n_bytes = 0
        for path in _temporary_files(out):
            # None = of another machine
            is_left = True if _SHARED.fullmatch(path.name) else is_left_behind(path)
            size = 0
            is_old = False
            with contextlib.suppress(OSError):
                status = path.lstat()
                size = status.st_size
                is_old = time.time() - status.st_mtime > OTHER_MACHINE_S
            if is_left or (is_left is None and is_old):
                stale.append(path)
                n_bytes += size
            elif is_left is None:
                kept.append(path)
        if not dry_run:
            for path in stale:
                with contextlib.suppress(OSError):
                    path.unlink()
            if forgotten:
                with Journal(folder) as journal:
                    journal.forget(forgotten)
    return Cleaned(tuple(stale), n_bytes, forgotten, tuple(kept))


def _vanished(folder: Path, archive: Path) -> Iterator[str]:
    if not archive.is_dir():
        raise InputError(
            str(archive), "no such folder, expected the archive", "check that its disk is mounted"
        )
    names = [entry.name for entry in read_entries(folder)]
    lost = [name for name in names if not os.path.lexists(archive / name)]
    if names and len(lost) == len(names):
        problem = f"none of the {len(names)} inputs in the journal is here, expected their archive"
        raise ConfigError(str(archive), problem, "check the name and that its disk is mounted")
    yield from lost


def _temporary_files(out: Path) -> Iterator[Path]:
    # by their names; links to folders are not followed
    for folder, _, names in os.walk(out):
        for name in sorted(names):
            path = Path(folder, name)
            if is_left_behind(path) is not False or (
                Path(folder).name == OWN_FOLDER and _SHARED.fullmatch(name)
            ):
                yield path


# -- whole outputs: for backups, restored archives and doubtful disks ------------------------------

Wholeness: TypeAlias = Literal["whole", "missing", "damaged", "unknown"]


@dataclass(frozen=True, slots=True)
class Verified:
    """The state of an output."""

    name: str
    """Name in the output folder."""
    state: Wholeness
    why: str = ""
    """The difference; empty if it is whole."""


def verify_outputs(out: Path) -> Iterator[Verified]:
    """Compare outputs with size and hash in the journals, else in the records beside them.

    It needs no lock.
    """
    expected: dict[str, tuple[int, str | None] | None] = dict(_recorded(out))
    for entry in read_entries(out / OWN_FOLDER):
        if isinstance(entry.outcome, Done):
            path = Path(entry.name)
            name = str(path.with_name(entry.outcome.output_name or path.name))
            if entry.state == "done":
                expected[name] = entry.outcome.output_size, entry.outcome.output_sha256
            else:
                expected.pop(name, None)
    if not expected:
        raise InputError(
            str(out), "contains no outputs that prc wrote", "name the output folder of a run"
        )
    for name in sorted(expected):
        yield _verified(out, name, expected[name])


def _recorded(out: Path) -> Iterator[tuple[str, tuple[int, str | None] | None]]:
    # by the records beside the outputs; links to folders are not followed
    for folder, folders, names in os.walk(out):
        if OWN_FOLDER in folders:
            folders.remove(OWN_FOLDER)
        for name in names:
            if name.endswith(RECORD_SUFFIX) and not name.startswith("."):
                path = Path(folder, name)
                recorded = None
                with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
                    output = json.loads(read_small(path, LARGEST_RECORD))["output"]
                    recorded = int(output["size"]), str(output["sha256"])
                yield str(path.relative_to(out)).removesuffix(RECORD_SUFFIX), recorded


def _verified(out: Path, name: str, expected: tuple[int, str | None] | None) -> Verified:
    path = out / name
    if expected is None or expected[1] is None:
        return Verified(name, "unknown", "prc has no record of its size and hash")
    try:
        if not os.path.lexists(path):
            return Verified(name, "missing", "is not there")
        if not path.is_file():
            return Verified(name, "damaged", "is not a file")
        if (size := path.stat().st_size) != expected[0]:
            return Verified(name, "damaged", f"has {size:,} bytes, expected {expected[0]:,}")
        if fingerprint(path).sha256 != expected[1]:
            return Verified(name, "damaged", "its content has changed")
    except InputError as error:
        return Verified(name, "damaged", error.problem)
    return Verified(name, "whole")
