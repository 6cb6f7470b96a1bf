"""The table of checks: the question, the limit with its reason, and what a check misses.

``prc info``, the run record, ``--accept-doubt`` and the page "How prc knows" use these names. The
limits of the result are those of :class:`prc_cli.methods.base.UsualLabels` of every method.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from prc_cli.core.findings import Finding, Verdict


@dataclass(frozen=True, slots=True)
class Check:
    """A question about every input."""

    name: str
    """Name, as for ``--accept-doubt``."""
    asks: str
    """The question."""
    limit: str
    """The limits of the warning and of the refusal."""
    reason: str
    """Why the limit is that number."""
    blind: str
    """What the check cannot see."""


@cache
def check_table() -> tuple[Check, ...]:
    """Return all checks, in the order in which they are reported."""
    text = (Path(__file__).parent / "checks.toml").read_text(encoding="utf-8")
    return tuple(Check(name, **texts) for name, texts in tomllib.loads(text).items())


def verdict_of(*, doubtful: bool, against: bool = False) -> Verdict:
    """Return the answer of a check that has one or two limits."""
    if against:
        return Verdict.AGAINST
    return Verdict.DOUBTFUL if doubtful else Verdict.FINE


def worst_of(by_scanner: Mapping[int, Iterable[Finding]]) -> list[Finding]:
    """Return one answer to every check.

    Of several scanners it is the worst answer, with the scanner.
    """
    worst: dict[str, Finding] = {}
    for scanner, findings in by_scanner.items():
        for finding in findings:
            if finding.check not in worst or finding.verdict > worst[finding.check].verdict:
                measured = (
                    f"scanner {scanner}: {finding.found}" if len(by_scanner) > 1 else finding.found
                )
                worst[finding.check] = replace(finding, found=measured)
    return list(worst.values())
