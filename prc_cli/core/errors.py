"""Exceptions of the package, its exit codes, and text that a terminal can show.

An exception says where, what was found against what was expected, and what to do. In logs, JSON and
tables it is one line. The command line catches :class:`PrcError` once, prints its :func:`message`
of at most three lines, and ends with its :class:`ExitCode`.
"""

from __future__ import annotations

import re
from enum import IntEnum

AFTER_SIGNAL = 128
"""The exit code after a signal is its number plus this, as in shells."""


class ExitCode(IntEnum):
    """Exit code of a command; scripts can trust it."""

    DONE = 0
    FAILED = 1
    """At least one file failed."""
    USAGE = 2
    """Wrong usage or configuration; nothing was done."""
    GATE = 3
    """A score of an evaluation is too low; no file failed."""
    LOOK = 4
    """Done, but look at it: a doubt, or classes unlike those of earlier runs; no file failed."""
    BUSY = 5
    """Another run works in the output folder; nothing was done."""
    HANGUP = AFTER_SIGNAL + 1
    """SIGHUP: the terminal was closed."""
    INTERRUPTED = AFTER_SIGNAL + 2
    """SIGINT: Ctrl-C."""
    TERMINATED = AFTER_SIGNAL + 15
    """SIGTERM."""


_REASON = re.compile(r"; |, (?=expected\b|so )")
"""Divides what is wrong from the reason."""


def message(head: str, problem: str, hint: str = "") -> str:
    """Return a message for a terminal: what is wrong, why, and what to do, a line each.

    Parameters
    ----------
    head : str
        ``error`` or ``warning``, and where: a file, a check.
    problem : str
        What is wrong; after a semicolon, or from *expected* or *so* on, the reason or the result.
    hint : str
        What to do; empty if nothing is known.

    Examples
    --------
    >>> print(message("error: out", "is a folder, expected a file name", "name the file inside it"))
    error: out: is a folder
      expected a file name
      hint: name the file inside it
    >>> message("error: drive.laz", "is cut short")
    'error: drive.laz: is cut short'
    """
    fault, *reason = _REASON.split(problem, maxsplit=1)
    lines = [f"{head}: {fault}", *(f"  {text}" for text in reason)]
    if hint:
        lines.append(f"  hint: {hint}")
    return "\n".join(printable(line) for line in lines)


class PrcError(Exception):
    """Base of all errors of this package; as a string it is one line.

    Parameters
    ----------
    where : str
        File, position in it, or configuration key.
    problem : str
        What was found against what was expected; a reason follows after a semicolon.
    hint : str
        What to do next, as something that can be typed or checked.
    """

    exit_code = ExitCode.FAILED

    def __init__(self, where: str, problem: str, hint: str = "") -> None:
        self.where = where
        self.problem = problem
        self.hint = hint
        super().__init__(f"{where}: {problem}" + (f"; {hint}" if hint else ""))

    def __reduce__(self) -> tuple[type[PrcError], tuple[str, str, str]]:
        # the message is composed, so pickling (to worker processes) must keep the parts
        return type(self), (self.where, self.problem, self.hint)

    def message(self) -> str:
        """Return the :func:`message` for a terminal."""
        return message(f"error: {self.where}", self.problem, self.hint)


class InputError(PrcError):
    """An input file or stream that cannot be read as what it claims to be."""


class OrderError(InputError):
    """An input whose records are not in the order the shots were fired."""


class EvidenceError(InputError):
    """An input that is not what it is said to be, by what it shows itself."""


class DoubtWarning(UserWarning):
    """An input that may not be what it is said to be.

    Warned of by functions that return labels alone.
    """


class OutputError(PrcError):
    """An output that cannot be written whole."""


class OutputExistsError(OutputError):
    """An output that exists already and was not allowed to be replaced."""

    exit_code = ExitCode.USAGE


class ConfigError(PrcError):
    """A configuration file, option or parameter that makes no sense."""

    exit_code = ExitCode.USAGE


class GateError(PrcError):
    """An evaluation score below the required minimum."""

    exit_code = ExitCode.GATE


class DriftError(PrcError):
    """A file whose class shares differ much from those of the archive's earlier files."""

    exit_code = ExitCode.LOOK


class BusyError(PrcError):
    """An output folder that another run is working in; nothing was done."""

    exit_code = ExitCode.BUSY


def printable(text: str) -> str:
    """Return a text as one printable line.

    Control characters and bytes that are not UTF-8 are escaped.
    """
    return "".join(_shown(character) for character in text)


def printable_lines(text: str) -> str:
    """Return a text of several lines, each made :func:`printable`."""
    return "".join(character if character == "\n" else _shown(character) for character in text)


def _shown(character: str) -> str:
    if character.isprintable():
        return character
    # a byte that is not UTF-8, in Python's encoding of file names
    if "\udc80" <= character <= "\udcff":
        return f"\\x{ord(character) - 0xDC00:02x}"
    return ascii(character)[1:-1]
