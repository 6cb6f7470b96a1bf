"""Calibration: estimates properties of the sensor from a stream, and parameters from them.

:mod:`.sensor` measures noise and steps. :mod:`.implied` counts support and background at all
thresholds, and derives parameters from both. :mod:`.search` tries parameters against a reference in
a second pass.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.config import LoadedConfig, RunConfig, resolve
from prc_cli.core.blocks import regroup
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import output_errors
from prc_cli.core.findings import Doubted, Finding
from prc_cli.core.stream import FAR_M, ReadTally, ScanStream
from prc_cli.core.types import I64
from prc_cli.evaluation.confusion import refuse_poor_match
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.scores import scores
from prc_cli.formats.labels import open_codes
from prc_cli.formats.records import CodeSource
from prc_cli.jobs.calibrate.implied import Advice, CurveCounter, Curves, imply
from prc_cli.jobs.calibrate.search import (
    MEAN_F1,
    Group,
    Judged,
    Searcher,
    SearchResult,
    Tried,
    axes_of,
    check_objective,
    confusion,
    figure,
    figures,
    split_groups,
    with_values,
)
from prc_cli.jobs.calibrate.sensor import SensorEstimate, SensorMeter
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import open_for_method
from prc_cli.jobs.progress import advance
from prc_cli.jobs.run import Progress
from prc_cli.methods.prc.surfaces import area_threshold
from prc_cli.streams.evidence.watch import watched

SHOTS_AT_ONCE = 1 << 18
"""Shots measured at a time; it changes only the pairs of lines across two chunks."""
LEAST_LINES = 3
"""Scan lines that a support decision needs: the line of the shot and both neighbours."""
GROUPS = 40
"""Number of line groups for training and held-out lines, unless they become too large."""
NOTHING = (
    "fused measures the sensor in every run: there is nothing to calibrate, "
    "and the configuration changes nothing"
)
STAYS_OPEN = (
    "the configuration leaves the method open: "
    "where the angles of the beams are known, fused is taken all the same"
)


@dataclass(frozen=True, slots=True)
class SearchOptions:
    """Options of the search."""

    reference: Path
    mapping: ClassMapping | str | Path = "prc"
    dimension: str | None = None
    """Column or dimension with the reference codes."""
    objective: str = MEAN_F1
    training_share: float = 0.6
    """Share of the line groups used for training."""
    budget: int = 300
    """Largest number of parameter sets tried."""
    seed: int = 0
    """Seed for drawing the training lines."""
    max_shots: int = 4_000_000
    """Most shots kept in memory, training and held-out together.

    Longer streams are sampled by groups.
    """
    keep: tuple[str, ...] = ()
    """Keys that are not searched; they take the value implied by the sensor."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration(Doubted):
    """Result of a calibration."""

    path: str
    sensor: SensorEstimate
    curves: Curves
    advice: tuple[Advice, ...]
    """Values to write, with reasons."""
    config: LoadedConfig
    """The calibrated configuration; its sources hold the reasons."""
    search: SearchResult | None = None
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    """Results of all checks of the stream."""

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values for JSON."""
        support = self.config.config.prc.support
        # the published figure fixes the other threshold at 1 m
        table: dict[str, Any] = {
            "path": self.path,
            "sensor": self.sensor.as_dict(),
            "curves": self.curves.as_dict(1.0, 1.0),
            "supported_share": self.curves.share(support.zeta_p, support.zeta_s),
            "advice": [asdict(item) for item in self.advice],
            "notes": list(self.notes),
            "doubts": [doubt.as_dict() for doubt in self.doubts],
        }
        if self.search is not None:
            table["search"] = asdict(self.search)
        return table


def calibrate(
    source: Path | str,
    config: LoadedConfig | None = None,
    search: SearchOptions | None = None,
    *,
    progress: Progress | None = None,
    tried: Tried | None = None,
) -> Calibration:
    """Derive parameters from a stream, and from a reference if given.

    Parameters
    ----------
    source : path
        Any readable input.
    config : LoadedConfig, optional
        How the stream is read, and the initial parameters. If it names no method, the method that
        would be chosen is calibrated: the parameters of PRC, or nothing for ``fused``.
    search : SearchOptions, optional
        Reference and options of the search. Without it the sensor implies the parameters.
    progress : callable, optional
        Called with the number of lines that were just read.
    tried : callable, optional
        Called after every trial of the search.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the stream is damaged, has fewer than three lines or no range; if the reference has
        another number of records, codes that the mapping does not list, or no scored record.
    EvidenceError
        If a check of the stream fails; ``input.accept_doubts`` lists accepted checks.
    ConfigError
        If the objective or an option of the search is invalid.
    """
    loaded = config if config is not None else LoadedConfig(RunConfig())
    prepared = None if search is None else _prepare(search, loaded.config)
    scan, with_layout = resolve(source, loaded)
    decided = decide(scan, with_layout)
    run = decided.config
    stream = open_for_method(scan, run)
    watch = watched(stream, run.input)
    sensor, curves, lines, n_records = _measure(watch, run, progress)
    advice, notes = _implied(sensor, curves, decided)
    result = None
    if not advice and search is not None:
        notes = (*notes, f"{search.reference.name} was not used")
    elif prepared is not None and search is not None:
        mapping, codes = prepared
        n_records = stream.info.n_records or n_records
        training, held_out = _groups(
            stream, run, codes, mapping, search, lines, n_records, progress
        )
        result, search_notes = _search(run, advice, mapping, training, held_out, search, tried)
        advice = _found_advice(advice, result, run)
        notes = (*notes, *search_notes)
    values = {item.key: item.value for item in advice}
    sources = {**loaded.sources, **{item.key: f"prc calibrate: {item.reason}" for item in advice}}
    calibrated = replace(loaded, config=with_values(loaded.config, values), sources=sources)
    return Calibration(
        str(scan),
        sensor,
        curves,
        advice,
        calibrated,
        result,
        notes,
        tuple(watch.observed.findings),
    )


def _implied(
    sensor: SensorEstimate, curves: Curves, decided: LoadedConfig
) -> tuple[tuple[Advice, ...], tuple[str, ...]]:
    # advice for the method (none for fused), and notes
    run = decided.config
    choice = decided.choice
    if run.method == "fused":
        why = "" if choice is None else f" (taken because {choice.why})"
        return (), (f"{NOTHING}{why}; for PRC's parameters give --method prc", *_notes(sensor))
    notes = _notes(sensor)
    if choice is not None:
        notes = (f"{choice.why}: PRC is calibrated; {STAYS_OPEN}", *notes)
    return imply(sensor, curves, run.prc, run.sequential_angle.angles.range_noise_m), notes


def _prepare(search: SearchOptions, config: RunConfig) -> tuple[ClassMapping, CodeSource]:
    # checks the options before the stream is read
    mapping = (
        search.mapping if isinstance(search.mapping, ClassMapping) else load_mapping(search.mapping)
    )
    check_objective(search.objective, mapping)
    axes_of(config, search.keep)
    if not 0 < search.training_share < 1:
        where = "--training-share"
        raise ConfigError(
            where, f"found {search.training_share:g}, expected a share between 0 and 1"
        )
    return mapping, open_codes(search.reference, search.dimension)


def _measure(
    stream: ScanStream, config: RunConfig, progress: Progress | None
) -> tuple[SensorEstimate, Curves, dict[int, int], int]:
    """Read the stream once; also return the lines of every scanner and the number of records."""
    meter = SensorMeter(stream.info)
    counter = CurveCounter(config.prc)
    lines: dict[int, int] = {}
    tally = ReadTally()
    info = stream.info
    for block in regroup(
        stream.blocks(), max(LEAST_LINES, SHOTS_AT_ONCE // stream.info.points_per_line)
    ):
        meter.add(block)
        counter.add(block)
        lines[block.scanner] = lines.get(block.scanner, 0) + block.n_lines
        tally = tally + block.tally
        advance(progress, block, info, config.input.window)
    path = stream.info.path
    if max(lines.values(), default=0) < LEAST_LINES:
        problem = (
            f"found {sum(lines.values())} scan lines, expected {LEAST_LINES} or more: "
            "support needs lines around"
        )
        raise InputError(path, problem, "check -M and --lines, or calibrate on a longer piece")
    if meter.n_missing == meter.n_shots:
        problem = f"all of {meter.n_shots} shots are missing, expected ranges"
        raise InputError(path, problem, "check --range and the layout; see prc info")
    return meter.finish(), counter.finish(), lines, tally.n_records


def _groups(
    stream: ScanStream,
    config: RunConfig,
    codes: CodeSource,
    mapping: ClassMapping,
    search: SearchOptions,
    lines: dict[int, int],
    n_records: int,
    progress: Progress | None,
) -> tuple[tuple[Group, ...], tuple[Group, ...]]:
    """Read the stream again and keep the drawn line groups, training and held-out."""
    k = config.prc.lines_per_block
    m = stream.info.points_per_line
    length_of_group = -(-sum(lines.values()) // (GROUPS * k)) * k
    length = max(k, min(length_of_group, search.max_shots // 10 // m // k * k))
    # a remainder of less than half a group is left out
    n_groups = sum(n // length + (2 * (n % length) >= length) for n in lines.values())
    order = np.random.default_rng(search.seed).permutation(n_groups)
    kept = sorted(order[: max(2, search.max_shots // (length * m))].tolist())
    training, held_out = split_groups(len(kept), search.training_share, search.seed)
    groups: list[Group] = []
    with tempfile.TemporaryFile(prefix="prc-calibrate-") as spool:
        classes = _spool(codes, mapping, spool, n_records, stream.info.path)
        number = 0
        for block in regroup(stream.blocks(), length):
            if progress is not None:
                progress(block.n_lines)
            if 2 * block.n_lines < length:
                continue
            if number in kept:
                record = block.records().ravel()
                truth: I64 = np.where(record >= 0, classes[np.maximum(record, 0)], -1).astype(
                    np.int64
                )
                # drop what the classifiers do not use, to save memory
                light = replace(
                    block,
                    record=None,
                    time_s=None,
                    intensity=None,
                    extra=type(block.extra).none(),
                    next_m=None,
                    first_line=0,
                    scanner=0,
                    is_last=True,
                )
                groups.append(Group(light, truth))
            number += 1
        del classes
    return tuple(groups[i] for i in training), tuple(groups[i] for i in held_out)


def _spool(
    codes: CodeSource,
    mapping: ClassMapping,
    spool: Any,
    n_records: int,
    path: str,
) -> Any:
    """Write the reference class of every record to a temporary file.

    Return it as a memory-mapped array.
    """
    n = n_scored = 0
    for chunk in codes.codes():
        rows = mapping.class_indices(chunk, "reference").astype("<i2")
        n += len(rows)
        n_scored += int(np.count_nonzero(rows >= 0))
        if n <= n_records:
            with output_errors(Path(tempfile.gettempdir()) / "prc-calibrate"):
                spool.write(rows.tobytes())
    refuse_poor_match(n, n_records, codes.path, path)
    if not n_scored:
        problem = (
            f"none of {n} records has a class that is scored, "
            "expected a reference that overlaps the stream"
        )
        raise InputError(codes.path, problem, "check --mapping and --reference-dimension")
    with output_errors(Path(tempfile.gettempdir()) / "prc-calibrate"):
        spool.flush()
    return np.memmap(spool, "<i2", "r", shape=(n,))


def _search(
    config: RunConfig,
    advice: tuple[Advice, ...],
    mapping: ClassMapping,
    training: tuple[Group, ...],
    held_out: tuple[Group, ...],
    search: SearchOptions,
    tried: Tried | None,
) -> tuple[SearchResult, tuple[str, ...]]:
    # searches, evaluates the result, and notes its limits
    for name, side in (("training", training), ("held-out", held_out)):
        if not any((group.reference >= 0).any() for group in side):
            problem = f"no {name} line has a class that is scored"
            raise InputError(
                str(search.reference), problem, "choose another --seed or --training-share"
            )
    implied = {item.key: item.value for item in advice}
    axes = axes_of(config, search.keep)
    kept = with_values(config, {key: implied[key] for key in search.keep if key in implied})
    m = training[0].block.points_per_line
    configured = {axis.key: _configured(config, axis.key, m) for axis in axes}
    start = {key: float(implied.get(key, value)) for key, value in configured.items()}
    searcher = Searcher(
        kept, mapping, training, search.objective, max(2, search.budget), axes, tried
    )
    values = searcher.run((configured, start))
    tables = {"configured": {}, "from the sensor": implied, "search": {**implied, **values}}
    judged = []
    has_noise = False
    for name, configured_values in tables.items():
        sides = [
            scores(confusion(side, with_values(config, configured_values), mapping))
            for side in (training, held_out)
        ]
        has_noise = has_noise or any(
            class_scores.name == "noise" and class_scores.n_reference
            for class_scores in sides[0].classes
        )
        judged.append(Judged(name, *(figures(side, search.objective) for side in sides)))
    notes = (*_blind(values, has_noise=has_noise), *_doubts(judged, search.objective))
    n_training = sum(group.block.range_m.size for group in training)
    n_held_out = sum(group.block.range_m.size for group in held_out)
    result = SearchResult(
        search.objective,
        values,
        searcher.n_trials,
        n_training,
        n_held_out,
        len(training),
        len(held_out),
        tuple(judged),
    )
    return result, notes


def _configured(config: RunConfig, key: str, points_per_line: int) -> float:
    value = attrgetter(key)(config)
    if value == "auto":
        k = config.prc.lines_per_block
        return area_threshold(config.prc.surfaces, k, k, points_per_line)
    return float(value)


def _found_advice(
    advice: tuple[Advice, ...], result: SearchResult, config: RunConfig
) -> tuple[Advice, ...]:
    """Replace values implied by the sensor with those of the search."""
    by_key = {item.key: item for item in advice}
    unchanged = tuple(item for item in advice if item.key not in result.values)
    new = []
    for key, value in result.values.items():
        before = by_key[key].before if key in by_key else _configured(config, key, 1)
        reason = f"best of {result.n_trials} trials for {result.objective} on the training lines"
        if key in by_key:
            reason += f"; the sensor alone implies {by_key[key].value:g}: {by_key[key].reason}"
        new.append(Advice(key, before, value, reason))
    return (*unchanged, *new)


def _notes(sensor: SensorEstimate) -> tuple[str, ...]:
    notes = []
    if (middle := sensor.range_quantiles_m["50%"]) > FAR_M:
        notes.append(
            f"the median range is some {middle / 1000:.0f} km: beyond {FAR_M / 1000:g} km the "
            "origin of the scanner is wrong, or the unit; see prc info, and do not use these "
            "parameters"
        )
    if sensor.sigma_m is None:
        notes.append("no stretch of the stream is flat: the noise of the sensor was not measured")
    if sensor.step_rad is None:
        notes.append(f"the angular step was not measured: {sensor.step_source}")
    return tuple(notes)


def _blind(values: Iterable[str], *, has_noise: bool) -> tuple[str, ...]:
    """Warn that wide thresholds are not penalised if the reference has no noise class."""
    if has_noise or not any(key.startswith("prc.support.") for key in values):
        return ()
    return (
        "the reference holds no noise, so wide thresholds look fine: where noise "
        "matters, keep those of the sensor with --keep prc.support.zeta_p "
        "--keep prc.support.zeta_s",
    )


def _doubts(judged: Sequence[Judged], objective: str) -> tuple[str, ...]:
    """Warn if the result of the search is worse on held-out lines than its start."""
    value = {item.name: figure(item.held_out, objective) for item in judged}
    return tuple(
        "on the held-out lines the values "
        f"{'as configured' if name == 'configured' else name} reach {objective} "
        f"{value[name]:.3f}, those of the search {value['search']:.3f}: "
        "the training lines are too few or too unlike them"
        for name in list(value)[:-1]
        if value[name] > value["search"]
    )


__all__ = ["Calibration", "SearchOptions", "calibrate"]
