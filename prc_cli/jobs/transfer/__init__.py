"""``prc transfer``: copies the classes of a raw run to the registered points of the same drive.

Both sides are read once for a survey (which refuses damaged files), sorted by key (on disk, unless
sorted already), and merge-joined; a spool brings the classes back to the record order of the
registered file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.brief import Brief
from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import InputError
from prc_cli.core.files import file_state, prepare_outputs, suffix_of
from prc_cli.core.stream import Assumption
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.las.rewrite import LasRecoder
from prc_cli.formats.las.vlrs import names_of_file
from prc_cli.formats.options import Layout
from prc_cli.formats.writing.disk import scratch_file
from prc_cli.formats.writing.record import Fingerprint, RunRecord, fingerprint, record_path
from prc_cli.jobs.progress import tell_share
from prc_cli.jobs.transfer.options import TransferOptions
from prc_cli.jobs.transfer.sides import TransferSides, check_paths, open_sides
from prc_cli.matching.join import CODE, KEY, RECORD, SAME, Joined, JoinTally, columns_of, merge_join
from prc_cli.matching.keys import AXES, SPARE_LABELS, NearestLabel
from prc_cli.matching.nearest import Cloud, fit_of, nearest_join
from prc_cli.matching.shift import shift_of, shift_text
from prc_cli.matching.sides import CONFIDENCE

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


def refuse_poor_match(
    counts: TransferCounts,
    tally: JoinTally,
    sides: TransferSides,
    options: TransferOptions,
) -> None:
    """Refuse a match of too few records, with advice, or one with too many ambiguous keys."""
    if counts.n_matched and counts.share >= options.min_matched:
        _refuse_guesses(counts, sides, options)
        return
    problem = (
        f"{counts.n_matched:,} of {counts.n_points:,} points and {counts.n_labels_matched:,} of "
    )
    problem += f"{counts.n_labels:,} labels of {sides.labels.path} match, expected at least {options.min_matched:.0%} "
    problem += "of the smaller side"
    unmatched = counts.n_points - counts.n_matched
    near = tally.near()
    if counts.n_other_return > unmatched / 2:
        what = "return number" if "return_number" in sides.labels.rule.same else "value of --same"
        hint = f"{counts.n_other_return:,} points have a label of their time but another {what}"
        hint += ": --ignore-return" if "return_number" in sides.labels.rule.same else ""
    elif (
        options.match == "time"
        and near is not None
        and sides.tolerance < near < sides.step_s * CHANCE
    ):
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


@dataclass(frozen=True, repr=False)
class TransferRecord(RunRecord):
    """A :class:`RunRecord` whose ``input`` is the registered file."""

    labels: Fingerprint | None = None
    """The file with the classes."""
    points: Fingerprint | None = None
    """The input of the labels, if these have no keys of their own."""
    counts: TransferCounts | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the record as nested plain values."""
        own = {
            key: None if value is None else asdict(value)
            for key, value in (
                ("labels", self.labels),
                ("points", self.points),
                ("counts", self.counts),
            )
        }
        return {**RunRecord.as_dict(self), "transfer": own}


@dataclass(frozen=True, slots=True, repr=False)
class TransferSummary(Brief):
    """Summary of a transfer."""

    output: Path
    record: RunRecord
    """Provenance and what was written, as stored in the output.

    ``.notices`` holds warnings for the user.
    """
    counts: TransferCounts


def transfer(
    labels: Path | str,
    registered: Path | str,
    output: Path | str,
    options: TransferOptions | None = None,
    *,
    points: Path | str | None = None,
    layout: Layout | None = None,
    overwrite: bool = False,
    progress: Callable[[int], object] | None = None,
) -> TransferSummary:
    """Write the registered file again with the classes of a raw run.

    The output is complete or absent.

    Parameters
    ----------
    labels : path
        LAS or LAZ with classes, text with classes and times, or labels alone (``.npy``, ``.csv``,
        ``.parquet``, ...) in the order of ``points``. Code 0 of label files (a shot without return)
        is left out.
    registered : path
        LAS or LAZ. Points without partner keep their class; all else stays as it is.
    output : path
        ``.las`` or ``.laz``.
    options : TransferOptions, optional
        How records are matched; default: by gps_time and return number.
    points : path, optional
        Record input (text, raw dump, LAS) that the labels belong to; must be given with labels
        alone.
    layout : Layout, optional
        Record layout of ``points``.
    overwrite : bool
        Replace an existing output.
    progress : callable, optional
        Called with the number of registered points that were just matched.

    Returns
    -------
    TransferSummary
        Counts and notices; the same record is stored in the output and beside it.

    Raises
    ------
    InputError
        When a side is damaged or lacks the key, labels and points differ in number, less than
        ``options.min_matched`` of the smaller side is matched, or more than the rest of the matches
        are ambiguous (several different labels).
    OutputError, ConfigError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    options = options or TransferOptions()
    labels = Path(labels)
    registered = Path(registered)
    output = Path(output)
    points = None if points is None else Path(points)
    inputs = tuple(
        path for path in (labels, points, registered, options.trajectory) if path is not None
    )
    check_paths(labels, registered, output, points)
    prepare_outputs(output, record_path(output), overwrite=overwrite, inputs=inputs)
    before = [_state(path) for path in inputs]
    sides = open_sides(labels, registered, points, layout, options)
    tally = JoinTally()
    n_changed = 0
    n_done = 0
    n_unsure = 0
    moved = np.zeros(256, np.bool_)
    beside = tuple(
        dict.fromkeys((*options.carry, *(() if options.min_confidence is None else (CONFIDENCE,))))
    )
    with LasRecoder(output, registered, options.carry) as writer, ExitStack() as stack:
        for item in _partners(sides, beside, options, tally, stack):
            record = item.left[RECORD]
            codes = item.left[CODE].copy()
            at = item.left_index
            to = item.right_index
            if options.min_confidence is not None:
                sure = item.right[CONFIDENCE][to] >= options.min_confidence
                n_unsure += len(sure) - int(np.count_nonzero(sure))
                at = at[sure]
                to = to[sure]
            codes[at] = item.right[CODE][to]
            moved[codes[at]] = True
            n_changed += int(np.count_nonzero(codes != item.left[CODE]))
            writer.put(record, codes)
            if options.carry:
                writer.put_values(
                    record[at], {name: item.right[name][to] for name in options.carry}
                )
            n_done += len(record)
            if n_points := sides.points.n_records:
                tell_share(progress, min(n_done / n_points, 1.0))
            if progress is not None:
                progress(len(record))
        counts = counts_of(tally, n_changed, sides)
        refuse_poor_match(counts, tally, sides, options)
        for path, state in zip(inputs, before, strict=True):
            if _state(path) != state:
                raise InputError(
                    str(path), "changed while it was read", "run again when the copy is complete"
                )
        least = options.min_confidence
        unsure = (
            f"{n_unsure:,} points keep their class: their label has a confidence below {least} %",
        )
        stored = TransferRecord(
            config={"transfer": options.as_dict()},
            input=fingerprint(registered),
            format=sides.points.format,
            points_per_line=0,
            n_records=sides.found[1].n_records,
            assumptions=tuple(sides.assumptions),
            notices=(*sides.notices, *(() if least is None else unsure), *notices_of(counts)),
            labels=fingerprint(labels),
            points=None if points is None else fingerprint(points),
            counts=counts,
        )
        writer.name_classes(
            {code: name for code, name in _user_names(labels).items() if moved[code]}
        )
        return TransferSummary(output, writer.finish(stored), counts)


def _partners(
    sides: TransferSides,
    beside: tuple[str, ...],
    options: TransferOptions,
    tally: JoinTally,
    stack: ExitStack,
) -> Iterator[Joined]:
    """Yield the registered points (left) with their labels (right)."""
    if options.match != "nearest":
        names = (KEY, SAME, CODE)
        target = columns_of(sides.points, names, sort=not sides.found[1].in_order)
        origin = columns_of(sides.labels, (*names, *beside), sort=not sides.found[0].in_order)
        match = NearestLabel(sides.tolerance)
        paths = (sides.points.path, sides.labels.path)
        yield from merge_join(
            target, origin, match, sides.tolerance, tally, paths, spare=SPARE_LABELS
        )
        return
    points, labels = (
        Cloud(
            columns_of(side, (*AXES, CODE, *more), sort=False),
            stack.enter_context(scratch_file("matching")),
        )
        for side, more in ((sides.points, ()), (sides.labels, beside))
    )
    fit = fit_of(points, labels)
    sides.tolerance = options.tolerance_s or (1.0 if fit is None else fit.tolerance_m)
    why = "given" if options.tolerance_s else "beyond it few more points find a label"
    sides.assumptions.append(Assumption("transfer.tolerance_m", f"{sides.tolerance:g}", why))
    shift = shift_of(labels, points)
    if shift is not None:
        sides.notices.append(f"the registered points are shifted {shift_text(shift)}")
    for item in nearest_join(points, labels, sides.tolerance, tally):
        at = np.flatnonzero(item.to >= 0)
        yield Joined(item.left, item.right, at, item.to[at])


def _user_names(labels: Path) -> dict[int, str]:
    """Return the names of user codes.

    Those of the file with the classes, else those of this program.
    """
    own = names_of_file(labels) if suffix_of(labels) in LAS_SUFFIXES else {}
    return {**ClassCodes().user_names(), **own}


def _state(path: Path) -> tuple[int, ...]:
    try:
        return file_state(path)
    except OSError as error:
        raise InputError(
            str(path), f"cannot be read ({error.strerror or error})", "check the name"
        ) from error
