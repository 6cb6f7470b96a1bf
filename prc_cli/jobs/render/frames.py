"""Intermediate images of the classification, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.config import LoadedConfig
from prc_cli.core.blocks import regroup
from prc_cli.core.classes import LABEL_OF_SURFACE, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ScanBlock, ScanStream, StageLabels
from prc_cli.core.types import F64
from prc_cli.imaging.stages import trigger_codes
from prc_cli.jobs.classify import label_blocks, open_stream
from prc_cli.jobs.render.options import PRC_STEPS
from prc_cli.jobs.render.stages import interval_codes, test_codes
from prc_cli.methods.base import OneByOne
from prc_cli.methods.prc.pipeline import PrcParams, PrcState, PrcTrace, classify_block, initial_state
from prc_cli.streams.beams import with_beams

Plane: TypeAlias = NDArray[Any]

TURN_LINES = 64
"""Lines examined for a rotation of the scanner."""
LEAST_TURN_RAD = 1e-4
"""Smallest azimuth step between lines that counts as a rotation [rad]."""
SEGMENT_COLOURS = 1 << 30
"""Segment ids are drawn modulo this number."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Consecutive lines and the images of their steps."""

    block: ScanBlock
    planes: Mapping[str, Plane]
    """(lines, M) by step: ranges, masks, ids, labels."""


def open_for_pictures(loaded: LoadedConfig, path: Any) -> ScanStream:
    """Open a stream, with beam angles if the input provides them, for any classifier."""
    stream = open_stream(path, loaded)
    if loaded.config.needs_beams:
        return stream
    # without a vertical direction pictures lie on their side; damage is reported when the stream is read
    with suppress(InputError, ConfigError):
        return with_beams(stream, loaded.config.input)
    return stream


def of_station(blocks: Iterator[ScanBlock], station: int | None, path: str) -> Iterator[ScanBlock]:
    """Keep the blocks of one scanner, by default the first."""
    others: set[int] = set()
    chosen, found = station, False
    for block in blocks:
        if chosen is None:
            chosen = block.scanner
        if block.scanner == chosen:
            found = True
            yield block
        else:
            others.add(block.scanner)
    if not found and others:
        numbers = ", ".join(str(number) for number in sorted(others)[:20])
        shown = f"one, number {numbers}" if len(others) == 1 else f"{len(others)}, numbers {numbers}"
        shown += ", ..." if len(others) > 20 else ""
        raise ConfigError("--station", f"found {station}, but {path} holds {shown}")


def count_lines(stream: ScanStream, station: int | None, loaded: LoadedConfig) -> int:
    """Return the number of lines of one scanner; reads the stream if it is not known otherwise."""
    info = stream.info
    alone = loaded.config.input.scanner == "none" and not info.facts.has_scans and station is None
    if info.n_lines is not None and alone:
        return info.n_lines
    return sum(block.n_lines for block in of_station(stream.blocks(), station, info.path))


def frames(
    blocks: Iterator[ScanBlock], loaded: LoadedConfig, steps: tuple[str, ...], *, classify: bool
) -> Iterator[Frame]:
    """Classify blocks as far as the steps need it; yield the intermediate images."""
    config = loaded.config
    if not classify:
        for block in blocks:
            yield Frame(block, _of_block(block, steps))
    elif isinstance(params := config.classifier, PrcParams) and set(steps) & set(PRC_STEPS):
        yield from _traced(blocks, params, steps)
    else:
        for item in label_blocks(blocks, config.classifier, stages=True, confidence="confidence" in steps):
            planes = {**_of_block(item.block, steps), "classes": item.labels}
            if item.confidence is not None:
                seen = ~np.isnan(item.block.range_m)
                planes["confidence"] = np.where(seen, item.confidence.astype(np.float32), np.float32(np.nan))
            if item.stages is not None:
                planes |= _of_stages(item.block, item.stages, steps)
            yield Frame(item.block, planes)


def trace_blocks(
    blocks: Iterator[ScanBlock], params: PrcParams, *, critical: bool = False
) -> Iterator[tuple[ScanBlock, PrcTrace]]:
    """Run PRC over the blocks of one scanner; yield the intermediate images, critical thresholds on request."""
    turn: OneByOne[PrcState] | None = None
    for block in regroup(blocks, params.lines_per_block):
        turn = turn or OneByOne(initial_state(block.points_per_line))
        yield block, classify_block(block.range_m, block.next_m, turn, params, segments=True, critical=critical)


def _traced(blocks: Iterator[ScanBlock], params: PrcParams, steps: tuple[str, ...]) -> Iterator[Frame]:
    images: dict[str, Callable[[PrcTrace], Plane]] = {
        "support": lambda trace: trace.supported,
        "background": lambda trace: trace.background,
        "critical": _critical,
        # filling gives labels to shots of G alone, so without them the components are those before it
        "components": lambda trace: np.where(trace.supported & ~trace.background, trace.components.image, np.int32(0)),
        "segments": lambda trace: _ids(trace.components.to_segments()),
        "surfaces": lambda trace: _ids(trace.surfaces.to_patches()),
        "segmentation": lambda trace: _ids(trace.surfaces.to_segments()),
    }
    for block, trace in trace_blocks(blocks, params, critical="critical" in steps):
        planes = {**_of_block(block, steps), "classes": trace.labels}
        planes |= {step: images[step](trace) for step in steps if step in images}
        yield Frame(block, planes)


def _critical(trace: PrcTrace) -> Plane:
    """Return the larger critical threshold of every shot: from there on both neighbourhoods support it."""
    assert trace.critical is not None
    return np.maximum(trace.critical.in_line_m, trace.critical.adjacent_m)


def _ids(segments: NDArray[np.int64]) -> Plane:
    """Return segment ids as int32, modulo :data:`SEGMENT_COLOURS` plus 1; 0 stays 0."""
    return np.where(segments > 0, segments % SEGMENT_COLOURS + 1, 0).astype(np.int32)


def _of_block(block: ScanBlock, steps: tuple[str, ...]) -> dict[str, Plane]:
    planes: dict[str, Plane] = {"range": block.range_m}
    if "intensity" in steps:
        if block.intensity is None:
            where = "--steps"
            raise ConfigError(where, "found 'intensity', but the input has none")
        planes["intensity"] = block.intensity
    return planes


def _of_stages(block: ScanBlock, stages: StageLabels, steps: tuple[str, ...]) -> dict[str, Plane]:
    seen = ~np.isnan(block.range_m)
    images: dict[str, Callable[[], Plane]] = {
        "coarse": lambda: np.array(LABEL_OF_SURFACE, np.uint8)[stages.surface],
        "dense": lambda: np.where(
            stages.dense_vegetation, Label.VEGETATION, np.where(seen, Label.UNCLASSIFIED, Label.MISSING)
        ).astype(np.uint8),
        "ground": lambda: np.where(seen, stages.ground_height_m, np.float32(np.nan)),
        "triggers": lambda: trigger_codes(np.array(LABEL_OF_SURFACE, np.uint8)[stages.car_surface], stages.trigger),
        "dividers": lambda: interval_codes(stages, seen),
        "tests": lambda: test_codes(stages, seen),
    }
    return {step: images[step]() for step in steps if step in images}


def upright(beam_rad: F64 | None) -> NDArray[np.intp] | None:
    """Return the columns of a vertical line from the sky to the ground; None if lines are not vertical.

    >>> upright(np.deg2rad([10.0, 90.0, 140.0])).tolist()
    [2, 1, 0]
    """
    if beam_rad is None or not ((beam_rad >= 0).all() or (beam_rad <= 0).all()):
        return None
    return np.argsort(-np.abs(beam_rad), kind="stable")


def turns(block: ScanBlock) -> float:
    """Return how a scanner turns from line to line, seen from above."""
    if block.xyz_m is None or block.n_lines < 2:
        return 0.0
    x, y = (block.xyz_m[: TURN_LINES + 1, :, axis].astype(np.float64) for axis in (0, 1))
    with np.errstate(invalid="ignore"):
        step = np.arctan2(x[:-1] * y[1:] - y[:-1] * x[1:], x[:-1] * x[1:] + y[:-1] * y[1:])
        step = step[(np.hypot(x, y)[:-1] > 0) & (np.hypot(x, y)[1:] > 0)]
    middle = float(np.median(step)) if step.size else 0.0
    return middle if abs(middle) > LEAST_TURN_RAD else 0.0
