"""Watches a stream while it passes, and runs all checks of it.

Nothing is read twice: a bounded sample of the lines is kept while blocks pass. Evidence against the
input is raised as soon as the sample is full for the first time, and again at the end; outputs get
their final name later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

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
from prc_cli.streams.stream import Stream

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


@dataclass(slots=True)
class Evidence:
    """Samples and counts of the blocks of one reading, and the answers of all checks."""

    stream: ScanStream
    """The stream before it is watched."""
    accepted: tuple[str, ...] = ()
    """Checks whose findings the user accepts."""
    needs: Needs = field(default_factory=lambda: Needs(()))
    """Limits of the method."""
    dropped: str = ""
    """The note of a run record on shots that were left out."""
    others: tuple[Finding, ...] = ()
    """Answers of checks that were done before."""
    is_part: bool = False
    """Whether the stream is only a window of the lines, which may be short."""
    _scanners: dict[int, _Scanner] = field(default_factory=dict, init=False)
    _tally: ReadTally = field(default_factory=ReadTally, init=False)
    _repeats: LineRepeats = field(default_factory=LineRepeats, init=False)

    @property
    def info(self) -> StreamInfo:
        """Metadata of the stream, which may be known better the more of it is read."""
        return self.stream.info

    @property
    def n_full(self) -> int:
        """How often samples have been full."""
        return sum(scanner.sample.n_full for scanner in self._scanners.values())

    def add(self, block: ScanBlock) -> bool:
        """Add a block; return whether the sample of its scanner became full for the first time."""
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
                most_noise_m=self.needs.most_noise_m,
                has_rings=state.has_rings,
                least_rings=self.needs.least_rings,
                cone_spread_rad=state.cones.spread_rad(),
            )
            for scanner, state in sorted(self._scanners.items())[:MAX_SCANNERS]
        )

    def question(self, *, is_whole: bool) -> Callable[[], tuple[Finding, ...]]:
        """Return a function that runs all checks so far, in this or another thread."""
        # short streams are not judged
        is_long = sum(scanner.n_lines for scanner in self._scanners.values()) >= LEAST_LINES
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


def evidence_of(
    stream: ScanStream,
    config: InputConfig,
    *,
    needs: Needs | None = None,
    others: tuple[Finding, ...] = (),
) -> Callable[[], Evidence]:
    """Return what starts the checks of a stream; ``needs`` are the limits of the method."""
    return partial(
        Evidence,
        stream,
        accepted=accepted_by(config),
        needs=needs or Needs(()),
        dropped=stream.info.facts.dropped or dropped_beside(Path(stream.info.path)),
        others=others,
        is_part=config.window is not None,
    )


def watched(
    stream: ScanStream,
    config: InputConfig,
    *,
    refuses: bool = True,
    needs: Needs | None = None,
    others: tuple[Finding, ...] = (),
) -> Stream:
    """Check a stream while its blocks pass, unchanged; the findings are observed at its end.

    Parameters
    ----------
    stream : ScanStream
    config : InputConfig
        Names accepted warnings.
    refuses : bool
        Whether evidence against the input is raised.
    needs : Needs, optional
        Limits of the method.
    others : tuple of Finding
        Answers of checks that were done before.

    Raises
    ------
    EvidenceError
        While blocks are read, if a check refuses the input.
    """
    plain = Stream.of(stream)
    begin = evidence_of(plain, config, needs=needs, others=others)

    def checked(blocks: Iterator[ScanBlock]) -> Iterator[ScanBlock]:
        evidence = begin()
        for block in blocks:
            is_first_sample = evidence.add(block)
            if is_first_sample and refuses:
                refuse(plain.info.path, evidence.question(is_whole=False)())
            yield block
        findings = evidence.question(is_whole=True)()
        plain.observed.findings[:] = findings
        if refuses:
            refuse(plain.info.path, findings)

    return plain.through(checked)


class LiveFindings:
    """The worst answer of every check of a live stream so far: a warning is never taken back."""

    def __init__(
        self, path: str, accepted: tuple[str, ...], report: Callable[[Finding], None]
    ) -> None:
        self._path = path
        self._accepted = accepted
        self._report = report
        self._reported: set[str] = set()
        self._worst: dict[str, Finding] = {}

    def __iter__(self) -> Iterator[Finding]:
        return iter(self._worst.values())

    def hear(self, findings: Iterable[Finding]) -> None:
        """Add answers: refuse, keep and report them."""
        answers = accept(findings, self._accepted)
        refuse(self._path, answers)
        for finding in answers:
            known = self._worst.get(finding.check)
            if known is None or finding.verdict >= known.verdict:
                self._worst[finding.check] = finding
        for doubt in doubts(answers):
            if doubt.check not in self._reported:
                self._reported.add(doubt.check)
                self._report(doubt)


def watched_live(
    stream: ScanStream, begin: Callable[[], Evidence], findings: LiveFindings
) -> Stream:
    """Check a live stream whenever it is twice as long, beside its blocks, and at its end."""

    def checked(blocks: Iterator[ScanBlock]) -> Iterator[ScanBlock]:
        evidence = begin()
        n_checked = 0
        pending: Future[tuple[Finding, ...]] | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="evidence") as executor:
            for block in blocks:
                if pending is not None and pending.done():
                    findings.hear(pending.result())
                    pending = None
                evidence.add(block)
                if evidence.n_full > n_checked and pending is None:
                    n_checked = evidence.n_full
                    pending = executor.submit(evidence.question(is_whole=False))
                yield block
            if pending is not None:
                findings.hear(pending.result())
        findings.hear(evidence.question(is_whole=True)())

    return Stream.of(stream).through(checked)
