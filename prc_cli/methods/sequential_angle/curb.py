"""Curbs: possible curb points in a row, and verification across lines (Stamos et al. 2012, sec. 6).

A possible curb point is the first vertical point after the ground with nothing under it. Vertical
points that are neighbours on the grid of lines and beams and close in space form regions. A
complete, low region with a possible curb point is a curb if it spans three lines, or if it is
straight.

Interpretations of passages that are silent or ambiguous:

- Neighbours are the eight around a point, closer than 0.3 m.
- A region is complete when the next line of its side adds nothing to it. A region of very many
  lines is decided and closed early, which bounds the memory; points that follow start a new region.
- "Vertical curvature" is the change of the signed angle between neighbouring points of the region
  in a line. A region without such a pair does not count as straight.
- "Behind a curb" is decided by horizontal distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.sequential_angle import curb_loops
from prc_cli.methods.sequential_angle.curb_loops import connect_verticals
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import CurbThresholds, OpenRegions


@dataclass(frozen=True, slots=True, eq=False)
class CurbState:
    """Undecided regions between two calls; P lines, at most ``max_lines``."""

    regions: OpenRegions
    """Regions in the lines that are not final, at least the last line."""
    xyz_m: F32
    """(n_sides, n, 3) float32, points of the last line [m]."""
    signed_deg: F32
    """((min_lines - 1) * n_sides, n) float32, signed angles of the last lines [deg]."""

    @classmethod
    def start(cls, n_sides: int, n: int, thresholds: CurbThresholds) -> CurbState:
        """Return the state before the first line."""
        return cls(
            regions=OpenRegions(
                labels=np.zeros((n_sides, n), np.int32),
                n_given=1,
                side=np.empty(0, np.int32),
                first=np.empty(0, np.int32),
                last=np.empty(0, np.int32),
                possible=np.empty(0, np.bool_),
                low_m=np.empty(0, np.float32),
                high_m=np.empty(0, np.float32),
            ),
            xyz_m=np.full((n_sides, n, 3), np.nan, np.float32),
            signed_deg=np.full(((thresholds.min_lines - 1) * n_sides, n), np.nan, np.float32),
        )

    @property
    def n_waiting(self) -> int:
        """Lines taken but not yet returned."""
        return len(self.regions.labels) // len(self.xyz_m) - self.regions.n_given


def possible_curbs(
    lines: VerticalLines,
    surface: U8,
    ground: Mask,
    z_g: F32,
    thresholds: CurbThresholds,
) -> I32:
    """Find the possible curb point of every row.

    This is the first vertical point after the last ground point with nothing under it: none of the
    points before it is farther from the scanner, as the road under a car would be. The search ends
    at the first point 2 m above the ground.

    ``surface`` (R, n) uint8; ``ground`` (R, n) bool; ``z_g`` (R,) float32; returns (R,) int32.
    """
    return curb_loops.possible_curbs(surface, lines.range_m, lines.xyz_m, ground, z_g, thresholds)


def curbs(
    lines: VerticalLines,
    surface: U8,
    signed_deg: F32,
    possible: I32,
    state: CurbState,
    thresholds: CurbThresholds,
    *,
    last: bool,
) -> tuple[Mask, CurbState]:
    """Connect vertical points into regions, and return the rows whose regions are all decided.

    ``surface`` (R, n) uint8; ``signed_deg`` (R, n) float32; ``possible`` (R,) int32; returns
    ``curb`` (F, n) bool.
    """
    curb, regions = connect_verticals(
        surface,
        lines.xyz_m,
        signed_deg,
        possible,
        lines.n_sides,
        state.xyz_m,
        state.signed_deg,
        state.regions,
        thresholds,
        last,
    )
    return curb, CurbState(
        regions, _tail(state.xyz_m, lines.xyz_m), _tail(state.signed_deg, signed_deg)
    )


def _tail(before: F32, new: F32) -> F32:
    """Return the last rows of both, as many as there were before; a copy."""
    n = len(before)
    return np.concatenate([before[min(len(new), n) :], new[max(len(new) - n, 0) :]])
