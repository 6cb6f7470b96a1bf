"""Hints name only options that the input takes; the other parts are left out here."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.findings import Finding

_OPTIONS = {
    "--lines": "lines",
    "--columns": "columns",
    "--range": "range",
    "--range trajectory": "trajectory",
    "--range origin": "origin",
    "--scanner": "scanner",
    "--sort-by-time": "order",
    "--layout": "layout",
    "--points-per-line": "points_per_line",
    "-M": "points_per_line",
}
"""Options of the command line, and their keys of ``[input]``."""
_NAMED = re.compile(
    r"(?<![\w-])(--range (?:trajectory|origin)|--[a-z-]+|-M)(?![\w-])"
    r"|\binput\.([a-z_]+)|\b(layout)\b"
)
_PARTS = re.compile(r"(?:; |, or )(?:else )?")


def named_keys(text: str) -> frozenset[str]:
    """Return the keys of the input that a hint names.

    >>> sorted(named_keys("check --lines and -M, or --set input.nadir=DEG"))
    ['lines', 'nadir', 'points_per_line']
    """
    named = (
        _OPTIONS.get(option, "") or key or layout for option, key, layout in _NAMED.findall(text)
    )
    return frozenset(key for key in named if key)


def fitting(hint: str, refuses: Collection[str], remedy: str = "") -> str:
    """Return a hint without the parts that name refused keys; if none is left, the remedy.

    Parameters
    ----------
    hint : str
        What to do; its parts are divided by semicolons or ``, or``.
    refuses : collection of str
        Keys of ``[input]`` that the input refuses.
    remedy : str
        What else can be done with such an input.

    Examples
    --------
    >>> fitting("check --lines; split the file there", {"lines"})
    'split the file there'
    >>> fitting("give -M 24", {"points_per_line"}, "record the scanner's own topic")
    "record the scanner's own topic"
    """
    if not named_keys(hint) & frozenset(refuses):
        return hint
    parts = [part for part in _PARTS.split(hint) if not named_keys(part) & frozenset(refuses)]
    return "; ".join(parts) or remedy


def fitting_finding(finding: Finding, refuses: Collection[str], remedy: str = "") -> Finding:
    """Return a finding whose hint and option name nothing that the input refuses."""
    if not named_keys(f"{finding.hint} {finding.option}") & frozenset(refuses):
        return finding
    option = "" if named_keys(finding.option) & frozenset(refuses) else finding.option
    return replace(finding, hint=fitting(finding.hint, refuses, remedy), option=option)


def fitting_error(
    error: InputError | ConfigError, refuses: Collection[str], remedy: str = ""
) -> InputError | ConfigError:
    """Return an error whose hint names nothing that the input refuses."""
    hint = fitting(error.hint, refuses, remedy)
    return error if hint == error.hint else type(error)(error.where, error.problem, hint)
