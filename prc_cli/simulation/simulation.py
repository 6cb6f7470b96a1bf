"""A whole simulation out of its parameters: the scene is built, the scanner mounted and set on its way."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from prc_cli.core.errors import ConfigError
from prc_cli.core.threads import default_threads
from prc_cli.core.types import F64, U8
from prc_cli.simulation.drive import SimulatedScan, ground_below, lines_of, room_around
from prc_cli.simulation.forest.reference import reference_labels
from prc_cli.simulation.forest.scene import ForestScene
from prc_cli.simulation.settings import Kind, Settings, StationSettings, WalkSettings, load_settings
from prc_cli.simulation.street.scene import StreetScene
from prc_cli.simulation.trajectory import Station, Trajectory

SIGHT_M: dict[Kind, float] = {"street": 120.0, "forest": 60.0, "street-scan": 160.0}
"""Nothing farther is simulated unless it is asked for [m]."""
LOOK_AHEAD_M, LOOK_STEP_M = 60.0, 1.0
"""How far, and how closely, a place for a tripod is looked for [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A scan that can be simulated, and what is known of its world."""

    kind: Kind
    settings: Settings
    scene: StreetScene | ForestScene
    scan: SimulatedScan

    @property
    def end_s(self) -> float:
        """When the last shot is made [s]."""
        scanner = self.scan.scanner
        return float(scanner.line_time_s(self.scan.n_lines - 1, 1)[0]) + scanner.shot_s * (scanner.points_per_line - 1)


def open_simulation(
    kind: Kind,
    settings: Settings | None = None,
    *,
    reference: Literal["truth", "cylinders"] = "truth",
    threads: int | None = None,
    with_xyz: bool | None = None,
    with_world: bool = False,
) -> Simulation:
    """Prepare a simulation; nothing is simulated before its blocks are asked for.

    >>> found = open_simulation("street", load_settings("street", options={"lines": 2}))
    >>> [block.range_m.shape for block in found.scan.blocks()]
    [(2, 2154)]
    """
    chosen = load_settings(kind) if settings is None else settings
    scanner, seed = chosen.scanner, chosen.seed
    sight_m = min(chosen.sight_m if chosen.sight_m is not None else SIGHT_M[kind], scanner.max_range_m)
    if reference == "cylinders" and kind != "forest":
        raise ConfigError("reference", f"found 'cylinders', expected 'truth': a {kind} has no stems")
    scene: StreetScene | ForestScene
    platform: Station | Trajectory
    relabel: Callable[[F64], U8] | None = None
    if isinstance(chosen, WalkSettings):
        forest = scene = ForestScene(chosen.scene, seed)
        platform = Trajectory(forest.path_point, chosen.trajectory, scanner.height_m, seed)
        if reference == "cylinders":
            relabel = partial(reference_labels, forest)
    else:
        street = scene = StreetScene(chosen.scene, seed)
        if isinstance(chosen, StationSettings):
            platform = _stand(street, chosen)
        else:
            platform = Trajectory(street.path_point, chosen.trajectory, scanner.height_m, seed)
    scan = SimulatedScan(
        f"simulated {kind}",
        scene.bodies_near,
        scanner,
        platform,
        seed,
        _count_lines(chosen, platform),
        sight_m,
        threads=default_threads() if threads is None else threads,
        with_xyz=(kind == "street-scan") if with_xyz is None else with_xyz,
        with_world=with_world,
        relabel=relabel,
    )
    return Simulation(kind, chosen, scene, scan)


def _count_lines(settings: Settings, platform: Station | Trajectory) -> int:
    if isinstance(settings, StationSettings):
        step_deg = settings.scanner.azimuth_step_deg
        most = max(1, round(360.0 / step_deg))
        if settings.lines is not None and settings.lines > most:
            problem = f"found {settings.lines}, expected at most {most}: the head turns once, in steps of {step_deg:g}°"
            raise ConfigError("lines", problem, "set a smaller scanner.azimuth_step_deg")
        return max(1, round(settings.station.turn_deg / step_deg)) if settings.lines is None else settings.lines
    if settings.lines is not None:
        return settings.lines
    if settings.duration_s is not None:
        return max(1, math.floor(settings.duration_s * settings.scanner.line_hz))
    assert isinstance(platform, Trajectory)
    return lines_of(platform, settings.scanner, settings.length_m)


def _stand(street: StreetScene, settings: StationSettings) -> Station:
    """Put the tripod where there is room; the azimuth of its lines counts from the direction of the street."""
    place = settings.station
    points, headings = street.path_point(place.along_m + np.arange(0.0, LOOK_AHEAD_M, LOOK_STEP_M))
    best: tuple[float, Station] | None = None
    for point, heading in zip(points, headings, strict=True):
        x = float(point[0] - place.left_m * np.sin(heading))
        y = float(point[1] + place.left_m * np.cos(heading))
        z = ground_below(street.bodies_near, x, y, float(point[2]))
        room_m = room_around(street.bodies_near, x, y, z) if place.clearance_m else 0.0
        if best is None or room_m > best[0]:
            best = room_m, Station(x, y, z + settings.scanner.height_m, float(heading))
        if room_m >= place.clearance_m:
            break
    assert best is not None
    return best[1]
