"""Exceptions of the package: where, what was found, what was expected, what to do.

And names that can be printed.

The command line catches :class:`PrcError` once and turns it into one line and an exit code that
scripts can trust: 1 a file failed, 2 wrong usage or configuration, 3 an evaluation gate failed, 4
done, but look at it (doubts, or classes that drifted from those of earlier runs), 5 another run is
at work in the output folder.
"""

from __future__ import annotations


class PrcError(Exception):
    """Base of all errors of this package; its message is one line.

    Parameters
    ----------
    where : str
        File, position in it, or configuration key.
    problem : str
        What was found against what was expected.
    hint : str
        What to do next, as something that can be typed or checked.
    """

    exit_code = 1

    def __init__(self, where: str, problem: str, hint: str = "") -> None:
        self.where = where
        self.problem = problem
        self.hint = hint
        super().__init__(f"{where}: {problem}" + (f"; {hint}" if hint else ""))

    def __reduce__(self) -> tuple[type[PrcError], tuple[str, str, str]]:
        # the message is composed, so pickling (to worker processes) must keep the parts
        return type(self), (self.where, self.problem, self.hint)


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

    exit_code = 2


class ConfigError(PrcError):
    """A configuration file, option or parameter that makes no sense."""

    exit_code = 2


class GateError(PrcError):
    """An evaluation score below the required minimum."""

    exit_code = 3


class DriftError(PrcError):
    """A file whose class shares differ much from those of the archive's earlier files."""

    exit_code = 4


class BusyError(PrcError):
    """An output folder that another run is working in; nothing was done."""

    exit_code = 5


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
    if (
        "\udc80" <= character <= "\udcff"
    ):  # a byte that is not UTF-8, in Python's encoding of file names
        return f"\\x{ord(character) - 0xDC00:02x}"
    return ascii(character)[1:-1]
