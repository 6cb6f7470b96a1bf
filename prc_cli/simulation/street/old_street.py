"""A small simulated street: the embedded input of ``prc demo``, with a reference label for every shot.

Terraces whose walls stand on the pavement alternate with single houses behind hedges. The first are the hard case of
PRC (the wall foot joins facade and ground), the second the easy one; their mixture decides the building figures, so
these say how a classifier behaves, not how well it does in a town.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import Assumption, LabelledBlock, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, U8
from prc_cli.simulation.furniture import bodies_between
from prc_cli.simulation.houses import cast_ground, cast_houses
from prc_cli.simulation.params import StreetParams
from prc_cli.simulation.rays import Hits, Rays, window
from prc_cli.simulation.scanner import draw, scan

__all__ = ["StreetParams", "StreetScan", "simulate_street"]

LANE_M = -1.6
"""The scanner drives to the right of the crown of the road [m]."""
LINES_AT_ONCE = 64


@dataclass(frozen=True, slots=True)
class StreetScan:
    """A simulated drive; a :class:`prc_cli.core.stream.ScanStream` whose reference labels are known.

    Nothing is kept: every call of :meth:`blocks` simulates again, a few lines at a time, so that memory does not
    grow with the length of the drive.
    """

    params: StreetParams

    @property
    def angle_rad(self) -> F64:
        """Scan angle of every column, (M,) float64, in the scan plane, 0 = down, positive to the left [rad]."""
        m = self.params.points_per_line
        angle: F64 = (np.arange(m, dtype=np.float64) + 0.5) * (2.0 * np.pi / m) - np.pi
        return angle

    @property
    def info(self) -> StreamInfo:
        """What is known of the stream."""
        params = self.params
        return StreamInfo(
            path="simulated street",
            format="simulation",
            points_per_line=params.points_per_line,
            n_records=params.n_lines * params.points_per_line,
            n_lines=params.n_lines,
            angle_rad=self.angle_rad,
            line_hz=params.line_hz,
            assumptions=(Assumption("seed", str(params.seed), "the same seed gives the same street"),),
        )

    def blocks(self, lines: int = LINES_AT_ONCE) -> Iterator[ScanBlock]:
        """Simulate from the start; the ranges do not depend on how many ``lines`` a block has."""
        return (item.block for item in self.labelled_blocks(lines))

    def labelled_blocks(self, lines: int = LINES_AT_ONCE) -> Iterator[LabelledBlock]:
        """Simulate from the start, with reference labels.

        Parameters
        ----------
        lines : int
            Lines in a block, at least 1; it changes nothing but the memory that is used.

        Yields
        ------
        LabelledBlock
            ``labels`` holds NOISE, GROUND, BUILDING, VEGETATION, CAR, UNCLASSIFIED (posts and signs) or MISSING.

        Raises
        ------
        ConfigError
            When ``lines`` is below 1.
        """
        if lines < 1:
            where = "lines"
            raise ConfigError(where, f"found {lines}, expected at least 1 line in a block")
        params, angle = self.params, self.angle_rad
        for first in range(0, params.n_lines, lines):
            n_lines = min(lines, params.n_lines - first)
            range_m, labels = _simulate(params, angle, first, n_lines)
            shot = np.arange(first * params.points_per_line, (first + n_lines) * params.points_per_line)
            time_s = shot.reshape(range_m.shape) / (params.line_hz * params.points_per_line)
            block = ScanBlock(first, range_m, time_s=time_s, angle_rad=angle)
            yield LabelledBlock(block, labels, np.empty(0, dtype=np.uint8))


def simulate_street(params: StreetParams | None = None) -> StreetScan:
    """Prepare a simulated drive down a street.

    Parameters
    ----------
    params : StreetParams, optional
        Length, scanner and noise; default: 600 lines, about 104 m.

    Returns
    -------
    StreetScan
        Blocks of ranges, with or without reference labels, as often as asked.

    Examples
    --------
    >>> scan = simulate_street(StreetParams(n_lines=3, points_per_line=90))
    >>> [item.labels.shape for item in scan.labelled_blocks(lines=2)]
    [(2, 90), (1, 90)]
    """
    return StreetScan(params if params is not None else StreetParams())


def _simulate(params: StreetParams, angle_rad: F64, first_line: int, n_lines: int) -> tuple[F32, U8]:
    """Cast and scan consecutive lines.

    Returns
    -------
    (lines, M) float32, (lines, M) uint8
        Range [m], NaN = missing; reference label.
    """
    rays = _rays(params, angle_rad, first_line, n_lines)
    draws = draw(params.seed, first_line, n_lines, params.points_per_line)
    hits = Hits.none((n_lines, params.points_per_line))
    cast_ground(rays, hits)
    for side in (1, -1):
        cast_houses(rays, hits, params.seed, side, draws.glass)
    reach = 30.0 * max(float(np.tan(np.deg2rad(abs(params.slant_deg)))), 0.2) + 10.0
    for body in bodies_between(params.seed, float(rays.x[0, 0]) - reach, float(rays.x[-1, -1]) + reach):
        place = window(rays, angle_rad, body.bounds)
        if place is not None:
            t, label = body.cast(rays.part(*place), draws.glass[place], draws.depth[place])
            hits.part(*place).take_nearer(t, label)
    return scan(hits, draws, first_line, params)


def _rays(params: StreetParams, angle_rad: F64, first_line: int, n_lines: int) -> Rays:
    """Shots of consecutive lines: the mirror turns in a plane that is slanted back, while the car drives on."""
    m = params.points_per_line
    shot = np.arange(first_line * m, (first_line + n_lines) * m, dtype=np.int64).reshape(n_lines, m)
    slant = np.deg2rad(params.slant_deg)
    down = np.cos(angle_rad)
    x: F64 = shot.astype(np.float64) * (params.speed_m_s / (params.line_hz * m))
    return Rays(
        x=x,
        y=LANE_M,
        z=params.height_m,
        dx=-np.sin(slant) * down,
        dy=np.sin(angle_rad),
        dz=-np.cos(slant) * down,
    )
