"""Says why a shot has its class: the answers of the stages, and the parameters that decided (``prc explain``).

The run is that of ``prc classify``, from the start of the input to the block of the shot, because states are handed
from block to block: so its class is the one that ``prc classify`` writes. A listener keeps what was handed on for that
block; the images of its stages are then computed again by the stages themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prc_cli.config import LoadedConfig, MethodChoice, RunConfig, refuse_window
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.threads import default_threads
from prc_cli.core.window import Window
from prc_cli.formats import check_input
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import Progress, load_classifier, open_stream
from prc_cli.jobs.explain.answers import Answer
from prc_cli.jobs.explain.fused import fused_answers
from prc_cli.jobs.explain.prc import prc_answers
from prc_cli.jobs.explain.sequential_angle import sequential_angle_answers
from prc_cli.jobs.progress import advance
from prc_cli.methods.base import Classifier, MethodParams, Needs, Turn, Wanted
from prc_cli.methods.fused.confidence import Overhearing
from prc_cli.methods.fused.pipeline import FusedParams
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.run import SHOTS_AT_ONCE, run_blocks
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a shot has its class."""

    path: str
    line: int
    column: int
    scanner: int
    record: int
    """Index in the input, -1 = none."""
    range_m: float | None
    """None = missing [m]."""
    time_s: float | None
    beam_deg: float | None
    """From straight down; None = not known or not needed."""
    method: str
    choice: MethodChoice | None
    """The method that was chosen for the input; None = it was named."""
    label: Label
    code: int
    """As ``prc classify`` writes it."""
    answers: tuple[Answer, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        choice = self.choice
        return {
            "path": self.path,
            "line": self.line,
            "column": self.column,
            "scanner": self.scanner,
            "record": self.record,
            "range_m": self.range_m,
            "time_s": self.time_s,
            "beam_deg": self.beam_deg,
            "method": self.method,
            "chosen": None if choice is None else {"preset": choice.preset, "why": choice.why},
            "class": self.label.name.lower(),
            "code": self.code,
            "answers": [answer.as_dict() for answer in self.answers],
        }


def explain(
    source: Path | str,
    line: int,
    column: int,
    config: LoadedConfig | RunConfig | None = None,
    *,
    scanner: int | None = None,
    progress: Progress | None = None,
    loading: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> Explanation:
    """Say why a shot has its class."""
    source = Path(source)
    if line < 0 or column < 0:
        raise ConfigError("--at", f"found {line},{column}, expected LINE,COLUMN, both from 0")
    loaded = config if isinstance(config, LoadedConfig) else LoadedConfig(config or RunConfig())
    refuse_window(loaded.config, "prc explain")
    check_input(source)
    loaded = decide(source, loaded)
    with loading():
        load_classifier(loaded)
    params = loaded.config.classifier
    listener = _Listener(params.method(), line, scanner)
    item = _find(source, loaded, listener, progress)
    if column >= item.block.points_per_line:
        problem = f"found column {column}, expected 0 to {item.block.points_per_line - 1}"
        raise InputError(str(source), problem, "lines have as many shots: prc info")
    at = line - item.block.first_line, column
    label = Label(int(item.labels[at]))
    answers: Sequence[Answer] = [Answer("range", "no return", "missing")]
    if label != Label.MISSING:
        answers = list(_answers(item, listener, params, at))
    block = item.block
    range_m = float(block.range_m[at])
    time_s = None if block.time_s is None else float(block.time_s[at])
    return Explanation(
        path=str(source),
        line=line,
        column=column,
        scanner=block.scanner,
        record=int(block.records()[at]),
        range_m=None if range_m != range_m else range_m,
        time_s=None if time_s is None or time_s != time_s else time_s,
        beam_deg=None if block.beam_rad is None else math.degrees(block.beam_rad[column]),
        method=loaded.config.method,
        choice=loaded.choice,
        label=label,
        code=loaded.config.classes.code(label),
        answers=tuple(answers),
    )


def _find(source: Path, loaded: LoadedConfig, listener: _Listener, progress: Progress | None) -> LabelledBlock:
    """Run to the block of the shot."""
    last, found = -1, set[int]()
    stream = open_stream(source, loaded)
    info, to_line = stream.info, Window("--at", True, 0.0, listener.line + 1.0)
    labelled = run_blocks(
        stream.blocks(), listener, threads=default_threads(),
        wanted=Wanted(stages=loaded.config.method == "sequential-angle"),
        shots_at_once=SHOTS_AT_ONCE,
    )  # fmt: skip
    with closing(_generator(labelled)) as items:
        for item in items:
            block = item.block
            advance(progress, block, info, to_line)
            found.add(block.scanner)
            if listener.holds(block):
                return item
            if block.scanner == listener.number:
                last = block.first_line + block.n_lines - 1
    problem = f"found lines 0 to {last}, expected line {listener.line}"
    if last < 0:
        problem = f"found scanners {', '.join(map(str, sorted(found))) or 'none'}, expected {listener.number}"
    raise InputError(str(source), problem, "lines and columns are counted from 0: prc info")


def _generator(items: Iterator[LabelledBlock]) -> Generator[LabelledBlock]:
    yield from items


class _Listener(Classifier[Any, Any]):
    """A method that also keeps the block of a line, and what was handed on for it."""

    def __init__(self, method: Classifier[Any, Any], line: int, number: int | None) -> None:
        self._method = method
        self.line = line
        self.number = number
        """Scanner that is asked for; by default the first that comes."""
        self.block: ScanBlock | None = None
        self.constants: Any = None
        self.heard: dict[str, Any] = {}

    @property
    def needs(self) -> Needs:
        """What the method requires of its input."""
        return self._method.needs

    def holds(self, block: ScanBlock) -> bool:
        """Whether a block has the line."""
        return block.scanner == self.number and block.first_line <= self.line < block.first_line + block.n_lines

    def scanner(self, first: ScanBlock) -> Any:
        """Return the constants of a scanner."""
        if self.number is None:
            self.number = first.scanner
        return self._method.scanner(first)

    def initial_state(self, scanner: Any) -> Any:
        """Return the state before the first block."""
        return self._method.initial_state(scanner)

    def label(self, block: ScanBlock, scanner: Any, turn: Turn, wanted: Wanted) -> Sequence[LabelledBlock]:
        """Label a block; listen where it has the line."""
        if not self.holds(block):
            return self._method.label(block, scanner, turn, wanted)
        heard = Overhearing(turn)
        found = self._method.label(block, scanner, heard, wanted)
        self.block, self.constants, self.heard = block, scanner, dict(heard.results)
        return found


def _answers(item: LabelledBlock, listener: _Listener, params: MethodParams, at: tuple[int, int]) -> Iterator[Answer]:
    """Yield the answers of the stages of a method."""
    block = listener.block
    assert block is not None
    if isinstance(params, SequentialAngleParams):
        yield from sequential_angle_answers(item, params, *at)
    elif isinstance(params, PrcParams):
        yield from prc_answers(block, listener.heard, params, *at)
    elif isinstance(params, FusedParams):
        yield from fused_answers(item, block, (listener.constants, listener.heard), params, at)


__all__ = ["Answer", "Explanation", "explain"]
