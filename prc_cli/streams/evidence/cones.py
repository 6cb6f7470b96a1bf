"""Test whether rings are cones around z, as in the frame of a spinning scanner."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from prc_cli.core.findings import Finding
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, I64
from prc_cli.formats.sensor_frame import FEWEST_RINGS, FEWEST_SHOTS, spread_of_cones
from prc_cli.streams.evidence.figures import Seen
from prc_cli.streams.evidence.table import verdict_of

MOST_LINES = 4096
"""First lines that are looked at, about two turns."""
MOST_RAD = math.radians(0.15)
"""Rings of most scanners spread less in their own frame [rad]."""
EXPLAINED = 0.3
"""Another frame explains the rings if it leaves less than this share of their spread.

Of a real frame it left 0.52,
of a walk in the frame of its map 1.0, of a sector on other axes 0.01."""
NO_CONES_RAD = math.radians(3.0)
"""Rings that spread more in every frame are none.

Those of a drive in the frame of a map spread by 0.7 deg [rad].
"""


@dataclass(slots=True)
class ConeSample:
    """Shots of the first lines of a scanner, and their rings."""

    n_lines: int = 0
    xyz_m: list[F32] = field(default_factory=list)
    ring: list[I64] = field(default_factory=list)
    found_rad: tuple[float, float] | None = None

    def add(self, block: ScanBlock) -> None:
        """Take the shots of a block while there are few lines."""
        if not block.has_rings or block.xyz_m is None or self.n_lines >= MOST_LINES:
            return
        rows = block.xyz_m[: MOST_LINES - self.n_lines]
        self.n_lines += len(rows)
        there = np.isfinite(rows).all(axis=2)
        shots = rows[there]
        self.xyz_m.append(shots if block.frame is None else block.frame.own(shots))
        self.ring.append(np.nonzero(there)[1])
        self.found_rad = None

    def spread_rad(self) -> tuple[float, float] | None:
        """Return the spread of elevation within rings, as used and in the best frame [rad]."""
        if self.found_rad is None and self.xyz_m:
            xyz_m = np.concatenate(self.xyz_m)
            ring = np.concatenate(self.ring)
            if len(ring) >= FEWEST_SHOTS and len(np.unique(ring)) >= FEWEST_RINGS:
                spread = spread_of_cones(xyz_m, ring, is_fitted=False)
                # cones need no other frame
                fitted = (
                    spread_of_cones(xyz_m, ring, is_fitted=True) if spread > MOST_RAD else spread
                )
                self.found_rad = spread, fitted
        return self.found_rad


def check_cones(seen: Seen) -> Finding | None:
    """Check whether coordinates are those of the scanner's own frame, and rings are rings."""
    if seen.cone_spread_rad is None or not seen.has_rings:
        return None
    spread, fitted = seen.cone_spread_rad
    is_elsewhere = spread > MOST_RAD and fitted < EXPLAINED * spread
    measured = f"elevation spreads by {math.degrees(spread):.2g} deg within rings"
    if is_elsewhere:
        measured += (
            f", by {math.degrees(fitted):.2g} deg around another axis or point, "
            "which a sector shows only roughly"
        )
    hint = "give x, y, z in the scanner's own frame: z along its axis, 0 at the scanner"
    verdict = verdict_of(doubtful=is_elsewhere or fitted > NO_CONES_RAD)
    return Finding(
        "coordinates", verdict, measured, f"at most {math.degrees(MOST_RAD):.2g} deg", hint
    )
