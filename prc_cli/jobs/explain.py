"""Says why a shot has its class.

The rule that decided, its limits, and what the stages measured (``prc explain``).

The run is that of ``prc classify``, from the start of the input to the block of the shot, because
states are handed from block to block. The method itself gives the rule, beside the label.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

from prc_cli.config import LoadedConfig, MethodChoice, RunConfig, refuse_window
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.threads import close_items, default_threads
from prc_cli.core.window import Window
from prc_cli.formats import check_input
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import Progress, label_blocks, load_classifier, open_stream
from prc_cli.jobs.progress import advance
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
    """The method that was chosen for the input; None = it was named."""
    label: Label
    code: int
    """As ``prc classify`` writes it."""
    reason: int
    """As ``output.reason`` writes it (:class:`prc_cli.core.classes.Reason`)."""
    rule: str
    """Name of the rule that decided."""
    sentence: str
    """What it says."""
    limits: dict[str, Any]
    """Keys of the configuration or names of constants that decided, and their values."""
    measures: dict[str, Any]
    """What the stages measured of the shot, by names with their units; None = not known."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        chosen = (
            None if self.chosen is None else {"preset": self.chosen.preset, "why": self.chosen.why}
        )
        found = {**asdict(self), "class": self.label.name.lower(), "chosen": chosen}
        del found["label"]
        return found


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
    loaded = LoadedConfig.of(config)
    refuse_window(loaded.config, "prc explain")
    check_input(source)
    loaded = decide(source, loaded)
    with loading():
        load_classifier(loaded)
    item = _find(source, loaded, line, scanner, progress)
    block = item.block
    if column >= block.points_per_line:
        problem = f"found column {column}, expected 0 to {block.points_per_line - 1}"
        raise InputError(str(source), problem, "lines have as many shots: prc info")
    at = line - block.first_line, column
    assert item.reasons is not None
    label = Label(int(item.labels[at]))
    reason = int(item.reasons[at])
    name, rule = rule_of(reason)
    measures = (
        {}
        if label == Label.MISSING
        else {name: _plain(each[at]) for name, each in item.measures.items()}
    )
    return Explanation(
        path=str(source),
        line=line,
        column=column,
        scanner=block.scanner,
        record=int(block.records()[at]),
        range_m=_plain(block.range_m[at]),
        time_s=None if block.time_s is None else _plain(block.time_s[at]),
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
    source: Path,
    loaded: LoadedConfig,
    line: int,
    scanner: int | None,
    progress: Progress | None,
) -> LabelledBlock:
    """Classify up to the line of a scanner, by default the first that comes."""
    last = -1
    seen = set[int]()
    stream = open_stream(source, loaded)
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
    raise InputError(str(source), problem, "lines and columns are counted from 0: prc info")


def _plain(value: Any) -> Any:
    """Return a value of an array as one of Python; None = not known."""
    plain = value.item()
    return None if plain != plain else plain


def _limits(rule: Rule, config: RunConfig, block: ScanBlock) -> dict[str, Any]:
    """Return the limits of a rule: keys of the configuration, or constants of the fused method."""
    found: dict[str, Any] = {}
    constants = config.classifier.method().limits(block) if rule.limits else None
    for name in rule.limits:
        is_key = name.startswith(("prc.", "sequential_angle."))
        value = attrgetter(name)(config if is_key else constants)
        found[name] = (
            float(f"{value:.7g}") if isinstance(value, float) or hasattr(value, "dtype") else value
        )
    return found
