"""A run: an input is read, its blocks are counted, and an output gets the record of it.

A job refuses its outputs, starts a :class:`Run`, opens its stream, passes every block to
:meth:`Run.see`, and gives the output its name with :meth:`Run.finish`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from prc_cli.config import LoadedConfig
from prc_cli.core.brief import Brief
from prc_cli.core.classes import Label, count_bytes
from prc_cli.core.files import check_unchanged, file_state
from prc_cli.core.findings import Doubted, Finding, notices
from prc_cli.core.profile import timed
from prc_cli.core.stream import FAR_M, LabelledBlock, ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import I64
from prc_cli.formats.input import Input
from prc_cli.formats.writing.base import StagedWriter
from prc_cli.formats.writing.record import Fingerprint, RunRecord, fingerprint
from prc_cli.jobs.progress import advance

Progress: TypeAlias = Callable[[int], None]
"""Called with the number of scan lines that are finished since the last call."""


@dataclass(frozen=True, slots=True, repr=False)
class Counts(Brief):
    """Running counts of a stream."""

    n_lines: int
    n_shots: int
    n_far: int
    """Ranges longer than :data:`FAR_M`, implausible for a terrestrial scanner."""
    labels: I64
    """(number of labels,) int64, records by :class:`~prc_cli.core.classes.Label`.

    For MISSING it is the number of shots.
    """
    tally: ReadTally
    n_extra: int = field(default=0, repr=False)
    """Further returns."""
    scanners: Mapping[int, int] = field(default_factory=dict, repr=False)
    """M by scanner."""

    @classmethod
    def none(cls) -> Counts:
        """Return the counts before the first block."""
        return cls(0, 0, 0, np.zeros(len(Label), np.int64), ReadTally())

    def add(self, item: LabelledBlock | ScanBlock, *, only_records: bool = False) -> Counts:
        """Return the counts with one more block.

        ``only_records`` leaves out cells and lines without a record.
        """
        block = item.block if isinstance(item, LabelledBlock) else item
        # index of the counted cells and of the counted further returns: all of them, or a mask
        cells: Any = ...
        further: Any = ...
        n_lines = block.n_lines
        if only_records:
            cells = block.records() >= 0
            further = block.extra.record >= 0
            n_lines = int(cells.any(axis=1).sum())
        ranges = block.range_m[cells]
        if isinstance(item, LabelledBlock):
            labels = (
                count_bytes(item.labels[cells])[: len(Label)]
                + count_bytes(item.extra_labels[further])[: len(Label)]
            )
        else:
            labels = np.zeros(len(Label), np.int64)
            labels[Label.MISSING] = np.count_nonzero(np.isnan(ranges))
        return Counts(
            n_lines=self.n_lines + n_lines,
            n_shots=self.n_shots + ranges.size,
            n_far=self.n_far + int(np.count_nonzero(ranges > FAR_M)),
            labels=self.labels + labels,
            tally=self.tally + block.tally,
            n_extra=self.n_extra + len(block.extra.record[further]),
            scanners={block.scanner: block.points_per_line, **self.scanners},
        )

    def __add__(self, other: Counts) -> Counts:
        """Return the counts of two streams together."""
        return Counts(
            n_lines=self.n_lines + other.n_lines,
            n_shots=self.n_shots + other.n_shots,
            n_far=self.n_far + other.n_far,
            labels=self.labels + other.labels,
            tally=self.tally + other.tally,
            n_extra=self.n_extra + other.n_extra,
            scanners={**other.scanners, **self.scanners},
        )

    @property
    def n_missing(self) -> int:
        """Shots without return."""
        return int(self.labels[Label.MISSING])


@dataclass(frozen=True, slots=True, repr=False)
class RunSummary(Doubted):
    """Summary of a run."""

    output: Path
    record: RunRecord
    """Provenance and what was written, as stored in the output.

    ``.notices`` holds warnings for the user.
    """
    counts: Counts
    """Lines, shots and labels of the stream."""
    findings: tuple[Finding, ...] = ()
    """Results of all checks of the input and of its labels."""

    def as_dict(self) -> dict[str, Any]:
        """Return the run record with the warnings, for JSON."""
        return {**self.record.as_dict(), "doubts": [doubt.as_dict() for doubt in self.doubts]}


@dataclass(slots=True)
class Run:
    """One reading of an input, from its state at the start to the name of the output.

    Raises
    ------
    InputError
        If the input cannot be read.
    """

    scan: Input
    loaded: LoadedConfig
    """Configuration; replaced when prc has chosen the method."""
    progress: Progress | None = None
    counts: Counts = field(default_factory=Counts.none)
    """Blocks so far."""
    _state_at_start: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.scan.check()
        self._state_at_start = file_state(self.scan.path)

    def see(self, item: LabelledBlock | ScanBlock, info: StreamInfo) -> None:
        """Count a finished block, and report it."""
        self.counts = self.counts.add(item)
        block = item.block if isinstance(item, LabelledBlock) else item
        advance(self.progress, block, info, self.loaded.config.input.window)

    def record(
        self,
        info: StreamInfo,
        findings: tuple[Finding, ...] = (),
        notes: tuple[str, ...] = (),
        input_print: Fingerprint | None = None,
    ) -> RunRecord:
        """Return the provenance of the run, with notes and the results of the checks."""
        record = run_record(info, self.counts, self.loaded, input_print)
        return replace(record, notices=(*record.notices, *notes, *notices(findings)))

    def check_unchanged(self) -> None:
        """Refuse an input that changed while it was read."""
        check_unchanged(self.scan.path, self._state_at_start)

    def finish(self, writer: StagedWriter, record: RunRecord) -> RunRecord:
        """Check the input, and give the output its name; return the record as it was written."""
        self.check_unchanged()
        with timed("finishing the output"):
            return writer.finish(record)


def run_record(
    info: StreamInfo,
    counts: Counts,
    loaded: LoadedConfig,
    input_print: Fingerprint | None = None,
) -> RunRecord:
    """Return the provenance of a finished run; without ``input_print`` the input is read again."""
    config = loaded.config
    # the hash and the number of records are those of the complete file
    is_complete = config.input.window is None
    if input_print is None:
        input_print = fingerprint(Path(info.path), hashes=is_complete)
    n_records = counts.tally.n_records
    if is_complete and info.n_records is not None:
        n_records = info.n_records
    assumptions = info.assumptions
    if loaded.choice is not None:
        assumptions = (loaded.choice.assumption, *assumptions)
    return RunRecord(
        config=config.of_run(),
        input=input_print,
        trajectory=None if loaded.trajectory is None else fingerprint(loaded.trajectory),
        format=info.format,
        points_per_line=info.points_per_line,
        n_lines=counts.n_lines,
        n_records=n_records,
        n_missing=counts.n_missing,
        assumptions=assumptions,
        tally=counts.tally,
        notices=(*loaded.notes, *info.facts.notes),
    )
