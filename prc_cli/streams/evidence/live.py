"""Watches a live stream: the checks are asked in a thread beside it, so that no label waits for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

from prc_cli.core.findings import Finding, accept, doubts, refuse
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.streams.evidence.watch import EvidenceStream


class LiveEvidence:
    """A stream without an end that is watched while its blocks pass, unchanged.

    The checks are asked whenever the sample is full anew, which is each time that the stream is twice as long, and at
    the end. What they find is raised, or told, with the next block.
    """

    def __init__(self, watch: EvidenceStream, tell: Callable[[Finding], None]) -> None:
        self._watch = watch
        self._tell = tell
        self._told: set[str] = set()
        self._worst: dict[str, Finding] = {}

    @property
    def info(self) -> StreamInfo:
        """Metadata of the stream."""
        return self._watch.info

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        n_asked = 0
        asked: Future[tuple[Finding, ...]] | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="evidence") as beside:
            for block in self._watch.source.blocks():
                if asked is not None and asked.done():
                    self.hear(asked.result())
                    asked = None
                n_full = self._watch.see(block)
                if n_full > n_asked and asked is None:
                    n_asked, asked = n_full, beside.submit(self._watch.question(is_whole=False))
                yield block
            if asked is not None:
                self.hear(asked.result())
        self.hear(self._watch.question(is_whole=True)())

    def findings(self) -> tuple[Finding, ...]:
        """Return the worst answer of every check so far: what was labelled in doubt stays doubtful."""
        return tuple(self._worst.values())

    def hear(self, findings: Iterable[Finding]) -> None:
        """Take answers, also those of other checks: refuse, keep and tell them."""
        found = accept(findings, self._watch.accepted)
        refuse(self.info.path, found)
        for finding in found:
            known = self._worst.get(finding.check)
            if known is None or finding.verdict >= known.verdict:
                self._worst[finding.check] = finding
        for doubt in doubts(found):
            if doubt.check not in self._told:
                self._told.add(doubt.check)
                self._tell(doubt)
