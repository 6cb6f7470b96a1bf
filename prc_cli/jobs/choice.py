"""Chooses the method for an input if none is named (``method = "auto"``).

Segment ids and the reference engine need PRC. Otherwise the input decides: ``fused``, if the angle
of every beam from straight down is known or can be measured from the ranges, with the classes of
streets or of forests as the first lines show; else PRC, which needs no angles, with a warning.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import get_args

from prc_cli.config import ChosenPreset, LoadedConfig, MethodChoice, RunConfig
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.loops import Engine
from prc_cli.core.stream import ScanBlock
from prc_cli.core.threads import closing_items
from prc_cli.formats.input import Input
from prc_cli.methods.rings.pipeline import WIDEST_FAN_RAD, is_fan
from prc_cli.streams.beams import ANGLES, with_beams
from prc_cli.streams.evidence.place import place_of_blocks
from prc_cli.streams.open import open_input
from prc_cli.streams.rules import trusting
from prc_cli.streams.stream import Stream

LEAST_COSINE = math.cos(math.radians(60.0))
"""Cosine of the largest lean of a scan plane.

Fused allows 45 degrees; ranges in feet look like 72 degrees.
"""
_BETTER = "with the angles of the beams fused labels better"


def decided_by(choice: MethodChoice, loaded: LoadedConfig) -> LoadedConfig:
    """Return a configuration that names the method of a choice.

    >>> from prc_cli.config import load_config
    >>> loaded = decided_by(MethodChoice("fused-forest", "as an example"), load_config())
    >>> loaded.config.fused.environment
    'forest'
    """
    config = loaded.config
    sources = {**loaded.sources, "method": "chosen"}
    changes: dict[str, object] = {"method": choice.method}
    if choice.preset == "fused-forest":
        changes["fused"] = config.fused.model_copy(update={"environment": "forest"})
        sources["fused.environment"] = "chosen"
    return replace(loaded, config=config.model_copy(update=changes), sources=sources, choice=choice)


def possible_configs(loaded: LoadedConfig) -> list[RunConfig]:
    """Return the possible configurations of a run: one per choice if no method is named."""
    if loaded.config.is_decided:
        return [loaded.config]
    return [
        decided_by(MethodChoice(preset, ""), loaded).config for preset in get_args(ChosenPreset)
    ]


def choice_by_request(config: RunConfig, *, engine: Engine = "compiled") -> MethodChoice | None:
    """Return the choice if the options allow only one method; None = the input decides.

    >>> choice_by_request(RunConfig(output={"segment_ids": True})).preset
    'prc-2019-urban'
    """
    if config.output.segment_ids:
        return MethodChoice("prc-2019-urban", "only PRC has segment ids")
    if engine == "reference":
        return MethodChoice(
            "prc-2019-urban", "--engine reference has only the methods of the papers"
        )
    return None


def choice_by_beams(
    first: ScanBlock,
    blocks: Iterator[ScanBlock],
    known: str = "the angles of the beams are known",
    *,
    may_spin: bool = True,
) -> MethodChoice:
    """Return the choice for an input whose beam directions are known.

    Parameters
    ----------
    first : ScanBlock
    blocks : iterator of ScanBlock
        The blocks from the first.
    known : str
        How the angles are known, for the reason.
    may_spin : bool
        Whether the scanner may be a spinning one: it is not on a tripod.
    """
    if may_spin and first.has_rings:
        return MethodChoice("rings", "columns are the rings of a spinning scanner")
    if may_spin and first.beam_rad is not None and is_fan(first.beam_rad):
        return MethodChoice(
            "rings", f"the beams lie within {math.degrees(WIDEST_FAN_RAD):.0f} deg, as rings do"
        )
    place = place_of_blocks(blocks)
    doubt = f"{place.why}: {place.doubt}" if place.doubt else ""
    if place.kind == "forest":
        why = f"{known}, and the place looks like a forest: {place.why}"
        return MethodChoice("fused-forest", why, doubt=doubt)
    if place.kind == "street":
        why = f"{known}, and the place looks like a street: {place.why}"
    else:
        why = (
            f"{known}; assumed to be a street: {place.why}; in a forest give --preset fused-forest"
        )
    return MethodChoice("fused", why, doubt=doubt)


def choose(stream: Stream, config: RunConfig) -> tuple[MethodChoice, Stream]:
    """Choose the method for an opened stream, by its first blocks.

    Returns
    -------
    tuple
        The choice, and the stream with the beam directions that the method needs.
    """
    try:
        choice, chosen = _choose(stream, config)
    except (InputError, ConfigError) as refusal:
        choice = _choice_after(refusal, stream.info.facts.scanners)
        chosen = stream
    if chosen.beams is None:
        # it may be read with other rules
        stream.first.forget()
    return choice, chosen


def _choose(stream: Stream, config: RunConfig) -> tuple[MethodChoice, Stream]:
    facts = stream.info.facts
    with closing_items(stream.first_blocks()) as blocks:
        if next(blocks, None) is None:
            return MethodChoice("prc-2019-urban", "the input has no lines"), stream
    directed = with_beams(stream, config.input)
    beams = () if directed.beams is None else directed.beams.values()
    if any(scanner_beams.is_made_up for scanner_beams in beams):
        # a later line with two returns is refused
        for _ in directed.blocks():
            pass
        return MethodChoice("prc-2019-urban", "no line has two returns"), stream
    cosine = min((scanner_beams.cos_tilt for scanner_beams in beams), default=1.0)
    if cosine < LEAST_COSINE:
        lean = f"the scan plane seems to lean by {math.degrees(math.acos(cosine)):.0f} deg"
        lacks = f"{lean}, too much for fused"
        return MethodChoice(
            "prc-2019-urban", lacks, lacks, "look at the unit of the ranges"
        ), stream
    if facts.scanners or facts.has_scans or config.input.scanner != "none":
        _read_all_scanners(directed, facts.scanners)
    with closing_items(directed.first_blocks()) as blocks:
        first_block = next(blocks)
    is_measured = any(
        assumption.key == ANGLES and assumption.value.startswith("measured")
        for assumption in directed.info.assumptions
    )
    known = ("the angles of the beams are measured from the ranges",) if is_measured else ()
    # a scan from a tripod whose sky was cut off may have as few beams as a spinning scanner
    may_spin = not facts.has_scans
    with closing_items(directed.first_blocks()) as blocks:
        return choice_by_beams(first_block, blocks, *known, may_spin=may_spin), directed


def _read_all_scanners(directed: Stream, scanners: Sequence[str]) -> None:
    """Read until the beams of every scanner are known: a later scanner may be refused."""
    with closing_items(directed.first_blocks()) as blocks:
        for _ in blocks:
            known = {*(directed.beams or ()), *directed.observed.beams}
            if scanners and len(known) >= len(scanners):
                return


def _choice_after(refusal: InputError | ConfigError, scanners: Sequence[str]) -> MethodChoice:
    """Choose PRC, which needs no angles, with the reason why ``fused`` cannot be used."""
    scanner = refusal.where.rpartition(": ")[2] if isinstance(refusal, InputError) else ""
    lacks = refusal.problem
    give = refusal.hint
    if scanner in scanners:
        lacks = f"{scanner}: {lacks}"
        others = ",".join(name.partition(" (")[0] for name in scanners if name != scanner)
        if others:
            topic = scanner.partition(" (")[0]
            give += (
                f", and --set input.topic={topic}; or try the others: --set input.topic={others}"
            )
    return MethodChoice("prc-2019-urban", f"{lacks}; {_BETTER}", lacks, give)


def decide_stream(
    stream: Stream, loaded: LoadedConfig, *, engine: Engine = "compiled"
) -> tuple[LoadedConfig, Stream]:
    """Name the method of a stream, and add the beam directions that the method needs."""
    if not loaded.config.is_decided:
        choice = choice_by_request(loaded.config, engine=engine)
        if choice is None:
            choice, stream = choose(stream, loaded.config)
        loaded = decided_by(choice, loaded)
    if loaded.config.needs_beams and stream.beams is None:
        stream = with_beams(stream, loaded.config.input)
    return loaded, stream


def decide(
    scan: Input,
    loaded: LoadedConfig,
    *,
    engine: Engine = "compiled",
    trust_order: bool = False,
) -> LoadedConfig:
    """Return a configuration that names a method: its own, or the method chosen for a file."""
    return decide_and_open(scan, loaded, engine=engine, trust_order=trust_order)[0]


def decide_and_open(
    scan: Input,
    loaded: LoadedConfig,
    *,
    engine: Engine = "compiled",
    trust_order: bool = False,
) -> tuple[LoadedConfig, Stream | None]:
    """Decide as :func:`decide`; also return the stream if it was opened and has beam directions."""
    config = loaded.config
    if config.is_decided:
        return loaded, None
    asked = choice_by_request(config, engine=engine)
    if asked is not None:
        return decided_by(asked, loaded), None
    inputs = config.input
    try:
        if trust_order:
            inputs = trusting(scan.records(), inputs)
        stream = open_input(scan, inputs)
    except (InputError, ConfigError) as refusal:
        return decided_by(MethodChoice("prc-2019-urban", refusal.problem), loaded), None
    choice, stream = choose(stream, config)
    decided = decided_by(choice, loaded)
    return decided, stream if decided.config.needs_beams else None
