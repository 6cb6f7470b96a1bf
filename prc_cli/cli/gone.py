"""Options that went with 2.0, and what to type instead."""

from __future__ import annotations

GONE = {
    "--adopt": "--overwrite, or another folder",
    "--cdf": "prc render IN --html PAGE.html",
    "--draft": "prc info FILE, which prints the options to type",
    "--figure": "prc render IN --html PAGE.html",
    "--first": "--only LENGTH, e.g. --only 30s or --only 500lines",
    "--keep-version": "nothing: outputs of an older version are made again",
    "--max-range": "--set input.max_range=METRES",
    "--metadata": "--set input.metadata=FILE.json",
    "--only-lines": "--only A:B, e.g. --only 200:300",
    "--only-time": "--only A:B with units, e.g. --only +10s:+40s",
    "--return": "--set input.return=strongest, first or last",
}
"""What to type instead, by option."""

GONE_OF = {
    "prc batch --engine": "--scheduler ADDRESS",
    "prc batch --only-failed": "prc batch retry OUT",
    "prc calibrate --plot": "-o FILE.svg",
    "prc evaluate --by-confidence": "--by confidence:50,80,90",
    "prc evaluate --by-lines": "--by lines:N",
    "prc evaluate --by-range": "--by range:5,10,20",
    "prc evaluate --by-scanner": "--by scanner",
    "prc evaluate --interval-lines": "--intervals: its blocks have a fixed number of lines",
}
"""The same for one command; wins over :data:`GONE`."""


def instead_of(command: str, option: str) -> str | None:
    """Return what to type instead of an option of a command, or None if it never was one.

    >>> instead_of("prc convert", "--return")
    '--set input.return=strongest, first or last'
    """
    return GONE_OF.get(f"{command} {option}", GONE.get(option))
