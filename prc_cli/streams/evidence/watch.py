"""Watches a stream while it passes, and runs all checks of it.

Nothing is read twice: a bounded sample of the lines is kept while blocks pass. Evidence against the
input is raised as soon as the sample is full for the first time, and again at the end; outputs get
their final name later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from prc_cli.core.brief import Brief
from prc_cli.core.findings import CHECK_NAMES, ORDER_CHECKS, Finding, accept, doubts, refuse
from prc_cli.core.hints import fitting_finding
from prc_cli.core.stream import ReadTally, ScanBlock, ScanStream, StreamInfo
from prc_cli.core.types import F64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.writing.record import dropped_beside
from prc_cli.methods.base import Needs
from prc_cli.streams.evidence.checks import ask_all, check_few_lines, check_thinned
from prc_cli.streams.evidence.cones import ConeSample
from prc_cli.streams.evidence.figures import LineSample, Seen
from prc_cli.streams.evidence.line_limits import LEAST_LINES
from prc_cli.streams.evidence.reading import with_other_reading
from prc_cli.streams.evidence.repeats import LineRepeats, check_repeats
from prc_cli.streams.evidence.table import worst_of

MAX_SCANNERS = 4
"""Most scanners whose lines are sampled; the counts include all."""


@dataclass(slots=True)
class _Scanner:
    """The sample and the counts of one scanner."""

    sample: LineSample
    angle_rad: F64 | None = None
    beam_rad: F64 | None = None
    has_rings: bool = False
    n_lines: int = 0
    n_shots: int = 0
    n_missing: int = 0
    cones: ConeSample = field(default_factory=ConeSample)


@dataclass(slots=True, repr=False)
class EvidenceStream(Brief):
    """A stream that is watched while its blocks pass, unchanged."""

    source: ScanStream
    accepted: tuple[str, ...] = ()
    refuses: bool = True
    most_noise_m: float = math.inf
    least_rings: int = 0
    dropped: str = ""
    """The note of a run record on shots that were left out."""
    others: tuple[Finding, ...] = ()
    is_part: bool = False
    """Whether the stream is only a window of the lines, which may be short."""
    _scanners: dict[int, _Scanner] = field(default_factory=dict, init=False)
    _tally: ReadTally = field(default_factory=ReadTally, init=False)
    _repeats: LineRepeats = field(default_factory=LineRepeats, init=False)
    _final: tuple[Finding, ...] = field(default=(), init=False)

    @property
    def info(self) -> StreamInfo:
        """Metadata of the stream."""
        return self.source.info

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        self._scanners = {}
        self._tally = ReadTally()
        self._repeats = LineRepeats()
        for block in self.source.blocks():
            if self._see(block) and self.refuses:
                refuse(self.info.path, self.question(is_whole=False)())
            yield block
        self._final = self.question(is_whole=True)()
        if self.refuses:
            refuse(self.info.path, self._final)

    def _see(self, block: ScanBlock) -> bool:
        """Add a block.

        Return whether the sample of its scanner became full just now.
        """
        self._tally += block.tally
        self._repeats.add(block)
        scanner = self._scanners.get(block.scanner)
        if scanner is None:
            scanner = self._scanners[block.scanner] = _Scanner(LineSample(block.points_per_line))
        scanner.angle_rad = block.angle_rad
        scanner.beam_rad = block.beam_rad
        scanner.has_rings = block.has_rings
        scanner.cones.add(block)
        scanner.n_lines += block.n_lines
        scanner.n_shots += block.range_m.size
        scanner.n_missing += int(np.count_nonzero(np.isnan(block.range_m)))
        if len(self._scanners) > MAX_SCANNERS:
            return False
        before = scanner.sample.n_full
        scanner.sample.add(block)
        return before == 0 < scanner.sample.n_full

    def seen(self) -> tuple[Seen, ...]:
        """Return the samples and counts so far, by scanner."""
        info = self.info
        every = self._scanners.values()
        n_shots = sum(state.n_shots for state in every)
        n_missing = sum(state.n_missing for state in every)
        return tuple(
            Seen(
                info=info,
                scanner=scanner,
                windows=state.sample.windows(),
                n_lines=state.n_lines,
                n_shots=n_shots,
                n_missing=n_missing,
                tally=self._tally,
                angle_rad=info.angle_rad if state.angle_rad is None else state.angle_rad,
                beam_rad=state.beam_rad,
                most_noise_m=self.most_noise_m,
                has_rings=state.has_rings,
                least_rings=self.least_rings,
                cone_spread_rad=state.cones.spread_rad(),
            )
            for scanner, state in sorted(self._scanners.items())[:MAX_SCANNERS]
        )

    def findings(self) -> tuple[Finding, ...]:
        """Return the answers of all checks once the stream was read to its end.

        Before that there are none.
        """
        return self._final

    def see(self, block: ScanBlock) -> int:
        """Add a block that is read elsewhere.

        Return how often samples have been full.
        """
        self._see(block)
        return sum(scanner.sample.n_full for scanner in self._scanners.values())

    def question(self, *, is_whole: bool) -> Callable[[], tuple[Finding, ...]]:
        """Return a function that runs all checks so far, in this or another thread."""
        is_long = (
            sum(scanner.n_lines for scanner in self._scanners.values()) >= LEAST_LINES
        )  # short streams are not judged
        others = [
            *(self._of_whole() if is_whole else ()),
            *check_thinned(self.dropped),
            *self.info.facts.findings,
            *(self.others if is_long else ()),
        ]
        return partial(_ask_of_all, self.seen(), tuple(others), self.accepted)

    def _of_whole(self) -> Iterator[Finding]:
        yield check_repeats(self._repeats, self.info.facts.repeated)
        if self.is_part:
            return
        scanners = self._scanners.items()
        yield from worst_of(
            {key: check_few_lines(state.n_lines, state.n_shots) for key, state in scanners}
        )


def _ask_of_all(
    seen: tuple[Seen, ...], others: tuple[Finding, ...], accepted: tuple[str, ...]
) -> tuple[Finding, ...]:
    """Run all checks of every scanner.

    ``others`` are answers about the whole stream.
    """
    by_scanner: dict[int, list[Finding]] = {}
    for scan in seen:
        findings = (
            with_other_reading(finding, scan.info.path, scan.points_per_line)
            for finding in ask_all(scan)
        )
        by_scanner[scan.scanner] = [_fitted(finding, scan) for finding in findings]
    every = (*worst_of(by_scanner), *others)
    return accept(sorted(every, key=lambda finding: CHECK_NAMES.index(finding.check)), accepted)


def _fitted(finding: Finding, seen: Seen) -> Finding:
    facts = seen.info.facts
    without_angles = frozenset() if seen.angle_rad is not None else frozenset(("nadir",))
    return fitting_finding(finding, facts.refuses | without_angles, facts.remedy)


def accepted_by(config: InputConfig) -> tuple[str, ...]:
    """Return the checks whose findings the user accepts."""
    return (*(config.accept_doubts or ()), *(ORDER_CHECKS if config.order == "trust" else ()))


def watched(
    stream: ScanStream,
    config: InputConfig,
    *,
    refuses: bool = True,
    needs: Needs | None = None,
    others: tuple[Finding, ...] = (),
) -> EvidenceStream:
    """Watch a stream; ``config`` names accepted warnings, ``needs`` the limits of the method."""
    dropped = stream.info.facts.dropped or dropped_beside(Path(stream.info.path))
    is_part = config.window is not None
    needs = needs or Needs(frozenset())
    return EvidenceStream(
        stream,
        accepted_by(config),
        refuses,
        needs.most_noise_m,
        needs.least_rings,
        dropped,
        others,
        is_part,
    )


class LiveEvidence:
    """A live stream that is checked whenever it is twice as long, and at its end."""

    def __init__(self, watch: EvidenceStream, report: Callable[[Finding], None]) -> None:
        self._watch = watch
        self._report = report
        self._reported: set[str] = set()
        self._worst: dict[str, Finding] = {}

    @property
    def info(self) -> StreamInfo:
        """Metadata of the stream."""
        return self._watch.info

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        n_checked = 0
        pending: Future[tuple[Finding, ...]] | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="evidence") as executor:
            for block in self._watch.source.blocks():
                if pending is not None and pending.done():
                    self.hear(pending.result())
                    pending = None
                n_full = self._watch.see(block)
                if n_full > n_checked and pending is None:
                    n_checked = n_full
                    pending = executor.submit(self._watch.question(is_whole=False))
                yield block
            if pending is not None:
                self.hear(pending.result())
        self.hear(self._watch.question(is_whole=True)())

    def findings(self) -> tuple[Finding, ...]:
        """Return the worst answer of every check so far.

        A warning is never taken back.
        """
        return tuple(self._worst.values())

    def hear(self, findings: Iterable[Finding]) -> None:
        """Add answers, also those of other checks: refuse, keep and report them."""
        answers = accept(findings, self._watch.accepted)
        refuse(self.info.path, answers)
        for finding in answers:
            known = self._worst.get(finding.check)
            if known is None or finding.verdict >= known.verdict:
                self._worst[finding.check] = finding
        for doubt in doubts(answers):
            if doubt.check not in self._reported:
                self._reported.add(doubt.check)
                self._report(doubt)
