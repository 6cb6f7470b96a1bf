"""Positions of the sensor over time, from CSV, TUM and SBET files and from the poses of a bag."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64, I64
from prc_cli.formats.bags import FORMATS as BAGS
from prc_cli.formats.clock import Unwrapped, unit_of_positions
from prc_cli.formats.options import FACTORS
from prc_cli.formats.trajectory import (
    is_tum,
    project,
    read_poses,
    read_sbet,
    read_text,
    read_tum,
    read_turns,
    turned,
)

_WEEK_S = 604_800.0
_HOUR_S = 3600.0
_ADJUSTED_S = 1e9
"""Adjusted standard GPS time is GPS time less this (LAS 1.4, global encoding bit 0)."""
_LEAP_S = 18.0
"""GPS time is ahead of UTC since 2017 [s]."""
_UNIX_S = 315_964_800.0 - _LEAP_S
"""UNIX time (ROS, TUM) less GPS time since 2017 [s]."""
_TO_GPS = "UNIX and GPS time"
_TO_ADJUSTED = "UNIX and adjusted GPS time"
_SINCE_1970 = (_TO_GPS, _TO_ADJUSTED)
_CLOCKS = (
    (0.0, ""),
    (-_ADJUSTED_S, f"{-_ADJUSTED_S:+.0e} s"),
    (_ADJUSTED_S, f"{_ADJUSTED_S:+.0e} s"),
    (-_UNIX_S, _TO_GPS),
    (-_UNIX_S - _ADJUSTED_S, _TO_ADJUSTED),
    (_UNIX_S, _TO_GPS),
    (_UNIX_S + _ADJUSTED_S, _TO_ADJUSTED),
)
"""What clocks differ by [s], whole weeks aside, and its name."""
_GAP_STEPS = 10
_GAP_S = 1.0
"""By default, steps longer than this multiple of the median step and this time [s] are gaps."""
_PLAIN_S = 1e15
"""Larger times are shown in exponent notation."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Positions of the sensor over time, interpolated linearly but not across gaps.

    They take 32 bytes each: 23 MB an hour at 200 Hz.
    """

    path: str
    """File name, for messages."""
    time_s: F64
    """(n,) float64, strictly increasing [s], offset included."""
    xyz_m: F64
    """(n, 3) float64, in the coordinate system of the points [m]."""
    max_gap_s: float | None = None
    """Longest step between positions that is interpolated [s].

    None means ten median steps, and at least 1 s.
    """
    lever_arm_m: tuple[float, float, float] | None = None
    """What the positions were moved by, on the axes of the vehicle [m]; None = not."""
    quaternion: F64 | None = None
    """(n, 4) float64, turn of the vehicle (forward, left, up) to the points.

    None = not known or not needed.
    """
    gap_limit_s: float = field(init=False)
    """The same, with its default resolved [s]."""
    _gaps: I64 = field(init=False, repr=False)
    """Indices of the positions before gaps."""

    def __post_init__(self) -> None:
        with np.errstate(over="ignore"):
            steps = np.diff(self.time_s)
        limit = self.max_gap_s
        if limit is None:
            # the lower of two medians: of 1 s and 1099 s, 1 s is the usual step
            middle = (len(steps) - 1) // 2
            limit = (
                max(_GAP_S, _GAP_STEPS * float(np.partition(steps, middle)[middle]))
                if len(steps)
                else _GAP_S
            )
        object.__setattr__(self, "gap_limit_s", limit)
        object.__setattr__(self, "_gaps", np.flatnonzero(steps > limit))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s], offset included."""
        return float(self.time_s[0]), float(self.time_s[-1])

    def positions(self, time_s: F64) -> F64:
        """Interpolate."""
        if len(time_s) == 0:
            return np.empty((0, 3))
        # comparisons with NaN are false, so NaN counts as outside
        inside = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        if not inside.all():
            raise self._outside(time_s, inside)
        if len(self._gaps):
            self._check_gaps(time_s)
        columns = [np.interp(time_s, self.time_s, self.xyz_m[:, axis]) for axis in range(3)]
        return np.stack(columns, axis=1)

    def places(self, time_s: F64, xyz_m: F64) -> F64:
        """Return where vectors of the vehicle (n, 3) end, (n, 3) [m]."""
        assert self.quaternion is not None
        columns = [np.interp(time_s, self.time_s, self.quaternion[:, axis]) for axis in range(4)]
        turn = np.stack(columns, axis=1)
        turn /= np.sqrt((turn * turn).sum(axis=1, keepdims=True))
        return self.positions(time_s) + turned(turn, xyz_m)

    def _check_gaps(self, time_s: F64) -> None:
        """Refuse times strictly inside a gap, where interpolation would invent positions."""
        starts = self.time_s[self._gaps]
        ends = self.time_s[self._gaps + 1]
        k = np.searchsorted(starts, time_s, side="left") - 1
        held = (k >= 0) & (time_s < ends[k])
        if not held.any():
            return
        i = int(np.argmax(held))
        start = float(starts[k[i]])
        end = float(ends[k[i]])
        gap_s = float(time_s[i])
        n_held = int(np.count_nonzero(held))
        problem = (
            f"no position from {_shown(start)} to {_shown(end)} s, a gap of "
            f"{_shown(end - start)} s that holds the "
            f"point time {_shown(gap_s)} s; expected gaps of at most "
            f"{_shown(self.gap_limit_s)} s ({n_held} of "
            f"{len(time_s)} point times are in such gaps)"
        )
        enough = _shown(math.ceil(end - start), 0) if end - start < _PLAIN_S else "more"
        hint = (
            "give the whole trajectory, or set trajectory_max_gap = "
            f"{enough} to take straight lines across"
        )
        raise InputError(self.path, problem, hint)

    def _outside(self, time_s: F64, inside: NDArray[np.bool_]) -> InputError:
        finite = time_s[np.isfinite(time_s)]
        n_outside = int(np.count_nonzero(~inside))
        if not len(finite):
            problem = (
                f"all {len(time_s)} point times are NaN or infinite, "
                "expected times within the trajectory"
            )
            return InputError(self.path, problem, "look at gps_time with prc info")
        first = float(finite.min())
        last = float(finite.max())
        problem = (
            f"{n_outside} of {len(time_s)} point times are outside the trajectory: "
            f"points from {_shown(first)} to {_shown(last)} s, "
            f"trajectory from {_shown(self.span[0])} to {_shown(self.span[1])} s"
        )
        if len(finite) < len(time_s):
            problem += f" ({len(time_s) - len(finite)} times are NaN or infinite)"
        return InputError(self.path, problem, self._offset_hint(first, last))

    def _offset_hint(self, first: float, last: float) -> str:
        start, end = self.span
        middle = (first + last - start - end) / 2
        unknown = (
            "give the trajectory of this drive, "
            "or set trajectory_time_offset to what its times lack"
        )
        if not abs(middle) < _PLAIN_S:
            return unknown
        slack = max((end - start - (last - first)) / 2, 0.0) + 1.0
        for offset in (_LEAP_S, -_LEAP_S):
            if start + offset <= first and last <= end + offset:
                what = f"{offset:+g} s, as UTC and GPS do"
                return (
                    f"the clocks seem to differ by {what}: "
                    f"try --set input.trajectory_time_offset={offset:.0f}"
                )
        hours = round(middle / _HOUR_S)
        is_inside = start + hours * _HOUR_S <= first and last <= end + hours * _HOUR_S
        if hours and abs(hours) < _WEEK_S / _HOUR_S and is_inside:
            offset = hours * _HOUR_S
            return (
                f"the clocks seem to differ by {hours:+d} h: "
                f"try --set input.trajectory_time_offset={offset:.0f}"
            )
        for base, name in _CLOCKS:
            weeks = 0 if name in _SINCE_1970 else round((middle - base) / _WEEK_S)
            offset = base + weeks * _WEEK_S
            if offset and abs(middle - offset) <= slack:
                known = ((f"{weeks:+d} GPS weeks", weeks), (name, base))
                what = " and ".join(text for text, there in known if there)
                return (
                    f"the clocks seem to differ by {what}: "
                    f"try --set input.trajectory_time_offset={offset:.0f}"
                )
        return unknown


def _shown(time_s: float, digits: int = 2) -> str:
    return f"{time_s:.{digits}f}" if abs(time_s) <= _PLAIN_S else f"{time_s:g}"


SBET_SUFFIXES = (".sbet", ".out")


def load_trajectory(
    path: Path,
    *,
    crs: str | None,
    source_crs_wkt: str | None,
    time_offset: float,
    max_gap: float | None = None,
    topic: str | None = None,
    lever_arm_m: tuple[float, float, float] | None = None,
    with_turns: bool = False,
    unit_m: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Trajectory:
    """Read a trajectory by its suffix: SBET, bag, else text; with turns its orientation, too.

    ``unit_m`` are the metres in one unit of its positions, by axis; an SBET has metres.
    """
    quaternion: F64 | None = None
    try:
        size = path.stat().st_size
        if size == 0:
            raise InputError(
                str(path),
                "empty file, expected a trajectory",
                "give a CSV or SBET file with positions",
            )
        if path.suffix.lower() in SBET_SUFFIXES:
            time_s, position = read_sbet(path, size)
            xyz_m = project(path, position, crs or source_crs_wkt)
        elif path.suffix.lower() in BAGS[0].scans:
            time_s, xyz_m, quaternion = read_poses(path, topic)
        elif is_tum(path):
            time_s, xyz_m, quaternion = read_tum(path)
        else:
            time_s, xyz_m = read_text(path)
        if with_turns:
            quaternion = (
                read_turns(path, crs or source_crs_wkt) if quaternion is None else quaternion
            )
            # q and -q are one turn: neighbours must be near each other to interpolate
            turns = np.sign((quaternion[1:] * quaternion[:-1]).sum(axis=1)).cumprod()
            quaternion = quaternion * np.append(1.0, turns)[: len(quaternion), None]
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(
            str(path), problem, "check the trajectory's name and permissions"
        ) from None
    if path.suffix.lower() not in SBET_SUFFIXES:
        xyz_m = xyz_m * np.array(unit_m)
    if lever_arm_m is not None:
        if quaternion is None:
            problem = (
                "a lever arm needs the orientation of the vehicle, "
                "which this trajectory does not give"
            )
            hint = (
                "give the positions of the scanner, or poses: TUM (time x y z qx qy qz qw) or a bag"
            )
            raise ConfigError("input.trajectory_lever_arm", problem, hint)
        xyz_m = xyz_m + turned(quaternion, np.array(lever_arm_m))
    with np.errstate(over="ignore"):
        time_s = Unwrapped().put(time_s * FACTORS[unit_of_positions(time_s)]) + time_offset
    _check(path, time_s)
    return Trajectory(
        str(path), time_s, xyz_m, max_gap, lever_arm_m, quaternion if with_turns else None
    )


def _check(path: Path, time_s: F64) -> None:
    """Refuse times that do not increase; after finite offsets they may be equal or overflow."""
    if len(time_s) < 2:
        problem = f"{len(time_s)} positions, expected at least 2 to interpolate between"
        raise InputError(str(path), problem, "give the whole trajectory")
    # compare, do not subtract: also finds infinite times
    stuck = np.flatnonzero(~(time_s[1:] > time_s[:-1]))
    if len(stuck):
        i = int(stuck[0]) + 1
        problem = (
            f"position {i + 1} (counted from 1) has time {_shown(time_s[i], 6)} s after "
            f"{_shown(time_s[i - 1], 6)} s, "
            f"expected times that increase ({len(stuck)} such steps)"
        )
        raise InputError(str(path), problem, "sort the trajectory by time and drop repeated rows")
