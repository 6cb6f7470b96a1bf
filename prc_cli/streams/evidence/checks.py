"""The table of all checks: what each asks, its limit, why the limit is that number, and what it cannot see.

``prc info``, the run record, ``--accept-doubt`` and the page "How prc knows" use these names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from prc_cli.core.findings import Finding
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
    """Ask every check of a scanner that was seen; a check that cannot tell gives no finding."""
    yield from ()
