"""A street of planes, without the simulator.

Road, kerbs, facades, a hedge, a parked car, stray points.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.ablation import changed
from prc_cli.config import load_config
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, U8
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import LABELS_ALONE, OneByOne, Wanted
from prc_cli.methods.fused.pipeline import Fused, FusedParams, FusedScanner, initial_state

GROUND, BUILDING, VEGETATION, STRAY, CAR, SKY = range(1, 7)
BEAM: F64 = np.deg2rad(np.linspace(-150, 150, 1501))
HEIGHT_M = 2.4


def street_lines(n_lines: int, seed: int = 1, *, noise_m: float = 0.002) -> tuple[F32, U8]:
    """Return ranges and what they are of.

    a facade on the left, a hedge on the right, a car in the middle lines.

    Returns
    -------
    range_m : (n_lines, 1501) float32
    kind : (n_lines, 1501) uint8
    """
    rng = np.random.default_rng(seed)
    side = np.sin(BEAM)
    down = np.cos(BEAM)
    with np.errstate(divide="ignore"):
        road = np.where(down > 0, HEIGHT_M / down, np.inf)
        sidewalk = np.where(down > 0, (HEIGHT_M - 0.12) / down, np.inf)
        road = np.where(np.abs(road * side) > 4.0, np.maximum(sidewalk, 4.0 / np.abs(side)), road)
        facade = np.where(side > 0, 7.0 / side, np.inf)
        hedge = np.where(side < 0, -6.0 / side, np.inf)
        roof = np.where(down > 0, (HEIGHT_M - 1.5) / down, np.inf)
        flank = np.where(side > 0, 2.0 / side, np.inf)
    facade[facade * -down > 6.0] = np.inf
    car = np.where(
        (flank * down > HEIGHT_M - 1.5) & (flank * down < HEIGHT_M - 0.25), flank, np.inf
    )
    car = np.minimum(car, np.where((roof * side > 2.0) & (roof * side < 3.7), roof, np.inf))
    ranges = np.empty((n_lines, len(BEAM)))
    kind = np.empty((n_lines, len(BEAM)), np.uint8)
    for line in range(n_lines):
        leaves = hedge + rng.exponential(0.25, len(BEAM))
        leaves[leaves * down < HEIGHT_M - 1.9] = np.inf
        things = [road, facade, leaves]
        if n_lines // 3 <= line < 2 * n_lines // 3:
            things.append(car)
        every = np.stack(things)
        kind[line] = np.array([GROUND, BUILDING, VEGETATION, CAR], np.uint8)[
            np.argmin(every, axis=0)
        ]
        ranges[line] = np.min(every, axis=0)
    ranges += rng.normal(0, noise_m, ranges.shape)
    strays = rng.random(ranges.shape) < 0.01
    ranges[strays] = rng.uniform(1, 60, int(strays.sum()))
    kind[strays] = STRAY
    sky = ~np.isfinite(ranges) | (ranges > 60)
    ranges[sky] = np.nan
    kind[sky] = SKY
    return ranges.astype(np.float32), kind


def with_limits(scanner: FusedScanner, **tables: Any) -> FusedScanner:
    """Return a scanner with other limits; see :func:`benchmarks.ablation.changed`."""
    return replace(scanner, limits=changed(scanner.limits, **tables))


def classified(ranges: F32, **limits: Any) -> U8:
    """Label a stream as one block, with other limits than usual."""
    scanner = with_limits(FusedScanner.of(BEAM), **limits)
    turn = OneByOne(initial_state(scanner))
    (item,) = Fused(FusedParams()).label(ScanBlock(0, ranges), scanner, turn, LABELS_ALONE)
    return item.labels


def results(
    preset: str, name: str, ranges: F32, size: int = 50, threads: int = 1
) -> np.ndarray[Any, Any]:
    """Label a stream in pieces; return its "labels", "confidence" or heights, "above_m"."""
    pieces = (
        ScanBlock(first, ranges[first : first + size], beam_rad=BEAM)
        for first in range(0, len(ranges), size)
    )
    params = load_config(preset=preset).config.classifier
    wanted = Wanted(confidence=name == "confidence", stages=name == "above_m")
    items = list(label_blocks(pieces, params, wanted=wanted, threads=threads))
    return np.concatenate([getattr(item, name) for item in items])
