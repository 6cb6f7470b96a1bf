"""Types of options and arguments for files that a command reads or writes.

Every path of every command has one of these types; a test checks all commands. The types declare
the path while click reads the options. If two options name the same file and one of them writes it,
the command is refused before any file is opened.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import click

from prc_cli.core.paths import will_read, will_write
from prc_cli.formats import scan_file
from prc_cli.formats.registry import by_suffix

STDOUT = "-"


def _suffixes(path: Path) -> tuple[str, ...]:
    return (*by_suffix("scans"), *by_suffix("codes")) if path.is_dir() else ()


class ReadPath(click.Path):
    """A file or folder that the command reads."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, declared."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        will_read(path, _suffixes(path))
        return path


class NamedPath(ReadPath):
    """A file or folder that the command reads, with a name if wanted: ``NAME=FILE``."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the name, empty without one, and the path, declared."""
        text = os.fsdecode(value)
        name, equals, file = text.partition("=")
        # a file name may contain the separator itself
        if not equals or not file or Path(text).exists():
            return "", super().convert(text, param, ctx)
        return name.strip(), super().convert(file, param, ctx)


class ScanPath(ReadPath):
    """Name of an input: a file, or a folder that is one recording."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the file to read."""
        if value == STDOUT:
            message = "- is not a file; prc stream reads from a pipe: prc stream < FILE > LABELS"
            raise click.UsageError(message, ctx)
        path = super().convert(value, param, ctx)
        source = scan_file(path)
        if source != path:
            will_read(source)
        return source


def in_folder(output: Path, name: str) -> Path:
    """Return the file ``name`` in an output that is an existing folder, as ``cp`` does."""
    if not output.is_dir():
        return output
    inside = output / name
    will_write(inside)
    return inside


class ReadText(click.types.StringParamType):
    """A text that may name a file, by itself or behind ``=`` or ``:``, as ``trajectory:FILE``."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the text; all files that it may name are declared."""
        text = os.fsdecode(value)
        begins = [0, *(mark.end() for mark in re.finditer("[=:]", text))]
        for begin in begins:
            if name := text[begin:].strip("\"' "):
                will_read(Path(name))
        return text


class WritePath(click.Path):
    """A file or folder that the command writes."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, declared."""
        if not value:  # of a variable that is not set: Path makes the current folder of it
            self.fail("the name is empty; give the name of a file", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        will_write(path)
        return path


class WriteText(click.types.StringParamType):
    """A file that the command writes, or ``-`` for stdout."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the text, declared."""
        text = os.fsdecode(value)
        if text != STDOUT:
            will_write(Path(text))
        return text


READ = ReadPath()
NAMED = NamedPath()
WRITTEN = WritePath()
READ_TEXT = ReadText()
WRITTEN_TEXT = WriteText()
