"""Types of options and arguments that name files.

Each says whether the command reads or writes them.

Every path of every command has one of these types, and a test walks all of them. They declare the
path while options are read: two options that name one file, where one of them writes it, are
refused before anything is opened.
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
    """Return the suffixes of the files that are read in a folder."""
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


class ScanPath(ReadPath):
    """Name of an input: that of a folder stands for the file in it where it is one recording."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the file to read."""
        path = super().convert(value, param, ctx)
        source = scan_file(path)
        if source != path:
            will_read(source)
        return source


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
WRITTEN = WritePath()
READ_TEXT = ReadText()
WRITTEN_TEXT = WriteText()
