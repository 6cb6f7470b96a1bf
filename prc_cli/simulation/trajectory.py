"""Position and attitude of a scanner at any time, its shots, and trajectory files.

Everything is a closed formula of time: sums of sines with seeded frequencies and phases, and a
table of stops that is made by hashing. So any time can be asked for in any order and nothing grows
with the length of a drive.

Frames: world x, y horizontal, z up; platform x forward, y left, z up. A platform is turned by yaw
about z, then pitch about its y (positive = nose down), then roll about its x (positive = left side
up).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from pydantic import Field, model_validator

from prc_cli.core.config import Params
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output
from prc_cli.core.types import F64, I64
from prc_cli.formats.trajectory import SBET_SUFFIXES
from prc_cli.simulation.casting_loops import aim_shots
from prc_cli.simulation.scanners import Scanner
from prc_cli.simulation.world import hashed

if TYPE_CHECKING:
    import pyproj

PathPoint = Callable[[F64], tuple[F64, F64]]
"""A scene's way: distances (n,) float64 [m] to the ground below the platform, (n, 3) float64 [m],
and heading, (n,)
float64 [rad, 0 = x, positive to the left]; continuous both."""

_KNOT_S = 0.005
"""Poses are computed at least this often [s]; shots in between are interpolated."""
_WAVE_M = 40.0
"""Cruising speed wavers over this distance, divided by two pi [m]."""
_SINES = 6
"""Sines that a wobble is made of."""


class MotionParams(Params):
    """How the platform moves along its path and wobbles while it does."""

    speed_m_s: float = Field(8.33, gt=0, le=60, description="cruising speed [m/s]; 8.33 = 30 km/h")
    speed_variation: float = Field(
        0.1, ge=0, le=0.5, description="variation of the cruising speed, as a share"
    )
    stop_every_m: float = Field(
        400.0, ge=0, le=10**6, description="mean way from stop to stop [m]; 0 = none"
    )
    stop_s: float = Field(5.0, ge=0, le=600, description="mean time of a stop [s]")
    brake_m_s2: float = Field(
        1.5, gt=0, le=10, description="hardest braking, and acceleration [m/s²]"
    )
    roll_deg: float = Field(
        0.3, ge=0, le=20, description="roll by bumps, standard deviation at full speed [degrees]"
    )
    pitch_deg: float = Field(
        0.25, ge=0, le=20, description="pitch by bumps, standard deviation [degrees]"
    )
    yaw_deg: float = Field(
        0.15, ge=0, le=20, description="yaw beside the path's, standard deviation [degrees]"
    )
    bounce_m: float = Field(
        0.008, ge=0, le=1, description="up and down on the springs, standard deviation [m]"
    )
    wobble_hz: float = Field(2.0, gt=0, le=20, description="fastest of these wobbles [Hz]")
    lean_deg: float = Field(
        0.4, ge=0, le=10, description="pitch and roll by acceleration [degrees for 1 m/s²]"
    )
    gait_hz: float = Field(1.8, gt=0, le=5, description="steps of a walking person [Hz]")
    bob_m: float = Field(0.0, ge=0, le=0.5, description="walking: lowest to highest of a step [m]")
    sway_m: float = Field(0.0, ge=0, le=0.5, description="walking: left to right of two steps [m]")
    gait_deg: float = Field(
        0.0, ge=0, le=20, description="walking: swing of roll and yaw to either side [degrees]"
    )

    @model_validator(mode="after")
    def _check_stops(self) -> MotionParams:
        # a stop lies at 0.3 to 0.7 of its stretch, with room to brake before and to speed up after
        # it
        if 0.0 < 0.3 * self.stop_every_m < self.braking_m:
            least_m = self.braking_m / 0.3
            problem = f"stop_every_m of at least {least_m:.0f} at this speed and braking, or 0"
            raise ValueError(problem)
        return self

    @property
    def braking_s(self) -> float:
        """Time to come to a stop, as half a cosine [s]."""
        return float(np.pi) * self.speed_m_s / (2.0 * self.brake_m_s2)

    @property
    def braking_m(self) -> float:
        """Way to come to a stop [m]."""
        return self.speed_m_s * self.braking_s / 2.0


MOTIONS: dict[str, MotionParams] = {
    "car": MotionParams(),
    "backpack": MotionParams(
        speed_m_s=1.1,
        speed_variation=0.2,
        stop_every_m=0.0,
        roll_deg=1.0,
        pitch_deg=1.0,
        yaw_deg=3.0,
        bounce_m=0.005,
        wobble_hz=0.6,
        lean_deg=0.0,
        bob_m=0.04,
        sway_m=0.05,
        gait_deg=2.0,
    ),
}
"""Motions of the platforms of Lehtola et al. (2019, III): a car, a person with a backpack."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Position of a scanner and attitude of its platform at n times."""

    position: F64
    """(n, 3) float64, centre of the scanner in the world [m]."""
    roll: F64
    """(n,) float64 [rad], positive = left side up."""
    pitch: F64
    """(n,) float64 [rad], positive = nose down."""
    yaw: F64
    """(n,) float64 [rad], 0 = x, positive to the left."""

    def turn(self) -> F64:
        """Return the matrices that bring platform vectors to the world, (n, 3, 3) float64."""
        return _turn(self.roll, self.pitch, self.yaw)


class Platform(Protocol):
    """Anything that carries a scanner."""

    def pose(self, time_s: F64) -> Pose:
        """Return the pose at times of at least 0, (n,) float64 [s]."""


@dataclass(frozen=True, slots=True)
class Station:
    """A tripod: the same pose at all times, upright."""

    x_m: float
    y_m: float
    z_m: float
    """Of the scanner itself, not of the ground [m]."""
    yaw: float = 0.0
    """[rad]"""

    def pose(self, time_s: F64) -> Pose:
        """Return the one pose for every time, (n,) float64 [s]."""
        zero = np.zeros(len(time_s))
        position = np.tile([self.x_m, self.y_m, self.z_m], (len(time_s), 1))
        return Pose(position, zero, zero, zero + self.yaw)


class Progress(NamedTuple):
    """How far and how fast a platform is at n times, (n,) float64 each."""

    distance: F64
    """Along the path [m]."""
    speed: F64
    """[m/s]"""
    acceleration: F64
    """[m/s²]"""


class Trajectory:
    """A drive or walk along a scene's path."""

    def __init__(
        self,
        path_point: PathPoint,
        motion: MotionParams,
        height_m: float,
        seed: int,
    ) -> None:
        self.path_point = path_point
        self.motion = motion
        self.height_m = height_m
        self.seed = seed
        fastest = motion.wobble_hz
        self._wobbles = [_Wobble(seed, channel, fastest / 8.0, fastest) for channel in range(4)]
        self._gait_drift = _Wobble(seed, 4, 0.02, 0.1)

    def progress(self, time_s: F64) -> Progress:
        """Return how far and how fast the platform is at times (n,) float64 [s]."""
        even = self._stop_and_go(np.asarray(time_s, dtype=np.float64))
        share = self.motion.speed_variation
        phase = hashed(self.seed, 5, np.zeros(1, np.int64))[0] * 2.0 * np.pi
        around = even.distance / _WAVE_M + phase
        faster = 1.0 + share * np.cos(around)
        slower_m_s2 = even.speed * even.speed * (share / _WAVE_M) * np.sin(around)
        return Progress(
            distance=even.distance + share * _WAVE_M * (np.sin(around) - np.sin(phase)),
            speed=even.speed * faster,
            acceleration=even.acceleration * faster - slower_m_s2,
        )

    def pose(self, time_s: F64) -> Pose:
        """Return the pose at times, (n,) float64 [s]."""
        time_s = np.ascontiguousarray(time_s, dtype=np.float64)
        motion = self.motion
        progress = self.progress(time_s)
        distance = progress.distance
        speed = progress.speed

        # slope and bend of the way, from a metre behind to a metre ahead
        ground, heading = self.path_point(distance)
        behind_m = np.maximum(distance - 1.0, 0.0)
        ahead, heading_ahead = self.path_point(distance + 1.0)
        behind, heading_behind = self.path_point(behind_m)
        run = distance + 1.0 - behind_m
        slope = np.arctan((ahead[:, 2] - behind[:, 2]) / run)
        bend = np.sin(heading_ahead - heading_behind) / run

        # bumps shake the platform more the faster it is
        moving = speed / motion.speed_m_s
        lively = 0.1 + 0.9 * moving
        of_roll, of_pitch, of_yaw, of_bounce = self._wobbles
        roll_bump = np.deg2rad(motion.roll_deg) * lively * of_roll.value(time_s)
        pitch_bump = np.deg2rad(motion.pitch_deg) * lively * of_pitch.value(time_s)
        yaw_bump = np.deg2rad(motion.yaw_deg) * lively * of_yaw.value(time_s)
        bounce = motion.bounce_m * lively * of_bounce.value(time_s)

        # two steps make a stride: the body goes up and down with each step, left and right with
        # each stride; nobody walks like a clock
        stride = np.pi * motion.gait_hz * time_s + 0.5 * self._gait_drift.value(time_s)
        swing = np.deg2rad(motion.gait_deg) * moving
        bob = 0.5 * motion.bob_m * moving * np.sin(2.0 * stride)
        sway = 0.5 * motion.sway_m * moving * np.sin(stride + 0.3)

        lean = np.deg2rad(motion.lean_deg)
        pitch_lean = lean * progress.acceleration
        roll = roll_bump + swing * np.sin(stride) + lean * speed * speed * bend
        pitch = pitch_bump + 0.5 * swing * np.sin(2.0 * stride + 1.0) - pitch_lean - slope
        yaw = heading + yaw_bump + swing * np.sin(stride + 0.7)
        turn = _turn(roll, pitch, yaw)
        up = self.height_m + bounce + bob
        position = ground + turn[:, :, 2] * up[:, None] + turn[:, :, 1] * sway[:, None]
        return Pose(position, roll, pitch, yaw)

    def _stop_and_go(self, time_s: F64) -> Progress:
        """Return the progress of a platform with even speed between stops."""
        motion = self.motion
        speed_m_s = motion.speed_m_s
        stretch_m = motion.stop_every_m
        if stretch_m == 0.0:
            even = np.full_like(time_s, speed_m_s)
            return Progress(speed_m_s * time_s, even, np.zeros_like(time_s))
        brake_s = motion.braking_s
        mean_s = stretch_m / speed_m_s + brake_s + motion.stop_s
        # a stretch begins at its number times the mean duration, earlier or later by less than a
        # mean stop: the sum of the stops before it telescopes
        number = np.maximum(np.floor(time_s / mean_s).astype(np.int64) - 1, 0)
        for _ in range(2):
            number = number + (time_s >= self._start_s(number + 1, mean_s))
        since_s = time_s - self._start_s(number, mean_s)

        # a stretch: cruising, braking, a stop, starting, cruising
        stop_place = 0.3 + 0.4 * hashed(self.seed, 7, number)
        cruise_s = stop_place * stretch_m / speed_m_s - 0.5 * brake_s
        halt_s = motion.stop_s + self._early(number + 1) - self._early(number)
        braking = np.clip((since_s - cruise_s) / brake_s, 0.0, 1.0)
        starting = np.clip((since_s - cruise_s - brake_s - halt_s) / brake_s, 0.0, 1.0)
        after_s = np.maximum(since_s - cruise_s - 2.0 * brake_s - halt_s, 0.0)
        # v/2 (1 + cos pi x) while braking, v/2 (1 - cos pi x) while starting, and their integrals
        braking_way = braking + np.sin(np.pi * braking) / np.pi
        ways = braking_way + starting - np.sin(np.pi * starting) / np.pi
        at_speed_s = np.minimum(since_s, cruise_s) + 0.5 * brake_s * ways + after_s
        twice_share = 2.0 + np.cos(np.pi * braking) - np.cos(np.pi * starting)
        hardest_m_s2 = 0.5 * speed_m_s * np.pi / brake_s
        return Progress(
            distance=number * stretch_m + speed_m_s * at_speed_s,
            speed=0.5 * speed_m_s * np.maximum(twice_share, 0.0),
            acceleration=hardest_m_s2 * (np.sin(np.pi * starting) - np.sin(np.pi * braking)),
        )

    def _start_s(self, number: I64, mean_s: float) -> F64:
        """Return when stretches begin, (n,) float64 [s]."""
        first = self._early(np.zeros(1, np.int64))
        start: F64 = np.where(number == 0, 0.0, number * mean_s + self._early(number) - first)
        return start

    def _early(self, number: I64) -> F64:
        return self.motion.stop_s * hashed(self.seed, 6, number)


class _Wobble:
    """Smooth random function of time within a band: a sum of sines, variance 1."""

    def __init__(
        self,
        seed: int,
        channel: int,
        slowest_hz: float,
        fastest_hz: float,
    ) -> None:
        number = np.arange(_SINES, dtype=np.int64)
        place = (number + hashed(seed, 16 + 2 * channel, number)) / _SINES
        self.rate = 2.0 * np.pi * slowest_hz * (fastest_hz / slowest_hz) ** place
        self.phase = 2.0 * np.pi * hashed(seed, 17 + 2 * channel, number)

    def value(self, time_s: F64) -> F64:
        total = np.zeros_like(time_s)
        for rate, phase in zip(self.rate, self.phase, strict=True):
            total += np.sin(rate * time_s + phase)
        total *= np.sqrt(2.0 / _SINES)
        return total


def _turn(roll: F64, pitch: F64, yaw: F64) -> F64:
    """Return yaw after pitch after roll as matrices, (n, 3, 3) float64."""
    cos_r = np.cos(roll)
    sin_r = np.sin(roll)
    cos_p = np.cos(pitch)
    sin_p = np.sin(pitch)
    cos_y = np.cos(yaw)
    sin_y = np.sin(yaw)
    forward = [cos_y * cos_p, sin_y * cos_p, -sin_p]
    left = [
        cos_y * sin_p * sin_r - sin_y * cos_r,
        sin_y * sin_p * sin_r + cos_y * cos_r,
        cos_p * sin_r,
    ]
    up = [
        cos_y * sin_p * cos_r + sin_y * sin_r,
        sin_y * sin_p * cos_r - cos_y * sin_r,
        cos_p * cos_r,
    ]
    rows = [np.stack(row, axis=-1) for row in zip(forward, left, up, strict=True)]
    return np.stack(rows, axis=-2)


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """Rays of consecutive scan lines."""

    origin: F64
    """(lines, M, 3) float64, world [m]."""
    direction: F64
    """(lines, M, 3) float64, unit vectors."""
    time_s: F64
    """(lines, M) float64 [s]."""


def aim(
    platform: Platform,
    scanner: Scanner,
    first_line: int,
    n_lines: int,
) -> Shots:
    """Return the rays of consecutive lines, straight between poses every few ms."""
    m = scanner.points_per_line
    # rings that fire late for a line come from the firings after it
    late = scanner.late_lines
    n_firings = n_lines + int(late.max())
    line_s = scanner.shot_s * m
    n_knots = 1 if scanner.turns else max(int(np.ceil(line_s / _KNOT_S)), 1)
    start_s = scanner.line_time_s(first_line, n_firings)
    knot_s = start_s[:, None] + np.arange(n_knots + 1) * (line_s / n_knots)
    pose = platform.pose(knot_s.ravel())
    turn = pose.turn().reshape(n_firings, n_knots + 1, 3, 3)
    if scanner.turns:
        # a head that spins turns on while the rings fire
        firing = np.arange(first_line, first_line + n_firings)[:, None]
        line = firing + np.array([0.0, scanner.duty * scanner.spins])
        azimuth_deg = scanner.first_azimuth_deg + scanner.azimuth_step_deg * line
        azimuth = np.deg2rad(azimuth_deg).ravel()
        zero = np.zeros(len(azimuth))
        turn = turn @ _turn(zero, zero, azimuth).reshape(turn.shape)
    position = pose.position.reshape(n_firings, n_knots + 1, 3)
    origin, direction = aim_shots(position, np.ascontiguousarray(turn), scanner.directions())
    column = np.arange(m)
    time_s = start_s[:, None] + column * scanner.shot_s
    if not late.any():
        return Shots(origin, direction, time_s)
    row = np.arange(n_lines)[:, None] + late
    return Shots(origin[row, column], direction[row, column], time_s[row, column])


_BATCH = 50_000
"""Rows written at a time."""
_COLUMNS = ("time", "x", "y", "z", "roll_deg", "pitch_deg", "yaw_deg")


class Frame(Params):
    """A coordinate system in metres, x east, y north, and the place of the world in it."""

    crs: str = Field("EPSG:32635", description="as pyproj takes it")
    easting_m: float = Field(363_000.0, description="of the world's origin [m]")
    northing_m: float = Field(6_671_000.0, description="of the world's origin [m]")
    height_m: float = Field(40.0, description="of the world's origin above the ellipsoid [m]")

    def origin(self) -> F64:
        """Return what is added to world coordinates, (3,) float64 [m]."""
        return np.array([self.easting_m, self.northing_m, self.height_m])


WORLD = Frame(crs="", easting_m=0.0, northing_m=0.0, height_m=0.0)
"""Coordinates of the simulated world, without a place on earth: only for CSV."""


def write_trajectory(
    path: Path,
    platform: Platform,
    duration_s: float,
    *,
    hz: float = 200.0,
    start_s: float = 0.0,
    frame: Frame = WORLD,
    into: Path | None = None,
) -> None:
    """Write the trajectory from time 0: SBET (``.sbet``, ``.out``), else CSV with degrees.

    The last time is at the duration or just after it.
    """
    is_sbet = path.suffix.lower() in SBET_SUFFIXES
    earth = _earth(path, frame) if is_sbet else None
    target = atomic_output(path) if into is None else contextlib.nullcontext(into)
    n_times = int(np.ceil(duration_s * hz)) + 1
    with target as temporary, temporary.open("wb") as handle:
        if earth is None:
            handle.write((",".join(_COLUMNS) + "\n").encode())
        for first in range(0, n_times, _BATCH):
            time_s = np.arange(first, min(first + _BATCH, n_times)) / hz
            pose = platform.pose(time_s)
            xyz_m = pose.position + frame.origin()
            if earth is None:
                angles = np.degrees(np.stack([pose.roll, pose.pitch, pose.yaw], axis=1))
                rows = np.column_stack([time_s + start_s, xyz_m, angles])
                np.savetxt(handle, rows, "%.6f,%.4f,%.4f,%.4f,%.5f,%.5f,%.5f")
            else:
                half_later = platform.pose(time_s + 0.5 / hz)
                velocity = (half_later.position - pose.position) * (2.0 * hz)
                handle.write(_records(earth, time_s + start_s, xyz_m, pose, velocity).tobytes())


def check_frame(path: Path, frame: Frame) -> None:
    """Raise ConfigError for a coordinate system that is not in metres, if pyproj is installed."""
    if frame.crs and find_spec("pyproj") is not None:
        _earth(path, frame)


def _earth(path: Path, frame: Frame) -> pyproj.Proj:
    if not frame.crs:
        problem = (
            "an SBET trajectory is in latitude and longitude, "
            "and the simulated world lies nowhere on earth"
        )
        raise ConfigError(
            str(path), problem, "give a coordinate system, for example EPSG:32635, or write CSV"
        )
    try:
        import pyproj
        import pyproj.exceptions
    except ImportError:
        problem = "an SBET trajectory needs pyproj, which is not installed"
        raise ConfigError(str(path), problem, 'pip install ".[crs]"') from None
    try:
        crs = pyproj.CRS.from_user_input(frame.crs)
        is_metric = all(axis.unit_conversion_factor == 1.0 for axis in crs.axis_info)
        if not crs.is_projected or not is_metric:
            problem = f"coordinate system {frame.crs[:40]!r} is not a projected one in metres"
            raise ConfigError(str(path), problem, "give one, for example EPSG:32635")
        return pyproj.Proj(crs)
    except pyproj.exceptions.ProjError as error:
        why = str(error).splitlines()[0]
        problem = f"coordinate system {frame.crs[:40]!r} cannot be used ({why})"
        raise ConfigError(str(path), problem, "give another, for example EPSG:32635") from None


def _records(
    earth: pyproj.Proj,
    time_s: F64,
    xyz_m: F64,
    pose: Pose,
    velocity: F64,
) -> F64:
    """Return SBET records, (n, 17) little-endian float64."""
    longitude, latitude = earth(xyz_m[:, 0], xyz_m[:, 1], inverse=True)
    convergence = np.radians(earth.get_factors(longitude, latitude).meridian_convergence)
    records = np.zeros((len(time_s), 17), dtype="<f8")
    records[:, 0] = time_s
    records[:, 1] = np.radians(latitude)
    records[:, 2] = np.radians(longitude)
    records[:, 3] = xyz_m[:, 2]
    east = velocity[:, 0]
    north = velocity[:, 1]
    records[:, 4] = north * np.cos(convergence) - east * np.sin(convergence)
    records[:, 5] = east * np.cos(convergence) + north * np.sin(convergence)
    records[:, 6] = -velocity[:, 2]
    # there the body has x forward, y right, z down: pitch changes its sign, roll does not
    records[:, 7] = pose.roll
    records[:, 8] = -pose.pitch
    records[:, 9] = (np.pi / 2.0 - pose.yaw + convergence) % (2.0 * np.pi)
    return records
