"""The one runner of all classifiers: blocks of several scanners through the steps of a method, in threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import count
from typing import Any, TypeVar

from prc_cli.classifiers.base import LABELS_ALONE, Classifier, Part, Wanted
from prc_cli.core.blocks import regroup
from prc_cli.core.memory import keep_memory
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.threads import Relay, close_items, ordered

SHOTS_AT_ONCE = 1 << 17
"""Shots of a block where the method takes any number of lines; labels do not depend on it."""

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
    """Classify a stream block by block; what crosses blocks is one state a scanner.

    Parameters
    ----------
    blocks : iterator of ScanBlock
        Blocks of any number of lines; with ``beam_rad`` where the classifier needs beams.
    classifier : Classifier
        A method and its parameters.
    threads : int
        Threads that classify; results do not depend on it. At most one block more is held at a time.
    wanted : Wanted
        What to find beside the labels, where the method has it.
    shots_at_once : int
        Where the method takes any number of lines: about as many shots, whole lines, at a time; labels do not depend
        on it.

    Yields
    ------
    LabelledBlock
        In order for each scanner: blocks of k lines (fewer at the end), or the lines that became final.
    """
    needs = classifier.needs
    scanners: dict[int, _Scanner] = {}

    def begin() -> Iterator[_Job]:
        cut = regroup(blocks, needs.lines_per_block, shots_per_block=shots_at_once, look_ahead=needs.look_ahead)
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

    keep_memory()
    # one more than are worked on: the queue before the threads holds the next one
    found = ordered(work, begin(), threads=threads, ahead=threads + 1)
    try:
        for labelled in found:
            yield from labelled
            del labelled
    finally:
        close_items(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Scanner:
    """A scanner and its state, which blocks in several threads hand on field by field."""

    constants: Any
    relays: dict[str, Relay[Any]]
    turns: Iterator[int]

    @classmethod
    def of(cls, classifier: Classifier[Any, Any], first: ScanBlock) -> _Scanner:
        """Begin with the first block of a scanner."""
        constants = classifier.scanner(first)
        state = classifier.initial_state(constants)
        return cls(constants, {each.name: Relay(getattr(state, each.name)) for each in fields(state)}, count())


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """A block on its way; it is its own :class:`~prc_cli.classifiers.base.Turn`."""

    block: ScanBlock
    scanner: _Scanner
    turn: int

    def hand_on(self, part: Part[_ValueT], step: Callable[[_ValueT], tuple[_ResultT, _ValueT]]) -> _ResultT:
        """Wait until the block before has handed the part on, and take the step."""
        relay: Relay[_ValueT] = self.scanner.relays[part.name]
        return relay.take_turn(self.turn, step)[0]

    def give_up(self) -> None:
        """Tell the blocks after this one that nothing comes."""
        for relay in self.scanner.relays.values():
            relay.give_up(self.turn)
