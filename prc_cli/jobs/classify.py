"""Joins reader, classifier and writer for one file; the functions the commands call.

The data flows one way: ``open_stream`` → blocks of k lines → ``label_blocks`` → writer. :func:`classify` gives each of
the three its own threads, with short queues between them; which thread does what never changes a byte.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from prc_cli import kernels
from prc_cli.classifiers.fused import pipeline as fused
from prc_cli.classifiers.fused.pipeline import FusedParams
from prc_cli.classifiers.fused.plane import AROUND_LINES
from prc_cli.classifiers.fused.returns import label_further_returns
from prc_cli.classifiers.prc import pipeline as prc
from prc_cli.classifiers.prc.pipeline import PrcParams
from prc_cli.classifiers.returns import label_extra_returns
from prc_cli.classifiers.sequential_angle import pipeline as sequential_angle
from prc_cli.classifiers.sequential_angle.pipeline import SequentialAngleParams
from prc_cli.config import FUSED, SEQUENTIAL_ANGLE, LoadedConfig, RunConfig
from prc_cli.core.bytewise import count_bytes
from prc_cli.core.classes import Label
from prc_cli.core.errors import InputError
from prc_cli.core.files import check_output, remove_stale, suffix_of
from prc_cli.core.memory import keep_memory
from prc_cli.core.profile import timed, timed_items
from prc_cli.core.stream import FAR_M, LabelledBlock, ReadTally, ScanBlock, ScanStream, StageLabels, StreamInfo
from prc_cli.core.threads import close_items, default_threads, ordered, read_ahead, write_behind
from prc_cli.core.types import F32, F64, I64, U8
from prc_cli.formats import LAS_SUFFIXES, check_input
from prc_cli.formats.label_files import open_writer
from prc_cli.formats.ranges import clean_ranges
from prc_cli.formats.writing.base import LabelWriter
from prc_cli.formats.writing.record import (
    Fingerprint,
    FingerprintBeside,
    RunRecord,
    fingerprint,
    record_path,
)
from prc_cli.kernels import load_kernels
from prc_cli.stream.blocks import LineBuffer, regroup
from prc_cli.stream.open import open_input

Progress: TypeAlias = Callable[[int], None]
"""Called with the number of scan lines that were just finished."""

Labeller: TypeAlias = Callable[[Iterator[ScanBlock], int], Iterator[LabelledBlock]]
"""Labels a stream, given its blocks and a number of threads; in the order of the stream."""

FUSED_FOREST = f"{FUSED}-forest"
KERNELS_OF = {
    "prc": frozenset({"prc.components", "prc.support", "prc.surfaces"}),
    SEQUENTIAL_ANGLE: frozenset({"sequential_angle"}),
    FUSED: frozenset({"fused.classes", "fused.ground", "fused.neighbours", "fused.strips"}),
    FUSED_FOREST: frozenset({"fused.stems"}),
}
"""Modules of the compiled loops of every method; forests have their own."""

SHOTS_AT_ONCE = 1 << 17
"""Shots that the sequential-angle classifier takes at a time; its labels do not depend on it."""
AHEAD = 1
"""Blocks that wait between reader and classifier, and between classifier and writer: each side makes one meanwhile."""
OFF_M = 0.1
"""Coordinates relative to the scanner are as far from it as their range says, but for rounding [m]."""


@dataclass(frozen=True, slots=True)
class Counts:
    """Running counts of a stream, passed along with it."""

    n_lines: int
    n_shots: int
    n_far: int
    """Ranges beyond :data:`FAR_M`: no laser scanner on a vehicle or in a forest measures so far."""
    labels: I64
    """(number of labels,) int64, records by :class:`~prc_cli.core.classes.Label`; MISSING counts shots."""
    tally: ReadTally

    @classmethod
    def none(cls) -> Counts:
        """Return the counts before the first block."""
        return cls(0, 0, 0, np.zeros(len(Label), np.int64), ReadTally())

    def add(self, item: LabelledBlock) -> Counts:
        """Return the counts with one more block."""
        block = item.block
        labels = count_bytes(item.labels)[: len(Label)]
        extra = count_bytes(item.extra_labels)[: len(Label)]
        return Counts(
            self.n_lines + block.n_lines,
            self.n_shots + block.range_m.size,
            self.n_far + int(np.count_nonzero(block.range_m > FAR_M)),
            self.labels + labels + extra,
            self.tally + block.tally,
        )


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a run did."""

    output: Path
    record: RunRecord
    """Provenance and what was written, as stored in the output; ``.notices`` is what the user should know."""
    counts: Counts
    """Lines, shots and labels of the stream."""


def open_stream(path: Path | str, config: LoadedConfig | RunConfig | None = None) -> ScanStream:
    """Open any readable input as a stream of blocks.

    Parameters
    ----------
    path : path
        Raw binary, text, LAS/LAZ or array file.
    config : LoadedConfig or RunConfig, optional
        How lines, columns and ranges are found (``[input]``, ``[layout]``).

    Returns
    -------
    ScanStream
        ``.info`` says what is known before reading, ``.blocks()`` reads from the start. For all
        classifiers but PRC the blocks know where down is.

    Raises
    ------
    InputError
        When the file is damaged, or holds nothing that a range can be taken from.
    """
    return _open(Path(path), _loaded(config).config, geometry=True)


def _open(path: Path, config: RunConfig, *, geometry: bool, only_ranges: bool = False) -> ScanStream:
    """Open an input.

    ``geometry``: angles are looked for though the classifier does not need them; ``only_ranges``: times and
    intensities may be left out.
    """
    stream = open_input(
        path, config.input, config.layout, lines_at_once=getattr(config.classifier, "lines_per_block", 1),
        geometry=geometry or config.needs_beams, only_ranges=only_ranges,
    )  # fmt: skip
    if not config.needs_beams:
        return stream
    # not at the top: PRC needs no beams, and starts sooner without what finds them
    from prc_cli.stream.beams import with_beams

    return with_beams(stream, config.input, from_ground=config.nadir_from_ground)


def label_blocks(
    blocks: Iterator[ScanBlock],
    params: PrcParams | SequentialAngleParams | FusedParams,
    *,
    threads: int = 1,
    segments: bool = False,
    stages: bool = False,
    shots_at_once: int = SHOTS_AT_ONCE,
) -> Iterator[LabelledBlock]:
    """Classify a stream block by block; what crosses blocks is one state a scanner.

    Parameters
    ----------
    blocks : iterator of ScanBlock
        Blocks of any number of lines; with ``beam_rad`` for all classifiers but PRC.
    params : PrcParams, SequentialAngleParams or FusedParams
        Parameters of the classifier, which say which one it is.
    threads : int
        Threads that classify; results do not depend on it. At most twice as many blocks are held at a time.
    segments : bool
        Find the segment ids too, where the method has any.
    stages : bool
        Give what was found on the way too, where the method has any.
    shots_at_once : int
        Sequential-angle: about as many shots, whole lines, are taken at a time; labels do not depend on it.

    Yields
    ------
    LabelledBlock
        In order for each scanner: blocks of k lines (fewer at the end), or the lines that became final.
    """
    if isinstance(params, PrcParams):
        yield from _prc(blocks, params, threads, segments=segments)
    elif isinstance(params, FusedParams):
        yield from _fused(blocks, params, threads)
    else:
        yield from _sequential_angle(blocks, params, threads, shots_at_once, stages=stages)


def _prc(blocks: Iterator[ScanBlock], params: PrcParams, threads: int, *, segments: bool) -> Iterator[LabelledBlock]:
    scanners: dict[int, prc.ParallelBlocks] = {}

    def begin() -> Iterator[tuple[ScanBlock, prc.BlockJob]]:
        for block in regroup(blocks, params.lines_per_block):
            if block.scanner not in scanners:
                scanners[block.scanner] = prc.ParallelBlocks(block.points_per_line, params, segments=segments)
            yield block, scanners[block.scanner].begin(block.range_m, block.next_m)

    def work(item: tuple[ScanBlock, prc.BlockJob]) -> LabelledBlock:
        block, job = item
        labels, ids = scanners[block.scanner].classify(job)
        further, support = block.extra, params.support
        extra = label_extra_returns(
            block.range_m, labels, further.line, further.column, further.range_m, support.zeta_p, support.zeta_s
        )
        return LabelledBlock(block, labels, extra, ids)

    keep_memory()
    # one more than are worked on: the queue before the threads holds the next ones
    yield from ordered(work, begin(), threads=threads, ahead=threads + 1)


def _fused(blocks: Iterator[ScanBlock], params: FusedParams, threads: int) -> Iterator[LabelledBlock]:
    scanners: dict[int, fused.ParallelBlocks] = {}
    Item: TypeAlias = tuple[ScanBlock, fused.ParallelBlocks, fused.BlockJob]

    def begin() -> Iterator[Item]:
        for block in regroup(blocks, params.lines_per_block, look_ahead=AROUND_LINES):
            one = scanners.pop(block.scanner, None) or fused.ParallelBlocks(_beams_of(block), params)
            if not block.is_last:
                scanners[block.scanner] = one
            yield block, one, one.begin(block.range_m, block.next_m)

    def work(item: Item) -> LabelledBlock:
        block, one, job = item
        labels = one.classify(job)
        further = block.extra
        extra = label_further_returns(
            block.range_m, labels, further.line, further.column, further.range_m, params.extra_return_m
        )
        return LabelledBlock(block, labels, extra)

    keep_memory()
    yield from ordered(work, begin(), threads=threads, ahead=threads + 1)


def _beams_of(block: ScanBlock) -> F64:
    """Return the beams of a block, which must have them."""
    if block.beam_rad is None:
        problem = "no beam angles, expected the angle of every column from straight down"
        raise InputError("block of ranges", problem)
    return block.beam_rad


def _sequential_angle(
    blocks: Iterator[ScanBlock], params: SequentialAngleParams, threads: int, shots_at_once: int, *, stages: bool
) -> Iterator[LabelledBlock]:
    scanners: dict[int, sequential_angle.ParallelBlocks] = {}
    waiting: dict[int, LineBuffer] = {}
    Item: TypeAlias = tuple[ScanBlock, sequential_angle.ParallelBlocks, sequential_angle.BlockJob]

    def begin() -> Iterator[Item]:
        for block in regroup(blocks, shots_per_block=shots_at_once):
            beam_rad, one = _beams_of(block), scanners.pop(block.scanner, None)
            if one is None:
                one = sequential_angle.ParallelBlocks(beam_rad, params, stages=stages)
            if not block.is_last:
                scanners[block.scanner] = one
            yield block, one, one.begin(block.range_m, block.xyz_m, last=block.is_last)

    def work(item: Item) -> tuple[ScanBlock, U8, StageLabels | None]:
        block, one, job = item
        return block, *one.classify(job)

    keep_memory()
    for block, labels, found in ordered(work, begin(), threads=threads):
        buffer = waiting.setdefault(block.scanner, LineBuffer())
        buffer.add(block)
        start = 0
        for final in buffer.take_parts(len(labels)):
            rows = slice(start, start + final.n_lines)
            start = rows.stop
            # what lies beyond the scanner's reach is missing to the method, but it is a return
            own, n_beyond = kernels.mark_beyond(final.range_m, labels[rows])
            final = replace(final, next_m=None, tally=final.tally + ReadTally(n_beyond=n_beyond))
            # lines leave alone or together, as it happens: only the shot's own line may have a say
            further, limit = final.extra, params.extra_return_m
            extra = label_extra_returns(
                final.range_m, own, further.line, further.column, further.range_m, limit, 0.0,
                alone=Label.UNCLASSIFIED,
            )  # fmt: skip
            yield LabelledBlock(final, own, extra, stages=None if found is None else found.of_lines(rows))


def load_classifier(config: LoadedConfig | RunConfig | None = None) -> None:
    """Load the compiled loops of the classifier; after installation they are compiled once, which takes a while."""
    run = _loaded(config).config
    is_forest = run.method == FUSED and run.fused.environment == "forest"
    load_kernels(KERNELS_OF[FUSED_FOREST if is_forest else run.method])


def classify(
    source: Path | str,
    output: Path | str,
    config: LoadedConfig | RunConfig | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    threads: int | None = None,
    label: Labeller | None = None,
) -> RunSummary:
    """Classify one file and write its labels; the output exists whole or not at all.

    Parameters
    ----------
    source : path
        Any readable input.
    output : path
        ``.las``, ``.laz``, ``.npy``, ``.csv`` or ``.parquet``.
    config : LoadedConfig or RunConfig, optional
        Default: the published urban parameters.
    overwrite : bool
        Replace an existing output.
    progress : callable, optional
        Called with the number of lines that were just finished.
    threads : int, optional
        Threads that classify; default: one for every core. With more than one, reading, writing and the fingerprint of
        the input have a thread each beside them; with one, all is done in this one. The output does not depend on it.
    label : callable, optional
        Labels the stream where its labels are known already in part; default: :func:`label_blocks`.

    Returns
    -------
    RunSummary
        Counts, assumptions and notices; the same record is stored in the output and beside it.

    Raises
    ------
    InputError, OutputError, ConfigError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    loaded = _loaded(config)
    source, output = Path(source), Path(output)
    trajectory = loaded.trajectory
    keep_memory()  # before any thread
    threads = default_threads() if threads is None else threads
    inputs = (source, *loaded.files, *([] if trajectory is None else [trajectory]))
    for path in (output, record_path(output)):
        check_output(path, overwrite=overwrite, inputs=inputs)
        remove_stale(path)
    check_input(source)
    before = source.stat()
    with timed("opening"):
        # times and intensities are asked for only by who makes a point cloud of something else
        only_ranges = suffix_of(output) not in LAS_SUFFIXES or suffix_of(source) in LAS_SUFFIXES
        stream = _open(source, loaded.config, geometry=False, only_ranges=only_ranges)
    with (
        FingerprintBeside(source, threads=threads) as beside,
        open_writer(
            output,
            source=source,
            source_is_las=suffix_of(source) in LAS_SUFFIXES,
            n_records=stream.info.n_records,
            points_per_line=stream.info.points_per_line,
            codes=loaded.config.classes,
            options=loaded.config.output,
            overwrite=overwrite,
            laz_contexts=stream.info.facts.laz_contexts,
        ) as writer,
    ):
        counts = _write_labels(stream, writer, label or _labeller(loaded.config), threads, progress)
        record = run_record(stream.info, counts, loaded, beside.result())
        record = replace(record, notices=(*record.notices, *_missed(counts, loaded.config)))
        after = source.stat()
        if (after.st_size, after.st_mtime_ns) != (before.st_size, before.st_mtime_ns):
            raise InputError(str(source), "changed while it was read", "run again when the copy is complete")
        with timed("finishing the output"):
            record = writer.finish(record)
    return RunSummary(output, record, counts)


def _labeller(config: RunConfig) -> Labeller:
    """Label a stream from its ranges."""
    return lambda blocks, threads: label_blocks(
        blocks, config.classifier, threads=threads, segments=config.output.segment_ids, stages=config.output.stages
    )


def _write_labels(
    stream: ScanStream, writer: LabelWriter, label: Labeller, threads: int, progress: Progress | None
) -> Counts:
    """Read, classify and write at the same time; with one thread one after the other.

    However it ends, every thread is at rest when it has: what the writer holds may be removed.
    """
    counts = Counts.none()

    def write(item: LabelledBlock) -> None:
        nonlocal counts
        with timed("writing"):
            writer.add(item)
            counts = counts.add(item)

    with ExitStack() as stack:
        blocks = timed_items(stream.blocks(), "reading")
        put = write
        if threads > 1:
            blocks = read_ahead(blocks, depth=AHEAD)
            stack.callback(close_items, blocks)
        labelled = label(blocks, threads)
        stack.callback(close_items, labelled)
        if threads > 1:
            put = stack.enter_context(write_behind(write, depth=AHEAD)).put
        for item in labelled:
            put(item)
            if progress is not None:
                progress(item.block.n_lines)
    return counts


def classify_ranges(
    range_m: ArrayLike,
    config: LoadedConfig | RunConfig | None = None,
    *,
    beam_rad: ArrayLike | None = None,
    xyz_m: ArrayLike | None = None,
    threads: int | None = None,
) -> U8:
    """Classify a range image that is in memory.

    Parameters
    ----------
    range_m : (lines, M) float, metres
        Chronological; NaN, infinite or not positive = missing.
    config : LoadedConfig or RunConfig, optional
        Default: the published urban parameters.
    beam_rad : (M,) float, radians, optional
        Angle of every column's beam from straight down, its sign the side of the scan plane; needed by all
        classifiers but PRC.
    xyz_m : (lines, M, 3) float, metres, optional
        Relative to the scanner, z up; without it the sequential-angle classifier takes range and beam angle.
    threads : int, optional
        Threads that classify; default: one for every core. The labels do not depend on it.

    Returns
    -------
    (lines, M) uint8
        :class:`prc_cli.core.classes.Label` of every shot.

    Raises
    ------
    InputError
        When an array has another shape than it should have, or beam angles are needed and not given.

    Examples
    --------
    A wall with one stray shot in front of it:

    >>> image = np.full((6, 9), 20.0)
    >>> image[3, 4] = 5.0
    >>> labels = classify_ranges(image)
    >>> Label(labels[3, 4]).name, Label(labels[0, 0]).name
    ('NOISE', 'GROUND')
    """
    config = _loaded(config).config
    given = np.asarray(range_m)
    if given.dtype.kind not in "fiu":
        raise InputError("range_m", f"found values of type {given.dtype}, expected ranges in metres")
    ranges, tally = clean_ranges(given, config.input.min_range, config.input.max_range)
    if ranges.ndim != 2 or not ranges.size:
        raise InputError("range_m", f"found an array of shape {ranges.shape}, expected (lines, points per line)")
    block = ScanBlock(
        first_line=0,
        range_m=np.ascontiguousarray(ranges),
        tally=tally,
        xyz_m=None if xyz_m is None else _coordinates(xyz_m, ranges),
        beam_rad=None if beam_rad is None else _beams(beam_rad, ranges.shape[1]),
    )
    if config.needs_beams and beam_rad is None:
        raise InputError("beam_rad", "not given, expected the angle of every column's beam from straight down")
    threads = default_threads() if threads is None else threads
    return np.concatenate([item.labels for item in label_blocks(iter([block]), config.classifier, threads=threads)])


def _beams(beam_rad: ArrayLike, points_per_line: int) -> F64:
    """Check beam angles; those of a circle from 0 to two pi are turned to -pi to pi."""
    beams = np.asarray(beam_rad, np.float64)
    if beams.shape != (points_per_line,):
        raise InputError("beam_rad", f"found an array of shape {beams.shape}, expected ({points_per_line},)")
    if not np.isfinite(beams).all():
        raise InputError("beam_rad", "found an angle that is not finite, expected one for every column")
    if np.abs(beams).max() > 2 * np.pi:
        problem = f"found {np.abs(beams).max():g}, expected radians from -pi to pi"
        raise InputError("beam_rad", problem, "np.deg2rad turns degrees")
    turned: F64 = np.pi - np.remainder(np.pi - beams, 2 * np.pi)
    along = np.diff(np.unwrap(turned))
    if (along < 0).any() and (along > 0).any():
        raise InputError("beam_rad", "found angles that turn back, expected them to rise or fall with the column")
    return turned


def _coordinates(xyz_m: ArrayLike, range_m: F32) -> F32:
    """Check coordinates against the ranges."""
    xyz = np.array(xyz_m, np.float32)
    if xyz.shape != (*range_m.shape, 3):
        raise InputError("xyz_m", f"found an array of shape {xyz.shape}, expected {(*range_m.shape, 3)}")
    xyz[~np.isfinite(xyz).all(axis=-1)] = np.nan
    both = ~np.isnan(range_m) & ~np.isnan(xyz[..., 0])
    off = np.abs(np.sqrt((xyz[both].astype(np.float64) ** 2).sum(axis=-1)) - range_m[both])
    if off.size and np.median(off) > OFF_M:
        problem = f"found points {np.median(off):.3g} m farther or nearer than their ranges (median)"
        raise InputError("xyz_m", f"{problem}, expected coordinates relative to the scanner")
    return xyz


def run_record(
    info: StreamInfo, counts: Counts, loaded: LoadedConfig, input_print: Fingerprint | None = None
) -> RunRecord:
    """Return the provenance of a finished run; reads the input once more where its fingerprint is not given."""
    config, trajectory = loaded.config, loaded.trajectory
    return RunRecord(
        config=config.of_run(),
        input=fingerprint(Path(info.path)) if input_print is None else input_print,
        trajectory=None if trajectory is None else fingerprint(trajectory),
        format=info.format,
        points_per_line=info.points_per_line,
        n_lines=counts.n_lines,
        n_records=counts.tally.n_records if info.n_records is None else info.n_records,
        n_missing=int(counts.labels[Label.MISSING]),
        assumptions=info.assumptions,
        tally=counts.tally,
        notices=info.facts.notes,
    )


def _missed(counts: Counts, config: RunConfig) -> tuple[str, ...]:
    """Say what a run did without."""
    if config.method == FUSED and config.output.segment_ids:
        return ("the fused method has no segments: every segment id is 0",)
    if config.method != SEQUENTIAL_ANGLE:
        return ()
    said: list[str] = []
    if not counts.labels[Label.GROUND]:
        said.append("no ground was found, and without its height neither curbs nor cars are looked for")
    if counts.tally.n_beyond:
        limit = config.sequential_angle.max_range_m
        said.append(
            f"{counts.tally.n_beyond} ranges lie beyond sequential_angle.max_range_m = {limit:g} m or the limits of "
            "[input]: they are missing to the method, and unclassified"
        )
    if config.output.segment_ids:
        said.append("the sequential-angle method has no segments: every segment id is 0")
    return tuple(said)


def _loaded(config: LoadedConfig | RunConfig | None) -> LoadedConfig:
    if isinstance(config, LoadedConfig):
        return config
    return LoadedConfig(config if config is not None else RunConfig())


__all__ = [
    "Counts",
    "Labeller",
    "Progress",
    "RunSummary",
    "classify",
    "classify_ranges",
    "label_blocks",
    "open_stream",
]
