"""Chooses the method for an input where none is named (``method = "auto"``).

What is asked for may leave one method: segment ids and the plain engine are PRC's. Otherwise the
input decides: ``fused`` where the angle of every beam from straight down is known or can be
measured from the ranges, for streets or for forests as its first lines look; else PRC, which needs
no angles, with a doubt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

from prc_cli.config import ChosenPreset, LoadedConfig, MethodChoice, RunConfig, with_layout_beside
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ScanBlock, ScanStream
from prc_cli.formats import open_source
from prc_cli.kernels import Engine
from prc_cli.methods.rings.pipeline import WIDEST_FAN_RAD, is_fan
from prc_cli.streams.beams import ANGLES, BeamStream, with_beams
from prc_cli.streams.evidence.place import place_of_blocks
from prc_cli.streams.open import open_input
from prc_cli.streams.rules import trusting

LEAST_COSINE = math.cos(math.radians(60.0))
"""Planes that lean more are no scan planes of streets.

Fused allows 45 degrees, ranges in feet look like 72.
"""
_BETTER = "with the angles of the beams fused labels better"


def decided_by(choice: MethodChoice, loaded: LoadedConfig) -> LoadedConfig:
    """Return a configuration that names the method of a choice.

    >>> from prc_cli.config import load_config
    >>> decided_by(MethodChoice("fused-forest", "as an example"), load_config()).config.fused.environment
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
    """Return the configurations that a run may have been done with.

    Where no method is named, one for every choice.
    """
    if loaded.config.is_decided:
        return [loaded.config]
    return [
        decided_by(MethodChoice(preset, ""), loaded).config for preset in get_args(ChosenPreset)
    ]


def choice_by_request(config: RunConfig, *, engine: Engine = "compiled") -> MethodChoice | None:
    """Return the choice where what is asked for leaves one method; None = the input decides.

    >>> choice_by_request(RunConfig(output={"segment_ids": True})).preset
    'urban'
    """
    if config.output.segment_ids:
        return MethodChoice("urban", "segment ids are those of PRC")
    if engine == "reference":
        return MethodChoice("urban", "the plain engine has the papers' methods alone")
    return None


def choice_by_beams(
    first: ScanBlock,
    blocks: Iterator[ScanBlock],
    known: str = "the angles of the beams are known",
    *,
    may_spin: bool = True,
) -> MethodChoice:
    """Return the choice for an input whose beam directions are known.

    ``may_spin``: it is no static scan.
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
        why = f"{known}; taken for a street: {place.why}; in a forest give --preset fused-forest"
    return MethodChoice("fused", why, doubt=doubt)


def choose(stream: ScanStream, config: RunConfig) -> tuple[MethodChoice, ScanStream]:
    """Choose the method for an opened stream."""
    try:
        first = next(stream.blocks(), None)
        if first is None:
            return MethodChoice("urban", "the input has no lines"), stream
        directed = with_beams(stream, config.input)
        beams = directed.known.values() if isinstance(directed, BeamStream) else ()
        if any(found.is_made_up for found in beams):
            # refused where a later line has two
            for _ in directed.blocks():
                pass
            return MethodChoice("urban", "no line has two returns"), stream
        if (cosine := min((found.cos_tilt for found in beams), default=1.0)) < LEAST_COSINE:
            lean = f"the scan plane seems to lean by {math.degrees(math.acos(cosine)):.0f} deg"
            lacks = f"{lean}, which fused does not stand"
            return MethodChoice("urban", lacks, lacks, "look at the unit of the ranges"), stream
        every = stream.info.facts.scanners
        if every or stream.info.facts.has_scans or config.input.scanner != "none":
            # a later scanner may be refused only when it is reached
            for _ in directed.blocks():
                if (
                    every
                    and isinstance(directed, BeamStream)
                    and len(directed.known | directed.late) >= len(every)
                ):
                    break
        is_measured = any(
            one.key == ANGLES and one.value.startswith("measured")
            for one in directed.info.assumptions
        )
        known = ("the angles of the beams are measured from the ranges",) if is_measured else ()
        first_block = next(iter(directed.blocks()))
        # rows of a tripod's scan may see as little as rings do, where the sky was cut off
        may_spin = not stream.info.facts.has_scans
        return choice_by_beams(first_block, directed.blocks(), *known, may_spin=may_spin), directed
    except (InputError, ConfigError) as refusal:
        scanner = refusal.where.rpartition(": ")[2] if isinstance(refusal, InputError) else ""
        every = stream.info.facts.scanners
        lacks = f"{scanner}: {refusal.problem}" if scanner in every else refusal.problem
        give = refusal.hint
        others = ",".join(name.partition(" (")[0] for name in every if name != scanner)
        if scanner in every and others:
            give += (
                f", and --topic {scanner.partition(' (')[0]}; or try the others: --topic {others}"
            )
        return MethodChoice("urban", f"{lacks}; {_BETTER}", lacks, give), stream


def decide_stream(
    stream: ScanStream, loaded: LoadedConfig, *, engine: Engine = "compiled"
) -> tuple[LoadedConfig, ScanStream]:
    """Return a configuration that names a method, and the stream with the beam directions that the method needs."""
    if not loaded.config.is_decided:
        choice = choice_by_request(loaded.config, engine=engine)
        if choice is None:
            choice, stream = choose(stream, loaded.config)
        loaded = decided_by(choice, loaded)
    if loaded.config.needs_beams and not isinstance(stream, BeamStream):
        stream = with_beams(stream, loaded.config.input)
    return loaded, stream


def decide(
    path: Path,
    loaded: LoadedConfig,
    *,
    engine: Engine = "compiled",
    trust_order: bool = False,
) -> LoadedConfig:
    """Return a configuration that names a method.

    The given one, or with the method chosen for a file.
    """
    return decide_and_open(path, loaded, engine=engine, trust_order=trust_order)[0]


def decide_and_open(
    path: Path,
    loaded: LoadedConfig,
    *,
    engine: Engine = "compiled",
    trust_order: bool = False,
) -> tuple[LoadedConfig, ScanStream | None]:
    """Return :func:`decide`, and the stream with its beam directions where it was opened and the method needs them."""
    loaded = with_layout_beside(path, loaded)
    config = loaded.config
    if config.is_decided:
        return loaded, None
    asked = choice_by_request(config, engine=engine)
    if asked is not None:
        return decided_by(asked, loaded), None
    inputs = config.input
    try:
        if trust_order:
            inputs = trusting(open_source(path, config.layout), inputs)
        stream = open_input(path, inputs, config.layout)
    except (InputError, ConfigError) as refusal:
        return decided_by(MethodChoice("urban", refusal.problem), loaded), None
    choice, stream = choose(stream, config)
    decided = decided_by(choice, loaded)
    return decided, stream if decided.config.needs_beams else None
