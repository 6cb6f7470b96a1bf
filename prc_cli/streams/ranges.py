"""Computes the slant range of every record, from a dimension or as distance to the sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import Assumption, ReadTally
from prc_cli.core.types import F32, F64
from prc_cli.formats.options import InputConfig, parse_origin
from prc_cli.formats.ranges import clean_ranges, scale_told
from prc_cli.formats.systems import units_of_system
from prc_cli.streams.trajectory import Trajectory, load_trajectory

XYZ = ("x", "y", "z")
MAX_LENGTH_OFF = 0.01
"""Tolerance for the length of coordinates relative to the scanner, as a share of the range."""
MAX_LENGTH_OFF_M = 0.05
"""The same in metres; the larger one applies."""


@dataclass(frozen=True, slots=True)
class RangeRule:
    """Source of ranges; exactly one of the first three is set."""

    dimension: str | None = None
    """Dimension with the range [m]."""
    origin_m: tuple[float, float, float] | None = None
    """Fixed position of the sensor in the coordinates of the input [m]; zeros = sensor frame."""
    trajectory: Trajectory | None = None
    """Position of the sensor over time."""
    sensor_xyz: bool = False
    """Whether x, y, z beside a dimension of ranges are relative to the sensor."""
    scale: float = 1.0
    """Metres in one of the stored ranges; of ranges from x, y, z, in one unit of these."""
    min_range_m: float = 0.0
    """Ranges at or below are missing [m]."""
    max_range_m: float | None = None
    """Ranges beyond are missing [m]; None = no bound."""

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """Assumptions behind the ranges."""
        if self.trajectory is None:
            return scale_told(self.scale)
        first, last = self.trajectory.span
        value = (
            f"trajectory of {len(self.trajectory.time_s)} positions "
            f"from {first:.3f} to {last:.3f} s"
        )
        why = (
            "straight lines between the positions of a trajectory; "
            "they are those of the scanner, no lever arm"
        )
        if self.trajectory.lever_arm_m is not None:
            shown = ", ".join(f"{arm_m:g}" for arm_m in self.trajectory.lever_arm_m)
            why = (
                "straight lines between the positions of a trajectory, "
                f"moved by the lever arm {shown} m"
            )
        return (Assumption("input.range", value, why), *scale_told(self.scale))

    @property
    def names(self) -> tuple[str, ...]:
        """Dimensions that :func:`measure_ranges` needs."""
        if self.dimension is not None:
            return (self.dimension, *(XYZ if self.sensor_xyz else ()))
        return (*XYZ, "time") if self.trajectory is not None else XYZ


def open_ranges(
    rule: str,
    dimensions: tuple[str, ...],
    path: str,
    config: InputConfig,
    *,
    crs_wkt: str | None,
    sensor_xyz: bool = False,
) -> RangeRule:
    """Parse a resolved ``input.range``; reads the trajectory if there is one."""
    kind, _, argument = rule.partition(":")
    bounds = RangeRule(min_range_m=config.min_range, max_range_m=config.max_range)
    if kind == "dimension":
        return replace(bounds, dimension=argument, sensor_xyz=sensor_xyz, scale=config.range_scale)
    needed = (*XYZ, "time") if kind == "trajectory" else XYZ
    lacking = [name for name in needed if name not in dimensions]
    if lacking:
        problem = f"range = {rule} needs {', '.join(needed)}; the file has no {', '.join(lacking)}"
        raise InputError(path, problem, f"it has: {', '.join(dimensions)}")
    xy_m, z_m = metres_of(config, crs_wkt)
    # where a scale is given it is that of x, y, z; else these are metres already
    bounds = replace(bounds, scale=config.range_scale)
    if kind == "sensor-xyz":
        return replace(bounds, origin_m=(0.0, 0.0, 0.0))
    if kind == "origin":
        x, y, z = parse_origin(rule)
        return replace(bounds, origin_m=(x * xy_m, y * xy_m, z * z_m))
    try:
        file = Path(argument).expanduser()
    except RuntimeError:
        raise ConfigError(
            "input.range", f"found {rule!r}, whose home folder is not known", "write it out"
        ) from None
    trajectory = load_trajectory(
        file,
        crs=config.trajectory_crs,
        source_crs_wkt=crs_wkt,
        time_offset=config.trajectory_time_offset,
        max_gap=config.trajectory_max_gap,
        topic=config.trajectory_topic,
        lever_arm_m=config.trajectory_lever_arm,
        unit_m=(xy_m, xy_m, z_m),
    )
    return replace(bounds, trajectory=trajectory)


def metres_of(config: InputConfig, crs_wkt: str | None) -> tuple[float, float]:
    """Return the metres in one unit of x and y, and of z.

    They are configured, or those of the coordinate system.
    """
    if config.range_scale != 1.0:
        return config.range_scale, config.range_scale
    units = units_of_system(crs_wkt)
    return (1.0, 1.0) if units is None or units.is_geographic else (units.xy_m, units.z_m)


def measure_ranges(
    values: dict[str, NDArray[Any]], rule: RangeRule
) -> tuple[NDArray[Any], F32 | None]:
    """Return ranges, not yet cleaned, and sensor-centred coordinates."""
    if rule.dimension is not None and not rule.sensor_xyz:
        return values[rule.dimension], None
    xyz: F64 = np.stack([np.asarray(values[name], np.float64) for name in XYZ], axis=1)
    if rule.dimension is not None:
        with np.errstate(over="ignore"):
            return values[rule.dimension], xyz.astype(np.float32)
    if rule.scale != 1.0:
        xyz *= rule.scale
    # coordinates of 1e6 m need float64 for millimetres: subtract before rounding
    if rule.trajectory is not None:
        xyz -= rule.trajectory.positions(np.asarray(values["time"], np.float64))
    elif rule.origin_m is not None:
        xyz -= rule.origin_m
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt((xyz * xyz).sum(axis=1)), xyz.astype(np.float32)


def clean_measured(
    values: dict[str, NDArray[Any]], rule: RangeRule
) -> tuple[F32, F32 | None, ReadTally]:
    """Return cleaned ranges, coordinates, and counts of ranges made missing."""
    lengths, xyz_m = measure_ranges(values, rule)
    if rule.dimension is not None and rule.scale != 1.0:
        lengths = lengths * np.float64(rule.scale)
    range_m, tally = clean_ranges(lengths, rule.min_range_m, rule.max_range_m)
    return range_m, xyz_m, tally


IN_PLANE = 0.05
"""Directions of a profiler are off a plane or flat cone by less than this share of its spread."""


def is_in_plane(values: dict[str, NDArray[Any]]) -> bool:
    """Whether directions from the scanner lie on a plane or a cone, as those of a profiler do.

    >>> angle = np.linspace(-2.0, 2.0, 50)
    >>> is_in_plane({"x": 0 * angle + 0.3, "y": np.sin(angle), "z": -np.cos(angle)})
    True
    >>> is_in_plane({"x": np.cos(angle), "y": np.sin(angle), "z": 0.3 * np.sin(9 * angle)})
    False
    """
    xyz = np.stack([np.asarray(values[axis], np.float64) for axis in XYZ], axis=1)
    length = np.sqrt((xyz * xyz).sum(axis=1))
    use = np.isfinite(length) & (length > 0)
    if np.count_nonzero(use) < len(XYZ):
        return True
    unit = xyz[use] / length[use, None]
    unit -= unit.mean(axis=0)
    spread = np.linalg.eigvalsh(unit.T @ unit)
    return bool(spread[0] < IN_PLANE**2 * spread[2])


def is_sensor_xyz(values: dict[str, NDArray[Any]], dimension: str) -> bool:
    """Whether coordinates beside ranges are relative to the sensor: then their length is the range.

    >>> point = {name: np.array([value]) for name, value in zip("xyz", (3.0, 0.0, 4.0))}
    >>> point["range"] = np.array([5.0])
    >>> is_sensor_xyz(point, "range"), is_sensor_xyz(point | {"z": np.array([90.0])}, "range")
    (True, False)
    """
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z, range_m = (np.asarray(values[name], np.float64) for name in (*XYZ, dimension))
        length = np.sqrt(x * x + y * y + z * z)
        # all heights 0: a scan plane laid flat, as written without directions
        use = np.isfinite(length) & np.isfinite(range_m) & (range_m > 0)
    if not use.any() or not z[use].any():
        return False
    off = np.abs(length[use] - range_m[use]) - np.maximum(
        MAX_LENGTH_OFF * range_m[use], MAX_LENGTH_OFF_M
    )
    return float(np.percentile(off, 95)) <= 0
