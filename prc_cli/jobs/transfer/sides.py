"""Opens and surveys the two inputs of a transfer; refuses inputs that cannot be matched."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import suffix_of
from prc_cli.core.stream import Assumption
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.input import Input
from prc_cli.formats.labels import open_codes
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.las.vlrs import same_crs
from prc_cli.formats.options import Layout
from prc_cli.formats.records import CLASS_CODE, CodeSource, Source, nearest_first
from prc_cli.formats.registry import by_suffix, format_of
from prc_cli.jobs.coordinates import placed_source
from prc_cli.jobs.transfer.options import TransferOptions
from prc_cli.matching.keys import AXES, KeyRule
from prc_cli.matching.sides import CONFIDENCE, Survey, classified, survey, with_codes, with_key
from prc_cli.streams.order import WEEK_S, over_weeks

GPS_EPOCH_SHIFT_S = 1e9
"""Adjusted standard GPS time is GPS time less this [s] (LAS 1.4, global encoding bit 0)."""
_ROUNDING_STEPS = 2.0
"""Steps of float64 by which equal times may differ."""


@dataclass(slots=True)
class TransferSides:
    """The two inputs, and the assumptions about them."""

    labels: Source
    points: Source
    """With keys and classes; see :func:`prc_cli.matching.sides.with_key`."""
    rule: KeyRule
    """The key of the labels."""
    surveys: tuple[Survey, Survey]
    """Of the labels and the points."""
    tolerance: float
    """Largest difference of the keys of a point and its label: [s], or [m] for ``nearest``."""
    step_s: float = math.inf
    """Mean step between the times of the labels [s]; infinite for other keys."""
    assumptions: list[Assumption] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)


def check_paths(
    labels: Path,
    registered: Path,
    output: Path,
    points: Path | None,
) -> None:
    """Refuse files whose suffix does not fit their role."""
    if output.suffix.lower() not in LAS_SUFFIXES:
        raise ConfigError(
            str(output), f"found suffix {output.suffix!r}, expected .las or .laz", "name OUT so"
        )
    target = Input.of(registered)
    if not target.is_las and registered.exists():
        problem = f"found suffix {target.suffix!r}, expected the registered points as .las or .laz"
        raise InputError(str(registered), problem, "give LABELS first, then REGISTERED, then OUT")
    target.check()
    suffix = suffix_of(labels)
    if suffix in LAS_SUFFIXES:
        Input.of(labels).check()
        if points is not None:
            problem = "has its own keys, expected no --points with it"
            raise ConfigError(
                str(labels),
                problem,
                "leave out --points, or give the labels as .npy, .csv or .parquet",
            )
        return
    known = by_suffix("codes")
    if suffix not in known:
        others = " ".join(name for name in known if name not in LAS_SUFFIXES)
        problem = f"found suffix {suffix!r}, expected classes: .las .laz {others}"
        raise InputError(
            str(labels), problem, "classify the raw input first: prc classify RAW LABELS"
        )


def open_sides(
    labels: Path,
    registered: Path,
    points: Path | None,
    layout: Layout | None,
    options: TransferOptions,
) -> TransferSides:
    """Open and survey both sides."""
    target = LasSource(registered)
    if options.trajectory is None:
        origin = _open_labelled(labels, points, layout, options)
    elif options.match != "nearest" or points is None:
        problem = "gives coordinates to the shots of --points, expected these and --match nearest"
        raise ConfigError("--trajectory", problem, "or leave it out")
    else:
        crs = target.facts.crs_wkt
        origin = placed_source(
            points, labels, options.trajectory, options.mount, crs=crs, layout=layout
        )
    assumptions: list[Assumption] = []
    rules = _rules(options, _same(origin, target, options, assumptions))
    for source, rule in zip((origin, target), rules, strict=True):
        _demand_key(source, rule)
    classes, dimension = _classes(labels, origin, options)
    rule = rules[0]
    left = with_key(classes, rule, dimension)
    right = with_key(target, rules[1])
    surveys = survey(left), survey(right)
    if options.match == "record":
        rule = _equal_order(left, right, rule, surveys, assumptions)
        if rule != rules[0]:
            left = with_key(classes, rule, dimension)
            surveys = survey(left), surveys[1]
    sides = TransferSides(left, right, rule, surveys, 0.0, assumptions=assumptions)
    for side, its_rule, its_survey in zip((left, right), (rule, rules[1]), surveys, strict=True):
        _refuse_useless(side, its_rule, its_survey, options)
    if options.match == "time":
        _set_time_tolerance(sides, options)
    _refuse_apart(sides, options)
    labels_crs = origin.facts.crs_wkt
    points_crs = target.facts.crs_wkt
    if (
        isinstance(origin, LasSource)
        and labels_crs is not None
        and points_crs is not None
        and not same_crs(labels_crs, points_crs)
    ):
        notice = "the coordinate systems of labels and points differ"
        if options.match == "nearest":
            raise InputError(sides.labels.path, notice, "reproject one of them, or match by time")
        sides.notices.append(f"{notice}; the match does not use coordinates")
    return sides


def _set_time_tolerance(sides: TransferSides, options: TransferOptions) -> None:
    times = [abs(bound) for side in sides.surveys for bound in (side.low, side.high)]
    largest = max(*times, abs(options.time_offset_s))
    rounding = _ROUNDING_STEPS * float(np.spacing(largest))
    sides.tolerance = max(options.tolerance_s, rounding)
    why = "given" if options.tolerance_s >= rounding else "what float64 rounds at these times"
    sides.assumptions.append(Assumption("transfer.tolerance_s", f"{sides.tolerance:.3g}", why))
    labels = sides.surveys[0]
    sides.step_s = (labels.high - labels.low) / max(labels.n_records - 1, 1)
    if sides.tolerance > sides.step_s / 2:
        sides.notices.append(
            f"the tolerance of {sides.tolerance:g} s exceeds half the mean step between the labels "
            f"({sides.step_s:.2g} s): a point whose own label is missing gets its neighbour's"
        )


def _open_labelled(
    labels: Path,
    points: Path | None,
    layout: Layout | None,
    options: TransferOptions,
) -> Source:
    if suffix_of(labels) in LAS_SUFFIXES:
        return LasSource(labels)
    if points is not None:
        scan = Input.of(points, layout)
        source = scan.records()
        if source is None:
            problem = (
                f"found a range image or an organised scan ({scan.suffix}), "
                "expected a list of records"
            )
            raise InputError(str(scan), problem, "classify it to .las, and transfer that")
        return source
    if options.match == "record" or options.match.startswith("record:"):
        # the key is the order, which the label file has
        return open_codes(labels, options.dimension)
    form = format_of(labels)
    if form is not None and form.records:
        table = Input.of(labels, layout).records()
        if table is not None and set(_rules(options, ())[0].names) <= set(table.dimensions):
            return table
    problem = f"contains only classes, expected a key to match by {options.match}"
    raise InputError(str(labels), problem, "name the input of the labels: --points RAW")


def _classes(labels: Path, origin: Source, options: TransferOptions) -> tuple[Source, str]:
    """Return the records with a class, and the dimension that holds it."""
    # seconds of week may wrap within a drive, but the times of the points do not
    source = over_weeks(origin) if abs(options.time_offset_s) > WEEK_S / 2 else origin
    if suffix_of(labels) in LAS_SUFFIXES:
        name = options.dimension or "classification"
        _demand_dimensions(origin, (name, *options.carry))
        if options.min_confidence is not None and CONFIDENCE not in origin.dimensions:
            problem = f"no dimension {CONFIDENCE!r} in {labels}"
            raise ConfigError(
                "--min-confidence", problem, "classify again with --set output.confidence=true"
            )
        return source, name
    if options.min_confidence is not None:
        raise ConfigError(
            "--min-confidence", f"{labels} contains only classes, expected classified LAS or LAZ"
        )
    if options.carry:
        raise ConfigError(
            "--carry", f"{labels} contains only classes, expected classified LAS or LAZ"
        )
    if isinstance(origin, CodeSource):
        return classified(source), CLASS_CODE
    return with_codes(source, open_codes(labels, options.dimension)), CLASS_CODE


def _refuse_useless(side: Source, rule: KeyRule, records: Survey, options: TransferOptions) -> None:
    if not records.n_records:
        raise InputError(
            side.path, "no record has a class, expected classes to transfer", "check --dimension"
        )
    if records.n_records > 1 and records.low == records.high:
        key = "gps_time" if options.match == "time" else rule.dimension
        problem = (
            f"all {records.n_records:,} values of {key} are {records.low:g}, expected one a shot"
        )
        raise InputError(side.path, problem, "match by another key with --match")


def _same(
    origin: Source,
    target: LasSource,
    options: TransferOptions,
    assumptions: list[Assumption],
) -> tuple[str, ...]:
    # dimensions that must be equal in addition to the key
    for source in (origin, target):
        _demand_dimensions(source, options.same)
    if options.match != "time" or options.ignore_return:
        return options.same
    if "return_number" not in origin.dimensions:
        why = "the labels have no return numbers: every return of a shot gets its class"
        assumptions.append(Assumption("transfer.ignore_return", "true", why))
        return options.same
    return ("return_number", *options.same)


def _rules(options: TransferOptions, same: tuple[str, ...]) -> tuple[KeyRule, KeyRule]:
    kind, _, name = options.match.partition(":")
    if kind == "nearest":
        return KeyRule("place", AXES[0], same), KeyRule("place", AXES[0], same)
    if kind == "time":
        return KeyRule("time", "time", same, options.time_offset_s), KeyRule("time", "time", same)
    if kind == "dimension":
        return KeyRule("dimension", name, same), KeyRule("dimension", name, same)
    record = KeyRule("record", same=same)
    return record, KeyRule("dimension", name, same) if name else record


def _demand_key(source: Source, rule: KeyRule) -> None:
    if rule.kind == "time" and "time" not in source.dimensions:
        shown = ", ".join(source.dimensions[:20]) or "nothing"
        problem = f"no time to match by, found: {shown}"
        hint = "match by --match nearest, order, record:NAME or dimension:NAME"
        raise InputError(source.path, problem, hint)
    if rule.kind in ("dimension", "place"):
        _demand_dimensions(source, rule.key_names)


def _demand_dimensions(source: Source, names: tuple[str, ...]) -> None:
    for name in names:
        if name not in source.dimensions:
            shown = ", ".join(nearest_first(source.dimensions, name)[:40]) or "nothing"
            raise ConfigError(source.path, f"no dimension {name!r} in the file", f"it has: {shown}")


def _equal_order(
    left: Source,
    right: Source,
    rule: KeyRule,
    surveys: tuple[Survey, Survey],
    assumptions: list[Assumption],
) -> KeyRule:
    """Return the rule by which labels and points are in equal order."""
    labels, points = surveys
    # either all records match by order, or the registered file has only the shots with a return
    n_all = left.n_records or labels.n_read
    if n_all == points.n_records or labels.n_read == points.n_records:
        assumptions.append(
            Assumption("transfer.match", "record", "record i of the labels is point i")
        )
        return rule
    if labels.n_records == points.n_records:
        why = (
            "the labels without shots that have no return are as many as the points: "
            "the i-th of them is point i"
        )
        assumptions.append(Assumption("transfer.match", "record", why))
        return KeyRule("rank", same=rule.same)
    problem = (
        f"found {n_all:,} records ({labels.n_records:,} with a class), "
        f"expected {points.n_records:,} as {right.path} has, to match by equal order"
    )
    raise InputError(left.path, problem, "match by --match time, record:NAME or dimension:NAME")


def _refuse_apart(sides: TransferSides, options: TransferOptions) -> None:
    labels, points = sides.surveys
    slack = sides.tolerance
    if labels.low <= points.high + slack and points.low <= labels.high + slack:
        return
    keys = "times" if options.match == "time" else "keys"
    problem = (
        f"{keys} run from {points.low:.10g} to {points.high:.10g}, "
        f"{keys} of {sides.labels.path} from {labels.low:.10g} to {labels.high:.10g}: "
        "they do not overlap"
    )
    hint = "are these the same drive?"
    if options.match == "time" and (offset := _scale_offset(labels, points)) is not None:
        offset_s, meaning = offset
        hint = f"{meaning}: --time-offset {offset_s + options.time_offset_s:.0f}"
    raise InputError(sides.points.path, problem, hint)


def _scale_offset(labels: Survey, points: Survey) -> tuple[float, str] | None:
    # offset [s] between two common time scales that aligns labels and points, and its meaning
    labels_in_weeks = "the labels look like seconds of the GPS week"
    points_in_weeks = "the points look like seconds of the GPS week"
    adjusted = "one side looks like GPS time, the other like adjusted standard GPS time"
    offsets = [
        (_week_start(points.low + GPS_EPOCH_SHIFT_S) - GPS_EPOCH_SHIFT_S, labels_in_weeks),
        (GPS_EPOCH_SHIFT_S - _week_start(labels.low + GPS_EPOCH_SHIFT_S), points_in_weeks),
        (GPS_EPOCH_SHIFT_S, adjusted),
        (-GPS_EPOCH_SHIFT_S, adjusted),
        (_week_start(points.low), labels_in_weeks),
        (-_week_start(labels.low), points_in_weeks),
    ]
    for offset_s, meaning in offsets:
        if labels.low + offset_s <= points.high and points.low <= labels.high + offset_s:
            return offset_s, meaning
    return None


def _week_start(time_s: float) -> float:
    return WEEK_S * math.floor(time_s / WEEK_S)
