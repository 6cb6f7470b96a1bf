"""Paths of the running command: inputs and outputs; no path may be both.

The command line declares both while it reads its options, before anything is opened
(:mod:`prc_cli.cli.paths`). Every output is compared again when it is prepared and when it gets its
name, so that names made of others count, too.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from prc_cli.core.errors import ConfigError, OutputExistsError

_HINT = "choose another output name"


@dataclass
class _Declared:
    command: str = ""
    read: dict[Path, Collection[str]] = field(default_factory=dict)
    """Files, and folders with the suffixes of their files that are read."""
    written: list[Path] = field(default_factory=list)


_STATE = _Declared()


def begin_command(command: str) -> None:
    """Forget the paths of the command before."""
    _STATE.command = command
    _STATE.read.clear()
    _STATE.written.clear()


def will_read(path: Path, suffixes: Collection[str] = ()) -> None:
    """Declare an input; of a folder, files with some suffixes."""
    for output in _STATE.written:
        _compare(output, path, suffixes)
    _STATE.read[path] = suffixes


def will_write(path: Path) -> None:
    """Declare an output that an option names."""
    refuse_read(path)
    for output in _STATE.written:
        if is_one_file(output, path):
            raise ConfigError(str(path), "found one output twice, expected a file for each", _HINT)
    _STATE.written.append(path)


def refuse_read(path: Path) -> None:
    """Refuse an output that the command reads."""
    for source, suffixes in _STATE.read.items():
        _compare(path, source, suffixes)


def run_key(*inputs: Path) -> str:
    """Return 8 hexadecimal digits that name the command and its inputs."""
    names = sorted({os.path.realpath(path) for path in (*inputs, *_STATE.read)})
    text = "\0".join([_STATE.command, *names])
    return hashlib.sha256(os.fsencode(text)).hexdigest()[:8]


def is_one_file(first: Path, second: Path) -> bool:
    """Return whether two names lead to one file, whether it is there or not."""
    try:
        return first.samefile(second)
    except (OSError, ValueError):
        return os.path.realpath(first) == os.path.realpath(second)


def _compare(output: Path, source: Path, suffixes: Collection[str]) -> None:
    if is_one_file(output, source):
        problem = "the output is the input itself; inputs are never modified"
        raise OutputExistsError(str(output), problem, _HINT)
    if not suffixes or not os.path.lexists(output):
        return
    is_inside = Path(os.path.realpath(source)) in Path(os.path.realpath(output)).parents
    if is_inside and output.name.lower().endswith(tuple(suffixes)):
        problem = f"is a file of {source}, which is read; inputs are never modified"
        raise OutputExistsError(str(output), problem, _HINT)
