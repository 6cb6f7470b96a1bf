"""Carries the classes of a raw run onto the registered points of the same drive.

Both sides are surveyed (a damaged side is refused before any work), brought into the order of their keys (sorted on
disk where they are not), merge-joined, and the classes go back to the registered file's record order through a spool.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import check_output, remove_stale, suffix_of
from prc_cli.core.stream import Assumption
from prc_cli.formats import (
    LAS_SUFFIXES,
    READERS,
    check_input,
    open_source,
)
from prc_cli.formats.labels.read import open_codes
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.las.rewrite import CARRIED, LasRecoder
from prc_cli.formats.options import Layout
from prc_cli.formats.records import RecordSource
from prc_cli.formats.writing.record import (
    Fingerprint,
    RunRecord,
    fingerprint,
    record_path,
)
from prc_cli.matching.join import JoinTally, join
from prc_cli.matching.keys import (
    CODE,
    KEY,
    MAX_SAME,
    SAME,
    KeyedSource,
    KeyRule,
    Survey,
    in_key_order,
    survey,
)
from prc_cli.stream.gps_weeks import WEEK_S, WeekSource

CHANCE = 0.25
"""Half of the times that have nothing to do with the labels' lie within this share of the step between these."""
GPS_EPOCH_SHIFT_S = 1e9
"""Adjusted standard GPS time is GPS time less this [s] (LAS 1.4, global encoding bit 0)."""
_LABEL_SUFFIXES = (".npy", ".npz", ".csv", ".csv.gz", ".csv.zst", ".txt", ".txt.gz", ".txt.zst", ".parquet", ".label")
_ROUNDING_STEPS = 2.0


@dataclass(frozen=True, slots=True)
class TransferOptions:
    """How records of the two sides find each other."""

    by: str = "time"
    """``time``; ``record`` (equal order), ``record:NAME`` (a dimension of the registered file that holds the index of
    the raw record, from 0); ``dimension:NAME`` (an integer dimension of both sides)."""
    tolerance_s: float = 0.0
    """Largest difference of times [s]; what float64 rounds at these times is always allowed."""
    time_offset_s: float = 0.0
    """Added to the times of the labels [s]."""
    ignore_return: bool = False
    """Match by the key alone, though both sides have return numbers."""
    same: tuple[str, ...] = ()
    """Further integer dimensions that must be equal, such as ``scanner_channel``; at most two."""
    dimension: str | None = None
    """Column or dimension with the class codes; default as :func:`~prc_cli.formats.labels.read.open_codes`."""
    carry: tuple[str, ...] = ()
    """Dimensions of classified LAS labels that go along: ``segment_id``, ``range``, ``surface``, ``dense_vegetation``,
    ``ground_height``."""
    min_match: float = 0.5
    """Share of the smaller side that must find a partner, and of the points that do that must find a certain one."""

    def __post_init__(self) -> None:
        kind, _, name = self.by.partition(":")
        if self.by not in ("time", "record") and not (kind in ("record", "dimension") and name):
            raise ConfigError("--by", f"found {self.by!r}, expected time, record, record:NAME or dimension:NAME")
        if not (math.isfinite(self.tolerance_s) and self.tolerance_s >= 0):
            raise ConfigError("--tolerance", f"found {self.tolerance_s}, expected seconds, 0 or more")
        if not math.isfinite(self.time_offset_s):
            raise ConfigError("--time-offset", f"found {self.time_offset_s}, expected seconds")
        if self.by != "time" and (self.tolerance_s or self.time_offset_s):
            problem = f"--tolerance and --time-offset are for times, found --by {self.by}"
            raise ConfigError("--by", problem, "leave them out")
        if not 0 <= self.min_match <= 1:
            raise ConfigError("--min-match", f"found {self.min_match}, expected a share from 0 to 1")
        if len(self.same) >= MAX_SAME:
            raise ConfigError("--same", f"found {len(self.same)} dimensions, expected at most {MAX_SAME - 1}")
        for name in self.carry:
            if name not in CARRIED:
                raise ConfigError("--carry", f"found {name!r}, expected one of {', '.join(CARRIED)}")


@dataclass(frozen=True, slots=True)
class TransferCounts:
    """How many records found a partner."""

    n_labels: int
    """Label records with a class (shots without return left out)."""
    n_labels_matched: int
    n_points: int
    """Records of the registered file."""
    n_matched: int
    """Points that got the class of a label; the others keep theirs."""
    n_changed: int
    """Points whose class became another one."""
    n_repeated: int
    """Matched points whose key another point has too."""
    n_shared: int
    """Matched points whose key several labels have."""
    n_in_order: int
    """Of these, points that were paired in record order though the labels differ."""
    n_by_majority: int
    """Of these, points that got the most frequent of several differing labels."""
    n_other_return: int
    """Points without partner whose key has a label of another return (or other ``same``)."""
    largest_difference: float
    """Largest difference of the keys of a point and its label [s for times]."""

    @property
    def share(self) -> float:
        """Share of the smaller side that found a partner."""
        if self.n_points <= self.n_labels:
            return self.n_matched / self.n_points if self.n_points else 0.0
        return self.n_labels_matched / self.n_labels if self.n_labels else 0.0


@dataclass(frozen=True)
class TransferRecord(RunRecord):
    """A :class:`RunRecord` whose ``input`` is the registered file."""

    labels: Fingerprint | None = None
    """The file with the classes."""
    points: Fingerprint | None = None
    """The input that the labels belong to, where they have no keys of their own."""
    counts: TransferCounts | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the record as nested plain values."""
        own = {key: None if value is None else asdict(value) for key, value in
               (("labels", self.labels), ("points", self.points), ("counts", self.counts))}  # fmt: skip
        return {**RunRecord.as_dict(self), "transfer": own}


@dataclass(frozen=True, slots=True)
class TransferSummary:
    """What a transfer did."""

    output: Path
    record: RunRecord
    """Provenance and what was written, as stored in the output; ``.notices`` is what the user should know."""
    counts: TransferCounts


@dataclass(slots=True)
class _Sides:
    """What the two inputs are, and what was taken for granted."""

    labels: KeyedSource
    points: KeyedSource
    found: tuple[Survey, Survey]
    tolerance: float
    step_s: float = math.inf
    """Mean step between the times of the labels [s]; infinite for other keys."""
    assumptions: list[Assumption] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)


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
    """Write the registered file again with the classes of a raw run; the output exists whole or not at all.

    Parameters
    ----------
    labels : path
        LAS or LAZ with classes, text with classes and times, or labels alone (``.npy``, ``.csv``, ``.parquet``, ...) in
        the order of ``points``. Label files' code 0 (a shot without return) is left out.
    registered : path
        LAS or LAZ. Points without partner keep their class; all else stays as it is.
    output : path
        ``.las`` or ``.laz``.
    options : TransferOptions, optional
        How records find each other; default by gps_time and return number.
    points : path, optional
        Record input (text, raw dump, LAS) that the labels belong to; must be given with labels alone.
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
        When a side is damaged or lacks the key, labels and points differ in number, or fewer than
        ``options.min_match`` of the smaller side find a partner, or more than the rest of those several that differ.
    OutputError, ConfigError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    options = options or TransferOptions()
    labels, registered, output = Path(labels), Path(registered), Path(output)
    points = None if points is None else Path(points)
    inputs = tuple(path for path in (labels, points, registered) if path is not None)
    _check(labels, registered, output, points)
    for path in (output, record_path(output)):
        check_output(path, overwrite=overwrite, inputs=inputs)
        remove_stale(path)
    before = [_state(path) for path in inputs]
    sides = _open(labels, registered, points, layout, options)
    tally = JoinTally()
    with LasRecoder(output, registered, options.carry) as writer:
        left = in_key_order(sides.labels, sides.found[0], (KEY, SAME, CODE, *options.carry))
        right = in_key_order(sides.points, sides.found[1], (KEY, SAME, CODE))
        paths = (sides.labels.path, sides.points.path)
        matches = join(left, right, tally, tolerance=sides.tolerance, carried=options.carry, paths=paths)
        for item in matches:
            writer.put(item.record, item.codes)
            if options.carry:
                writer.put_values(item.record[item.matched], item.values)
            if progress is not None:
                progress(len(item.record))
        counts = _counts(tally, sides)
        _refuse_poor_match(counts, tally, sides, options)
        for path, state in zip(inputs, before, strict=True):
            if _state(path) != state:
                raise InputError(str(path), "changed while it was read", "run again when the copy is complete")
        record = TransferRecord(
            config={"transfer": asdict(options)},
            input=fingerprint(registered),
            format=sides.points.format,
            points_per_line=0,
            n_records=sides.found[1].n_records,
            assumptions=tuple(sides.assumptions),
            notices=(*sides.notices, *_notices(counts)),
            labels=fingerprint(labels),
            points=None if points is None else fingerprint(points),
            counts=counts,
        )
        return TransferSummary(output, writer.finish(record), counts)


def _check(labels: Path, registered: Path, output: Path, points: Path | None) -> None:
    """Refuse files that cannot be what they are named for."""
    if output.suffix.lower() not in LAS_SUFFIXES:
        raise ConfigError(str(output), f"found suffix {output.suffix!r}, expected .las or .laz", "name OUT so")
    suffix = suffix_of(registered)
    if suffix not in LAS_SUFFIXES and registered.exists():
        problem = f"found suffix {suffix!r}, expected the registered points as .las or .laz"
        raise InputError(str(registered), problem, "give LABELS first, then REGISTERED, then OUT")
    check_input(registered)
    suffix = suffix_of(labels)
    if suffix in LAS_SUFFIXES:
        check_input(labels)
        if points is not None:
            problem = "has keys of its own, expected no --points with it"
            raise ConfigError(str(labels), problem, "leave out --points, or give the labels as .npy, .csv or .parquet")
        return
    if suffix not in _LABEL_SUFFIXES:
        problem = f"found suffix {suffix!r}, expected classes: .las .laz {' '.join(_LABEL_SUFFIXES)}"
        raise InputError(str(labels), problem, "classify the raw input first: prc classify RAW LABELS")


def _state(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror or error})", "check the name") from error
    return found.st_size, found.st_mtime_ns


def _open(
    labels: Path, registered: Path, points: Path | None, layout: Layout | None, options: TransferOptions
) -> _Sides:
    """Open and survey both sides."""
    target = LasSource(registered)
    origin = _open_labelled(labels, points, layout, options)
    assumptions: list[Assumption] = []
    rules = _rules(options, _same(origin, target, options, assumptions))
    for source, rule in zip((origin, target), rules, strict=True):
        _demand(source, rule)
    left, right = _keyed_labels(labels, origin, rules[0], options), KeyedSource(target, rules[1])
    found = survey(left), survey(right)
    if options.by == "record":
        left, found = _equal_order(left, right, found, assumptions)
    sides = _Sides(left, right, found, 0.0, assumptions=assumptions)
    for side, what in zip((left, right), found, strict=True):
        _refuse_useless(side, what, options)
    if options.by == "time":
        largest = max(abs(bound) for item in found for bound in (item.low, item.high))
        rounding = _ROUNDING_STEPS * float(np.spacing(max(largest, abs(options.time_offset_s))))
        sides.tolerance = max(options.tolerance_s, rounding)
        why = "given" if options.tolerance_s >= rounding else "what float64 rounds at these times"
        assumptions.append(Assumption("transfer.tolerance_s", f"{sides.tolerance:.3g}", why))
        sides.step_s = (found[0].high - found[0].low) / max(found[0].n_records - 1, 1)
        if sides.tolerance > sides.step_s / 2:
            text = f"the tolerance of {sides.tolerance:g} s exceeds half the mean step between the labels "
            text += f"({sides.step_s:.2g} s): a point whose own label is missing gets its neighbour's"
            sides.notices.append(text)
    _refuse_apart(sides, options)
    if isinstance(origin, LasSource) and (notice := _crs_notice(origin, target)):
        sides.notices.append(notice)
    return sides


def _open_labelled(labels: Path, points: Path | None, layout: Layout | None, options: TransferOptions) -> RecordSource:
    """Open the records that the labels belong to."""
    if suffix_of(labels) in LAS_SUFFIXES:
        return LasSource(labels)
    if points is not None:
        source = open_source(points, layout)
        if source is None:
            problem = f"found a range image or an organised scan ({suffix_of(points)}), expected a list of records"
            raise InputError(str(points), problem, "classify it to .las, and transfer that")
        return source
    if options.by == "record" or options.by.startswith("record:"):
        # the order is the key, and the labels have that themselves
        return _CodesAlone(open_codes(labels, options.dimension))
    if suffix_of(labels) in READERS:
        table = open_source(labels, layout)
        if table is not None and set(_rules(options, ())[0].names) <= set(table.dimensions):
            return table
    problem = f"holds classes alone, expected something to match by {options.by}"
    raise InputError(str(labels), problem, "name the input they belong to: --points RAW")


def _keyed_labels(labels: Path, origin: RecordSource, rule: KeyRule, options: TransferOptions) -> KeyedSource:
    # seconds of week begin again within a drive; what they are matched with does not
    source = WeekSource(origin) if abs(options.time_offset_s) > WEEK_S / 2 else origin
    if suffix_of(labels) in LAS_SUFFIXES:
        name = options.dimension or "classification"
        _demand_dimensions(origin, (name, *options.carry))
        return KeyedSource(source, rule, code_dimension=name)
    if options.carry:
        raise ConfigError("--carry", f"{labels} holds classes alone, expected classified LAS or LAZ")
    return KeyedSource(source, rule, open_codes(labels, options.dimension))


def _refuse_useless(side: KeyedSource, found: Survey, options: TransferOptions) -> None:
    if not found.n_records:
        raise InputError(side.path, "no record has a class, expected classes to transfer", "check --dimension")
    if found.all_equal:
        key = "gps_time" if options.by == "time" else side.rule.dimension
        problem = f"all {found.n_records:,} values of {key} are {found.low:g}, expected one a shot"
        raise InputError(side.path, problem, "match by something else with --by")


@dataclass(frozen=True)
class _CodesAlone:
    """Labels without records: their number and order is all that is known."""

    codes: Any
    format: str = "labels"
    dimensions: tuple[str, ...] = ()

    @property
    def path(self) -> str:
        return str(self.codes.path)

    @property
    def n_records(self) -> int | None:
        return None if self.codes.n is None else int(self.codes.n)

    def chunks(self, names: tuple[str, ...]) -> Iterator[Any]:
        from prc_cli.formats.records import RecordChunk

        first = 0
        for codes in self.codes.chunks():
            yield RecordChunk(first, {}, len(codes))
            first += len(codes)


def _same(
    origin: RecordSource, target: LasSource, options: TransferOptions, assumptions: list[Assumption]
) -> tuple[str, ...]:
    """Return what must be equal beside the key."""
    for source in (origin, target):
        _demand_dimensions(source, options.same)
    if options.by != "time" or options.ignore_return:
        return options.same
    if "return_number" not in origin.dimensions:
        why = "the labels have no return numbers: every return of a shot gets its class"
        assumptions.append(Assumption("transfer.ignore_return", "true", why))
        return options.same
    return ("return_number", *options.same)


def _rules(options: TransferOptions, same: tuple[str, ...]) -> tuple[KeyRule, KeyRule]:
    kind, _, name = options.by.partition(":")
    if kind == "time":
        return KeyRule("time", "time", same, options.time_offset_s), KeyRule("time", "time", same)
    if kind == "dimension":
        return KeyRule("dimension", name, same), KeyRule("dimension", name, same)
    return KeyRule("record", same=same), KeyRule("dimension", name, same) if name else KeyRule("record", same=same)


def _demand(source: RecordSource, rule: KeyRule) -> None:
    """Refuse a side that lacks the key."""
    if rule.kind == "time" and "time" not in source.dimensions:
        shown = ", ".join(source.dimensions[:20]) or "nothing"
        problem = f"no time to match by, found: {shown}"
        hint = "match by --by record, record:NAME or dimension:NAME"
        raise InputError(source.path, problem, hint)
    if rule.kind == "dimension":
        _demand_dimensions(source, (rule.dimension,))


def _demand_dimensions(source: RecordSource, names: tuple[str, ...]) -> None:
    for name in names:
        if name not in source.dimensions:
            shown = ", ".join(source.dimensions[:40]) or "nothing"
            raise ConfigError(source.path, f"no dimension {name!r} in the file", f"it has: {shown}")


def _equal_order(
    left: KeyedSource, right: KeyedSource, found: tuple[Survey, Survey], assumptions: list[Assumption]
) -> tuple[KeyedSource, tuple[Survey, Survey]]:
    """Match by order: of all records, or of those with a return where the registered file has only these."""
    labels, points = found
    n_all = left.source.n_records or labels.n_read
    if n_all == points.n_records or labels.n_read == points.n_records:
        assumptions.append(Assumption("transfer.by", "record", "record i of the labels is point i"))
        return left, found
    if labels.n_records == points.n_records:
        why = "the labels without shots that have no return are as many as the points: the i-th of them is point i"
        assumptions.append(Assumption("transfer.by", "record", why))
        rule = KeyRule("rank", same=left.rule.same)
        return KeyedSource(left.source, rule, left.codes, left.code_dimension), (survey(KeyedSource(
            left.source, rule, left.codes, left.code_dimension)), points)  # fmt: skip
    problem = f"found {n_all:,} records ({labels.n_records:,} with a class), expected {points.n_records:,} as "
    problem += f"{right.path} has, to match by equal order"
    raise InputError(left.path, problem, "match by --by time, record:NAME or dimension:NAME")


def _refuse_apart(sides: _Sides, options: TransferOptions) -> None:
    """Refuse keys that have nothing in common, with the offset between usual time scales that would help."""
    labels, points = sides.found
    slack = sides.tolerance
    if labels.low <= points.high + slack and points.low <= labels.high + slack:
        return
    what = "times" if options.by == "time" else "keys"
    problem = f"{what} run from {points.low:.10g} to {points.high:.10g}, those of {sides.labels.path} from "
    problem += f"{labels.low:.10g} to {labels.high:.10g}: nothing overlaps"
    hint = "are these the same drive?"
    if options.by == "time" and (offset := _scale_offset(labels, points)) is not None:
        hint = f"{offset[1]}: --time-offset {offset[0] + options.time_offset_s:.0f}"
    raise InputError(sides.points.path, problem, hint)


def _scale_offset(labels: Survey, points: Survey) -> tuple[float, str] | None:
    """Return the offset between two usual time scales that brings the labels to the points, and what it means."""
    weeks = "the labels look like seconds of the GPS week"
    to_weeks = "the points look like seconds of the GPS week"
    other = "one side looks like GPS time, the other like adjusted standard GPS time"
    tries = [
        (WEEK_S * math.floor((points.low + GPS_EPOCH_SHIFT_S) / WEEK_S) - GPS_EPOCH_SHIFT_S, weeks),
        (-(WEEK_S * math.floor((labels.low + GPS_EPOCH_SHIFT_S) / WEEK_S) - GPS_EPOCH_SHIFT_S), to_weeks),
        (GPS_EPOCH_SHIFT_S, other),
        (-GPS_EPOCH_SHIFT_S, other),
        (WEEK_S * math.floor(points.low / WEEK_S), weeks),
        (-(WEEK_S * math.floor(labels.low / WEEK_S)), to_weeks),
    ]
    for offset, what in tries:
        if labels.low + offset <= points.high and points.low <= labels.high + offset:
            return offset, what
    return None


def _counts(tally: JoinTally, sides: _Sides) -> TransferCounts:
    return TransferCounts(
        n_labels=sides.found[0].n_records,
        n_labels_matched=tally.n_labels_matched,
        n_points=tally.n_points,
        n_matched=tally.n_matched,
        n_changed=tally.n_changed,
        n_repeated=tally.n_repeated,
        n_shared=tally.n_shared,
        n_in_order=tally.n_in_order,
        n_by_majority=tally.n_by_majority,
        n_other_return=tally.n_other_return,
        largest_difference=tally.largest,
    )


def _refuse_poor_match(counts: TransferCounts, tally: JoinTally, sides: _Sides, options: TransferOptions) -> None:
    if counts.n_matched and counts.share >= options.min_match:
        _refuse_guesses(counts, sides, options)
        return
    problem = f"{counts.n_matched:,} of {counts.n_points:,} points and {counts.n_labels_matched:,} of "
    problem += f"{counts.n_labels:,} labels of {sides.labels.path} match, expected at least {options.min_match:.0%} "
    problem += "of the smaller side"
    unmatched = counts.n_points - counts.n_matched
    near = tally.near()
    if counts.n_other_return > unmatched / 2:
        what = "return number" if "return_number" in sides.labels.rule.same else "value of --same"
        hint = f"{counts.n_other_return:,} points have a label of their time but another {what}"
        hint += ": --ignore-return" if "return_number" in sides.labels.rule.same else ""
    elif options.by == "time" and near is not None and sides.tolerance < near < sides.step_s * CHANCE:
        hint = f"half of the points without partner have a label within {near:g} s: --tolerance {near:g}"
    elif near is not None and near < 10 * sides.step_s < math.inf:
        hint = "the times of the points fall between those of the labels: another drive, or clocks that differ "
        hint += "(UTC and GPS by 18 s, see --time-offset)"
    elif counts.n_matched:
        hint = (
            f"are these the same drive? To write it all the same: --min-match {math.floor(counts.share * 1000) / 1000}"
        )
    else:
        hint = "are these the same drive?"
    raise InputError(sides.points.path, problem, hint)


def _refuse_guesses(counts: TransferCounts, sides: _Sides, options: TransferOptions) -> None:
    """Refuse matches whose key does not tell the labels apart."""
    ordered = all(found.in_order for found in sides.found)
    # records that were moved around do not pair by their order
    n_guessed = counts.n_by_majority + (0 if ordered else counts.n_in_order)
    if n_guessed <= (1 - options.min_match) * counts.n_matched:
        return
    problem = f"{n_guessed:,} of {counts.n_matched:,} matched points have several labels of their key, which differ, "
    problem += f"expected at most {1 - options.min_match:.0%}"
    hint = "tell them apart by another value that both sides have, e.g. --same intensity or --same scanner_channel"
    raise InputError(sides.points.path, problem, hint)


def _notices(counts: TransferCounts) -> Iterator[str]:
    if counts.n_repeated:
        yield f"{counts.n_repeated:,} points have the key of another point (tiles that overlap, or coarse times)"
    if differ := counts.n_in_order + counts.n_by_majority:
        yield (
            f"{counts.n_shared:,} points have several labels of their key, which differ for {differ:,}: "
            f"{counts.n_in_order:,} were paired in record order, {counts.n_by_majority:,} got the most frequent one"
        )
    if counts.n_other_return:
        yield f"{counts.n_other_return:,} points have a label of their time, of another return; they keep their class"


def _crs_notice(origin: LasSource, target: LasSource) -> str | None:
    """Say that the coordinate systems differ; the match does not use coordinates."""
    left, right = origin.crs_wkt, target.crs_wkt
    if left is None or right is None or left == right:
        return None
    try:
        import pyproj

        if pyproj.CRS.from_user_input(left) == pyproj.CRS.from_user_input(right):
            return None
    except (ImportError, ValueError, RuntimeError):  # CRSError is a RuntimeError
        pass
    return "the coordinate systems of labels and points differ; the match does not use coordinates"
