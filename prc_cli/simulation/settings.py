"""Parameters of whole simulations, from options and TOML files: scene, scanner, platform."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from pydantic import Field

from prc_cli.core.classes import ClassCodes
from prc_cli.core.config import Params, build, merge, read_toml
from prc_cli.core.errors import ConfigError
from prc_cli.core.threads import default_threads
from prc_cli.core.types import F64, U8
from prc_cli.simulation.drive import MOST_LINES, SimulatedScan, ground_below, lines_of, room_around
from prc_cli.simulation.forest.params import PRESETS as FORESTS
from prc_cli.simulation.forest.params import ForestSceneParams
from prc_cli.simulation.forest.reference import reference_labels
from prc_cli.simulation.forest.scene import ForestScene
from prc_cli.simulation.scanners import SCANNERS, Scanner
from prc_cli.simulation.street.plan import CHARACTERS, VARIED, StreetSceneParams
from prc_cli.simulation.street.scene import StreetScene
from prc_cli.simulation.trajectory import MOTIONS, Frame, MotionParams, Station, Trajectory

Kind: TypeAlias = Literal["street", "forest", "street-scan"]

SCENES: dict[Kind, dict[str, dict[str, Any]]] = {
    "street": {"mixed": {}, **{name: {"character": name} for name in CHARACTERS}},
    "forest": {name: params.model_dump() for name, params in FORESTS.items()},
}
SCENES["street"]["varied"] = dict(VARIED)
SCENES["street-scan"] = SCENES["street"]
"""Parameters of scenes by name."""

_DEFAULTS: dict[Kind, dict[str, str]] = {
    "street": {"scene": "mixed", "scanner": "photon-80", "trajectory": "car"},
    "forest": {"scene": "mixed", "scanner": "focus3d-120", "trajectory": "backpack"},
    "street-scan": {"scene": "mixed", "scanner": "scanstation2"},
}


class SimulationSettings(Params):
    """Settings of every simulation."""

    seed: int = Field(
        1, ge=0, lt=2**63, description="the same seed gives the same scene, way and noise"
    )
    sight_m: float | None = Field(
        None, gt=1, le=2000, description="nothing farther is simulated [m]; unset = by kind"
    )


_FRAME = (
    "where the world lies on earth; unset = nowhere, coordinates count from the start, "
    "but for an SBET"
)


class MovingSettings(SimulationSettings):
    """Settings of every drive and walk."""

    length_m: float = Field(300.0, gt=0, le=1e7, description="way of the platform [m]")
    duration_s: float | None = Field(None, gt=0, le=1e7, description="instead of a length [s]")
    lines: int | None = Field(
        None, ge=1, le=MOST_LINES, description="scan lines, instead of a length"
    )
    scene: StreetSceneParams | ForestSceneParams
    scanner: Scanner = Field(SCANNERS["photon-80"], description="scanner and its mount")
    trajectory: MotionParams = Field(MOTIONS["car"], description="how the platform moves")
    frame: Frame | None = Field(None, description=_FRAME)
    flake_m: float = Field(
        0.0,
        ge=0,
        le=1e6,
        description="mean way of a beam from flake to flake of snow, or drop of rain [m]; 0 = none",
    )
    classes: ClassCodes = Field(
        default_factory=ClassCodes, description="class codes of the reference"
    )


class DriveSettings(MovingSettings):
    """A drive down a street."""

    scene: StreetSceneParams = Field(default_factory=StreetSceneParams, description="street")


class WalkSettings(MovingSettings):
    """A walk through a forest."""

    length_m: float = Field(100.0, gt=0, le=1e7, description="way of the platform [m]")
    scene: ForestSceneParams = Field(default_factory=ForestSceneParams, description="forest")
    scanner: Scanner = Field(SCANNERS["focus3d-120"], description="scanner and its mount")
    trajectory: MotionParams = Field(MOTIONS["backpack"], description="how the platform moves")


class StationParams(Params):
    """Where the tripod of a static scan stands, and how far its head turns."""

    along_m: float = Field(
        60.0, ge=0, le=1e6, description="from here on along the middle of the right-hand lane [m]"
    )
    left_m: float = Field(0.0, ge=-30, le=30, description="to the left of it [m]")
    clearance_m: float = Field(
        2.5,
        ge=0,
        le=20,
        description="at the first place with so much room around; 0 = just where it is said [m]",
    )
    turn_deg: float = Field(360.0, gt=0, le=360, description="angle that the head turns [degrees]")


class StationSettings(SimulationSettings):
    """A static scan of a street."""

    lines: int | None = Field(
        None, ge=1, le=MOST_LINES, description="scan lines, instead of station.turn_deg"
    )
    scene: StreetSceneParams = Field(default_factory=StreetSceneParams, description="street")
    scanner: Scanner = Field(SCANNERS["scanstation2"], description="scanner")
    station: StationParams = Field(default_factory=StationParams, description="place")
    classes: ClassCodes = Field(
        default_factory=ClassCodes, description="class codes of the reference"
    )


Settings: TypeAlias = DriveSettings | WalkSettings | StationSettings
_MODELS: dict[Kind, type[Settings]] = {
    "street": DriveSettings,
    "forest": WalkSettings,
    "street-scan": StationSettings,
}
KINDS: tuple[Kind, ...] = tuple(_MODELS)
"""Kinds of simulations."""


def load_settings(
    kind: Kind, path: Path | str | None = None, options: Mapping[str, Any] | None = None
) -> Settings:
    """Build the parameters of a simulation."""
    if kind not in _MODELS:
        raise ConfigError("kind", f"found {kind!r}, expected one of: {', '.join(KINDS)}")
    where = "simulation" if path is None else str(path)
    written = {} if path is None else read_toml(Path(path))
    _refuse_two_presets(written, options or {}, where)
    table = merge(written, options or {})
    for name, presets in _presets(kind).items():
        entry = table.get(name, {})
        if not isinstance(entry, Mapping):
            raise ConfigError(where, f"{name}: found {entry!r}, expected: a table")
        chosen = entry.get("name", _DEFAULTS[kind][name])
        if chosen not in presets:
            problem = f"{name}.name: found {chosen!r}, expected one of: {', '.join(presets)}"
            raise ConfigError(where, problem)
        changes = {key: value for key, value in entry.items() if key != "name"}
        table[name] = merge(presets[chosen], changes)
        if name == "trajectory" and "stop_every_m" not in changes:
            table[name] = _with_room_to_stop(table[name])
    try:
        settings = build(_MODELS[kind], table, where)
    except ConfigError as error:
        # `prc config` does not know these keys
        is_other = "prc config" in error.hint
        hint = f"see `prc simulate parameters {kind}`" if is_other else error.hint
        raise ConfigError(error.where, error.problem, hint) from None
    if settings.scanner.is_static != (kind == "street-scan"):
        fault = "is static" if settings.scanner.is_static else "is none for a tripod"
        needs_static = kind == "street-scan"
        fitting = [name for name, item in SCANNERS.items() if item.is_static == needs_static]
        problem = f"scanner: the scanner {fault}, expected one for a {kind}"
        raise ConfigError(where, problem, f"choose from: {', '.join(fitting)}")
    return settings


def preset_notes(
    kind: Kind,
    settings: Settings,
    path: Path | str | None = None,
    options: Mapping[str, Any] | None = None,
) -> dict[str, str]:
    """Return the preset of every table of a simulation's parameters, and the changed keys.

    >>> options = {"scanner": {"slant_deg": 30.0}}
    >>> preset_notes("street", load_settings("street", options=options), options=options)["scanner"]
    'preset photon-80; changed: slant_deg'
    """
    asked = merge({} if path is None else read_toml(Path(path)), options or {})
    notes = {}
    for name, presets in _presets(kind).items():
        values = getattr(settings, name).model_dump()
        preset_values = {
            key: type(getattr(settings, name))(**preset).model_dump()
            for key, preset in presets.items()
        }
        entry = asked.get(name, {})
        equal = [key for key, preset in preset_values.items() if preset == values]
        if "name" not in entry and set(entry) >= set(values):
            if equal:
                notes[name] = f"preset {equal[0]}"
            continue
        chosen = entry.get("name", _DEFAULTS[kind][name])
        changed = ", ".join(
            key for key, value in values.items() if value != preset_values[chosen][key]
        )
        notes[name] = f"preset {chosen}" + (f"; changed: {changed}" if changed else "")
    return notes


def _refuse_two_presets(written: Mapping[str, Any], options: Mapping[str, Any], where: str) -> None:
    # the keys of the file would win over the preset, maybe all of them
    for name in ("scene", "scanner", "trajectory"):
        asked = options.get(name)
        in_file = written.get(name)
        if not (isinstance(asked, Mapping) and isinstance(in_file, Mapping)):
            continue
        keys = sorted(set(in_file) - {"name"})
        if "name" in asked and keys and asked["name"] != in_file.get("name"):
            problem = (
                f"{name}: found the preset {asked['name']!r} asked for beside {keys[0]} "
                f"in [{name}], expected one"
            )
            raise ConfigError(
                where, problem, f"leave [{name}] out of the file, or do not ask for a preset"
            )


def _presets(kind: Kind) -> dict[str, dict[str, dict[str, Any]]]:
    presets: dict[str, dict[str, dict[str, Any]]] = {
        "scene": SCENES[kind],
        "scanner": {name: scanner.model_dump() for name, scanner in SCANNERS.items()},
    }
    if kind != "street-scan":
        presets["trajectory"] = {name: motion.model_dump() for name, motion in MOTIONS.items()}
    return presets


def _with_room_to_stop(motion: dict[str, Any]) -> dict[str, Any]:
    # stops that the user does not set move apart if the speed leaves no room to brake between them
    if not motion["stop_every_m"]:
        return motion
    with contextlib.suppress(ValueError, TypeError, ZeroDivisionError):
        free = MotionParams(**{**motion, "stop_every_m": 0.0})
        return {
            **motion,
            "stop_every_m": max(motion["stop_every_m"], math.ceil(free.braking_m / 0.3)),
        }
    return motion  # its validation reports the fault


SIGHT_M: dict[Kind, float] = {"street": 120.0, "forest": 60.0, "street-scan": 160.0}
"""Default limit of the sight [m]."""
LOOK_AHEAD_M = 60.0
LOOK_STEP_M = 1.0
"""Length and step of the search for a place of the tripod [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A scan that can be simulated, with its settings and its scene."""

    kind: Kind
    settings: Settings
    scene: StreetScene | ForestScene
    scan: SimulatedScan

    @property
    def end_s(self) -> float:
        """Time of the last shot [s]."""
        scanner = self.scan.scanner
        last = self.scan.n_lines - 1 + int(scanner.late_lines.max())
        return float(scanner.line_time_s(last, 1)[0]) + scanner.shot_s * (
            scanner.points_per_line - 1
        )


def open_simulation(
    kind: Kind,
    settings: Settings | None = None,
    *,
    reference: Literal["truth", "cylinders"] = "truth",
    threads: int | None = None,
    with_xyz: bool | None = None,
    with_world: bool = False,
) -> Simulation:
    """Prepare a simulation; nothing is simulated before its blocks are asked for."""
    chosen = load_settings(kind) if settings is None else settings
    scanner = chosen.scanner
    seed = chosen.seed
    sight_m = min(
        chosen.sight_m if chosen.sight_m is not None else SIGHT_M[kind], scanner.max_range_m
    )
    if reference == "cylinders" and kind != "forest":
        raise ConfigError(
            "reference", f"found 'cylinders', expected 'truth': a {kind} has no stems"
        )
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
        flake_m=getattr(chosen, "flake_m", 0.0),
        relabel=relabel,
    )
    return Simulation(kind, chosen, scene, scan)


def _count_lines(settings: Settings, platform: Station | Trajectory) -> int:
    if isinstance(settings, StationSettings):
        step_deg = settings.scanner.azimuth_step_deg
        most = max(1, round(360.0 / step_deg))
        if settings.lines is not None and settings.lines > most:
            problem = (
                f"found {settings.lines}, expected at most {most}: "
                f"the head turns once, in steps of {step_deg:g}°"
            )
            raise ConfigError("lines", problem, "set a smaller scanner.azimuth_step_deg")
        return (
            max(1, round(settings.station.turn_deg / step_deg))
            if settings.lines is None
            else settings.lines
        )
    if settings.lines is not None:
        return settings.lines
    if settings.duration_s is not None:
        return max(1, math.floor(settings.duration_s * settings.scanner.line_hz))
    assert isinstance(platform, Trajectory)
    return lines_of(platform, settings.scanner, settings.length_m)


def _stand(street: StreetScene, settings: StationSettings) -> Station:
    # the azimuth of its lines counts from the direction of the street
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
