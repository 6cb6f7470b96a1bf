"""Simulated scans as streams with reference labels: a scene, a scanner and its platform."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError
from prc_cli.core.loops import load_loops, loops_of
from prc_cli.core.stream import Assumption, ExtraReturns, LabelledBlock, ScanBlock, StreamInfo, cut
from prc_cli.core.threads import ordered
from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.simulation import casting_loops, sensor_loops
from prc_cli.simulation.scanners import Scanner
from prc_cli.simulation.sensor import Measured, cast, goes_behind, scan
from prc_cli.simulation.thresholds import Hits
from prc_cli.simulation.trajectory import Platform, Shots, Trajectory, aim
from prc_cli.simulation.world import PROPERTIES, Bodies, BodiesNear, Material, Shape, hashed

LINES_AT_ONCE = 64
"""Lines that are simulated together, whatever blocks are asked for: values do not depend on
these."""
LINES_LOOKED_AT = 1 << 12
"""Lines whose places are computed together in the search for the end of a drive."""
MOST_LINES = 2**31 - 1
LARGEST_ROOM_M = 25.0
BEHIND_M = 0.01
"""Surfaces that are seen through another lie farther behind it than this [m]."""
INTENSITY_SCALE = np.float32(4096.0)
"""Intensity of a white wall at 10 m; it grows with the root of the power, to fit 16 bits."""

LOOPS = loops_of(casting_loops, sensor_loops)


@dataclass(frozen=True, slots=True)
class SimulatedBlock:
    """Consecutive lines of a simulated scan."""

    labelled: LabelledBlock
    """Ranges, times, intensities, and the reference label of every return."""
    world_m: F64 | None = None
    """(lines, M, 3) float64, place of every return by the true pose [m]; NaN = missing."""
    extra_world_m: F64 | None = None
    """(n, 3) float64, the same for further returns."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedScan:
    """A simulated stream with known labels; every call of :meth:`blocks` simulates again."""

    name: str
    bodies_near: BodiesNear
    scanner: Scanner
    platform: Platform
    seed: int
    n_lines: int
    sight_m: float
    threads: int = 1
    with_xyz: bool = False
    with_world: bool = False
    flake_m: float = 0.0
    """Mean way of a beam from one flake of snow, or drop, to the next [m]; 0 = clear air."""
    relabel: Callable[[F64], U8] | None = None
    """Reference labels by place, (n, 3) [m] to (n,); unset = of the bodies. Needs
    ``with_world``."""

    @property
    def lines_at_once(self) -> int:
        """Lines that are simulated together: a turn of a spinning scanner, else LINES_AT_ONCE."""
        if not self.scanner.spins:
            return LINES_AT_ONCE
        return max(1, round(360.0 / self.scanner.azimuth_step_deg))

    @property
    def info(self) -> StreamInfo:
        """Properties of the stream."""
        scanner = self.scanner
        return StreamInfo(
            path=self.name,
            format="simulation",
            points_per_line=scanner.points_per_line,
            n_records=self.n_lines * scanner.points_per_line,
            n_lines=self.n_lines,
            angle_rad=scanner.angle_rad(),
            line_hz=scanner.line_hz,
            down_rad=0.0 if scanner.turns else -float(np.deg2rad(scanner.roll_deg)),
            cos_tilt=1.0 if scanner.turns else float(np.cos(np.deg2rad(scanner.slant_deg))),
            assumptions=(Assumption("seed", str(self.seed), "the same seed gives the same scan"),),
        )

    def blocks(self, lines: int = LINES_AT_ONCE) -> Iterator[ScanBlock]:
        """Simulate from the start; the values do not depend on how many ``lines`` a block has."""
        return (item.block for item in self.labelled_blocks(lines))

    def labelled_blocks(self, lines: int = LINES_AT_ONCE) -> Iterator[LabelledBlock]:
        """Simulate from the start, with reference labels."""
        if lines < 1:
            where = "lines"
            raise ConfigError(where, f"found {lines}, expected at least 1 line in a block")
        for item in self.simulated():
            for first in range(0, item.labelled.block.n_lines, lines):
                stop = min(first + lines, item.labelled.block.n_lines)
                extra_line = item.labelled.block.extra.line
                is_inside = (extra_line >= first) & (extra_line < stop)
                yield LabelledBlock(
                    block=cut(item.labelled.block, first, stop),
                    labels=item.labelled.labels[first:stop],
                    extra_labels=item.labelled.extra_labels[is_inside],
                )

    def simulated(self) -> Iterator[SimulatedBlock]:
        """Simulate from the start, with reference labels and registered coordinates."""
        load_simulator()
        return ordered(
            self._lines, range(0, self.n_lines, self.lines_at_once), threads=self.threads
        )

    def _lines(self, first: int) -> SimulatedBlock:
        """Simulate the lines from a multiple of :attr:`lines_at_once` on."""
        scanner = self.scanner
        n_lines = min(self.lines_at_once, self.n_lines - first)
        shots = aim(self.platform, scanner, first, n_lines)
        start = shots.origin[0, 0]
        end = shots.origin[-1, -1]
        x, y, _ = ((start + end) / 2.0).tolist()
        travelled = float(np.hypot(*(end - start)[:2]))
        when_s = float(shots.time_s[0, 0] + shots.time_s[-1, -1]) / 2.0
        bodies = self.bodies_near(x, y, self.sight_m + travelled, when_s)
        returns = self._measure(bodies, shots, first)
        ranges = returns.range_m
        line = returns.extra_line
        column = returns.extra_column
        record = (first + line.astype(np.int64)) * scanner.points_per_line + column
        # whole numbers from 0 to 65535, as scanners store them
        counts = np.minimum(np.rint(INTENSITY_SCALE * np.sqrt(returns.intensity)), 65535.0)
        counts[np.isnan(ranges)] = np.nan
        angle_rad = scanner.angle_rad()
        block = ScanBlock(
            first,
            ranges,
            time_s=shots.time_s,
            xyz_m=_relative(scanner, first, ranges) if self.with_xyz else None,
            intensity=counts.astype(np.float32, copy=False),
            angle_rad=angle_rad,
            beam_rad=angle_rad if scanner.turns else None,
            extra=ExtraReturns(line, column, returns.extra_range_m, record),
            is_last=first + n_lines == self.n_lines,
        )
        labelled = LabelledBlock(block, returns.label, returns.extra_label)
        if not self.with_world:
            return SimulatedBlock(labelled)
        world_m = shots.origin + ranges[..., None] * shots.direction
        extra_way = returns.extra_range_m[:, None] * shots.direction[line, column]
        extra_world_m = shots.origin[line, column] + extra_way
        if self.relabel is not None:
            labels = self.relabel(world_m.reshape(-1, 3)).reshape(ranges.shape)
            extra_labels = self.relabel(extra_world_m)
            labelled = replace(labelled, labels=labels, extra_labels=extra_labels)
        return SimulatedBlock(labelled, world_m, extra_world_m)

    def _measure(self, bodies: Bodies, shots: Shots, first: int) -> Measured:
        """Cast the shots, once more behind what light passes, and let the scanner measure."""
        scanner = self.scanner
        first_shot = first * scanner.points_per_line

        def cast_from(start_m: F64 | None) -> Hits:
            hits = cast(bodies, shots.origin, shots.direction, shots.time_s, first_shot, start_m)
            # beyond the sight, a body may or may not be among the bodies
            far = hits.t > self.sight_m
            hits.t[far] = np.inf
            hits.body[far] = -1
            hits.facing[far] = 0.0
            return hits

        hits = cast_from(None)
        passes = goes_behind(hits, bodies, scanner, first, self.seed)
        behind = None
        if passes.any():
            behind = cast_from(np.where(passes, hits.t + BEHIND_M, np.inf))
        returns = scan(hits, bodies, scanner, first, self.seed, behind)
        if self.flake_m:
            returns = in_snow(returns, self.flake_m, first, self.seed)
        if not scanner.is_static:
            return returns
        return _with_static_labels(returns, bodies, shots, hits, behind)


def load_simulator() -> None:
    """Load the compiled loops; after installation they are compiled once, which takes a while."""
    load_loops(LOOPS)


def lines_of(platform: Trajectory, scanner: Scanner, length_m: float) -> int:
    """Return the number of whole lines until a platform has gone this far, at least 1."""
    first = 0
    while first < MOST_LINES:
        start_s = scanner.line_time_s(first, LINES_LOOKED_AT)
        has_arrived = platform.progress(start_s).distance >= length_m
        if has_arrived.any():
            return max(1, first + int(np.argmax(has_arrived)))
        first += LINES_LOOKED_AT
    where = "length_m"
    raise ConfigError(where, f"found {length_m:g}, expected a drive of at most {MOST_LINES} lines")


def _with_static_labels(
    returns: Measured,
    bodies: Bodies,
    shots: Shots,
    hits: Hits,
    behind: Hits | None,
) -> Measured:
    """Return measurements with the labels of :func:`static_labels`."""

    def relabelled(label: U8, range_m: F32, shot: Any) -> U8:
        way = range_m.astype(np.float64)
        body = hits.body[shot]
        if behind is not None:
            off_front = np.abs(way - hits.t[shot])
            off_behind = np.abs(way - behind.t[shot])
            body = np.where(off_behind < off_front, behind.body[shot], body)
        place = shots.origin[shot] + way[..., None] * shots.direction[shot]
        labels = static_labels(label.ravel(), bodies, body.ravel(), place.reshape(-1, 3))
        return labels.reshape(label.shape)

    extra_shots = returns.extra_line, returns.extra_column
    return replace(
        returns,
        label=relabelled(returns.label, returns.range_m, slice(None)),
        extra_label=relabelled(returns.extra_label, returns.extra_range_m, extra_shots),
    )


NEAREST_FLAKE_M = 1.0
"""Flakes nearer than this are not answered [m]."""
FLAKE_SEEN_M = 9.0
"""A flake is answered with a chance that falls by e over this distance [m]."""
FLAKE_POWER = 0.02
"""Power of a flake's echo at 10 m, over that of a white wall; it falls with the range squared."""


def in_snow(
    returns: Measured,
    flake_m: float,
    first_line: int,
    seed: int,
) -> Measured:
    """Return measurements with flakes or drops before the surfaces; their returns are noise."""
    n_lines, m = returns.range_m.shape
    shot = (first_line * m + np.arange(n_lines * m, dtype=np.int64)).reshape(n_lines, m)
    flake_range = -flake_m * np.log1p(-hashed(seed, 40, shot))
    is_answered = hashed(seed, 41, shot) < np.exp(-flake_range / FLAKE_SEEN_M)
    # a missing range does not hide a flake
    is_hidden = flake_range >= returns.range_m
    is_flake = is_answered & (flake_range > NEAREST_FLAKE_M) & ~is_hidden
    range_m = returns.range_m.copy()
    label = returns.label.copy()
    intensity = returns.intensity.copy()
    flake_range = flake_range[is_flake]
    brightness = 0.5 + hashed(seed, 42, shot[is_flake])
    range_m[is_flake] = flake_range
    label[is_flake] = Label.NOISE
    intensity[is_flake] = FLAKE_POWER * (10.0 / flake_range) ** 2 * brightness
    return replace(returns, range_m=range_m, label=label, intensity=intensity)


def _relative(scanner: Scanner, first_line: int, range_m: F32) -> F32:
    """Return (lines, M, 3) float32, x forward (azimuth 0), y left, z up of the scanner [m]."""
    columns = scanner.directions()
    if not scanner.turns:
        return (range_m[..., None] * columns).astype(np.float32)
    azimuth = scanner.azimuth_rad(first_line, len(range_m))
    along = range_m * columns[:, 0]
    across = range_m * columns[:, 1]
    cosine = np.cos(azimuth)
    sine = np.sin(azimuth)
    parts = (
        cosine * along - sine * across,
        sine * along + cosine * across,
        range_m * columns[:, 2],
    )
    return np.stack(parts, axis=-1).astype(np.float32)


def ground_below(
    bodies_near: BodiesNear,
    x_m: float,
    y_m: float,
    z_m: float,
) -> float:
    """Return the height of the surface under a place [m]; ``z_m`` if there is none."""
    start_z = z_m + 1.0
    origin = np.array([[[x_m, y_m, start_z]] * 2])
    down = np.array([[[0.0, 0.0, -1.0]] * 2])
    bodies = bodies_near(x_m, y_m, 1.0, 0.0)
    depth = float(cast(bodies, origin, down, np.zeros((1, 2))).t[0, 0])
    return start_z - depth if np.isfinite(depth) else z_m


def room_around(
    bodies_near: BodiesNear,
    x_m: float,
    y_m: float,
    z_m: float,
) -> float:
    """Return the distance of the nearest body around a place, knee to head, at time 0 [m]."""
    heights = np.array([0.5, 1.0, 1.5])
    turns = np.arange(0.0, 2.0 * np.pi, np.pi / 90.0)
    origin = np.empty((len(heights), len(turns), 3))
    origin[:] = np.array([x_m, y_m, z_m])
    origin[:, :, 2] += heights[:, None]
    level = np.stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)], axis=1)
    direction = np.broadcast_to(level, origin.shape)
    bodies = bodies_near(x_m, y_m, LARGEST_ROOM_M, 0.0)
    return float(cast(bodies, origin, direction, np.zeros(len(heights))).t.min())


LEVEL_COSINE = float(np.cos(np.deg2rad(45.0)))
"""A face is level if its normal lies within 45 degrees of the vertical."""

_LABELS: dict[Material, Label] = {
    Material.SIDEWALK: Label.HORIZONTAL,
    Material.GRASS: Label.HORIZONTAL,
    Material.SOIL: Label.HORIZONTAL,
    Material.TRUNK: Label.VERTICAL,
}
"""Materials whose label in a static scan is another than in :data:`PROPERTIES`."""
_OF_EITHER = (
    Material.WALL,
    Material.GLASS,
    Material.DOOR,
    Material.BALCONY,
    Material.ROOF,
    Material.FENCE,
    Material.POLE,
    Material.SIGN,
)
"""Materials that are VERTICAL or HORIZONTAL."""


def static_labels(
    label: U8,
    bodies: Bodies,
    body: I32,
    place_m: F64,
) -> U8:
    """Return labels of a static scan: the classes of Stamos et al. (2012).

    That classifier does not know buildings. It separates horizontal from vertical surfaces, and its
    ground is only the road, up to the curb. So sidewalks and lawns are HORIZONTAL. Faces of houses,
    fences, posts and signs are HORIZONTAL if they are nearer to level than to upright (roofs of up
    to 45 degrees, sills, lintels, floors of balconies), else VERTICAL, as are trunks. People and
    wires have no class there and stay UNCLASSIFIED.
    """
    usual_label = np.array([PROPERTIES[material].label for material in Material], np.uint8)
    static_label = usual_label.copy()
    for material, of_material in _LABELS.items():
        static_label[material] = of_material
    is_upright = np.isin(label, (Label.BUILDING, Label.POLE))
    labels: U8 = np.where(is_upright, Label.VERTICAL, label).astype(np.uint8)
    is_surface = (body >= 0) & (label != Label.NOISE) & (label != Label.MISSING)
    shot = np.flatnonzero(is_surface)
    materials = bodies.material[body[shot]]
    # a split shot has the label of the surface of its range, which may be the neighbour's
    is_of_body = usual_label[materials] == label[shot]
    shot = shot[is_of_body]
    materials = materials[is_of_body]
    labels[shot] = static_label[materials]
    shot = shot[np.isin(materials, _OF_EITHER)]
    level = is_level(bodies, body[shot], place_m[shot])
    labels[shot] = np.where(level, Label.HORIZONTAL, Label.VERTICAL)
    return labels


def is_level(bodies: Bodies, body: I32, place_m: F64) -> Mask:
    """Return which places are on a level face, (n,) bool; only boxes and triangles have faces."""
    shape = bodies.shape[body]
    numbers = bodies.numbers[body]
    level = np.zeros(len(body), np.bool_)

    triangle = np.flatnonzero(shape == Shape.TRIANGLE)
    a = numbers[triangle, 0:3]
    b = numbers[triangle, 3:6]
    c = numbers[triangle, 6:9]
    normal = np.cross(b - a, c - a)
    least = LEVEL_COSINE * np.linalg.norm(normal, axis=1)
    level[triangle] = np.abs(normal[:, 2]) > least

    # the face of the box that the place is nearest to
    box = np.flatnonzero((shape == Shape.BOX) & (bodies.density[body] == 0.0))
    from_centre = place_m[box] - numbers[box, 0:3]
    dx = from_centre[:, 0]
    dy = from_centre[:, 1]
    half = numbers[box, 3:6]
    yaw = numbers[box, 6]
    along_axes = np.abs(from_centre)
    along_axes[:, 0] = np.abs(np.cos(yaw) * dx + np.sin(yaw) * dy)
    along_axes[:, 1] = np.abs(np.cos(yaw) * dy - np.sin(yaw) * dx)
    level[box] = np.argmin(np.abs(along_axes - half), axis=1) == 2
    return level
