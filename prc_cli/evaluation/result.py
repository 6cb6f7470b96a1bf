"""What an evaluation finds, as the reports take it: one matrix, how the records were matched, and its parts."""

from __future__ import annotations

from dataclasses import dataclass

from prc_cli.evaluation.confusion import ConfusionMatrix


@dataclass(frozen=True, slots=True)
class MatchReport:
    """How records of the two sides were paired, and how many of each found a partner."""

    method: str
    """``order``, ``time``, ``dimension:NAME`` or ``nearest``."""
    n_predicted: int
    n_reference: int
    n_matched: int
    """Pairs; every record is in one pair at most, unless a reference may serve several (``nearest``, on request)."""
    tolerance: float | None = None
    """Largest difference of a pair: seconds for ``time``, metres for ``nearest``."""
    notes: tuple[str, ...] = ()
    """What the reader should know, a plain sentence each."""
    n_reference_matched: int | None = None
    """Reference records in at least one pair; None = ``n_matched``, for each is in one."""


@dataclass(frozen=True, slots=True)
class SplitPart:
    """The pairs of one part of a split, for example ranges of 10 to 20 m."""

    name: str
    """As it is shown, ``10-20 m``."""
    low: float
    """Where the part begins: range [m], first scan line, scanner id."""
    high: float
    """Where it ends (not included), inf = open."""
    matrix: ConfusionMatrix


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval of a score."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Everything that ``prc evaluate`` prints."""

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
    """By the name that ``--fail-under`` takes, ``recall.ground``; empty where they were not asked for."""
    interval_method: str = ""
    """For example ``block jackknife, 120 blocks of 99 lines, 95 %``."""
