"""Classification of a live stream: ranges from a pipe, one class code per shot out.

A block is written as soon as its shots have arrived. There is no queue and no reading ahead, so a
slow reader of the labels slows down the writer of the ranges (back-pressure).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from prc_cli.config import LoadedConfig, MethodChoice, RunConfig, refuse_window
from prc_cli.core.errors import ConfigError, InputError, OutputError
from prc_cli.core.findings import Doubted, Finding
from prc_cli.core.stream import ScanBlock, ScanStream, StreamInfo
from prc_cli.core.types import U8
from prc_cli.jobs.choice import decide_stream
from prc_cli.jobs.classify import load_classifier
from prc_cli.jobs.run import Counts
from prc_cli.methods.run import run_blocks
from prc_cli.streams.evidence.result import ResultWatch
from prc_cli.streams.evidence.watch import (
    LiveFindings,
    accepted_by,
    evidence_of,
    watched_live,
)
from prc_cli.streams.pipe import ByteStream, open_pipe


def _ignore(message: Finding | MethodChoice) -> None:
    """Do nothing: the message is in the summary."""


RESULT_LINES = 1024
"""The labels are checked after so many lines, each time their number doubles, and at the end."""


class ByteSink(Protocol):
    """Output of the labels: an unbuffered file object, such as ``sys.stdout.buffer.raw``."""

    def write(self, data: memoryview, /) -> int | None:
        """Write some of the bytes; return how many."""


@dataclass(frozen=True, slots=True)
class Rate:
    """Progress of a stream."""

    n_lines: int
    """Lines whose labels were written."""
    n_shots: int
    seconds: float
    """Time since the stream was opened [s]."""
    line_hz: float | None
    """Lines per second of the scanner [Hz], None = unknown."""
    latency_s: float
    """Largest time from the last shot of a block until its labels were written [s]."""

    def real_time(self) -> float | None:
        """Return the throughput as a multiple of the scanner's line rate."""
        hz = self.line_hz
        return None if hz is None or not self.seconds else self.n_lines / self.seconds / hz


@dataclass(frozen=True, slots=True, repr=False)
class StreamSummary(Doubted):
    """Summary of a finished stream."""

    rate: Rate
    counts: Counts
    info: StreamInfo
    findings: tuple[Finding, ...] = ()
    """The worst result of every check of the input and of its labels."""
    choice: MethodChoice | None = None
    """The method that prc chose, and why; None = the user named it."""


def stream(
    source: ByteStream,
    sink: ByteSink,
    config: LoadedConfig | RunConfig | None = None,
    *,
    report: Callable[[Rate], None] | None = None,
    doubted: Callable[[Finding], None] = _ignore,
    chosen: Callable[[MethodChoice], None] = _ignore,
) -> StreamSummary:
    """Label a live stream.

    Parameters
    ----------
    source : ByteStream
        Records of ``config.layout`` (default: float32 ranges only, ``input.points_per_line`` per
        line), unbuffered.
    sink : ByteSink
        Receives one byte per shot, its class code, in chronological order; 0 = no return.
    config : LoadedConfig or RunConfig, optional
        Default: prc chooses the method, as for files. An incomplete last line is padded
        for processing, and cut again.
    report : callable, optional
        Called with the :class:`Rate` whenever labels were written.
    doubted : callable
        Called with the first warning of every check of the input and of its labels, at once.
    chosen : callable
        Called with the method that prc chose, before the first label.

    Returns
    -------
    StreamSummary

    Raises
    ------
    InputError
        If the stream is damaged or ends inside a record. The labels of all complete lines are
        written.
    EvidenceError
        If a check refuses the input; ``input.accept_doubts`` names checks to accept. The labels of
        earlier shots are written.
    OutputError
        If the reader of the labels has gone.
    ConfigError
        If the stream cannot be classified live, for example with several scanners.
    """
    loaded = LoadedConfig.of(config)
    config = loaded.config
    refuse_window(config, "prc stream")
    if config.input.scanner != "none":
        problem = f"found {config.input.scanner!r}, expected none: a live stream has one scanner"
        raise ConfigError(
            "input.scanner",
            problem,
            "write the stream to a file and use prc classify",
        )
    start = time.perf_counter()
    pipe, opened = open_pipe(
        source, config.input.model_copy(update={"partial_line": "pad"}), config.layout
    )
    is_dense = opened.grid is not None and opened.grid.rules.is_dense
    named = config.is_decided
    loaded, opened = decide_stream(opened, loaded)
    config = loaded.config
    unannounced = None if named else loaded.choice
    if not named:
        load_classifier(loaded)
    classifier = config.classifier.method()
    pipe.seal()
    # the blocks are read from the kept bytes, as the end of the pipe is checked from now on
    opened.first.forget()
    findings = LiveFindings(opened.info.path, accepted_by(config.input), doubted)
    begin = evidence_of(opened, config.input, needs=classifier.needs, others=loaded.findings)
    blocks = _UntilError(watched_live(opened, begin, findings))
    lookup = config.classes.lookup()
    counts = Counts.none()
    latency = 0.0
    result = ResultWatch(classifier.usual, opened.info.facts)
    next_check = RESULT_LINES
    for item in run_blocks(iter(blocks), classifier, shots_at_once=1):
        if unannounced is not None:  # not before the first block: the input may be refused
            chosen(unannounced)
            unannounced = None
        counts = counts.add(item)
        codes = lookup[item.labels]
        if is_dense and item.block.record is not None:
            # cells without a record pad the last line
            codes = codes[item.block.record >= 0]
        _write(sink, codes)
        latency = max(latency, time.perf_counter() - pipe.arrived_s)
        result.see(item)
        if counts.n_lines >= next_check:
            next_check = 2 * counts.n_lines
            findings.hear(result.findings())
        if report is not None:
            report(_rate(counts, start, opened.info, latency))
    if blocks.error is not None:
        raise blocks.error
    findings.hear(result.findings())
    rate = _rate(counts, start, opened.info, latency)
    return StreamSummary(rate, counts, opened.info, tuple(findings), loaded.choice)


def _rate(
    counts: Counts,
    start: float,
    info: StreamInfo,
    latency: float,
) -> Rate:
    return Rate(counts.n_lines, counts.n_shots, time.perf_counter() - start, info.line_hz, latency)


class _UntilError:
    """Yields blocks until the input raises, and keeps the error for later."""

    def __init__(self, stream: ScanStream) -> None:
        self._stream = stream
        self.error: InputError | None = None

    def __iter__(self) -> Iterator[ScanBlock]:
        try:
            yield from self._stream.blocks()
        except InputError as error:
            self.error = error


def _write(sink: ByteSink, codes: U8) -> None:
    data = np.ascontiguousarray(codes).reshape(-1).data
    while len(data):
        try:
            n_written = sink.write(data)
        except OSError as error:
            gone = isinstance(error, BrokenPipeError)
            problem = (
                "its reader has gone" if gone else f"cannot be written ({error.strerror or error})"
            )
            kept = "the labels of earlier shots are written"
            raise OutputError("stdout", f"{problem}; {kept}") from error
        data = data[n_written or 0 :]
