"""Match counts of a transfer, and whether they suffice."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from prc_cli.core.errors import InputError
from prc_cli.jobs.transfer.options import TransferOptions
from prc_cli.jobs.transfer.sides import TransferSides
from prc_cli.matching.join import JoinTally

CHANCE = 0.25
"""Half of random times lie within this share of the label step from the nearest label."""


@dataclass(frozen=True, slots=True)
class TransferCounts:
    """Match counts of a transfer."""

    n_labels: int
    """Label records with a class (shots without return left out)."""
    n_labels_matched: int
    n_points: int
    """Records of the registered file."""
    n_matched: int
    """Points that received the class of a label; the others keep theirs."""
    n_changed: int
    """Points whose class changed."""
    n_repeated: int
    """Matched points that share their key with another point."""
    n_shared: int
    """Matched points whose key several labels have."""
    n_in_order: int
    """Of these, points paired in record order although the labels differ."""
    n_by_majority: int
    """Of these, points that received the most frequent of several different labels."""
    n_other_return: int
    """Points without partner whose key has a label of another return (or other ``same``)."""
    largest_difference: float
    """Largest difference of the keys of a point and its label [s for times]."""

    @property
    def share(self) -> float:
        """Matched share of the smaller side."""
        if self.n_points <= self.n_labels:
            return self.n_matched / self.n_points if self.n_points else 0.0
        return self.n_labels_matched / self.n_labels if self.n_labels else 0.0


def counts_of(tally: JoinTally, n_changed: int, sides: TransferSides) -> TransferCounts:
    """Return the counts for the run record."""
    return TransferCounts(
        n_labels=sides.found[0].n_records,
        n_labels_matched=tally.n_right,
        n_points=tally.n_left,
        n_matched=tally.n_pairs,
        n_changed=n_changed,
        n_repeated=tally.n_repeated,
        n_shared=tally.n_shared,
        n_in_order=tally.n_in_order,
        n_by_majority=tally.n_by_majority,
        n_other_return=tally.n_other_same,
        largest_difference=tally.largest,
    )


def refuse_poor_match(counts: TransferCounts, tally: JoinTally, sides: TransferSides, options: TransferOptions) -> None:
    """Refuse a match of too few records, with advice, or one with too many ambiguous keys."""
    if counts.n_matched and counts.share >= options.min_matched:
        _refuse_guesses(counts, sides, options)
        return
    problem = f"{counts.n_matched:,} of {counts.n_points:,} points and {counts.n_labels_matched:,} of "
    problem += f"{counts.n_labels:,} labels of {sides.labels.path} match, expected at least {options.min_matched:.0%} "
    problem += "of the smaller side"
    unmatched = counts.n_points - counts.n_matched
    near = tally.near()
    if counts.n_other_return > unmatched / 2:
        what = "return number" if "return_number" in sides.labels.rule.same else "value of --same"
        hint = f"{counts.n_other_return:,} points have a label of their time but another {what}"
        hint += ": --ignore-return" if "return_number" in sides.labels.rule.same else ""
    elif options.match == "time" and near is not None and sides.tolerance < near < sides.step_s * CHANCE:
        hint = f"half of the points without partner have a label within {near:g} s: --tolerance {near:g}"
    elif near is not None and near < 10 * sides.step_s < math.inf:
        hint = "the times of the points fall between those of the labels: another drive, or clocks that differ "
        hint += "(UTC and GPS by 18 s, see --time-offset)"
    elif counts.n_matched:
        share = math.floor(counts.share * 1000) / 1000
        hint = f"are these the same drive? To write it all the same: --min-matched {share}"
    else:
        hint = "are these the same drive?"
    raise InputError(sides.points.path, problem, hint)


def _refuse_guesses(counts: TransferCounts, sides: TransferSides, options: TransferOptions) -> None:
    """Refuse matches in which too many points have several labels of different classes."""
    ordered = all(found.in_order for found in sides.found)
    # reordered records do not pair by their order
    n_guessed = counts.n_by_majority + (0 if ordered else counts.n_in_order)
    if n_guessed <= (1 - options.min_matched) * counts.n_matched:
        return
    problem = f"{n_guessed:,} of {counts.n_matched:,} matched points have several labels of their key, which differ, "
    problem += f"expected at most {1 - options.min_matched:.0%}"
    hint = "tell them apart by another value that both sides have, e.g. --same intensity or --same scanner_channel"
    raise InputError(sides.points.path, problem, hint)


def notices_of(counts: TransferCounts) -> Iterator[str]:
    """Yield warnings about the match."""
    if counts.n_repeated:
        yield f"{counts.n_repeated:,} points have the key of another point (tiles that overlap, or coarse times)"
    if differ := counts.n_in_order + counts.n_by_majority:
        yield (
            f"{counts.n_shared:,} points have several labels of their key, which differ for {differ:,}: "
            f"{counts.n_in_order:,} were paired in record order, {counts.n_by_majority:,} got the most frequent one"
        )
    if counts.n_other_return:
        yield f"{counts.n_other_return:,} points have a label of their time, of another return; they keep their class"
