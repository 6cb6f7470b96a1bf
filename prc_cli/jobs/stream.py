"""Classification of a live stream: ranges from a pipe, one class code per shot out.

A block is written as soon as the shots it needs have arrived. Nothing is queued, and nothing is
read ahead, so a slow reader of the labels slows down the writer of the ranges (back-pressure).
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
from prc_cli.jobs.classify import Counts, load_classifier
from prc_cli.methods.run import run_blocks
from prc_cli.streams.evidence.result import ResultWatch
from prc_cli.streams.evidence.watch import LiveEvidence, watched
from prc_cli.streams.grid import GridStream
from prc_cli.streams.pipe import ByteStream, open_pipe


def _ignore(told: Finding | MethodChoice) -> None:
    """Do nothing with what is told: it is in the summary."""


RESULT_LINES = 1024
"""The labels are checked when there are so many lines, each time there are twice as many, and at the end."""


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
    """Latency: time from the arrival of the last bytes needed for some labels until these were written; maximum so
    far [s]."""

    def real_time(self, line_hz: float | None = None) -> float | None:
        """Return the throughput as a multiple of the scanner's line rate."""
        hz = self.line_hz if line_hz is None else line_hz
        return None if hz is None or not self.seconds else self.n_lines / self.seconds / hz


@dataclass(frozen=True, slots=True, repr=False)
class StreamSummary(Doubted):
    """Summary of a finished stream."""

    rate: Rate
    counts: Counts
    info: StreamInfo
    findings: tuple[Finding, ...] = ()
    """The worst answer of every check of the input and of its labels while they passed."""
    choice: MethodChoice | None = None
    """The method that was chosen, and why; None = it was named."""


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
        Default: what labels the stream best, as for files. An incomplete last line is padded
        for processing, and cut again.
    report : callable, optional
        Called with the :class:`Rate` whenever labels were written.
    doubted : callable
        Called with the first doubt of every check of the input and of its labels as soon as it is
        known.
    chosen : callable
        Called with the method that was chosen where none is named, before the first label.

    Returns
    -------
    StreamSummary

    Raises
    ------
    InputError
        When the stream is damaged or ends inside a record; the labels of all complete lines were
        written before.
    EvidenceError
        When the evidence is against the input; ``input.accept_doubts`` names what is accepted. The
        labels of the shots before were written.
    OutputError
        When the reader of the labels has gone.
    ConfigError
        When the stream cannot be classified live, for example with several scanners.
    """
    loaded = LoadedConfig.of(config)
    config = loaded.config
    refuse_window(config, "prc stream")
    if config.input.scanner != "none":
        problem = f"found {config.input.scanner!r}, expected none: labels of one scanner leave in the order of its shots"
        raise ConfigError(
            "input.scanner",
            problem,
            "split the stream first, or write it to a file for prc classify",
        )
    start = time.perf_counter()
    pipe, opened = open_pipe(
        source, config.input.model_copy(update={"partial_line": "pad"}), config.layout
    )
    is_dense = isinstance(opened, GridStream) and opened.rules.is_dense
    named = config.is_decided
    loaded, opened = decide_stream(opened, loaded)
    config = loaded.config
    told = None if named else loaded.choice
    if not named:
        load_classifier(loaded)
    classifier = config.classifier.method()
    pipe.seal()
    watch = LiveEvidence(
        watched(opened, config.input, needs=classifier.needs, others=loaded.findings), doubted
    )
    blocks = _UntilError(watch)
    lookup = config.classes.lookup()
    counts = Counts.none()
    latency = 0.0
    result = ResultWatch(classifier.usual, opened.info.facts)
    asks_at = RESULT_LINES
    for item in run_blocks(iter(blocks), classifier, shots_at_once=1):
        if told is not None:  # not of an input that is refused
            chosen(told)
            told = None
        counts = counts.add(item)
        codes = lookup[item.labels]
        # in a dense stream only a padded last line has cells without a record
        whole = (
            codes if not is_dense or item.block.record is None else codes[item.block.record >= 0]
        )
        _write(sink, whole)
        latency = max(latency, time.perf_counter() - pipe.arrived_s)
        result.see(item)
        if counts.n_lines >= asks_at:
            asks_at = 2 * counts.n_lines
            watch.hear(result.findings())
        if report is not None:
            report(_rate(counts, start, opened.info, latency))
    if blocks.error is not None:
        raise blocks.error
    watch.hear(result.findings())
    rate = _rate(counts, start, opened.info, latency)
    return StreamSummary(rate, counts, opened.info, watch.findings(), loaded.choice)


def _rate(
    counts: Counts,
    start: float,
    info: StreamInfo,
    latency: float,
) -> Rate:
    return Rate(counts.n_lines, counts.n_shots, time.perf_counter() - start, info.line_hz, latency)


class _UntilError:
    """Yields blocks until the input raises, keeping the error, so that the blocks before it are labelled."""

    def __init__(self, stream: ScanStream) -> None:
        self._stream = stream
        self.error: InputError | None = None

    def __iter__(self) -> Iterator[ScanBlock]:
        try:
            yield from self._stream.blocks()
        except InputError as error:
            self.error = error


def _write(sink: ByteSink, codes: U8) -> None:
    """Write codes in the order of the shots."""
    data = np.ascontiguousarray(codes).reshape(-1).data
    while len(data):
        try:
            n_written = sink.write(data)
        except OSError as error:
            gone = isinstance(error, BrokenPipeError)
            problem = (
                "its reader has gone" if gone else f"cannot be written ({error.strerror or error})"
            )
            raise OutputError(
                "stdout", problem, "the labels of the shots before have left"
            ) from error
        data = data[n_written or 0 :]
