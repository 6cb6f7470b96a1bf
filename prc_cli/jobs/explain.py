"""Explains why a shot has its class: ``prc explain``.

The explanation names the rule that gave the label, its limits, and the measured values. The run is
the same as in ``prc classify``, from the start of the input to the block of the shot, because a
method keeps states from block to block. The method gives the rule together with the label.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

from prc_cli.config import LoadedConfig, MethodChoice, RunConfig, refuse_window, resolve
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.threads import close_items, default_threads
from prc_cli.core.window import Window
from prc_cli.formats.input import Input
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import label_blocks, load_classifier, open_for_method
from prc_cli.jobs.progress import advance
from prc_cli.jobs.run import Progress
from prc_cli.methods.base import Wanted
from prc_cli.methods.reasons import Rule, rule_of


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
    chosen: MethodChoice | None
    """Choice of the method; None = the user named it."""
    label: Label
    code: int
    """As ``prc classify`` writes it."""
    reason: int
    """As ``output.reason`` writes it (:class:`prc_cli.core.classes.Reason`)."""
    rule: str
    """Name of the rule that gave the label."""
    sentence: str
    """Text of the rule."""
    limits: dict[str, Any]
    """Limits of the rule: keys of the configuration or names of constants, with their values."""
    measures: dict[str, Any]
    """Measured values of the shot, by name with unit; None = not known."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        chosen = (
            None if self.chosen is None else {"preset": self.chosen.preset, "why": self.chosen.why}
        )
        table = {**asdict(self), "class": self.label.name.lower(), "chosen": chosen}
        del table["label"]
        return table


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
    """Explain why a shot has its class.

    Parameters
    ----------
    source : path
    line, column : int
        The shot, counted from 0.
    config : LoadedConfig or RunConfig, optional
    scanner : int, optional
        Number of the scanner; default: the first.
    progress : callable, optional
        Called with the number of lines that are finished since the last call.
    loading : callable
        Context in which the loops of the method are loaded.

    Raises
    ------
    InputError
        If the input has no such shot.
    """
    if line < 0 or column < 0:
        problem = f"found {line},{column}, expected LINE,COLUMN, counted from 0"
        raise ConfigError("--at", problem)
    scan, loaded = resolve(source, config)
    refuse_window(loaded.config, "prc explain")
    scan.check()
    loaded = decide(scan, loaded)
    with loading():
        load_classifier(loaded)
    item = _find(scan, loaded, line, scanner, progress)
    block = item.block
    if column >= block.points_per_line:
        problem = f"found column {column}, expected 0 to {block.points_per_line - 1}"
        raise InputError(str(scan), problem, "prc info prints the number of shots per line")
    cell = line - block.first_line, column
    assert item.reasons is not None
    label = Label(int(item.labels[cell]))
    reason = int(item.reasons[cell])
    name, rule = rule_of(reason)
    measures = (
        {}
        if label == Label.MISSING
        else {name: _plain(image[cell]) for name, image in item.measures.items()}
    )
    return Explanation(
        path=str(scan),
        line=line,
        column=column,
        scanner=block.scanner,
        record=int(block.records()[cell]),
        range_m=_plain(block.range_m[cell]),
        time_s=None if block.time_s is None else _plain(block.time_s[cell]),
        beam_deg=None if block.beam_rad is None else math.degrees(block.beam_rad[column]),
        method=loaded.config.method,
        chosen=loaded.choice,
        label=label,
        code=loaded.config.classes.code(label),
        reason=reason,
        rule=name,
        sentence=rule.sentence,
        limits=_limits(rule, loaded.config, block),
        measures=measures,
    )


def _find(
    scan: Input,
    loaded: LoadedConfig,
    line: int,
    scanner: int | None,
    progress: Progress | None,
) -> LabelledBlock:
    """Classify up to the line; return its block."""
    last = -1
    seen = set[int]()
    stream = open_for_method(scan, loaded.config)
    to_line = Window("--at", True, 0.0, line + 1.0)
    wanted = Wanted(stages=True, reasons=True, measures=True)
    labelled = label_blocks(
        stream.blocks(), loaded.config.classifier, threads=default_threads(), wanted=wanted
    )
    try:
        for item in labelled:
            block = item.block
            advance(progress, block, stream.info, to_line)
            seen.add(block.scanner)
            scanner = block.scanner if scanner is None else scanner
            if block.scanner == scanner:
                last = block.first_line + block.n_lines - 1
                if block.first_line <= line <= last:
                    return item
    finally:
        close_items(labelled)
    problem = f"found lines 0 to {last}, expected line {line}"
    if last < 0:
        problem = (
            f"found scanners {', '.join(map(str, sorted(seen))) or 'none'}, expected {scanner}"
        )
    raise InputError(str(scan), problem, "prc info prints the number of lines")


def _plain(value: Any) -> Any:
    """Return a value of an array as a Python value; NaN becomes None."""
    plain = value.item()
    return None if plain != plain else plain


def _limits(rule: Rule, config: RunConfig, block: ScanBlock) -> dict[str, Any]:
    limits: dict[str, Any] = {}
    constants = config.classifier.method().limits(block) if rule.limits else None
    for name in rule.limits:
        is_key = name.startswith(("prc.", "sequential_angle."))
        value = attrgetter(name)(config if is_key else constants)
        limits[name] = (
            float(f"{value:.7g}") if isinstance(value, float) or hasattr(value, "dtype") else value
        )
    return limits
