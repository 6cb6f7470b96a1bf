"""Runs any classifier on a stream of blocks, for several scanners and in several threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import count
from typing import Any, TypeVar

from prc_cli.core.blocks import regroup
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.threads import Relay, close_items, ordered
from prc_cli.methods.base import LABELS_ALONE, Classifier, Part, Wanted

SHOTS_AT_ONCE = 1 << 17
"""Approximate shots per block for methods that take any number of lines.

Labels do not depend on it.
"""

_ValueT = TypeVar("_ValueT")
_ResultT = TypeVar("_ResultT")


def run_blocks(
    blocks: Iterator[ScanBlock],
    classifier: Classifier[Any, Any],
    *,
    threads: int = 1,
    wanted: Wanted = LABELS_ALONE,
    shots_at_once: int = SHOTS_AT_ONCE,
) -> Iterator[LabelledBlock]:
    """Classify a stream block by block, with one state per scanner."""
    needs = classifier.needs
    scanners: dict[int, _Scanner] = {}
    firsts: dict[int, int] = {}

    def begin() -> Iterator[_Job]:
        cut = regroup(
            _from_zero(blocks, firsts),
            needs.lines_per_block,
            shots_per_block=shots_at_once,
            look_ahead=needs.look_ahead,
        )
        for block in cut:
            scanner = scanners.pop(block.scanner, None) or _Scanner.of(classifier, block)
            if not block.is_last:
                scanners[block.scanner] = scanner
            yield _Job(block, scanner, next(scanner.turns))

    def work(job: _Job) -> Sequence[LabelledBlock]:
        try:
            return classifier.label(job.block, job.scanner.constants, job, wanted)
        except BaseException:
            job.give_up()
            raise

    # one more than the threads work on: the next one waits in the queue
    results = ordered(work, begin(), threads=threads, ahead=threads + 1)
    try:
        for labelled_blocks in results:
            for labelled in labelled_blocks:
                first = firsts[labelled.block.scanner]
                if first:
                    labelled = replace(labelled, block=_moved(labelled.block, first))
                yield labelled
            del labelled_blocks
    finally:
        close_items(results)


def _from_zero(blocks: Iterator[ScanBlock], firsts: dict[int, int]) -> Iterator[ScanBlock]:
    """Count the lines of every scanner from its first one: methods know that none was before."""
    for block in blocks:
        first = firsts.setdefault(block.scanner, block.first_line)
        yield block if not first else _moved(block, -first)


def _moved(block: ScanBlock, n_lines: int) -> ScanBlock:
    """Return a block with other line numbers and the same records."""
    return replace(block, first_line=block.first_line + n_lines, record=block.records())


@dataclass(frozen=True, slots=True, eq=False)
class _Scanner:
    """A scanner's constants, and its state: its fields pass from block to block across threads."""

    constants: Any
    relays: dict[str, Relay[Any]]
    turns: Iterator[int]

    @classmethod
    def of(cls, classifier: Classifier[Any, Any], first: ScanBlock) -> _Scanner:

        constants = classifier.scanner(first)
        state = classifier.initial_state(constants)
        return cls(
            constants,
            {part.name: Relay(getattr(state, part.name)) for part in fields(state)},
            count(),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """A block being classified; also its :class:`~prc_cli.methods.base.Turn`."""

    block: ScanBlock
    scanner: _Scanner
    turn: int

    def hand_on(
        self, part: Part[_ValueT], step: Callable[[_ValueT], tuple[_ResultT, _ValueT]]
    ) -> _ResultT:

        relay: Relay[_ValueT] = self.scanner.relays[part.name]
        return relay.take_turn(self.turn, step)[0]

    def give_up(self) -> None:
        """Make the later blocks fail, as this one left no state."""
        for relay in self.scanner.relays.values():
            relay.give_up(self.turn)
