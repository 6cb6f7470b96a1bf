"""Interface of a classifier: how the stream is cut for it, and how it labels a block.

A method is one folder beside this file and one row in :mod:`prc_cli.methods.methods`, or a
:class:`Method` of another package.
:mod:`prc_cli.methods.run` runs all methods, in any number of threads.

Most steps of a method need only their own block. A step that depends on earlier blocks receives the
value left by the previous block, and returns its result and the value for the next block. These
values are the fields of the method's state, a frozen dataclass, one per scanner. Such steps should
be short: they run block after block, all other steps run in parallel.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from prc_cli.core.classes import Label
from prc_cli.core.config import Params
from prc_cli.core.errors import InputError
from prc_cli.core.loops import Loops
from prc_cli.core.stream import LabelledBlock, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64, I64

WHERE = "block of ranges"


def check_block(
    range_m: F32,
    next_m: F32 | None,
    points_per_line: int,
    lines_per_block: int,
    *,
    columns: str,
    key: str,
) -> None:
    """Refuse arrays that cannot be the next block of a stream.

    ``range_m`` (lines, M) float32, metres; ``next_m`` (lines, M) float32, metres.
    """
    for array in (range_m,) if next_m is None else (range_m, next_m):
        if array.ndim != 2 or array.shape[1] != points_per_line:
            problem = (
                f"found an array of shape {array.shape}, "
                f"expected (lines, {points_per_line}){columns}"
            )
            raise InputError(WHERE, problem, "check points_per_line")
    if not 1 <= len(range_m) <= lines_per_block:
        problem = f"found {len(range_m)} lines, expected 1 to {lines_per_block}"
        raise InputError(WHERE, problem, f"cut the stream into blocks of {key} lines")


ScannerT = TypeVar("ScannerT")
StateT = TypeVar("StateT")
StateT_co = TypeVar("StateT_co", covariant=True)
_ValueT = TypeVar("_ValueT")
_ResultT = TypeVar("_ResultT")


@dataclass(frozen=True)
class Part(Generic[_ValueT]):
    """A field of a state, handed on separately from the other fields."""

    name: str


class Turn(Protocol):
    """The position of a block in its scanner's stream; passes the state from block to block."""

    def hand_on(
        self, part: Part[_ValueT], step: Callable[[_ValueT], tuple[_ResultT, _ValueT]]
    ) -> _ResultT:
        """Run a step that depends on the previous blocks.

        Parameters
        ----------
        part : Part
            Every block of a scanner hands on the same parts, each exactly once.
        step : callable
            Takes the value left by the previous block; returns a result and the value for the next
            block.

        Returns
        -------
        object
            The result of the step.
        """


class OneByOne(Generic[StateT]):
    """A :class:`Turn` for blocks that one thread labels one after the other.

    Parameters
    ----------
    state : dataclass
        State left by the previous block.

    Attributes
    ----------
    state : dataclass
        After a block: the state for the next one.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Counts:
    ...     n_lines: int
    >>> turn = OneByOne(Counts(10))
    >>> turn.hand_on(Part[int]("n_lines"), lambda n: (f"starts at line {n}", n + 5)), turn.state
    ('starts at line 10', Counts(n_lines=15))
    """

    def __init__(self, state: StateT) -> None:
        self.state = state

    def hand_on(
        self, part: Part[_ValueT], step: Callable[[_ValueT], tuple[_ResultT, _ValueT]]
    ) -> _ResultT:
        """Run a step; see :class:`Turn`."""
        state: Any = self.state
        result, value = step(getattr(state, part.name))
        self.state = replace(state, **{part.name: value})
        return result


@dataclass(frozen=True, slots=True)
class Needs:
    """What a method requires of its input."""

    loops: Loops = ()
    """Its compiled loops, for :func:`prc_cli.core.loops.load_loops`."""
    lines_per_block: int | None = None
    """k, scan lines per block, fewer only at the end of the stream.

    None = any number of whole lines.
    """
    look_ahead: int | None = None
    """Lines of look-ahead after a block, at least 1.

    None = :func:`prc_cli.core.blocks.look_ahead_lines`.
    """
    beams: bool = True
    """Whether blocks must have beam angles (``beam_rad``)."""
    intensity: bool = False
    """Whether labels depend on intensities: every reader gives them, if the input has any."""
    most_noise_m: float = math.inf
    """Most range noise that the thresholds allow [m]; more is a warning."""
    least_rings: int = 0
    """Fewer rings with returns than this are a warning: classes are less certain."""
    confidence_loops: Loops | None = None
    """Further loops that it calls if confidence is requested; None = it has no confidence."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """Optional results besides the labels, where the method provides them."""

    segments: bool = False
    """Segment ids."""
    stages: bool = False
    """Intermediate results (:class:`~prc_cli.core.stream.StageLabels`)."""
    confidence: bool = False
    """How certain every label is [per cent]."""
    reasons: bool = False
    """The rule that gave every label (:class:`~prc_cli.core.classes.Reason`)."""
    measures: bool = False
    """Quantities that the stages measured for every shot, for ``prc explain``; needs ``stages``."""


LABELS_ALONE = Wanted()


@dataclass(frozen=True, slots=True)
class UsualLabels:
    """Usual labels of a method in scans whose description fits.

    :mod:`prc_cli.streams.evidence.result` checks them. The defaults check nothing.
    :mod:`prc_cli.streams.evidence.table` says how each limit was measured. "Returns" are those that
    are not noise, unless stated otherwise.
    """

    noise_share: float = 1.0
    """Largest share of noise in all returns; more is a warning."""
    garbage_share: float = 1.0
    """Largest share of noise of any scanner; more is refused."""
    unclassified_share: float = 1.0
    """Largest share of returns without a class."""
    level: tuple[Label, ...] = (Label.GROUND, Label.CURB)
    """Labels of the surface of the ground."""
    level_share: float = 0.0
    """Least share of ``level`` in the returns within 60 deg of straight down."""
    ground_share: float = 0.0
    """Least share of ``level`` in all returns, if nearly none is within 60 deg of straight down."""
    below_share: float = 1.0
    """Largest share 1 m or more below the ground in the returns within 20 m and 60 deg of down."""
    lean_deg: float = 90.0
    """Largest lean of the ground across the lines [deg]."""
    vanished_share: float = 0.0
    """Least share of ground, as a part of its upper quartile in the stream; less = vanished."""
    reach_m: float = 0.0
    """Some returns are farther than this [m]."""


class Classifier(Protocol[ScannerT, StateT_co]):
    """A method and its parameters."""

    @property
    @abstractmethod
    def needs(self) -> Needs:
        """What the method requires of its input."""

    @property
    def usual(self) -> UsualLabels:
        """Its usual labels; by default nothing is known."""
        return UsualLabels()

    @property
    def gives(self) -> frozenset[Label]:
        """Labels that it may give; by default all."""
        return frozenset(Label)

    @abstractmethod
    def scanner(self, first: ScanBlock) -> ScannerT:
        """Return the constants of a scanner, such as its beams, from its first block.

        Raises
        ------
        InputError
            When the block lacks what the method needs.
        """

    @abstractmethod
    def initial_state(self, scanner: ScannerT) -> StateT_co:
        """Return the state before the first block: a dataclass whose fields are handed on."""

    @abstractmethod
    def label(
        self,
        block: ScanBlock,
        scanner: ScannerT,
        turn: Turn,
        wanted: Wanted,
    ) -> Sequence[LabelledBlock]:
        """Label a block, in any thread.

        Parameters
        ----------
        block : ScanBlock
            The next lines of the scanner, with look-ahead (``next_m``) and whether it is the last
            (``is_last``).
        scanner : object
            From :meth:`scanner`.
        turn : Turn
            Hands the state on.
        wanted : Wanted
            Optional results to compute.

        Returns
        -------
        sequence of LabelledBlock
            The lines that became final, in order, including their further returns; may be empty,
            and may include lines of earlier blocks.
        """

    def limits(self, block: ScanBlock) -> Any:
        """Return the object with the limits for a block, by the names in the rules."""
        return self

    def notices(self, labels: I64, tally: ReadTally, *, segments: bool) -> tuple[str, ...]:
        """Return sentences on what a finished run could not compute.

        Parameters
        ----------
        labels : (number of labels,) int64
            Counts by :class:`~prc_cli.core.classes.Label`.
        tally : ReadTally
            Counts of the reader and the method.
        segments : bool
            Whether segment ids were requested.
        """
        return ()


class MethodParams(Params):
    """Parameters of a method, one table of the configuration."""

    def method(self) -> Classifier[Any, Any]:
        """Return the method with these parameters."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Method:
    """A method as the command line and the configuration know it.

    Another package adds one by an entry point of the group ``prc_cli.methods`` that names a
    ``Method``.
    """

    name: str
    """Value of ``--method``, in lower case with hyphens."""
    params: type[MethodParams]
    """Its table in the configuration."""
    description: str
    """Title of the table."""
    mapping: str | None = None
    """Classes for ``prc evaluate``: ``street`` or ``street_scan``; None = those of PRC."""
    presets: tuple[Path, ...] = ()
    """Presets: TOML files, whose names are those of the presets with underscores."""


def beams_of(block: ScanBlock) -> F64:
    """Return the beam angles of a block, (M,) float64 [rad].

    Raises
    ------
    InputError
        When it has none.
    """
    if block.beam_rad is None:
        problem = "no beam angles, expected the angle of every column from straight down"
        raise InputError("block of ranges", problem)
    return block.beam_rad
