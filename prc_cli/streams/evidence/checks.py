"""The table of all checks: what each asks, its limit, why the limit is that number, and what it cannot see.

``prc info``, the run record, ``--accept-doubt`` and the page "How prc knows" use these names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from prc_cli.core.findings import Finding, Verdict
from prc_cli.streams.evidence.cells import check_collisions, check_ranges, check_returns, check_unplaced
from prc_cli.streams.evidence.figures import figures_of
from prc_cli.streams.evidence.lines import check_dropouts, check_line_length, check_line_order, check_shot_order
from prc_cli.streams.evidence.seen import Seen


@dataclass(frozen=True, slots=True)
class Check:
    """A question that is asked of every input."""

    name: str
    """Name, as for ``--accept-doubt``."""
    asks: str
    """The question."""
    limit: str
    """Where doubt begins, and where the input is refused."""
    reason: str
    """Why the limit is that number."""
    blind: str
    """What the check cannot see."""


CHECKS: tuple[Check, ...] = ()


def ask_all(seen: Seen) -> Iterator[Finding]:
    """Ask every check of a scanner that was seen, the gravest faults first; a check that cannot tell finds nothing."""
    figures = figures_of(seen.windows)
    yield from _known(check_ranges(seen))
    order = check_shot_order(figures)
    yield from _known(order)
    if not _is_against(order):  # without an order there are no lines, and without lines no order of lines
        length = check_line_length(seen, figures)
        yield from _known(length)
        if not _is_against(length):
            yield from _known(check_line_order(seen, figures), check_dropouts(figures))
    yield from _known(check_collisions(seen), check_unplaced(seen), check_returns(seen))


def _known(*findings: Finding | None) -> Iterator[Finding]:
    return (finding for finding in findings if finding is not None)


def _is_against(finding: Finding | None) -> bool:
    return finding is not None and finding.verdict is Verdict.AGAINST
