"""Result of an evaluation, input of the reports: confusion matrix, matching, parts and intervals."""

from __future__ import annotations

from dataclasses import dataclass

from prc_cli.core.brief import Brief
from prc_cli.evaluation.confusion import ConfusionMatrix


@dataclass(frozen=True, slots=True, repr=False)
class MatchReport(Brief):
    """How the records of both sides were matched, and how many."""

    method: str
    """``order``, ``cell`` (scan line and column), ``time``, ``dimension:NAME`` or ``nearest``."""
    n_predicted: int
    n_reference: int
    n_matched: int
    """Pairs; every record is in at most one, except reference records with several partners (``nearest``, optional)."""
    tolerance: float | None = None
    """Largest difference of a pair: seconds for ``time``, metres for ``nearest``."""
    notes: tuple[str, ...] = ()
    """Remarks for the reader, one sentence each."""
    n_reference_matched: int | None = None
    """Reference records in at least one pair; None = ``n_matched``, as each is in one."""


@dataclass(frozen=True, slots=True)
class SplitPart:
    """The pairs of one part of a split, for example ranges of 10 to 20 m."""

    name: str
    """Displayed name, such as ``10-20 m``."""
    low: float
    """Lower bound: range [m], first scan line, scanner id."""
    high: float
    """Upper bound, exclusive; inf = open."""
    matrix: ConfusionMatrix


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval of a score."""

    low: float
    high: float


@dataclass(frozen=True, slots=True, repr=False)
class Evaluation(Brief):
    """Result of ``prc evaluate``."""

    predicted: tuple[str, ...]
    """Files."""
    reference: tuple[str, ...]
    """Files."""
    mapping: str
    """Name or file of the class mapping."""
    match: MatchReport
    matrix: ConfusionMatrix
    splits: dict[str, tuple[SplitPart, ...]]
    """Parts by what was split by: ``range``, ``lines``, ``scanner``; pairs whose range, line
    or scanner is not known are a part of their own named ``unknown``. The counts add up to those of ``matrix``; parts
    without scored records are left out, and the ignored records with them."""
    intervals: dict[str, Interval]
    """Intervals by the score's name as in ``--fail-under``, such as ``recall.ground``; empty unless requested."""
    interval_method: str = ""
    """For example ``block jackknife, 120 blocks of 99 lines, 95 %``."""
