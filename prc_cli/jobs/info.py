"""``prc info``: the contents of a file, and whether the chosen method can classify it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.config import LoadedConfig, MethodChoice, resolve
from prc_cli.core.brief import finite
from prc_cli.core.errors import ConfigError, EvidenceError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.findings import (
    CHECK_NAMES,
    LABEL_CHECKS,
    Doubted,
    Finding,
    Verdict,
    accept,
    refuse,
)
from prc_cli.core.stream import Assumption, ReadTally
from prc_cli.core.types import F32
from prc_cli.formats.clock import with_clock
from prc_cli.formats.input import Input
from prc_cli.formats.las.vlrs import names_of_file
from prc_cli.formats.options import InputConfig, parse_rate
from prc_cli.formats.records import (
    Contents,
    Reading,
    RecordChunk,
    Source,
    filtered,
    watched_contents,
)
from prc_cli.formats.sorting import sorted_by_time
from prc_cli.jobs.choice import decide_and_open
from prc_cli.jobs.path import hold_against
from prc_cli.streams.beams import with_beams
from prc_cli.streams.evidence.periods import (
    PeriodEstimate,
    RangeCorrelation,
    TimedScan,
    estimate_line_frequency,
    estimate_points_per_line,
    first_times,
    measure_rates,
    range_correlation,
)
from prc_cli.streams.evidence.watch import watched
from prc_cli.streams.grid import open_grid
from prc_cli.streams.head import first_ranges, shots_in_time
from prc_cli.streams.open import open_input
from prc_cli.streams.order import (
    OrderEvidence,
    OrderWatch,
    order_hint,
    take_turns,
)
from prc_cli.streams.registered.comparison import Comparison
from prc_cli.streams.registered.drive import Drive
from prc_cli.streams.registered.source import sorts_by_itself
from prc_cli.streams.registered.spinning_drive import SpinningDrive
from prc_cli.streams.rules import (
    MEASURED,
    NO_RANGES,
    POINTS,
    POINTS_HINT,
    is_timed_cloud,
    only_times_tell,
    trusting,
)
from prc_cli.streams.stream import Stream

RATE_OFF = 1e-3
"""If rates differ by more, a note says so: a line would be off by some columns."""
SAMPLE_SHOTS = 4_000_000
"""Number of ranges from the start of a file for the median, the correlation and M."""
SOME_SHOTS = 1 << 18
"""Number of these ranges for the estimate of M if M is known."""


@dataclass(frozen=True, slots=True)
class StreamFacts:
    """Counts and statistics of a stream."""

    n_lines: int
    n_shots: int
    n_missing: int
    """Shots without return."""
    scanners: tuple[int, ...]
    range_m: tuple[float, float, float] | None
    """Smallest, median (of the sample) and largest range [m]; None if ranges are not known."""
    line_hz: float | None
    """Scan lines a second, from the times of the lines [Hz]."""
    tally: ReadTally
    correlation: RangeCorrelation | None


@dataclass(frozen=True, slots=True)
class Inspection(Doubted):
    """Everything ``prc info`` prints of one file."""

    path: str
    size: int
    format: str
    n_records: int | None
    dimensions: tuple[str, ...]
    points_per_line: int | None
    period: PeriodEstimate | None
    """Estimate of M from the ranges; None if ranges are not known."""
    order: OrderEvidence | None
    """Order of the records by their times; None without times."""
    facts: StreamFacts | None
    assumptions: tuple[Assumption, ...] = ()
    header: dict[str, Any] = field(default_factory=dict)
    """Values of the file's header (LAS, LAZ)."""
    notes: tuple[str, ...] = ()
    method: str = "prc"
    """The method that the user named or prc chose."""
    choice: MethodChoice | None = None
    """Choice of the method; None = the user named it."""
    findings: tuple[Finding, ...] = ()
    """Results of all checks that need no labels."""
    problem: str = ""
    """Why prc cannot classify the file; empty if it can."""
    hint: str = ""
    mend: str = ""
    """The option with which prc can classify the file, if prc has tried it."""
    rates: TimedScan | None = None
    """Rates of the scanner, measured from the times; None if they are not measured."""
    contents: Contents | None = None
    """Contents of the records; None if the file is not a list of records."""
    missing: tuple[str, ...] = ()
    """Options of the command line that are still needed, with the measured values."""
    drive: Drive | SpinningDrive | None = None
    """The paths found from the points of a registered cloud (``range = "points"``)."""
    comparisons: tuple[Comparison, ...] = ()
    """Comparison of the given trajectory with the path found, per scanner (``--check-path``)."""

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values, undefined figures as None."""
        table: dict[str, Any] = finite(asdict(replace(self, drive=None)))
        table.pop("drive")
        table["path_found"] = None if self.drive is None else _path_as_dict(self.drive)
        table["contents"] = None if self.contents is None else self.contents.as_dict()
        table["classifiable"] = not self.problem
        table["doubts"] = [answer.check for answer in self.doubts]
        answered = {*LABEL_CHECKS, *(answer.check for answer in self.findings)}
        # checks that need a longer stream, times or scan angles
        table["checks_not_asked"] = [name for name in CHECK_NAMES if name not in answered]
        for finding in table["findings"]:
            finding["verdict"] = Verdict(finding["verdict"]).name.lower()
        if self.order is not None:
            table["order"]["sentence"] = self.order.sentence()
        return table


def _path_as_dict(drive: Drive | SpinningDrive) -> dict[str, Any]:
    passes: list[dict[str, Any]] = [finite(asdict(figures)) for figures in drive.figures]
    return {"n_scanners": drive.n_scanners, "n_unplaced": drive.n_unplaced, "passes": passes}


def inspect(
    path: Path,
    loaded: LoadedConfig,
    *,
    deep: bool = False,
    checks_path: bool = False,
) -> Inspection:
    """Read a file once or twice and describe its contents.

    Parameters
    ----------
    path
        The file.
    loaded
        The configuration.
    deep
        Decode every layer of LAZ.
    checks_path
        Compare the given trajectory with the path that is found from the points.
    """
    scan, loaded = resolve(path, loaded)
    if checks_path:
        return _with_comparisons(scan, loaded, deep=deep)
    return _inspect_for_method(scan, loaded, deep=deep)


def _inspect_for_method(scan: Input, loaded: LoadedConfig, *, deep: bool) -> Inspection:
    """Choose the method if none is named, and describe the input for it."""
    loaded, opened = decide_and_open(scan, loaded, trust_order=True)
    if deep:
        _decode(scan)
    inspection = _inspect(scan, loaded, opened)
    choice = loaded.choice
    assumptions = (
        inspection.assumptions if choice is None else (choice.assumption, *inspection.assumptions)
    )
    return replace(
        inspection,
        method=loaded.config.method,
        choice=choice,
        notes=(*loaded.notes, *inspection.notes),
        assumptions=assumptions,
    )


def _with_comparisons(scan: Input, loaded: LoadedConfig, *, deep: bool) -> Inspection:
    """Describe a file and its trajectory, also a refused one: the path may show why."""
    drive, comparisons, finding = hold_against(scan, loaded)
    try:
        inspection = _inspect_for_method(scan, loaded, deep=deep)
    except InputError as refusal:
        inspection = _describe(scan, scan.records(), None, None, refusal, judged=False)
    (finding,) = accept([finding], loaded.config.input.accept_doubts or ())
    inspection = replace(
        inspection, drive=drive, comparisons=comparisons, findings=(finding, *inspection.findings)
    )
    is_against = finding.verdict is Verdict.AGAINST and not finding.is_accepted
    if not is_against and not (inspection.problem and finding.option):
        return inspection
    # the path may explain why the reader refused the trajectory
    return replace(
        inspection, problem=finding.problem, hint=finding.hint, mend=finding.option, missing=()
    )


def _decode(scan: Input) -> None:
    """Decode every byte of a file of records."""
    source = scan.records()
    if source is not None:
        every_byte = source.with_reading(Reading(checks_layers=True))
        for _ in every_byte.chunks(source.dimensions):
            pass


def _inspect(scan: Input, loaded: LoadedConfig, opened: Stream | None = None) -> Inspection:
    source = scan.records()
    source = None if source is None else with_clock(source, loaded.config.input.time_unit)
    stream, refusal = _try_open(scan, loaded) if opened is None else (opened, None)
    judged = loaded.config.input.order == "require" and (
        source is None or not sorts_by_itself(source, loaded.config.input)
    )
    if stream is not None:
        needs = loaded.config.classifier.method().needs
        stream = watched(
            stream, loaded.config.input, refuses=False, needs=needs, others=loaded.findings
        )
    if source is None:
        if stream is None:
            raise refusal if refusal is not None else InputError(str(scan), "cannot be opened")
        return _describe(scan, None, stream, _line_order(stream), refusal, judged=judged)
    contents = Contents(class_names=names_of_file(scan.path) if scan.is_las else {})
    order = _time_order(source, contents)
    if stream is not None and _fires_in_turns(stream):
        order = _line_order(stream, in_turns=True)
    inspection = _inspect_records(scan, loaded, source, stream, refusal, order)
    drive = None
    if stream is not None and loaded.config.input.range == "points":
        drive = stream.drive
    return replace(inspection, contents=contents, drive=drive)


def _inspect_records(
    scan: Input,
    loaded: LoadedConfig,
    source: Source,
    stream: Stream | None,
    refusal: InputError | ConfigError | None,
    order: OrderEvidence | None,
) -> Inspection:
    """Describe a file of records, and try options that make it readable."""
    judged = loaded.config.input.order == "require" and not sorts_by_itself(
        source, loaded.config.input
    )
    if stream is None and is_timed_cloud(source, loaded.config.input):
        # prc computes a path from points only if the user asks for it
        lines = None if only_times_tell(source) else _lines_only(source, loaded.config.input)
        unread = _describe(scan, source, lines, order, refusal, judged=False, with_ranges=False)
        return replace(unread, problem=NO_RANGES, hint=POINTS_HINT, missing=(POINTS,))
    if stream is None:
        inspection = _describe(
            scan,
            source,
            _lines_only(source, loaded.config.input),
            order,
            refusal,
            judged=judged,
            with_ranges=False,
        )
        if "range" in source.dimensions:
            inspection = _with_estimate(
                scan, loaded, inspection, estimate_points_per_line(first_ranges(source))
            )
        inputs = loaded.config.input
        is_asked = inputs.lines == "auto" or (
            inputs.lines.startswith("time:") and inputs.columns == "auto"
        )
        # only the times show lines and columns
        is_asked &= inputs.range != "points"
        if (
            not inspection.mend
            and is_asked
            and only_times_tell(source)
            and inputs.points_per_line is None
        ):
            inspection = _with_rates(inspection, source, loaded.config.input)
        return inspection
    described = _describe(scan, source, stream, order, refusal, judged=judged)
    described = _with_other_rates(described, source, loaded.config.input)
    if described.problem or not judged or described.facts is None:
        return described
    tally = described.facts.tally
    if not (tally.n_time_steps_back or tally.n_unplaced or tally.n_collisions):
        return described
    # so far the order was trusted; prc classify may refuse it
    error = _refusal_of(scan, loaded)
    return (
        described if error is None else replace(described, problem=error.problem, hint=error.hint)
    )


def _with_rates(refused: Inspection, source: Source, inputs: InputConfig) -> Inspection:
    """Measure the rates of a scanner from its times, and list the options to type."""
    is_sorted = inputs.order == "sort-time"
    in_order = is_sorted or refused.order is None or refused.order.is_chronological
    rates = _measured_rates(sorted_by_time(source) if is_sorted else source) if in_order else None
    if rates is None:
        # the hint names prc info, which runs just now
        _, names_info, other_hints = refused.hint.partition(MEASURED)
        if not names_info:
            return refused
        return replace(refused, hint=f"the times show no constant rates; {other_hints}")
    options = [f"--lines time:{rates.line_hz:.9g}", f"--columns time:{rates.shot_hz:.10g}"]
    options.append(f"--set input.time_origin={rates.time_origin_s!r}")
    problem = "the file has times, but no scan lines and no columns"
    hint = f"use the rates that prc measured from the times: {_shown_rates(rates)}"
    return replace(refused, rates=rates, missing=tuple(options), problem=problem, hint=hint)


def _with_other_rates(inspection: Inspection, source: Source, inputs: InputConfig) -> Inspection:
    """Note that the given rates differ from the measured ones."""
    if (
        not (inputs.lines.startswith("time:") and inputs.columns.startswith("time:"))
        or inspection.facts is None
    ):
        return inspection
    rates = _measured_rates(sorted_by_time(source) if inputs.order == "sort-time" else source)
    if rates is None:
        return inspection
    off = max(
        abs(parse_rate(inputs.lines) / rates.line_hz - 1),
        abs(parse_rate(inputs.columns) / rates.shot_hz - 1),
    )
    note = f"the times show {_shown_rates(rates)}; --lines and --columns differ"
    return replace(
        inspection, rates=rates, notes=(*inspection.notes, *([note] if off > RATE_OFF else []))
    )


def _shown_rates(rates: TimedScan) -> str:
    return (
        f"{rates.shot_hz:.8g} shots and {rates.line_hz:.6g} lines a second, "
        f"M = {rates.points_per_line}"
    )


def _measured_rates(source: Source) -> TimedScan | None:
    """Measure the rates from the first shots."""
    names = ("time", "z") if "z" in source.dimensions else ("time",)
    parts = [
        [np.asarray(shots[name], np.float64) for name in names]
        for shots in shots_in_time(source, names, SAMPLE_SHOTS)
    ]
    return (
        measure_rates(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        if parts
        else None
    )


def _with_estimate(
    scan: Input,
    loaded: LoadedConfig,
    refused: Inspection,
    period: PeriodEstimate,
) -> Inspection:
    """Add the estimate of M to an input that cannot be opened, and try it if it differs from M."""
    refused = replace(refused, period=period)
    inputs = loaded.config.input
    estimate = period.points_per_line
    if (
        estimate is None
        or estimate == inputs.points_per_line
        or inputs.lines not in ("auto", "fixed")
    ):
        return refused
    estimated = inputs.model_copy(update={"points_per_line": estimate})
    try:
        tried = _inspect(
            scan, replace(loaded, config=loaded.config.model_copy(update={"input": estimated}))
        )
    except InputError:
        return refused
    if tried.problem:
        return refused
    option = f"-M {estimate}"
    return replace(
        refused, hint=f"give {option}: the ranges repeat after {estimate} shots", mend=option
    )


def _refusal_of(scan: Input, loaded: LoadedConfig) -> InputError | None:
    """Read the input as ``prc classify`` does; return the error if it is refused."""
    try:
        for _ in open_input(scan, loaded.config.input).blocks():
            pass
    except InputError as error:
        return error
    return None


def _try_open(
    scan: Input, loaded: LoadedConfig
) -> tuple[Stream | None, InputError | ConfigError | None]:
    """Open a stream as ``prc classify``, but count breaks of the order; without refused beams."""
    try:
        inputs = trusting(scan.records(), loaded.config.input)
        # as in prc classify, values that the method does not need are not read and not checked
        stream = open_input(scan, inputs, geometry=loaded.config.needs_beams)
    except (InputError, ConfigError) as refusal:
        return None, refusal
    if not loaded.config.needs_beams:
        return stream, None
    try:
        directed = with_beams(stream, inputs)
        if stream.info.facts.has_scans or inputs.scanner != "none":
            # the stream may be refused only when a later scan is reached
            for _ in directed.blocks():
                pass
    except (InputError, ConfigError) as refusal:
        return stream, refusal
    return directed, None


def _describe(
    scan: Input,
    source: Source | None,
    stream: Stream | None,
    order: OrderEvidence | None,
    refusal: InputError | ConfigError | None,
    *,
    judged: bool,
    with_ranges: bool = True,
) -> Inspection:
    """Measure a stream; refuse its order if ``prc classify`` does."""
    facts = None
    sample = None
    if stream is not None:
        try:
            facts, sample = _measure(stream, with_ranges=with_ranges)
        except InputError:
            # records out of order cause incomplete lines: report the order, not the line
            if order is None or order.is_chronological:
                raise
    findings = () if stream is None or not with_ranges else tuple(stream.observed.findings)
    problem, hint = _verdict(scan, order, findings, refusal, judged=judged)
    info = None if stream is None else stream.info
    source_facts = SourceFacts()
    file_format = ""
    n_records = None
    if info is not None:
        source_facts = info.facts
        file_format = info.format
        n_records = info.n_records
    if source is not None:
        source_facts = source_facts if info is not None else source.facts
        file_format = source.format
        n_records = n_records if source.n_records is None else source.n_records
    return Inspection(
        path=str(scan),
        size=scan.path.stat().st_size,
        format=file_format,
        n_records=n_records,
        dimensions=() if source is None else source.dimensions,
        points_per_line=None if info is None else info.points_per_line,
        # if M is known, a part of the ranges is enough to test it
        period=None if sample is None else estimate_points_per_line(sample[:SOME_SHOTS]),
        order=order,
        facts=facts,
        assumptions=() if info is None else info.assumptions,
        header=dict(source_facts.header),
        notes=source_facts.notes,
        findings=findings,
        problem=problem,
        hint=hint,
    )


def _verdict(
    scan: Input,
    order: OrderEvidence | None,
    findings: tuple[Finding, ...],
    refusal: InputError | ConfigError | None,
    *,
    judged: bool,
) -> tuple[str, str]:
    if judged and order is not None and not order.is_chronological:
        problem = f"not in the order the shots were fired: {order.sentence()}"
        return problem, order_hint(order, str(scan), can_sort=order.what != "time_s")
    if refusal is not None:
        return refusal.problem, refusal.hint
    try:
        refuse("", findings)
    except EvidenceError as error:
        return error.problem, error.hint
    return "", ""


def _measure(stream: Stream, *, with_ranges: bool) -> tuple[StreamFacts, F32 | None]:
    """Read a stream to its end; return the counts and the ranges at its start."""
    n_lines = n_shots = n_missing = kept = 0
    low = math.inf
    high = -math.inf
    scanners: set[int] = set()
    tally = ReadTally()
    sample: list[F32] = []
    line_times: list[np.ndarray] = []
    for block in stream.blocks():
        missing = np.isnan(block.range_m)
        n_lines += block.n_lines
        n_shots += block.range_m.size
        n_missing += int(missing.sum())
        scanners.add(block.scanner)
        tally += block.tally
        if not missing.all():
            low = min(low, float(np.nanmin(block.range_m)))
            high = max(high, float(np.nanmax(block.range_m)))
        if block.scanner == min(scanners) and kept < SAMPLE_SHOTS:
            sample.append(block.range_m.ravel()[: SAMPLE_SHOTS - kept])
            kept += sample[-1].size
            if block.time_s is not None:
                line_times.append(first_times(block.time_s))
    flat = np.concatenate(sample) if sample else np.empty(0, np.float32)
    ranges = (low, float(np.nanmedian(flat)), high) if with_ranges and low <= high else None
    times = np.concatenate(line_times) if line_times else np.empty(0, np.float64)
    line_hz = stream.info.line_hz
    if line_hz is None:
        line_hz = estimate_line_frequency(times)
    correlation = range_correlation(flat) if ranges is not None else None
    facts = StreamFacts(
        n_lines, n_shots, n_missing, tuple(sorted(scanners)), ranges, line_hz, tally, correlation
    )
    return facts, flat if ranges is not None else None


def _time_order(source: Source, contents: Contents) -> OrderEvidence | None:
    """Read the records once, count their contents, and return the order of the times."""
    watch = OrderWatch.of(source, "trust") if "time" in source.dimensions else None
    for chunk in watched_contents(source, contents):
        if watch is not None:
            watch.see(np.asarray(chunk.values["time"], np.float64), chunk.record)
    return None if watch is None else watch.evidence()


def _fires_in_turns(stream: Stream) -> bool:
    """Return whether the rings of records fire in another order than they lie."""
    return stream.grid is not None and bool(stream.grid.find_turns())


def _line_order(stream: Stream, *, in_turns: bool = False) -> OrderEvidence | None:
    """Return the order of the times of the scanner with most breaks; None without times.

    ``in_turns``: the rings are known to fire in another order than they lie.
    """
    watches: dict[int, OrderWatch] = {}
    for block in stream.blocks():
        if block.time_s is None:
            return None
        watch = watches.setdefault(block.scanner, OrderWatch(stream.info.path, "trust", "time_s"))
        # the shots of a line are fired at different times: compare the first ring
        time_s = (
            block.time_s[:, 0]
            if in_turns or stream.info.facts.has_line_times or take_turns(block)
            else block.time_s.ravel()
        )
        watch.see(time_s, None)
    scanners = [watch.evidence() for watch in watches.values()]
    return max(scanners, key=lambda order: (order.n_back, order.n_steps), default=None)


def _with_unit_ranges(source: Source) -> Source:
    """Return a source whose ranges are all 1, to find lines without ranges."""

    def chunks(names: tuple[str, ...], stored: Source) -> Iterator[RecordChunk]:
        for chunk in stored.chunks(tuple(name for name in names if name != "range")):
            yield replace(chunk, values={**chunk.values, "range": np.ones(chunk.n)})

    def facts_of(facts: SourceFacts) -> SourceFacts:
        # the caller reports the notes
        return replace(facts, notes=())

    dimensions = tuple(dict.fromkeys(("range", *source.dimensions)))
    return filtered(source, chunks, dimensions=dimensions, facts_of=facts_of)


def _lines_only(source: Source, inputs: InputConfig) -> Stream | None:
    """Find the lines of an input without ranges; None if they cannot be found."""
    inputs = trusting(source, inputs)
    if inputs.order == "require":
        return None
    try:
        lines = open_grid(
            _with_unit_ranges(source), inputs.model_copy(update={"range": "dimension:range"})
        )
        return Stream.of(lines)
    except (InputError, ConfigError):
        return None
