"""What a classifier is: how it wants the stream cut, and how it labels a block.

A method is one folder beside this file and one row in :mod:`prc_cli.classifiers.methods`;
:mod:`prc_cli.classifiers.run` runs whichever it is, in as many threads as there are.

Nearly all steps of a method need one block alone. The few that need the blocks before it hand a value on: the step
gets the value that the block before left, and returns its result and the value for the next block. These values are
the fields of the method's state, a frozen dataclass, one for every scanner. Steps that hand on should be short: the
blocks take turns in them, while all other steps run at the same time.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from prc_cli.core.config import Params
from prc_cli.core.errors import InputError
from prc_cli.core.stream import LabelledBlock, ReadTally, ScanBlock
from prc_cli.core.types import F64, I64

ScannerT = TypeVar("ScannerT")
StateT = TypeVar("StateT")
StateT_co = TypeVar("StateT_co", covariant=True)
_ValueT = TypeVar("_ValueT")
_ResultT = TypeVar("_ResultT")


@dataclass(frozen=True)
class Part(Generic[_ValueT]):
    """A field of a state, which is handed on by itself."""

    name: str


class Turn(Protocol):
    """The place of a block in the stream of its scanner."""

    def hand_on(self, part: Part[_ValueT], step: Callable[[_ValueT], tuple[_ResultT, _ValueT]]) -> _ResultT:
        """Take a step that needs the blocks before.

        Parameters
        ----------
        part : Part
            Every block of a scanner hands on the same parts, each once.
        step : callable
            Takes the value that the block before left; returns a result, and the value for the next block.

        Returns
        -------
        object
            The result of the step.
        """


class OneByOne(Generic[StateT]):
    """Turns of blocks that are labelled one after the other.

    Parameters
    ----------
    state : dataclass
        What the block before left.

    Attributes
    ----------
    state : dataclass
        After a block: what it leaves to the next one.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Seen:
    ...     n_lines: int
    >>> turn = OneByOne(Seen(10))
    >>> turn.hand_on(Part[int]("n_lines"), lambda n: (f"begins at line {n}", n + 5)), turn.state
    ('begins at line 10', Seen(n_lines=15))
    """

    def __init__(self, state: StateT) -> None:
        self.state = state

    def hand_on(self, part: Part[_ValueT], step: Callable[[_ValueT], tuple[_ResultT, _ValueT]]) -> _ResultT:
        """Take a step; see :class:`Turn`."""
        state: Any = self.state
        result, value = step(getattr(state, part.name))
        self.state = replace(state, **{part.name: value})
        return result


@dataclass(frozen=True, slots=True)
class Needs:
    """What a method asks for."""

    kernels: frozenset[str]
    """Folders or modules of the compiled loops that it calls, as for :func:`prc_cli.kernels.load_kernels`."""
    lines_per_block: int | None = None
    """k, scan lines of a block, fewer only at the end of the stream; None = any number of whole lines."""
    look_ahead: int | None = None
    """Lines that are shown after a block, at least 1; None = those of :func:`prc_cli.core.blocks.look_ahead_lines`."""
    beams: bool = True
    """Whether blocks must say where their beams point (``beam_rad``)."""
    nadir_from_ground: bool = False
    """Whether the ranges may tell where down is: in streets, where much is level, and a degree or two is enough."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is found beside the labels, where the method has it."""

    segments: bool = False
    """Segment ids."""
    stages: bool = False
    """What was found on the way (:class:`~prc_cli.core.stream.StageLabels`)."""


LABELS_ALONE = Wanted()


class Classifier(Protocol[ScannerT, StateT_co]):
    """A method and its parameters."""

    @property
    @abstractmethod
    def needs(self) -> Needs:
        """What the method asks for."""

    @abstractmethod
    def scanner(self, first: ScanBlock) -> ScannerT:
        """Return what never changes of a scanner, such as its beams, from its first block.

        Raises
        ------
        InputError
            When the block lacks what the method needs.
        """

    @abstractmethod
    def initial_state(self, scanner: ScannerT) -> StateT_co:
        """Return the state before the first block of a scanner, a dataclass whose fields are handed on."""

    @abstractmethod
    def label(self, block: ScanBlock, scanner: ScannerT, turn: Turn, wanted: Wanted) -> Sequence[LabelledBlock]:
        """Label a block, in any thread.

        Parameters
        ----------
        block : ScanBlock
            The next lines of the scanner, with the lines that follow (``next_m``) and whether it is the last
            (``is_last``).
        scanner : object
            From :meth:`scanner`.
        turn : Turn
            Hands the state on.
        wanted : Wanted
            What to find beside the labels.

        Returns
        -------
        sequence of LabelledBlock
            The lines that became final, in order, their further returns labelled too; there may be none, and lines of
            earlier blocks among them.
        """

    def hopping(self, hop: int) -> Classifier[Any, Any]:
        """Return the method such that labels leave every ``hop`` lines; here as it is, it has no other way.

        Raises
        ------
        ConfigError
            When the number of lines is not possible.
        """
        return self

    def notices(self, labels: I64, tally: ReadTally, *, segments: bool) -> tuple[str, ...]:
        """Say what a finished run did without, in sentences.

        Parameters
        ----------
        labels : (number of labels,) int64
            Counts by :class:`~prc_cli.core.classes.Label`.
        tally : ReadTally
            Counts of the reader and the method.
        segments : bool
            Whether segment ids were asked for.
        """
        return ()


class MethodParams(Params):
    """Parameters of a method, a table of the configuration; they know the method."""

    def method(self) -> Classifier[Any, Any]:
        """Return the method with these parameters."""
        raise NotImplementedError


def beams_of(block: ScanBlock) -> F64:
    """Return the beams of a block, (M,) float64 [rad].

    Raises
    ------
    InputError
        When it has none.
    """
    if block.beam_rad is None:
        problem = "no beam angles, expected the angle of every column from straight down"
        raise InputError("block of ranges", problem)
    return block.beam_rad
