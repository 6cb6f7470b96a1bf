"""Arguments of loops, as they are called when every method classifies small simulated scans.

Scans show what a loop usually gets. The same scans on a grid, with missing and stray shots, show
ties and edges; so do other thresholds.
"""

import zlib
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any
from unittest import mock

import numpy as np
from numpy.random import Generator

from prc_cli.config import load_config
from prc_cli.core.blocks import join
from prc_cli.core.loops import Loop
from prc_cli.core.stream import ScanBlock
from prc_cli.jobs.calibrate.implied import CurveCounter
from prc_cli.methods.base import LABELS_ALONE, Wanted
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.run import run_blocks
from prc_cli.simulation.settings import Kind, load_settings, open_simulation

Case = tuple[Any, ...]

SCANS: tuple[tuple[Kind, dict[str, Any], int, tuple[str, ...]], ...] = (
    ("street", {"name": "photon-80", "points_per_line": 90}, 40, ("fused", "street-scan")),
    (
        "street",
        {"name": "sick-push-broom", "points_per_line": 60},
        40,
        ("fused", "street-scan-published"),
    ),
    *(
        ("forest", {"name": "focus3d-120", "points_per_line": n_shots}, 24, ("fused-forest",))
        for n_shots in (240, 300, 400)
    ),
    (
        "street-scan",
        {"points_per_line": 60, "azimuth_step_deg": 9},
        40,
        ("fused", "street-scan", "street-scan-published"),
    ),
    ("street", {"name": "vlp-16"}, 240, ("rings", "fused")),
)
"""Kind, scanner, lines, and the presets that classify it."""
SHOTS_AT_ONCE = 900
BLOCKS = {name: {"lines_per_block": 24} for name in ("fused", "rings")}
"""So short that a scan has several, and that their loops run as Python, too."""
N_RECORDED = 20
N_VARIED = 20
GRID_M = 0.125


@cache
def calls(seed: int) -> dict[str, list[Case]]:
    """Return the arguments of every loop."""
    recorded: dict[str, list[Case]] = defaultdict(list)
    run = Loop.__call__

    def record(loop: Loop[..., Any], *arguments: Any) -> Any:
        recorded[loop.name].append(copied(arguments))
        return run(loop, *arguments)

    with mock.patch.object(Loop, "__call__", record):
        for kind, scanner, n_lines, presets in SCANS:
            block = simulated(kind, scanner, n_lines, seed)
            for scan in (block, spoilt(block, np.random.default_rng(seed))):
                CurveCounter(PrcParams()).add(scan)
                for preset in presets:
                    classify(scan, preset)
    return recorded


def simulated(kind: Kind, scanner: dict[str, Any], n_lines: int, seed: int) -> ScanBlock:
    """Return a simulated scan with the angles of its beams from straight down."""
    options = {"seed": seed, "lines": n_lines, "sight_m": 40.0, "scanner": scanner}
    scan = open_simulation(kind, load_settings(kind, options=options), threads=1).scan
    block = join([item.block for item in scan.labelled_blocks()])
    if block.beam_rad is not None:
        return block
    assert block.angle_rad is not None
    return replace(block, beam_rad=np.pi - np.remainder(np.pi - block.angle_rad, 2 * np.pi))


def spoilt(block: ScanBlock, rng: Generator) -> ScanBlock:
    """Return ranges on a grid, some of them missing or anywhere."""
    range_m = np.maximum(np.round(block.range_m / GRID_M) * GRID_M, GRID_M)
    stray = rng.random(range_m.shape) < 0.05
    range_m[stray] = rng.choice([1.5, 4.0, 30.0, 350.0, np.nan], np.count_nonzero(stray))
    xyz_m = block.xyz_m
    if xyz_m is not None:
        xyz_m = (xyz_m * (range_m / block.range_m)[..., None]).astype(np.float32)
        range_m[np.isnan(xyz_m[..., 0])] = np.nan
    return replace(block, range_m=range_m.astype(np.float32), xyz_m=xyz_m)


def classify(block: ScanBlock, preset: str) -> None:
    """Run a method on a scan, with confidence if it has any."""
    classifier = load_config(preset=preset, options=BLOCKS).config.classifier.method()
    has_confidence = classifier.needs.confidence_loops is not None
    wanted = Wanted(confidence=True) if has_confidence else LABELS_ALONE
    labelled = run_blocks(iter([block]), classifier, wanted=wanted, shots_at_once=SHOTS_AT_ONCE)
    assert sum(part.block.n_lines for part in labelled) == block.n_lines


@cache
def cases(name: str, seed: int = 1) -> list[Case]:
    """Return some calls of a loop from all scans, and some with other thresholds."""
    recorded = calls(seed)[name]
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    chosen = np.unique(np.linspace(0, len(recorded) - 1, N_RECORDED).astype(int))
    return [
        *(recorded[number] for number in chosen),
        *(varied(recorded[number], rng) for number in rng.integers(0, len(recorded), N_VARIED)),
    ]


def varied(case: Case, rng: Generator) -> Case:
    """Change the numbers of thresholds that are no whole numbers."""

    def scaled(number: Any) -> Any:
        if not isinstance(number, float | np.floating):
            return number
        return type(number)(number * rng.choice([0.3, 1.0, 1.7], p=[0.15, 0.7, 0.15]))

    def changed(value: Any) -> Any:
        is_threshold = type(value).__name__.endswith(("Thresholds", "Model"))
        return in_parts(value, scaled if is_threshold else changed)

    return tuple(changed(value) for value in case)


def copied(value: Any) -> Any:
    """Copy arrays: some loops change them."""
    return value.copy() if isinstance(value, np.ndarray) else in_parts(value, copied)


def in_parts(value: Any, change: Callable[[Any], Any]) -> Any:
    """Change the parts of a tuple, with or without names."""
    if not isinstance(value, tuple):
        return value
    parts = [change(part) for part in value]
    return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
