"""Which outputs of a folder are whole: for backups, restored archives and disks that are doubted."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from prc_cli.core.errors import InputError
from prc_cli.core.files import read_small
from prc_cli.formats.writing.record import LARGEST_RECORD, RECORD_SUFFIX, fingerprint
from prc_cli.jobs.batch.journal import read_entries
from prc_cli.jobs.batch.types import OWN_FOLDER, Done

State: TypeAlias = Literal["whole", "missing", "damaged", "unknown"]


@dataclass(frozen=True, slots=True)
class Verified:
    """What was found of an output."""

    name: str
    """Name in the output folder."""
    state: State
    why: str = ""
    """What was found and expected; empty if it is whole."""


def verify_outputs(out: Path) -> Iterator[Verified]:
    """Compare all outputs with the size and the hash that were noted when they were written.

    Journals count; outputs that none knows are compared with the record beside them. Files that a run is at work on,
    or that failed, are left out. Nothing is changed, and no lock is needed.
    """
    expected: dict[str, tuple[int, str | None] | None] = dict(_recorded(out))
    for entry in read_entries(out / OWN_FOLDER):
        if isinstance(entry.outcome, Done):
            name = str(Path(entry.name).with_name(entry.outcome.output_name or Path(entry.name).name))
            if entry.state == "done":
                expected[name] = entry.outcome.output_size, entry.outcome.output_sha256
            else:
                expected.pop(name, None)
    if not expected:
        raise InputError(str(out), "holds no outputs that prc wrote", "name the output folder of a run")
    for name in sorted(expected):
        yield _verified(out, name, expected[name])


def _recorded(out: Path) -> Iterator[tuple[str, tuple[int, str | None] | None]]:
    """Yield outputs by the records beside them; links to folders are not followed."""
    for place, folders, names in os.walk(out):
        if OWN_FOLDER in folders:
            folders.remove(OWN_FOLDER)
        for name in names:
            if name.endswith(RECORD_SUFFIX) and not name.startswith("."):
                path, noted = Path(place, name), None
                with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
                    found = json.loads(read_small(path, LARGEST_RECORD))["output"]
                    noted = int(found["size"]), str(found["sha256"])
                yield str(path.relative_to(out)).removesuffix(RECORD_SUFFIX), noted


def _verified(out: Path, name: str, expected: tuple[int, str | None] | None) -> Verified:
    path = out / name
    if expected is None or expected[1] is None:
        return Verified(name, "unknown", "nothing says what it was when it was written")
    try:
        if not path.is_file():
            there = os.path.lexists(path)
            return Verified(name, *(("damaged", "is no file") if there else ("missing", "is not there")))
        if (size := path.stat().st_size) != expected[0]:
            return Verified(name, "damaged", f"has {size:,} bytes, expected {expected[0]:,}")
        if fingerprint(path).sha256 != expected[1]:
            return Verified(name, "damaged", "has other content than was written")
    except InputError as error:
        return Verified(name, "damaged", error.problem)
    return Verified(name, "whole")
