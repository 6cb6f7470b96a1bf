"""Classifies the files of one drive as one stream.

The labels equal those of the joined file; every file gets an output. A gap of time, other
dimensions or another M between two files starts a new stream, and a notice says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from prc_cli.config import LoadedConfig, with_layout_beside
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import whole_set
from prc_cli.core.findings import notices
from prc_cli.core.loops import Engine, use_engine
from prc_cli.core.own_file import make_folder
from prc_cli.core.stream import LabelledBlock, ReadTally
from prc_cli.core.types import I64
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.input import Input
from prc_cli.formats.joined import (
    Break,
    JoinedFiles,
    JoinedInput,
    JoinedRecordings,
    find_break,
    is_continuous,
)
from prc_cli.formats.outputs import open_writer, prepare_label_outputs
from prc_cli.formats.registry import by_suffix, is_cloud
from prc_cli.formats.writing.base import StagedWriter
from prc_cli.formats.writing.columns import LabelOutput
from prc_cli.formats.writing.record import fingerprint
from prc_cli.jobs.classify import (
    OutputNeeds,
    open_decided,
    threads_of,
    user_names,
    write_labels,
)
from prc_cli.jobs.run import Counts, Progress, Run, RunSummary
from prc_cli.streams.evidence.watch import watched
from prc_cli.streams.registered.source import sorts_by_itself

SAME = "same"
FORMATS = (SAME, *(suffix.removeprefix(".") for suffix in sorted(by_suffix("labels"))))
"""Output formats.

``same`` writes LAS for LAS, LAZ for LAZ, and a label file for every other format.
"""
LABELS = ".labels"
"""Put between the name of an input and the suffix of its label file."""


def outputs_of_drive(parts: Sequence[Path], folder: Path) -> list[Path]:
    """Return the output of every file: LAS and LAZ keep their names, others get a label file."""
    outputs = [folder / output_name(part.name, SAME) for part in parts]
    if len(set(outputs)) < len(outputs):
        twice = next(output for output in outputs if outputs.count(output) > 1)
        raise ConfigError(
            str(twice), "two inputs have this output, expected files with different names"
        )
    return outputs


def classify_drive(
    parts: Sequence[Path],
    outputs: Path | Sequence[Path],
    config: LoadedConfig,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    threads: int | None = None,
    engine: Engine = "compiled",
    loading: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> list[RunSummary]:
    """Classify the files of one drive, in the order of recording.

    The outputs get their names together at the end, or none does.
    """
    outputs = outputs_of_drive(parts, outputs) if isinstance(outputs, Path) else outputs
    if config.config.input.window is not None:
        raise ConfigError(
            "input",
            "a window (--only) needs a single file",
            "leave it out",
        )
    scans = [Input.of(part) for part in parts]
    # refuse files that cannot be joined before a folder is made
    _joined(scans, config)
    for scan, output in zip(scans, outputs, strict=True):
        if is_cloud(output) and not scan.keeps_points(output):
            problem = f"{scan.name} contains no points: a drive of such files gets only labels"
            raise ConfigError(str(output), problem, "write .npy, .csv or .parquet")
        make_folder(output.parent)
    prepare_label_outputs(*outputs, overwrite=overwrite, inputs=(*parts, *config.files))
    summaries: list[RunSummary] = []
    first = 0
    why = ""
    with whole_set():
        while first < len(scans):
            drive, loaded, joined, cut = _joined(scans[first:], config)
            stop = len(scans) if cut is None else first + cut.part
            note = drive_note([part.name for part in parts])
            run = _StreamRun(
                drive.parts[: stop - first],
                tuple(outputs[first:stop]),
                (why, note) if why else (note,),
            )
            with use_engine(engine):
                summaries += run.execute(
                    loaded,
                    joined.upto(stop - first),
                    overwrite=overwrite,
                    progress=progress,
                    threads=threads_of(engine, threads),
                    engine=engine,
                    loading=loading,
                )
            first = stop
            why = "" if cut is None else f"a stream of its own begins with this file: {cut.why}"
    return summaries


def is_one_recording(parts: Sequence[Path], config: LoadedConfig) -> bool:
    """Return whether files continue each other, so that they should be classified as one drive.

    Files without times and without numbers of lines do not show it.
    """
    try:
        loaded = with_layout_beside(Input.of(parts[0]), config)
        scans = (replace(Input.of(part), layout=loaded.config.layout) for part in parts)
        return is_continuous(JoinedInput(tuple(scans)), loaded.config.input)
    except (InputError, ConfigError):
        return False


def _joined(
    scans: Sequence[Input], config: LoadedConfig
) -> tuple[JoinedInput, LoadedConfig, JoinedFiles | JoinedRecordings, Break | None]:
    # files, their configuration, and the first file that does not continue the file before it
    loaded = with_layout_beside(scans[0], config)
    layout = loaded.config.layout
    drive = JoinedInput(tuple(replace(scan, layout=layout) for scan in scans))
    joined = drive.joined(loaded.config.input)
    cut = None
    if isinstance(joined, JoinedFiles):
        in_order = not sorts_by_itself(joined.source(), loaded.config.input)
        cut = find_break(joined, in_order=in_order)
    return drive, loaded, joined, cut


@dataclass(frozen=True, slots=True)
class _StreamRun:
    """Classification of the files of one stream."""

    parts: tuple[Input, ...]
    outputs: tuple[Path, ...]
    notes: tuple[str, ...]
    """Notices: [why a new stream starts with the first file,] one for the record of every file."""

    def execute(
        self,
        loaded: LoadedConfig,
        joined: JoinedFiles | JoinedRecordings,
        *,
        overwrite: bool,
        progress: Progress | None,
        threads: int,
        engine: Engine,
        loading: Callable[[], AbstractContextManager[None]],
    ) -> Iterator[RunSummary]:
        runs = [Run(part, loaded) for part in self.parts]
        scan = self.parts[0] if len(self.parts) == 1 else JoinedInput(self.parts)
        loaded, opened = open_decided(scan, loaded, engine, OutputNeeds(), loading=loading)
        needs = loaded.config.classifier.method().needs
        stream = watched(opened, loaded.config.input, needs=needs, others=loaded.findings)
        firsts = joined.firsts()
        with ExitStack() as stack:
            writers = [
                stack.enter_context(
                    open_writer(
                        LabelOutput(
                            path=output,
                            source=part,
                            n_records=stop - start,
                            points_per_line=stream.info.points_per_line,
                            codes=loaded.config.classes,
                            options=loaded.config.output,
                            user_names=user_names(loaded.config),
                        ),
                        overwrite=overwrite,
                    )
                )
                for part, output, start, stop in zip(
                    self.parts, self.outputs, firsts[:-1], firsts[1:], strict=True
                )
            ]
            divided = DividedWriter(writers, firsts)
            _, findings, method_notices = write_labels(
                stream, divided, loaded.config, threads, progress
            )
            for run in runs:
                run.check_unchanged()
            for number, (run, writer) in enumerate(zip(runs, writers, strict=True)):
                run.loaded = loaded
                run.counts = divided.counts[number]
                record = run.record(stream.info, input_print=fingerprint(run.scan.path))
                notes = (
                    *loaded.notes,
                    *joined.notes(number),
                    *method_notices,
                    *notices(findings),
                    *self.notes[-1 if number else 0 :],
                )
                n_records = firsts[number + 1] - firsts[number]
                record = replace(record, n_records=n_records, notices=notes, engine=engine)
                record = run.finish(writer, record)
                yield RunSummary(self.outputs[number], record, run.counts, findings)


class DividedWriter:
    """Gives the writer of every file the labels of its records.

    ``firsts`` are the number of the first record of every file, and the number of all records.
    """

    def __init__(self, writers: Sequence[StagedWriter], firsts: Sequence[int]) -> None:
        self._writers = writers
        self._firsts = np.array(firsts)
        self.counts = [Counts.none() for _ in writers]
        """By file. A line that continues in the next file counts in both."""

    def add(self, block: LabelledBlock) -> None:
        """Write the labels of a block."""
        scan = block.block
        records = scan.records()
        extra = scan.extra.record
        known = np.concatenate([records[records >= 0], extra[extra >= 0]])
        if not len(known):
            return
        low, high = np.searchsorted(self._firsts, [known.min(), known.max()], side="right") - 1
        for number in range(low, min(high, len(self._writers) - 1) + 1):
            start = self._firsts[number]
            stop = self._firsts[number + 1]
            part = replace(
                block,
                block=replace(
                    scan,
                    record=_within(records, start, stop),
                    extra=replace(scan.extra, record=_within(extra, start, stop)),
                    tally=scan.tally if number == low else ReadTally(),
                ),
            )
            self._writers[number].add(part)
            self.counts[number] = self.counts[number].add(part, only_records=True)


def _within(records: I64, start: int, stop: int) -> I64:
    # numbers of records in their file; -1 = in another file
    inside = (records >= start) & (records < stop)
    return np.where(inside, records - start, -1)


def output_name(name: str, to: str) -> str:
    """Return the name of an output in its tree.

    It contains the whole name of the input, so that ``a.las``, ``a.laz`` and ``a.csv`` have
    different outputs. A LAS or LAZ output of an input of the same format keeps its name, so that
    the output tree can replace the input tree.

    >>> [output_name(name, "same") for name in ("night/a.laz", "a.csv.gz")]
    ['night/a.laz', 'a.csv.gz.labels.npy']
    >>> [output_name(name, "laz") for name in ("a.laz", "a.las", "a.bin")]
    ['a.laz', 'a.las.laz', 'a.bin.laz']
    """
    if to not in FORMATS:
        raise ConfigError("--to", f"found {to!r}, expected one of: {', '.join(FORMATS)}")
    suffix = PurePosixPath(name).suffix.lower()
    if to == SAME:
        return name if suffix in LAS_SUFFIXES else f"{name}{LABELS}.npy"
    if f".{to}" in LAS_SUFFIXES:
        return name if suffix == f".{to}" else f"{name}.{to}"
    return f"{name}{LABELS}.{to}"


_DRIVE = "one drive of "


def drive_note(names: Sequence[str]) -> str:
    """Return the notice in the run record of every file of a drive."""
    return f"{_DRIVE}{len(names)} files, {names[0]} to {names[-1]}"


def is_of_drive(notices: Iterable[str], names: Sequence[str]) -> bool:
    """Check whether a run record says that its file was classified as a part of this drive.

    Without names: whether the file was classified by itself.
    """
    notes = [notice for notice in notices if notice.startswith(_DRIVE)]
    return notes == ([drive_note(names)] if names else [])
