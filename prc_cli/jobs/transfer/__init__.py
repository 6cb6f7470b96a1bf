"""``prc transfer``: copies the classes of a raw run to the registered points of the same drive.

prc reads both sides once for a survey, which refuses damaged files. It sorts them by key on disk,
unless they are sorted, and joins them. A spool brings the classes back to the record order of the
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
from prc_cli.core.files import check_unchanged, file_state, prepare_outputs, suffix_of
from prc_cli.core.stream import Assumption
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.input import Input
from prc_cli.formats.las.rewrite import LasRecoder
from prc_cli.formats.las.vlrs import names_of_file
from prc_cli.formats.options import Layout
from prc_cli.formats.records import Source
from prc_cli.formats.writing.disk import scratch_file
from prc_cli.formats.writing.record import Fingerprint, RunRecord, fingerprint, record_path
from prc_cli.jobs.progress import report_share
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
    """Label records with a class (without shots that have no return)."""
    n_labels_matched: int
    n_points: int
    """Records of the registered file."""
    n_matched: int
    """Points that received the class of a label. The others keep their class."""
    n_changed: int
    """Points whose class changed."""
    n_repeated: int
    """Matched points that share their key with another point."""
    n_shared: int
    """Matched points whose key several labels have."""
    n_in_order: int
    """Points of ``n_shared`` that were paired in record order although the labels differ."""
    n_by_majority: int
    """Points of ``n_shared`` that received the most frequent of several different labels."""
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
        n_labels=sides.surveys[0].n_records,
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
        f"{counts.n_matched:,} of {counts.n_points:,} points and "
        f"{counts.n_labels_matched:,} of {counts.n_labels:,} labels of {sides.labels.path} match, "
        f"expected at least {options.min_matched:.0%} of the smaller side"
    )
    unmatched = counts.n_points - counts.n_matched
    near = tally.near()
    if counts.n_other_return > unmatched / 2:
        hint = f"{counts.n_other_return:,} points have a label of their time but another "
        if "return_number" in sides.rule.same:
            hint += f"return number: --match {options.match}+no-return"
        else:
            hint += f"value of {' or '.join(options.same)}"
    elif (
        options.match == "time"
        and near is not None
        and sides.tolerance < near < sides.step_s * CHANCE
    ):
        hint = (
            f"half of the points without partner have a label within {near:g} s: "
            f"--tolerance {near:g}"
        )
    elif near is not None and near < 10 * sides.step_s < math.inf:
        hint = (
            "the times of the points fall between the times of the labels: another drive, or "
            "clocks that differ (UTC and GPS by 18 s, see --time-offset)"
        )
    elif counts.n_matched:
        share = math.floor(counts.share * 1000) / 1000
        hint = f"are these the same drive? To write it all the same: --min-matched {share}"
    else:
        hint = "are these the same drive?"
    raise InputError(sides.points.path, problem, hint)


def _refuse_guesses(counts: TransferCounts, sides: TransferSides, options: TransferOptions) -> None:
    n_guessed = counts.n_by_majority
    if not all(side.in_order for side in sides.surveys):
        # in other files the record order does not pair points with labels
        n_guessed += counts.n_in_order
    if n_guessed <= (1 - options.min_matched) * counts.n_matched:
        return
    problem = (
        f"{n_guessed:,} of {counts.n_matched:,} matched points have several labels of their key, "
        f"which differ, expected at most {1 - options.min_matched:.0%}"
    )
    hint = (
        "match by one more value that both sides have, "
        f"e.g. --match {options.match}+intensity or --match {options.match}+scanner_channel"
    )
    raise InputError(sides.points.path, problem, hint)


def notices_of(counts: TransferCounts) -> Iterator[str]:
    """Yield warnings about the match."""
    if counts.n_repeated:
        yield (
            f"{counts.n_repeated:,} points have the key of another point "
            "(tiles that overlap, or coarse times)"
        )
    if n_different := counts.n_in_order + counts.n_by_majority:
        yield (
            f"{counts.n_shared:,} points have several labels of their key, "
            f"which differ for {n_different:,}: "
            f"{counts.n_in_order:,} were paired in record order, "
            f"{counts.n_by_majority:,} got the most frequent one"
        )
    if counts.n_other_return:
        yield (
            f"{counts.n_other_return:,} points have a label of their time, of another return; "
            "they keep their class"
        )


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
        details = {
            "labels": None if self.labels is None else asdict(self.labels),
            "points": None if self.points is None else asdict(self.points),
            "counts": None if self.counts is None else asdict(self.counts),
        }
        return {**RunRecord.as_dict(self), "transfer": details}


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
    """Write the registered file again with the classes of a raw run; it is complete or absent.

    Parameters
    ----------
    labels : path
        LAS or LAZ with classes, text with classes and times, or labels only (``.npy``, ``.csv``,
        ``.parquet``, ...) in the order of ``points``. Code 0 of label files (a shot without return)
        is left out.
    registered : path
        LAS or LAZ. Points without partner keep their class. Nothing else changes.
    output : path
        ``.las`` or ``.laz``.
    options : TransferOptions, optional
        How records are matched; default: by gps_time and return number.
    points : path, optional
        Record input (text, raw dump, LAS) of the labels. Needed if the label file has only labels.
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
        If a side is damaged or lacks the key, if labels and points differ in number, if less than
        ``options.min_matched`` of the smaller side is matched, or if a larger share of the matches
        than 1 - ``min_matched`` is ambiguous (several different labels).
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
    is_transferred = np.zeros(256, np.bool_)
    carried = list(options.carry)
    if options.min_confidence is not None and CONFIDENCE not in carried:
        carried.append(CONFIDENCE)
    with LasRecoder(output, Input.of(registered), options.carry) as writer, ExitStack() as stack:
        for joined in _partners(sides, tuple(carried), options, tally, stack):
            record = joined.left[RECORD]
            codes = joined.left[CODE].copy()
            points_at = joined.left_index
            labels_at = joined.right_index
            if options.min_confidence is not None:
                is_sure = joined.right[CONFIDENCE][labels_at] >= options.min_confidence
                n_unsure += len(is_sure) - int(np.count_nonzero(is_sure))
                points_at = points_at[is_sure]
                labels_at = labels_at[is_sure]
            codes[points_at] = joined.right[CODE][labels_at]
            is_transferred[codes[points_at]] = True
            n_changed += int(np.count_nonzero(codes != joined.left[CODE]))
            writer.put(record, codes)
            if options.carry:
                values = {name: joined.right[name][labels_at] for name in options.carry}
                writer.put_values(record[points_at], values)
            n_done += len(record)
            if n_points := sides.points.n_records:
                report_share(progress, min(n_done / n_points, 1.0))
            if progress is not None:
                progress(len(record))
        counts = counts_of(tally, n_changed, sides)
        refuse_poor_match(counts, tally, sides, options)
        for path, state in zip(inputs, before, strict=True):
            check_unchanged(path, state)
        notices = list(sides.notices)
        if options.min_confidence is not None:
            notices.append(
                f"{n_unsure:,} points keep their class: "
                f"their label has a confidence below {options.min_confidence} %"
            )
        notices.extend(notices_of(counts))
        stored = TransferRecord(
            config={"transfer": options.as_dict()},
            input=fingerprint(registered),
            format=sides.points.format,
            points_per_line=0,
            n_records=sides.surveys[1].n_records,
            assumptions=tuple(sides.assumptions),
            notices=tuple(notices),
            labels=fingerprint(labels),
            points=None if points is None else fingerprint(points),
            counts=counts,
        )
        names = ClassCodes().user_names()
        if suffix_of(labels) in LAS_SUFFIXES:
            names |= names_of_file(labels)
        writer.name_classes({code: name for code, name in names.items() if is_transferred[code]})
        return TransferSummary(output, writer.finish(stored), counts)


def _partners(
    sides: TransferSides,
    carried: tuple[str, ...],
    options: TransferOptions,
    tally: JoinTally,
    stack: ExitStack,
) -> Iterator[Joined]:
    """Yield the registered points (left) with their labels (right)."""
    if options.match != "nearest":
        names = (KEY, SAME, CODE)
        labels_survey, points_survey = sides.surveys
        target = columns_of(sides.points, names, sort=not points_survey.in_order)
        origin = columns_of(sides.labels, (*names, *carried), sort=not labels_survey.in_order)
        match = NearestLabel(sides.tolerance)
        yield from merge_join(
            target,
            origin,
            match,
            sides.tolerance,
            tally,
            sides.points.path,
            sides.labels.path,
            spare=SPARE_LABELS,
        )
        return
    points = _cloud(sides.points, (), stack)
    labels = _cloud(sides.labels, carried, stack)
    fit = fit_of(points, labels)
    sides.tolerance = options.tolerance_s or (1.0 if fit is None else fit.tolerance_m)
    why = "given" if options.tolerance_s else "beyond it few more points find a label"
    sides.assumptions.append(Assumption("transfer.tolerance_m", f"{sides.tolerance:g}", why))
    shift = shift_of(labels, points)
    if shift is not None:
        sides.notices.append(f"the registered points are shifted {shift_text(shift)}")
    for nearest in nearest_join(points, labels, sides.tolerance, tally):
        points_at = np.flatnonzero(nearest.partner_index >= 0)
        yield Joined(nearest.left, nearest.right, points_at, nearest.partner_index[points_at])


def _cloud(side: Source, carried: tuple[str, ...], stack: ExitStack) -> Cloud:
    columns = columns_of(side, (*AXES, CODE, *carried), sort=False)
    return Cloud(columns, stack.enter_context(scratch_file("matching")))


def _state(path: Path) -> tuple[int, ...]:
    try:
        return file_state(path)
    except OSError as error:
        raise InputError(
            str(path), f"cannot be read ({error.strerror or error})", "check the name"
        ) from error
