"""Classifies one file: connects reader, classifier and writer.

Data flow: ``open_stream`` → blocks of k lines → ``label_blocks`` → writer. :func:`classify` runs
each of the three in its own threads, with short queues between them; the output does not depend on
the threads.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prc_cli.config import CHOSEN_FROM, LoadedConfig, RunConfig, resolve
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import ConfigError, DoubtWarning, InputError
from prc_cli.core.files import suffix_of
from prc_cli.core.findings import Finding, accept, doubts, refuse
from prc_cli.core.loops import Engine, Loops, load_loops, use_engine
from prc_cli.core.profile import timed, timed_items
from prc_cli.core.stream import LabelledBlock, ScanBlock, ScanStream, StreamInfo
from prc_cli.core.threads import close_items, default_threads, read_ahead, write_behind
from prc_cli.core.types import F32, F64, U8
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.input import Input
from prc_cli.formats.joined import JoinedInput
from prc_cli.formats.las import LAZ
from prc_cli.formats.outputs import open_writer, prepare_label_outputs
from prc_cli.formats.ranges import clean_ranges
from prc_cli.formats.registry import is_cloud
from prc_cli.formats.writing.columns import (
    LabelOutput,
    OutputConfig,
    Placement,
    asked_columns,
)
from prc_cli.formats.writing.record import FingerprintBeside
from prc_cli.jobs.choice import (
    choice_by_beams,
    choice_by_request,
    choose,
    decide_stream,
    decided_by,
)
from prc_cli.jobs.coordinates import placement
from prc_cli.jobs.progress import advance
from prc_cli.jobs.run import Counts, Progress, Run, RunSummary
from prc_cli.methods.base import LABELS_ALONE, MethodParams, UsualLabels, Wanted
from prc_cli.methods.run import run_blocks
from prc_cli.streams.evidence.result import ResultWatch
from prc_cli.streams.evidence.watch import accepted_by, watched
from prc_cli.streams.open import open_input
from prc_cli.streams.stream import Blocks, Stream

AHEAD = 1
"""Blocks waiting between reader and classifier, and between classifier and writer.

Each side works on one more.
"""
LEAST_SHOTS = 1 << 14
"""Smaller images are labelled without checks.

It is half of the number of shots that the checks compare in a longer image.
"""
OFF_M = 0.1
"""Largest difference between a range and the length of its coordinates, by rounding [m]."""


@dataclass(frozen=True, slots=True)
class OutputNeeds:
    """What an output needs of the blocks beside their ranges."""

    geometry: bool = False
    """Scan angles, from which a new point cloud gets coordinates."""
    only_ranges: bool = True
    """Neither times nor intensities, which only a cloud that is built from blocks has."""
    checks_layers: bool = False
    """Every layer of LAZ: all are copied as bytes, and one that is not read may be damaged."""

    @classmethod
    def of(cls, scan: Input, output: Path, options: OutputConfig) -> OutputNeeds:
        """Return the needs of a classified output."""
        makes_cloud = is_cloud(output)
        suffix = suffix_of(output)
        is_rewritten = scan.is_las and suffix in LAS_SUFFIXES
        return cls(
            geometry=makes_cloud and not scan.keeps_points(output),
            only_ranges=not makes_cloud or is_rewritten,
            checks_layers=suffix == LAZ and not asked_columns(options),
        )


ALL_VALUES = OutputNeeds(geometry=True, only_ranges=False)


def open_stream(path: Path | str, config: LoadedConfig | RunConfig | None = None) -> ScanStream:
    """Open any readable input as a stream of blocks.

    Parameters
    ----------
    path : path
        Raw binary, text, LAS/LAZ or array file.
    config : LoadedConfig or RunConfig, optional
        Rules for lines, columns and ranges (``[input]``, ``[layout]``).

    Returns
    -------
    ScanStream
        ``.info`` holds what is known before reading, ``.blocks()`` reads from the start. For all
        classifiers but PRC the blocks hold beam angles.

    Raises
    ------
    InputError
        When the file is damaged, or ranges cannot be computed from it.
    """
    scan, loaded = resolve(path, config)
    return open_for_method(scan, loaded.config)


def open_for_method(
    scan: Input | JoinedInput,
    config: RunConfig,
    output_needs: OutputNeeds = ALL_VALUES,
) -> Stream:
    """Open an input for its method and for the output; default: blocks with all values."""
    # without a method the input is read as for PRC, which needs the least
    params = config.classifier if config.is_decided else config.prc
    needs = params.method().needs
    stream = open_input(
        scan,
        config.input,
        lines_at_once=needs.lines_per_block or 1,
        geometry=output_needs.geometry or config.needs_beams,
        only_ranges=output_needs.only_ranges,
        with_intensity=needs.intensity,
        checks_layers=output_needs.checks_layers,
    )
    if not config.needs_beams:
        return stream
    # imported here: PRC needs no beams, and starts sooner without this module
    from prc_cli.streams.beams import with_beams

    return with_beams(stream, config.input)


def open_decided(
    scan: Input | JoinedInput,
    loaded: LoadedConfig,
    engine: Engine,
    output_needs: OutputNeeds,
    *,
    loading: Callable[[], AbstractContextManager[None]],
) -> tuple[LoadedConfig, Stream]:
    """Open an input for the named method, else for the method that prc chooses.

    ``loading`` is the context in which the loops of a chosen method are loaded.
    """
    config = loaded.config
    if not config.is_decided:
        stream: Stream | None = None
        choice = choice_by_request(config, engine=engine)
        if choice is None:
            # the choice needs the beams of the input: it is opened before the method is known
            stream = open_input(
                scan,
                config.input,
                lines_at_once=config.fused.method().needs.lines_per_block or 1,
                only_ranges=output_needs.only_ranges,
                checks_layers=output_needs.checks_layers,
            )
            choice, stream = choose(stream, config)
        loaded = decided_by(choice, loaded)
        with loading():
            load_classifier(loaded, engine)
        chosen = loaded.config
        lacks_intensity = output_needs.only_ranges and chosen.classifier.method().needs.intensity
        if stream is not None and chosen.needs_beams and not lacks_intensity:
            return loaded, stream
        # else this stream has more or less than the method needs, and the input is opened again
    return loaded, open_for_method(scan, loaded.config, output_needs)


def label_blocks(
    blocks: Iterator[ScanBlock],
    params: MethodParams,
    *,
    threads: int = 1,
    wanted: Wanted = LABELS_ALONE,
) -> Iterator[LabelledBlock]:
    """Classify a stream block by block, with one state per scanner."""
    if wanted.confidence:
        load_loops(confidence_loops(params))  # before threads need them
    yield from run_blocks(blocks, params.method(), threads=threads, wanted=wanted)


def wanted_by(output: OutputConfig) -> Wanted:
    """Return what ``[output]`` asks of a method."""
    return Wanted(output.segment_ids, output.stages, output.confidence, output.reason)


def confidence_loops(params: MethodParams) -> Loops:
    """Return the loops that a method calls for the confidence of labels."""
    loops = params.method().needs.confidence_loops
    if loops is None:
        problem = "this method has no confidence, expected fused"
        hint = "give --preset fused or fused-forest, which need beam angles, or confidence = false"
        raise ConfigError("output.confidence", problem, hint)
    return loops


def load_classifier(
    config: LoadedConfig | RunConfig | None = None, engine: Engine = "compiled"
) -> None:
    """Load the loops of the method, or of all methods that prc may choose.

    The first call compiles them.
    """
    config = LoadedConfig.of(config).config
    if config.is_decided:
        methods = [config.classifier]
    elif choice_by_request(config, engine=engine) is not None:
        methods = [config.prc]
    else:
        forest = config.fused.model_copy(update={"environment": "forest"})
        methods = [*(getattr(config, name) for name in CHOSEN_FROM), forest]
    loops = [loop for params in methods for loop in params.method().needs.loops]
    with use_engine(engine):
        load_loops(tuple(dict.fromkeys(loops)))


def classify(
    source: Path | str,
    output: Path | str,
    config: LoadedConfig | RunConfig | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    threads: int | None = None,
    engine: Engine = "compiled",
    loading: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> RunSummary:
    """Classify one file and write its labels; the output is complete or absent.

    Parameters
    ----------
    source : path
        Any readable input.
    output : path
        ``.las``, ``.laz``, ``.npy``, ``.csv`` or ``.parquet``.
    config : LoadedConfig or RunConfig, optional
        Default: prc chooses the method (:mod:`prc_cli.jobs.choice`); the assumption ``method`` of
        the record contains the reason.
    overwrite : bool
        Replace an existing output.
    progress : callable, optional
        Called with the number of lines just finished.
    threads : int, optional
        Threads that classify; default: one per core. If it is more than one, reading, writing and
        the fingerprint of the input have one more thread each. The output does not depend on it.
    engine : str
        ``compiled`` or ``reference``: the papers' methods in plain NumPy, SciPy and scikit-image,
        slow, in one thread, with the same labels.
    loading : callable
        Context in which the loops of a method that was chosen are loaded.

    Returns
    -------
    RunSummary
        Counts, assumptions and notices; the same record is stored in the output and beside it.

    Raises
    ------
    InputError, OutputError, ConfigError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    if engine != "compiled":  # refused before anything is read
        load_classifier(config, engine)
    scan, loaded = resolve(source, config)
    with use_engine(engine):
        return _classify(
            scan,
            Path(output),
            loaded,
            overwrite=overwrite,
            progress=progress,
            threads=threads_of(engine, threads),
            engine=engine,
            loading=loading,
        )


def threads_of(engine: Engine, threads: int | None = None) -> int:
    """Return the number of threads: by default one per core; the reference engine has one."""
    if engine == "reference":
        return 1
    return default_threads() if threads is None else threads


def _classify(
    scan: Input,
    output: Path,
    loaded: LoadedConfig,
    *,
    overwrite: bool,
    progress: Progress | None,
    threads: int,
    engine: Engine,
    loading: Callable[[], AbstractContextManager[None]],
) -> RunSummary:
    """Classify one file with the engine that is set; see :func:`classify`."""
    prepare_label_outputs(output, overwrite=overwrite, inputs=loaded.inputs(scan.path))
    run = Run(scan, loaded, progress)
    output_needs = OutputNeeds.of(scan, output, loaded.config.output)
    with timed("opening"):
        loaded, opened = open_decided(scan, loaded, engine, output_needs, loading=loading)
        run.loaded = loaded
        needs = loaded.config.classifier.method().needs
        if loaded.config.output.confidence:
            # raises an error if the method has no confidence
            confidence_loops(loaded.config.classifier)
        stream = watched(opened, loaded.config.input, needs=needs, others=loaded.findings)
    coordinates: AbstractContextManager[Placement | None] = nullcontext()
    if output_needs.geometry:
        coordinates = placement(scan, output, loaded, opened)
    with (
        FingerprintBeside(
            scan.path, threads=threads, hashes=loaded.config.input.window is None
        ) as fingerprint_beside,
        coordinates as place,
        open_writer(
            LabelOutput(
                path=output,
                source=scan,
                n_records=stream.info.n_records,
                points_per_line=stream.info.points_per_line,
                codes=loaded.config.classes,
                options=loaded.config.output,
                laz_contexts=stream.info.facts.laz_contexts,
                user_names=user_names(loaded.config),
                is_part=loaded.config.input.window is not None,
                rules=loaded.config.input,
                place=place,
            ),
            overwrite=overwrite,
        ) as writer,
    ):
        run.counts, findings, notes = write_labels(stream, writer, loaded.config, threads, progress)
        record = run.record(stream.info, findings, notes, fingerprint_beside.result())
        record = run.finish(writer, replace(record, engine=engine))
    return RunSummary(output, record, run.counts, findings)


class LabelSink(Protocol):
    """Receives labelled blocks, such as a writer."""

    def add(self, block: LabelledBlock) -> None:
        """Add the labels of a block."""


def user_names(config: RunConfig) -> dict[int, str]:
    """Return the name of every user code that the method may write."""
    written = {config.classes.code(label) for label in config.classifier.method().gives}
    return {code: name for code, name in config.classes.user_names().items() if code in written}


class Judge:
    """Checks the labels of a watched stream while they pass."""

    def __init__(self, stream: Stream, config: RunConfig) -> None:
        self._stream = stream
        self._accepted = accepted_by(config.input)
        self._params = config.classifier
        self._result = ResultWatch(usual_labels(config, stream.info), stream.info.facts)

    def label(
        self, blocks: Iterator[ScanBlock], *, threads: int = 1, wanted: Wanted = LABELS_ALONE
    ) -> Iterator[LabelledBlock]:
        """Label the blocks of the stream, as :func:`label_blocks`."""
        labelled = label_blocks(blocks, self._params, threads=threads, wanted=wanted)
        try:
            for block in labelled:
                self._result.see(block)
                yield block
        finally:
            close_items(labelled)

    def findings(self) -> tuple[Finding, ...]:
        """Return the results of all checks of the stream and its labels, at its end.

        Raises
        ------
        EvidenceError
            If a check refuses the input.
        """
        findings = (
            *self._stream.observed.findings,
            *accept(self._result.findings(), self._accepted),
        )
        refuse(self._stream.info.path, findings)
        return findings


def write_labels(
    stream: Stream,
    writer: LabelSink,
    config: RunConfig,
    threads: int,
    progress: Progress | None,
) -> tuple[Counts, tuple[Finding, ...], tuple[str, ...]]:
    """Read, classify and write in parallel; return when all threads have ended.

    The results are the counts, the results of the checks and the notices of the method.
    """
    counts = Counts.none()
    judge = Judge(stream, config)

    def write_block(block: LabelledBlock) -> None:
        nonlocal counts
        with timed("writing"):
            writer.add(block)
            counts = counts.add(block)

    with ExitStack() as stack:
        blocks = timed_items(stream.blocks(), "reading")
        pass_on: Callable[[LabelledBlock], None] = write_block
        if threads > 1:
            blocks = read_ahead(blocks, depth=AHEAD)
            stack.callback(close_items, blocks)
        labelled = judge.label(blocks, threads=threads, wanted=wanted_by(config.output))
        stack.callback(close_items, labelled)
        if threads > 1:
            # a thread of its own calls write_block
            pass_on = stack.enter_context(write_behind(write_block, depth=AHEAD)).put
        info = stream.info
        for labelled_block in labelled:
            pass_on(labelled_block)
            advance(progress, labelled_block.block, info, config.input.window)
    findings = judge.findings()
    method_notices = config.classifier.method().notices(
        counts.labels, counts.tally, segments=config.output.segment_ids
    )
    return counts, findings, method_notices


@dataclass(frozen=True, slots=True, repr=False)
class ClassifiedRanges:
    """The classes of a range image."""

    labels: U8
    """:class:`prc_cli.core.classes.Label` of every shot, (lines, M) uint8."""
    classes: ClassCodes
    """The code of every label."""
    confidence: U8 | None = None
    """Probability that a label is right, (lines, M) uint8 [%]; 0 = no return or not known.

    None unless ``config.output.confidence`` is set.
    """
    reasons: U8 | None = None
    """:class:`prc_cli.core.classes.Reason` of every shot, (lines, M) uint8.

    None unless ``config.output.reason`` is set.
    """

    @property
    def codes(self) -> U8:
        """LAS class code of every shot, (lines, M) uint8, e.g. 2 = ground, 7 = noise."""
        return self.classes.lookup()[self.labels]

    @property
    def counts(self) -> dict[str, int]:
        """Return the number of shots by class name, the most frequent class first."""
        n = np.bincount(self.labels.ravel(), minlength=len(Label))
        return {
            label.name.lower(): int(n[label])
            for label in sorted(Label, key=lambda name: -n[name])
            if n[label]
        }

    def __repr__(self) -> str:
        lines, shots = self.labels.shape
        return f"{lines:,} lines of {shots:,} shots: " + ", ".join(
            f"{k} {n:,}" for k, n in self.counts.items()
        )


def classify_ranges(
    range_m: ArrayLike,
    config: LoadedConfig | RunConfig | None = None,
    *,
    beam_rad: ArrayLike | None = None,
    angle_deg: ArrayLike | None = None,
    xyz_m: ArrayLike | None = None,
    threads: int | None = None,
    engine: Engine = "compiled",
) -> ClassifiedRanges:
    """Classify a range image that is in memory.

    Parameters
    ----------
    range_m : (lines, M) float, metres
        Chronological; NaN, infinite or not positive = missing.
    config : LoadedConfig or RunConfig, optional
        Default: ``fused`` if the beam angles are known or can be measured, else PRC.
    beam_rad : (M,) float, radians, optional
        Angle of the beam of every column from straight down; the sign is the side of the scan
        plane. All methods except PRC need it, or ``angle_deg``.
    angle_deg : (M,) float, degrees, optional
        Scan angle of every column from any zero, as in files. Straight down is
        ``config.input.nadir``, else prc finds it from ``xyz_m``, else from level ground.
    xyz_m : (lines, M, 3) float, metres, optional
        Relative to the scanner, z up. Without them sequential-angle uses ranges and beam angles.
    threads : int, optional
        Threads that classify; default: one per core. The labels do not depend on it.
    engine : str
        ``compiled`` or ``reference``, as for :func:`classify`.

    Returns
    -------
    ClassifiedRanges
        ``codes`` as in files, ``labels``, and what ``config.output`` asks for.

    Raises
    ------
    InputError
        If an array has a wrong shape, or beam angles are needed and not given.
    EvidenceError
        If a check refuses the array, for example because its columns are shuffled.
        ``config.input.accept_doubts`` names checks to accept. An image of fewer than
        :data:`LEAST_SHOTS` shots is not checked.
    ConfigError
        If the reference engine does not have the method.

    Warns
    -----
    DoubtWarning
        If a check is unsure, once per check, unless it is accepted.

    Examples
    --------
    A street 2.5 m below the scanner, a wall 8 m beside it, and one stray shot in front of the wall:

    >>> beam = np.deg2rad(np.arange(-60.0, 120.0))
    >>> ground = 2.5 / np.cos(beam).clip(0.01)
    >>> wall = 8.0 / np.sin(beam).clip(0.01)
    >>> image = np.tile(np.minimum(ground, wall), (50, 1))
    >>> image[25, 170] = 3.0
    >>> classified = classify_ranges(image, beam_rad=beam)
    >>> classified
    50 lines of 180 shots: ground 6,700, building 2,299, noise 1
    >>> classified.codes[25, [60, 140, 170]]
    array([2, 6, 7], dtype=uint8)
    """
    config = LoadedConfig.of(config).config
    ranges = np.asarray(range_m)
    if ranges.dtype.kind not in "fiu":
        raise InputError(
            "range_m", f"found values of type {ranges.dtype}, expected ranges in metres"
        )
    if engine != "compiled":
        load_classifier(config, engine)
    with use_engine(engine):
        block = _block_of(ranges, config, beam_rad, xyz_m)
        if angle_deg is None and beam_rad is not None:
            loaded = _choose_method(config, block, engine)
        else:
            loaded, block = _find_beams_and_method(config, block, angle_deg, engine)
        config = loaded.config
        needs = config.classifier.method().needs
        stream = watched(_in_memory(block), config.input, needs=needs, others=loaded.findings)
        judge = Judge(stream, config)
        is_checked = block.range_m.size >= LEAST_SHOTS
        # the stream is checked while it is read
        blocks = list(stream.blocks()) if is_checked else [block]
        labelled = list(
            judge.label(
                iter(blocks), threads=threads_of(engine, threads), wanted=wanted_by(config.output)
            )
        )
        findings = judge.findings() if is_checked else ()
    for doubt in doubts(findings):
        message = (
            f"range_m: {doubt.sentence()} (to accept it: input.accept_doubts = [{doubt.check!r}])"
        )
        warnings.warn(message, DoubtWarning, stacklevel=2)
    return ClassifiedRanges(
        labels=np.concatenate([part.labels for part in labelled]),
        classes=config.classes,
        confidence=_concatenated([part.confidence for part in labelled]),
        reasons=_concatenated([part.reasons for part in labelled]),
    )


def _concatenated(parts: Sequence[U8 | None]) -> U8 | None:
    """Return an array that all blocks have, or None if they do not have it."""
    arrays = [part for part in parts if part is not None]
    return np.concatenate(arrays) if arrays else None


def _in_memory(block: ScanBlock) -> Stream:
    """Return a range image as a stream."""
    n_lines, points_per_line = block.range_m.shape
    n_records = n_lines * points_per_line
    info = StreamInfo("range_m", "array", points_per_line, n_records, n_lines, block.angle_rad)
    return Stream.of(Blocks(info, [block]))


def _choose_method(config: RunConfig, block: ScanBlock, engine: Engine) -> LoadedConfig:
    """Choose the method, if none is named, for an image whose beam directions are given."""
    loaded = LoadedConfig(config)
    if config.is_decided:
        return loaded
    choice = choice_by_request(config, engine=engine)
    return decided_by(choice or choice_by_beams(block, iter([block])), loaded)


def usual_labels(config: RunConfig, info: StreamInfo) -> UsualLabels:
    """Return the usual shares of the labels of the method in an input of this kind.

    A limit of 0 switches its check off.
    """
    usual = config.classifier.method().usual
    if config.input.max_range is not None and config.input.max_range <= usual.reach_m:
        # farther returns were removed
        usual = replace(usual, reach_m=0.0)
    if info.facts.has_scans:
        # the share of ground varies in every scan of a tripod, which turns all around
        usual = replace(usual, vanished_share=0.0)
    return usual


def _block_of(
    raw_range_m: NDArray[Any],
    config: RunConfig,
    beam_rad: ArrayLike | None,
    xyz_m: ArrayLike | None,
) -> ScanBlock:
    """Check the arrays of a range image."""
    ranges, tally = clean_ranges(raw_range_m, config.input.min_range, config.input.max_range)
    if ranges.ndim != 2 or not ranges.size:
        raise InputError(
            "range_m", f"found an array of shape {ranges.shape}, expected (lines, points per line)"
        )
    return ScanBlock(
        first_line=0,
        range_m=np.ascontiguousarray(ranges),
        tally=tally,
        xyz_m=None if xyz_m is None else _coordinates(xyz_m, ranges),
        beam_rad=None if beam_rad is None else _beams(beam_rad, ranges.shape[1]),
    )


def _find_beams_and_method(
    config: RunConfig,
    block: ScanBlock,
    angle_deg: ArrayLike | None,
    engine: Engine,
) -> tuple[LoadedConfig, ScanBlock]:
    """Find the beam directions from angles, coordinates or ranges, and choose the method.

    Return the configuration with the method, and the block with beam directions if it needs them.
    """
    if block.beam_rad is not None:
        raise InputError("angle_deg", "found beam_rad, too, expected one of them", "leave one out")
    if angle_deg is not None:
        angle = np.deg2rad(np.asarray(angle_deg, np.float64))
        if angle.shape != (block.points_per_line,) or not np.isfinite(angle).all():
            expected = f"expected finite angles of shape ({block.points_per_line},)"
            raise InputError("angle_deg", f"found an array of shape {angle.shape}, {expected}")
        block = replace(block, angle_rad=angle)
    loaded, stream = decide_stream(
        _in_memory(replace(block, is_last=True)), LoadedConfig(config), engine=engine
    )
    return loaded, next(iter(stream.blocks()))


def _beams(beam_rad: ArrayLike, points_per_line: int) -> F64:
    """Check beam angles; angles from 0 to 2 pi are converted to (-pi, pi]."""
    beams = np.asarray(beam_rad, np.float64)
    if beams.shape != (points_per_line,):
        raise InputError(
            "beam_rad", f"found an array of shape {beams.shape}, expected ({points_per_line},)"
        )
    if not np.isfinite(beams).all():
        raise InputError(
            "beam_rad", "found an angle that is not finite, expected one for every column"
        )
    if np.abs(beams).max() > 2 * np.pi:
        problem = f"found {np.abs(beams).max():g}, expected radians from -pi to pi"
        raise InputError("beam_rad", problem, "convert degrees with np.deg2rad")
    wrapped: F64 = np.pi - np.remainder(np.pi - beams, 2 * np.pi)
    steps = np.diff(np.unwrap(wrapped))
    if np.sign(steps).sum() < 0:
        steps = -steps
    # a step back may be a step forward over a sector of more than 180 degrees without beams; then
    # all steps together make at most one turn
    n_back = np.count_nonzero(steps < 0)
    if n_back and steps.sum() + 2 * np.pi * n_back > 2 * np.pi:
        raise InputError(
            "beam_rad", "found angles that turn back, expected them to rise or fall with the column"
        )
    return wrapped


def _coordinates(xyz_m: ArrayLike, range_m: F32) -> F32:
    """Check coordinates against the ranges."""
    xyz = np.array(xyz_m, np.float32)
    if xyz.shape != (*range_m.shape, 3):
        raise InputError(
            "xyz_m", f"found an array of shape {xyz.shape}, expected {(*range_m.shape, 3)}"
        )
    xyz[~np.isfinite(xyz).all(axis=-1)] = np.nan
    have_both = ~np.isnan(range_m) & ~np.isnan(xyz[..., 0])
    distance_m = np.sqrt((xyz[have_both].astype(np.float64) ** 2).sum(axis=-1))
    difference_m = np.abs(distance_m - range_m[have_both])
    if difference_m.size and np.median(difference_m) > OFF_M:
        median_m = np.median(difference_m)
        problem = f"found points {median_m:.3g} m farther or nearer than their ranges (median)"
        raise InputError("xyz_m", f"{problem}, expected coordinates relative to the scanner")
    return xyz
