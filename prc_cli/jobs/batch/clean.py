"""What dead runs left in an output folder: temporary files, parts of files, what the journal knows of lost inputs."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import is_left_behind, refuse_links
from prc_cli.jobs.batch.journal import Journal, journal_paths, read_entries
from prc_cli.jobs.batch.lock import Lock
from prc_cli.jobs.batch.types import OWN_FOLDER

_SHARED = re.compile(r"shared-[0-9a-f]{16}")
"""Empty files by which a run on Dask finds out whether its workers see OUT; no run is at work here now."""
PARTS_FOLDER = "parts"
"""Folder in which earlier versions kept parts of large files."""
OTHER_MACHINE_S = 86_400.0
"""A temporary file of another machine that was not written to for so long is taken for left behind [s]."""


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What was removed, or would be."""

    files: tuple[Path, ...]
    """Temporary files, and the folder of parts."""
    n_bytes: int
    forgotten: tuple[str, ...]
    """Names that the journal forgot."""
    kept: tuple[Path, ...]
    """Temporary files of other machines that may still be at work."""


def own_folder(out: Path) -> Path:
    """Return our folder in an output folder."""
    folder = out / OWN_FOLDER
    refuse_links(folder)
    if not journal_paths(folder):
        raise InputError(str(out), "has no journal of prc batch", "name the output folder of a run")
    return folder


def clean(out: Path, *, archive: Path | None = None, dry_run: bool = False) -> Cleaned:
    """Remove what dead runs left; outputs stay."""
    folder = own_folder(out)
    # a lock is taken in the dry run too: while a run is at work its files look like left ones
    with Lock(folder):
        forgotten = () if archive is None else tuple(_vanished(folder, archive))
        stale, kept = [], []
        for part in _temporary_files(out):
            left = True if _SHARED.fullmatch(part.name) else is_left_behind(part)
            if left or (left is None and _is_old(part)):
                stale.append(part)
            elif left is None:
                kept.append(part)
        n_bytes = sum(_size(part) for part in stale)
        parts = folder / PARTS_FOLDER
        if parts.is_dir():
            n_bytes += sum(_size(path) for path in parts.rglob("*"))
            stale.append(parts)
        if not dry_run:
            for part in stale:
                if part == parts:
                    shutil.rmtree(part, ignore_errors=True)
                else:
                    with contextlib.suppress(OSError):
                        part.unlink()
            if forgotten:
                with Journal(folder) as journal:
                    journal.forget(forgotten)
    return Cleaned(tuple(stale), n_bytes, forgotten, tuple(kept))


def _vanished(folder: Path, archive: Path) -> Iterator[str]:
    if not archive.is_dir():
        raise InputError(str(archive), "no such folder, expected the archive", "check that its disk is mounted")
    names = [entry.name for entry in read_entries(folder)]
    lost = [name for name in names if not os.path.lexists(archive / name)]
    if names and len(lost) == len(names):
        problem = f"none of the {len(names)} inputs in the journal is here, expected their archive"
        raise ConfigError(str(archive), problem, "check the name and that its disk is mounted")
    yield from lost


def _temporary_files(out: Path) -> Iterator[Path]:
    """Yield files that are named like our temporary ones; links to folders are not followed."""
    for place, _, names in os.walk(out):
        for name in sorted(names):
            path = Path(place, name)
            if is_left_behind(path) is not False or (Path(place).name == OWN_FOLDER and _SHARED.fullmatch(name)):
                yield path


def _is_old(path: Path) -> bool:
    with contextlib.suppress(OSError):
        return time.time() - path.lstat().st_mtime > OTHER_MACHINE_S
    return False


def _size(path: Path) -> int:
    with contextlib.suppress(OSError):
        return path.lstat().st_size
    return 0
