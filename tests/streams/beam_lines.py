"""Scan lines with known beams, for every way a scanner can turn; and streams made of blocks."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from prc_cli.core.blocks import cut
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64

RING_GAPS = np.concatenate([np.full(31, 0.5), np.full(32, 1 / 3)])

GEOMETRIES: dict[str, F64] = {
    "whole circle": np.deg2rad(np.arange(360) + 17.0),
    "whole circle, backwards": np.deg2rad(250.0 - np.arange(360)),
    "half circle": np.deg2rad(np.linspace(-95.0, 85.0, 181)),
    "low to high": np.deg2rad(np.linspace(32.0, 128.0, 193)),
    "high to low": np.deg2rad(np.linspace(128.0, 32.0, 193)),
    "through the zenith": np.deg2rad(np.linspace(40.0, 320.0, 281)),
    "through the zenith, backwards": np.deg2rad(np.linspace(320.0, 40.0, 281)),
    "rings": np.deg2rad(65.0 + np.concatenate([[0.0], np.cumsum(RING_GAPS)])),
    "two beams": np.deg2rad([70.0, 100.0]),
}
"""Angle of every column's beam from straight down [rad], unwrapped, by the name of the geometry."""


@dataclass(frozen=True)
class Blocks:
    """A stream that is there already."""

    parts: tuple[ScanBlock, ...]
    info: StreamInfo

    def blocks(self) -> Iterator[ScanBlock]:
        yield from self.parts


def stream(*parts: ScanBlock, **info: Any) -> Blocks:
    first = parts[0]
    properties = {"angle_rad": first.angle_rad} | info
    form = properties.pop("format", "LAS")
    facts = SourceFacts(has_scans=form in ("PTX", "E57"))
    return Blocks(
        parts,
        StreamInfo("drive.laz", form, first.points_per_line, None, None, facts=facts, **properties),
    )


def lines(
    beam_rad: F64,
    n_lines: int = 80,
    *,
    seed: int = 0,
    tilt_deg: float = 0.0,
    noise_m: float = 0.01,
    missing: float = 0.3,
    turn_deg: float = 40.0,
) -> ScanBlock:
    """Return lines of a scanner that turns slowly as it goes, its scan plane leaning over."""
    rng = np.random.default_rng(seed)
    m = len(beam_rad)
    range_m = rng.uniform(2.0, 40.0, (n_lines, m))
    heading = np.deg2rad(np.linspace(0.0, turn_deg, n_lines) + rng.uniform(0, 360))[:, None]
    tilt = np.deg2rad(tilt_deg)
    side = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=-1)
    across = np.stack([-np.sin(heading), np.cos(heading), 0 * heading], axis=-1)
    down = np.sin(tilt) * across + np.array([0.0, 0.0, -np.cos(tilt)])
    xyz = range_m[..., None] * (
        np.sin(beam_rad)[None, :, None] * side + np.cos(beam_rad)[None, :, None] * down
    )
    xyz += rng.normal(0, noise_m, xyz.shape)
    gone = rng.random((n_lines, m)) < missing
    xyz[gone] = np.nan
    ranges: F32 = np.sqrt((xyz**2).sum(axis=-1)).astype(np.float32)
    return ScanBlock(0, ranges, xyz_m=xyz.astype(np.float32))


def gone(block: ScanBlock, columns: Any, rows: Any = slice(None)) -> ScanBlock:
    """Take shots out of a block."""
    range_m = block.range_m.copy()
    xyz = None if block.xyz_m is None else block.xyz_m.copy()
    range_m[rows, columns] = np.nan
    if xyz is not None:
        xyz[rows, columns] = np.nan
    return replace(block, range_m=range_m, xyz_m=xyz)


def pieces(block: ScanBlock, rng: np.random.Generator) -> tuple[ScanBlock, ...]:
    """Cut a block anywhere."""
    n = block.n_lines
    borders = np.unique(np.concatenate([[0, n], rng.integers(0, n, rng.integers(0, 12))]))
    return tuple(cut(block, int(a), int(b)) for a, b in pairwise(borders))


def worst_deg(beam_rad: F64, true: F64) -> float:
    """Return the largest difference of two lists of angles, whichever side counts as positive
    [deg]."""
    return min(
        float(np.max(np.abs(np.rad2deg(np.angle(np.exp(1j * (way * beam_rad - true)))))))
        for way in (1, -1)
    )


def is_strictly_monotone(beam_rad: F64) -> bool:
    """Return whether angles turn one way, by a turn at most."""
    step = np.diff(beam_rad)
    return any(
        bool((along > 0).all() and along.sum() < 1.1 * 2 * np.pi)
        for along in (np.remainder(step, 2 * np.pi), np.remainder(-step, 2 * np.pi))
    )
