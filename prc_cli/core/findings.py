"""Findings: the answers of the checks of an input and of its labels.

A check asks one question of a stream, for example whether its lines repeat after M shots. The
checks are in :mod:`prc_cli.streams.evidence`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from enum import IntEnum
from typing import Any

from prc_cli.core.brief import Brief
from prc_cli.core.errors import EvidenceError

CHECK_NAMES = (
    "thinned",
    "path",
    "trajectory",
    "ranges",
    "rounding",
    "missing-code",
    "shot-order",
    "few-lines",
    "line-length",
    "columns-along",
    "line-order",
    "standing",
    "repeated-lines",
    "times",
    "collisions",
    "unplaced",
    "left-out",
    "returns",
    "unread",
    "other-readers",
    "dropouts",
    "range-noise",
    "units",
    "coordinates",
    "angle-step",
    "down",
    "method",
    "ground-below",
    "ground-lean",
    "below-ground",
    "noise-share",
    "indoors",
    "few-rings",
    "classes-along",
)
"""Names of all checks, in the order in which they are reported."""
LABEL_CHECKS = (
    "ground-below",
    "ground-lean",
    "below-ground",
    "noise-share",
    "indoors",
    "classes-along",
)
"""Checks that need the labels; methods that know no angles answer only some of them."""
ORDER_CHECKS = ("shot-order", "line-order", "times")
"""Checks that ``--trust-order`` accepts."""
_DOUBT = "doubt "
_ACCEPTED = "accepted doubt "


class Verdict(IntEnum):
    """The answer of a check, the worst last."""

    FINE = 0
    """The check found no fault, or the input is too small for it."""
    DOUBTFUL = 1
    """Labels are written with a warning; the exit code is 4."""
    AGAINST = 2
    """Labels would be wrong: the input is refused."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The answer of one check."""

    check: str
    """Name of the check, as for ``--accept-doubt``."""
    verdict: Verdict
    found: str
    """What was found, with its figure."""
    expected: str
    """What was expected, with the limit."""
    hint: str = ""
    """What to do, as something that can be typed or checked."""
    option: str = ""
    """The option of the command line that mends it, if one does."""
    is_accepted: bool = False
    """Whether the user accepts it (``--accept-doubt``); then it is only recorded."""

    @property
    def problem(self) -> str:
        """Return the fault and the expectation in one clause.

        >>> found = "the scanner is 6.6 m above the ground"
        >>> Finding("units", Verdict.DOUBTFUL, found, "at most 5 m").problem
        'the scanner is 6.6 m above the ground, expected at most 5 m'
        """
        return f"{self.found}, expected {self.expected}" if self.expected else self.found

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**asdict(self), "verdict": self.verdict.name.lower()}

    def sentence(self) -> str:
        """Return the finding with its name, and what to do.

        >>> found = "the scanner is 6.6 m above the ground"
        >>> Finding("units", Verdict.DOUBTFUL, found, "at most 5 m").sentence()
        'units: the scanner is 6.6 m above the ground, expected at most 5 m'
        """
        return f"{self.check}: {self.problem}" + (f"; {self.hint}" if self.hint else "")

    def notice(self) -> str:
        """Return the sentence for the run record; :func:`is_doubt` knows it again."""
        return f"{_ACCEPTED if self.is_accepted else _DOUBT}{self.sentence()}"


def is_doubt(notice: str) -> bool:
    """Return whether a notice of a run record is a doubt that nobody accepted.

    >>> is_doubt(Finding("units", Verdict.DOUBTFUL, "odd", "").notice())
    True
    """
    return notice.startswith(_DOUBT)


def doubt_of(notice: str) -> tuple[str, str] | None:
    """Return the check and the sentence of a doubt in a run record; None for any other notice.

    >>> doubt = Finding("units", Verdict.DOUBTFUL, "the median range is 700 m", "at most 100 m")
    >>> doubt_of(doubt.notice())
    ('units', 'units: the median range is 700 m, expected at most 100 m')
    >>> doubt_of("the time goes back") is None
    True
    """
    if not is_doubt(notice):
        return None
    sentence = notice.removeprefix(_DOUBT)
    return sentence.partition(":")[0], sentence


def accepted_doubt_of(notice: str) -> str | None:
    """Return the check of an accepted doubt in a run record; None for any other notice."""
    return (
        notice.removeprefix(_ACCEPTED).partition(":")[0] if notice.startswith(_ACCEPTED) else None
    )


def accept(findings: Iterable[Finding], names: Iterable[str]) -> tuple[Finding, ...]:
    """Mark the findings that the user accepts by the names of their checks."""
    known = set(names)
    marked = []
    for finding in findings:
        is_accepted = finding.check in known and finding.verdict > Verdict.FINE
        marked.append(replace(finding, is_accepted=True) if is_accepted else finding)
    return tuple(marked)


class Doubted(Brief):
    """Base of results that hold the answers of all checks."""

    __slots__ = ()
    findings: tuple[Finding, ...]

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """Findings that the user has to look at."""
        return doubts(self.findings)


def notices(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the notices of a run record for findings that are not fine."""
    return tuple(finding.notice() for finding in findings if finding.verdict is not Verdict.FINE)


def doubts(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings that the user has to look at: not fine, and not accepted."""
    unsure = (finding for finding in findings if finding.verdict > Verdict.FINE)
    return tuple(finding for finding in unsure if not finding.is_accepted)


def refuse(path: str, findings: Iterable[Finding]) -> None:
    """Raise :class:`EvidenceError` for the first finding that is against the input, if any."""
    for finding in doubts(findings):
        if finding.verdict is Verdict.AGAINST:
            accept_it = f"to accept it: --accept-doubt {finding.check}"
            hint = f"{finding.hint}; {accept_it}" if finding.hint else accept_it
            raise EvidenceError(path, finding.problem, hint)
