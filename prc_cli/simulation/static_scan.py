"""A simulated static scan of a street, with a reference label for every shot: what Stamos et al. (2012) classify.

A scanner on a tripod turns about the vertical and fires vertical lines from low to high. It sees a road with crossfall
between curbs of 12 to 15 cm, sidewalks, parked cars, trees, lamps, signs, hedges, and houses with recessed windows,
doors, ledges and balconies.

Where the numbers come from:

* scanner: Stamos et al. (2012, sec. 9) and the data sheet of the Leica ScanStation2 (300 m, 134 m on dark surfaces,
  5 mm as in the paper, 50 000 shots a second);
* street: usual cross-sections of town streets: lanes of 3.3 m, 2.2 m for parking, crossfall of 2 to 3 %, sidewalks of
  3.6 m falling 2 % towards the road, storeys of 3.2 m;
* leaves: Beer's law in clumps; leaf area density 1 to 2 m2/m3 in crowns of street trees, about ten in clipped hedges;
  a leaf is 5 cm wide, so that close to the scanner a few neighbouring shots share one (``leaf_m = 0``: none do);
* glass: most shots at panes and windscreens are swallowed or mirrored away, some come from behind it.

Not simulated: people, bicycles, crossings, slopes along the street, rough asphalt, several returns a shot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import Assumption, LabelledBlock, ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, U8, Mask
from prc_cli.simulation.furniture import Body
from prc_cli.simulation.rays import Bounds, Hits, Rays
from prc_cli.simulation.scanner import Draws, draw
from prc_cli.simulation.static_params import StaticScanParams
from prc_cli.simulation.static_street import Street, lay_out

__all__ = ["StaticScan", "StaticScanParams", "simulate_static_scan"]

LINES_AT_ONCE = 32


@dataclass(frozen=True, slots=True)
class StaticScan:
    """A simulated static scan; a :class:`prc_cli.core.stream.ScanStream` whose reference labels are known.

    Nothing is kept but the plan of the street: every call of :meth:`blocks` simulates again, a few lines at a time.
    """

    params: StaticScanParams

    @property
    def elevation_rad(self) -> F64:
        """Elevation of every column's beam, (M,) float64, rising [rad]."""
        params = self.params
        steps = np.arange(params.points_per_line, dtype=np.float64)
        elevation: F64 = np.deg2rad(params.lowest_deg + steps * params.elevation_step_deg)
        return elevation

    @property
    def beam_rad(self) -> F64:
        """Angle of every column's beam from straight down, (M,) float64 [rad]."""
        beam: F64 = self.elevation_rad + np.pi / 2
        return beam

    @property
    def azimuth_rad(self) -> F64:
        """Where every line points, (lines,) float64, 0 = along the street, growing to the left [rad]."""
        params = self.params
        steps = np.arange(params.n_lines, dtype=np.float64)
        azimuth: F64 = np.deg2rad(params.first_azimuth_deg + steps * params.azimuth_step_deg)
        return azimuth

    @property
    def info(self) -> StreamInfo:
        """What is known of the stream."""
        params = self.params
        return StreamInfo(
            path="simulated static scan",
            format="simulation",
            points_per_line=params.points_per_line,
            n_records=params.n_lines * params.points_per_line,
            n_lines=params.n_lines,
            angle_rad=self.elevation_rad,
            line_hz=params.shots_hz / params.points_per_line,
            nadir_rad=-np.pi / 2,
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
            ``labels`` holds GROUND (road), HORIZONTAL (sidewalks, steps, ledges, ceilings), CURB (its upright face),
            VERTICAL (facades, trunks, poles, signs), VEGETATION (leaves, branches), CAR, NOISE (shots that hit both
            sides of a step) or MISSING.

        Raises
        ------
        ConfigError
            When ``lines`` is below 1.
        """
        if lines < 1:
            where = "lines"
            raise ConfigError(where, f"found {lines}, expected at least 1 line in a block")
        caster = _Caster(self.params, lay_out(self.params), self.azimuth_rad, self.elevation_rad)
        m = self.params.points_per_line
        for first in range(0, self.params.n_lines, lines):
            n_lines = min(lines, self.params.n_lines - first)
            range_m, labels, xyz_m = caster.lines(first, n_lines)
            shot = np.arange(first * m, (first + n_lines) * m, dtype=np.int64).reshape(n_lines, m)
            block = ScanBlock(
                first,
                range_m,
                time_s=shot / self.params.shots_hz,
                xyz_m=xyz_m,
                angle_rad=self.elevation_rad,
                beam_rad=self.beam_rad,
            )
            yield LabelledBlock(block, labels, np.empty(0, dtype=np.uint8))


def simulate_static_scan(params: StaticScanParams | None = None) -> StaticScan:
    """Prepare a simulated static scan of a street.

    Parameters
    ----------
    params : StaticScanParams, optional
        Scanner, street and noise; default: a full turn of 3130 lines with 1087 beams each.

    Returns
    -------
    StaticScan
        Blocks of ranges and coordinates, with or without reference labels, as often as asked.

    Examples
    --------
    >>> scan = simulate_static_scan(StaticScanParams(azimuth_step_deg=90, elevation_step_deg=5))
    >>> [item.labels.shape for item in scan.labelled_blocks(lines=3)]
    [(3, 26), (1, 26)]
    """
    return StaticScan(params if params is not None else StaticScanParams())


@dataclass(frozen=True, slots=True)
class _Fan(Rays):
    """Rays whose directions differ from line to line: all arrays are (lines, M)."""

    def part(self, lines: slice, columns: slice) -> _Fan:
        cut = (lines, columns)
        return _Fan(self.x[cut], self.y, self.z, self.dx[cut], self.dy[cut], self.dz[cut])


@dataclass(frozen=True, slots=True)
class _Sight:
    """Under which angles bodies can be seen, one number a body [rad]; too wide rather than too narrow."""

    middle: F64
    """Azimuth."""
    half: F64
    """Half of the width in azimuth."""
    low: F64
    high: F64
    """Elevations."""


@dataclass(frozen=True, slots=True)
class _Caster:
    params: StaticScanParams
    street: Street
    azimuth_rad: F64
    elevation_rad: F64

    def lines(self, first: int, n_lines: int) -> tuple[F32, U8, F32]:
        """Cast and scan consecutive lines.

        Returns
        -------
        (lines, M) float32, (lines, M) uint8, (lines, M, 3) float32
            Range [m], NaN = missing; reference label; place relative to the scanner [m].
        """
        params, street = self.params, self.street
        azimuth = self.azimuth_rad[first : first + n_lines]
        rays = self._rays(azimuth)
        draws = draw(params.seed, first, n_lines, params.points_per_line)
        hits = Hits.none(rays.dx.shape)
        below = slice(0, int(np.searchsorted(self.elevation_rad, 0.0)))
        every = slice(None)
        street.ground.cast(rays.part(every, below), hits.part(every, below))
        self._cast(street.bodies, rays, hits, draws, azimuth)
        m = params.points_per_line
        time_s = np.arange(first * m, (first + n_lines) * m).reshape(n_lines, m) / params.shots_hz
        for speed, body in street.passing:
            # the scene moves against the car: only this body is cast with it
            moved = _Fan(-speed * time_s, rays.y, rays.z, rays.dx, rays.dy, rays.dz)
            span = sorted((speed * float(time_s[0, 0]), speed * float(time_s[-1, -1])))
            x = body.bounds.x
            swept = Bounds((x[0] + span[0], x[1] + span[1]), body.bounds.y, body.bounds.z)
            self._cast((body,), moved, hits, draws, azimuth, swept)
        range_m, labels = _measure(hits, draws, params)
        xyz = np.stack([range_m * rays.dx, range_m * rays.dy, range_m * rays.dz], axis=-1).astype(np.float32)
        return range_m, labels, xyz

    def _rays(self, azimuth: F64) -> _Fan:
        flat = np.cos(self.elevation_rad)
        dx = np.cos(azimuth)[:, None] * flat
        dz = np.broadcast_to(np.sin(self.elevation_rad), dx.shape)
        z = self.street.ground.z(self.params.across_m) + self.params.height_m
        x = np.broadcast_to(np.float64(0.0), dx.shape)
        return _Fan(x, self.params.across_m, z, dx, np.sin(azimuth)[:, None] * flat, dz)

    def _cast(
        self,
        bodies: tuple[Body, ...],
        rays: _Fan,
        hits: Hits,
        draws: Draws,
        azimuth: F64,
        swept: Bounds | None = None,
    ) -> None:
        """Cast bodies within the windows of the block where they can be seen."""
        bounds = [body.bounds if swept is None else swept for body in bodies]
        sight = _sight(bounds, rays.y, rays.z)
        turned = np.abs((azimuth - sight.middle[:, None] + np.pi) % (2 * np.pi) - np.pi)
        seen = turned <= sight.half[:, None]
        low = np.searchsorted(self.elevation_rad, sight.low)
        high = np.searchsorted(self.elevation_rad, sight.high, side="right")
        m = len(self.elevation_rad)
        for i in np.flatnonzero(seen.any(axis=1) & (low < high)).tolist():
            columns = slice(int(low[i]), int(high[i]))
            # every body draws its own numbers, or thin crowns behind each other would let the same shots through
            shifted = (np.arange(columns.start, columns.stop) + 37 * i) % m
            for lines in _runs(seen[i]):
                place = (lines, columns)
                t, label = bodies[i].cast(rays.part(*place), draws.glass[place], draws.depth[lines][:, shifted])
                hits.part(*place).take_nearer(t, label)


def _sight(bounds: list[Bounds], y: float, z: float) -> _Sight:
    """See :class:`_Sight`; the scanner is at (0, y, z)."""
    box = np.array([(*b.x, *b.y, *b.z) for b in bounds]).reshape(-1, 6) - (0.0, 0.0, y, y, z, z)
    x0, x1, y0, y1, z0, z1 = box.T
    middle = np.arctan2((y0 + y1) / 2, (x0 + x1) / 2)
    corners = np.stack([np.arctan2(b, a) for a in (x0, x1) for b in (y0, y1)])
    half = np.abs((corners - middle + np.pi) % (2 * np.pi) - np.pi).max(axis=0) + 1e-6
    near = np.hypot(np.maximum(np.maximum(x0, -x1), 0.0), np.maximum(np.maximum(y0, -y1), 0.0))
    far = np.hypot(np.maximum(np.abs(x0), np.abs(x1)), np.maximum(np.abs(y0), np.abs(y1)))
    low = np.minimum(np.arctan2(z0, near), np.arctan2(z0, far)) - 1e-6
    high = np.maximum(np.arctan2(z1, near), np.arctan2(z1, far)) + 1e-6
    return _Sight(middle, np.where(near > 0, half, np.pi), low, high)


def _runs(seen: Mask) -> Iterator[slice]:
    """Find the runs of true entries."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(np.int8)))
    for start, stop in edges.reshape(-1, 2).tolist():
        yield slice(start, stop)


def _measure(hits: Hits, draws: Draws, params: StaticScanParams) -> tuple[F32, U8]:
    """Turn true ranges into what the scanner says: noise, lost shots, mixed pixels.

    Returns
    -------
    (lines, M) float32, (lines, M) uint8
        Range [m], NaN = missing; reference label.
    """
    lost = draws.lost < _lost_share(hits)
    gone = lost | (hits.label == Label.MISSING) | (hits.t > params.max_range_m)
    true_range = np.where(gone, np.nan, hits.t)
    label = np.where(gone, Label.MISSING, hits.label).astype(np.uint8)
    step = np.diff(true_range, axis=1)
    # a road seen at a low angle is steps all over: an edge is a step much larger than one of its neighbours
    size = np.pad(np.abs(step), ((0, 0), (1, 1)), mode="edge")
    around = np.fmin(size[:, :-2], size[:, 2:])
    leaves = (label[:, :-1] == Label.VEGETATION) & (label[:, 1:] == Label.VEGETATION)
    # a pulse is about 1 m long: two surfaces farther apart do not mix; leaves are small steps all over
    edge = (np.abs(step) > 0.1) & (np.abs(step) < 1.0) & ~(np.abs(step) < 4.0 * around) & ~leaves
    mixed = edge & (draws.mixed[:, :-1] < params.mixed_share)
    true_range[:, :-1][mixed] += (draws.mixed_weight[:, :-1] * step)[mixed]
    label[:, :-1][mixed] = Label.NOISE
    range_m = true_range + params.noise_m * draws.normal
    # noise can push a range past what the scanner gives, or a very near one below zero
    with np.errstate(invalid="ignore"):
        given = (range_m > 0.0) & (range_m <= params.max_range_m)
    label[~given] = Label.MISSING
    return np.where(given, range_m, np.nan).astype(np.float32), label


def _lost_share(hits: Hits) -> F64:
    """Probability that a shot gets no answer: far away, or nearly along the road."""
    far = (np.minimum(hits.t, 1000.0) / 160.0) ** 4
    grazing = np.clip(1.0 - np.abs(hits.facing) / 0.04, 0.0, 1.0)
    share: F64 = 0.002 + far + grazing
    return share
