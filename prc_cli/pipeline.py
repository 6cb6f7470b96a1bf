"""Joins reader, classifier and writer for one file; the functions the commands call.

The data flows one way: ``open_stream`` → blocks of k lines → ``label_blocks`` → writer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from prc_cli.classifiers.prc.pipeline import PrcParams, PrcState, classify_block, initial_state
from prc_cli.classifiers.returns import label_extra_returns
from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.core.classes import Label
from prc_cli.core.errors import InputError
from prc_cli.core.files import check_output, remove_stale
from prc_cli.core.stream import LabelledBlock, ReadTally, ScanBlock, ScanStream, StreamInfo
from prc_cli.core.types import I64, U8
from prc_cli.readers import LAS_SUFFIXES, check_input, open_input, suffix_of
from prc_cli.readers.ranges_clean import clean_ranges
from prc_cli.readers.regroup import regroup
from prc_cli.writers import open_writer
from prc_cli.writers.record import RunRecord, fingerprint, record_path

Progress: TypeAlias = Callable[[int], None]
"""Called with the number of scan lines that were just finished."""

FAR_M = 20_000.0
"""Ranges from here on [m] are a sign of a wrong origin, trajectory or coordinate system."""


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
        labels = np.bincount(item.labels.ravel(), minlength=len(Label))
        extra = np.bincount(item.extra_labels, minlength=len(Label))
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
        ``.info`` says what is known before reading, ``.blocks()`` reads from the start.

    Raises
    ------
    InputError
        When the file is damaged, or holds nothing that a range can be taken from.
    """
    loaded = _loaded(config)
    return open_input(Path(path), loaded.config.input, loaded.config.layout)


def label_blocks(blocks: Iterator[ScanBlock], params: PrcParams) -> Iterator[LabelledBlock]:
    """Classify a stream block by block; what crosses blocks is one state a scanner.

    Parameters
    ----------
    blocks : iterator of ScanBlock
        Blocks of any number of lines.
    params : PrcParams
        Parameters of the classifier.

    Yields
    ------
    LabelledBlock
        Blocks of k lines (fewer at the end), in order for each scanner.
    """
    states: dict[int, PrcState] = {}
    for block in regroup(blocks, params.lines_per_block):
        state = states.get(block.scanner)
        if state is None:
            state = initial_state(block.points_per_line)
        result = classify_block(block.range_m, block.next_m, state, params)
        states[block.scanner] = result.state
        extra = label_extra_returns(
            block.range_m,
            result.labels,
            block.extra.line,
            block.extra.column,
            block.extra.range_m,
            params.support.zeta_p,
            params.support.zeta_s,
        )
        yield LabelledBlock(block, result.labels, extra, result.segments)


def classify(
    source: Path | str,
    output: Path | str,
    config: LoadedConfig | RunConfig | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
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
    inputs = (source, *loaded.files, *([] if trajectory is None else [trajectory]))
    for path in (output, record_path(output)):
        check_output(path, overwrite=overwrite, inputs=inputs)
        remove_stale(path)
    check_input(source)
    before = source.stat()
    stream = open_stream(source, loaded)
    counts = Counts.none()
    with open_writer(
        output,
        source=source,
        source_is_las=suffix_of(source) in LAS_SUFFIXES,
        n_records=stream.info.n_records,
        points_per_line=stream.info.points_per_line,
        codes=loaded.config.classes,
        options=loaded.config.output,
        overwrite=overwrite,
    ) as writer:
        for item in label_blocks(stream.blocks(), loaded.config.prc):
            writer.add(item)
            counts = counts.add(item)
            if progress is not None:
                progress(item.block.n_lines)
        record = run_record(stream.info, counts, loaded)
        after = source.stat()
        if (after.st_size, after.st_mtime_ns) != (before.st_size, before.st_mtime_ns):
            raise InputError(str(source), "changed while it was read", "run again when the copy is complete")
        record = writer.finish(record)
    return RunSummary(output, record, counts)


def classify_ranges(range_m: ArrayLike, config: LoadedConfig | RunConfig | None = None) -> U8:
    """Classify a range image that is in memory.

    Parameters
    ----------
    range_m : (lines, M) float, metres
        Chronological; NaN, infinite or not positive = missing.
    config : LoadedConfig or RunConfig, optional
        Default: the published urban parameters.

    Returns
    -------
    (lines, M) uint8
        :class:`prc_cli.core.classes.Label` of every shot.

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
    block = ScanBlock(first_line=0, range_m=np.ascontiguousarray(ranges), tally=tally)
    return np.concatenate([item.labels for item in label_blocks(iter([block]), config.prc)])


def run_record(info: StreamInfo, counts: Counts, loaded: LoadedConfig) -> RunRecord:
    """Return the provenance of a finished run; reads the input once more for its fingerprint."""
    config, trajectory = loaded.config, loaded.trajectory
    return RunRecord(
        config=config.to_table(),
        input=fingerprint(Path(info.path)),
        trajectory=None if trajectory is None else fingerprint(trajectory),
        format=info.format,
        points_per_line=info.points_per_line,
        n_lines=counts.n_lines,
        n_records=counts.tally.n_records if info.n_records is None else info.n_records,
        n_missing=int(counts.labels[Label.MISSING]),
        assumptions=info.assumptions,
        tally=counts.tally,
        notices=info.notes,
    )


def _loaded(config: LoadedConfig | RunConfig | None) -> LoadedConfig:
    if isinstance(config, LoadedConfig):
        return config
    return LoadedConfig(config if config is not None else RunConfig())


__all__ = [
    "Counts",
    "Progress",
    "RunSummary",
    "classify",
    "classify_ranges",
    "label_blocks",
    "open_stream",
]
