"""Scans of the contest: simulated by seed, or real ones from ../shared/data or $PRC_DATA, in one
form.

Every scan has the measurements of a scanner (ranges, angles, times, intensities, further returns),
the reference class of every shot, and registered coordinates. Methods of the stream do not get the
coordinates.

Seeds 9001-9199 are for tuning, 7201-7399 for reporting: nothing is tuned on them. Seeds 7001-7199
were looked at after every change and are spent."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.pages import DATA, ROOT
from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.stream import ExtraReturns, ScanBlock
from prc_cli.core.types import F32, F64, I64, U8
from prc_cli.jobs.classify import open_stream
from prc_cli.simulation.drive import SimulatedBlock, SimulatedScan
from prc_cli.simulation.settings import Kind, load_settings, open_simulation
from prc_cli.simulation.trajectory import aim

LINES_AT_ONCE = 256
"""Lines per block for the classifiers."""
STRAY_SHARE = 0.25
STRAY_M = 0.3
FARTHEST_M = 100.0
"""Background light of pulsed scanners, missing in the simulator.

This share lies around its surface with this standard
deviation [m], the rest anywhere up to a distance [m]."""


@dataclass(frozen=True, slots=True)
class Scan:
    """A whole scan in memory."""

    name: str
    range_m: F32
    """(lines, M) float32 [m]; NaN = missing."""
    angle_rad: F64
    """(M,) float64, from straight down within the scan plane [rad]."""
    codes: I64
    """(lines, M) int64, reference codes of ``mapping``; 0 = not judged."""
    mapping: str
    """Mapping of the codes: a key of ``contest_judge.MAPPINGS``."""
    time_s: F64 | None = None
    """(lines, M) float64 [s]."""
    intensity: F32 | None = None
    """(lines, M) float32."""
    cos_tilt: float = 1.0
    """Cosine of the tilt of the scan plane."""
    world_m: F64 | None = None
    """(lines, M, 3) float64, registered, or relative to the scanner of a single frame [m]."""
    scanner_m: F64 | None = None
    """(lines, 3) float64, position of the scanner [m]."""
    extra: ExtraReturns = field(default_factory=ExtraReturns.none)
    """Further returns; lines count from 0."""
    extra_codes: I64 = field(default_factory=lambda: np.empty(0, np.int64))
    extra_world_m: F64 = field(default_factory=lambda: np.empty((0, 3)))
    is_upright: bool = False
    """Whether lines are vertical lines of a turning scanner, not of a profiler."""
    height_m: float = 2.0
    """Height of the scanner above the ground [m], for filters that need it."""
    range_noise_m: float = 0.005
    """Ranging noise for the sequential-angle classifier [m]; its preset has 5 mm."""
    source: Path | None = None
    """Its own file, where it is classified from that."""
    config: Path | None = None
    """Configuration that reads this file."""
    record: I64 | None = None
    """(lines, M) int64, record of every shot in this file, -1 = none."""

    @property
    def n_shots(self) -> int:
        return self.range_m.size

    @property
    def n_returns(self) -> int:
        return int(np.count_nonzero(~np.isnan(self.range_m))) + len(self.extra)

    def blocks(self, lines: int = LINES_AT_ONCE) -> Iterator[ScanBlock]:
        """Return the scan as a stream, as from a reader."""
        m = self.range_m.shape[1]
        for first in range(0, len(self.range_m), lines):
            part = slice(first, first + lines)
            inside = (self.extra.line >= first) & (self.extra.line < first + lines)
            extra = ExtraReturns(
                self.extra.line[inside] - np.int32(first),
                self.extra.column[inside],
                self.extra.range_m[inside],
                self.extra.line[inside].astype(np.int64) * m + self.extra.column[inside],
            )
            yield ScanBlock(
                first,
                self.range_m[part],
                time_s=None if self.time_s is None else self.time_s[part],
                intensity=None if self.intensity is None else self.intensity[part],
                xyz_m=None
                if not self.is_upright or self.world_m is None
                else self.world_m[part].astype(np.float32),
                angle_rad=self.angle_rad,
                beam_rad=(self.angle_rad + np.pi) % (2 * np.pi) - np.pi,
                extra=extra,
                is_last=first + lines >= len(self.range_m),
            )


@dataclass(frozen=True, slots=True)
class Simulated:
    """Parameters of a simulated scan."""

    name: str
    seed: int
    length_m: float
    """Of a static scan: scan lines."""
    scene: str = "mixed"
    scanner: str = "photon-80"
    mount: dict[str, Any] = field(default_factory=dict)
    """Further keys of ``[scanner]``."""
    noise: float | None = None
    """Target share of noise; None = that of the preset."""
    kind: Kind = "street"
    setback_m: float = 0.0
    cylinders: bool = False
    """Forests: the reference of the paper, cylinders around stems, instead of the surfaces hit."""

    def options(self) -> dict[str, Any]:
        """Return the configuration of ``prc simulate``."""
        scene: dict[str, Any] = {"name": self.scene}
        if self.setback_m:
            scene["setback_m"] = self.setback_m
        scanner = {"name": self.scanner, **background(self.scanner, self.noise), **self.mount}
        options = {"seed": self.seed, "scene": scene, "scanner": scanner}
        if self.kind == "street-scan":
            return options | {"lines": int(self.length_m)}
        return options | {"length_m": self.length_m, "trajectory": {"stop_every_m": 0.0}}


PULSED = ("sick-push-broom", "profiler-1mhz", "scanstation2")
DARK: dict[str, Any] = {"pane_share": 1.0, "ghost_share": 0.0}
"""Glass returns the pulse itself, so that no range comes from a reflection.

Mixed ranges at edges remain.
"""
OWN_NOISE = 0.01
"""Share of mixed ranges and ghosts in a street without background light."""
PRESET_NOISE = 0.036
"""The same with the background light of the presets."""


def background(scanner: str, noise: float | None) -> dict[str, Any]:
    """Return the options of the simulator for a share of noise, as far as it can simulate it for
    the scanner."""
    if noise is None:
        return {}
    if noise == 0:
        nothing = dict.fromkeys(
            ("background_share", "sky_share", "bright_sky_share", "cluster_share"), 0.0
        )
        return {**nothing, **DARK}
    if scanner in PULSED:
        return {}
    # scale the shares of the presets to the requested share
    factor = max(noise - OWN_NOISE, 0.0) / (PRESET_NOISE - OWN_NOISE)
    shares = {
        "background_share": 0.008,
        "sky_share": 0.04,
        "bright_sky_share": 0.4,
        "cluster_share": 0.01,
    }
    return {key: min(value * factor, 0.5) for key, value in shares.items()}


def simulated(spec: Simulated) -> Scan:
    """Simulate a scan with its reference and registered coordinates."""
    settings = load_settings(spec.kind, options=spec.options())
    reference: Literal["cylinders", "truth"] = "cylinders" if spec.cylinders else "truth"
    simulation = open_simulation(spec.kind, settings, reference=reference, with_world=True)
    lookup = ClassCodes().lookup()
    parts: list[SimulatedBlock] = []
    scanner_m = []
    for item in simulation.scan.simulated():
        noisy, origin_m = _with_background(item, simulation.scan, spec)
        parts.append(noisy)
        scanner_m.append(origin_m)
    blocks = [part.labelled.block for part in parts]
    extras = [
        ExtraReturns(
            (block.extra.line + block.first_line).astype(np.int32),
            block.extra.column,
            block.extra.range_m,
            block.extra.record,
        )
        for block in blocks
    ]
    world = [part.world_m for part in parts if part.world_m is not None]
    extra_world = [part.extra_world_m for part in parts if part.extra_world_m is not None]
    angle_rad = blocks[0].angle_rad
    assert angle_rad is not None
    down_rad = simulation.scan.info.down_rad
    return Scan(
        spec.name,
        np.concatenate([block.range_m for block in blocks]),
        angle_rad - (down_rad or 0.0),
        np.concatenate([lookup[part.labelled.labels] for part in parts]).astype(np.int64),
        "cylinders" if spec.cylinders else spec.kind.replace("-", "_"),
        time_s=np.concatenate([block.time_s for block in blocks if block.time_s is not None]),
        intensity=np.concatenate(
            [block.intensity for block in blocks if block.intensity is not None]
        ),
        cos_tilt=simulation.scan.info.cos_tilt,
        world_m=np.concatenate(world),
        scanner_m=np.concatenate(scanner_m),
        extra=joined(extras),
        extra_codes=np.concatenate([lookup[part.labelled.extra_labels] for part in parts]).astype(
            np.int64
        ),
        extra_world_m=np.concatenate(extra_world),
        is_upright=spec.kind == "street-scan",
        height_m=settings.scanner.height_m,
        range_noise_m=max(settings.scanner.noise_m, 0.005),
    )


def joined(extras: list[ExtraReturns]) -> ExtraReturns:
    """Join further returns with common line numbers."""
    columns = {
        field.name: [getattr(extra, field.name) for extra in extras]
        for field in fields(ExtraReturns)
    }
    known = {
        name: parts for name, parts in columns.items() if all(part is not None for part in parts)
    }
    return ExtraReturns(**{name: np.concatenate(parts) for name, parts in known.items()})


def _with_background(
    item: SimulatedBlock, scan: SimulatedScan, spec: Simulated
) -> tuple[SimulatedBlock, F64]:
    """Add background to ranges of pulsed scanners, which the simulation lacks, and positions of the
    scanner.

    Background replaces random shots, including those without return.
    """
    block = item.labelled.block
    labels = item.labelled.labels
    shots = aim(scan.platform, scan.scanner, block.first_line, block.n_lines)
    origin_m = shots.origin[:, shots.origin.shape[1] // 2]
    if spec.scanner not in PULSED or not spec.noise or item.world_m is None:
        return item, origin_m
    random = np.random.default_rng((spec.seed, block.first_line))
    there = ~np.isnan(block.range_m)
    share = max(spec.noise - OWN_NOISE / 2, 0.0) * there.mean()
    hit = random.random(there.shape) < share
    stray = there & (random.random(there.shape) < STRAY_SHARE)
    scanner = scan.scanner
    anywhere = random.uniform(
        scanner.min_range_m, min(scanner.max_range_m, FARTHEST_M), there.shape
    )
    moved = np.where(
        stray, np.nan_to_num(block.range_m) + random.normal(0.0, STRAY_M, there.shape), anywhere
    )
    moved = np.maximum(
        np.rint(moved / scanner.resolution_m) * scanner.resolution_m, scanner.min_range_m
    )
    ranges: F32 = np.where(hit, moved, block.range_m).astype(np.float32)
    codes: U8 = np.where(hit, np.uint8(Label.NOISE), labels)
    world = np.where(
        hit[..., None], shots.origin + ranges[..., None] * shots.direction, item.world_m
    )
    intensity = block.intensity
    if intensity is not None:
        intensity = np.where(hit, random.integers(1, 200, there.shape), intensity).astype(
            np.float32
        )
    block = replace(block, range_m=ranges, intensity=intensity)
    return replace(
        item, labelled=replace(item.labelled, block=block, labels=codes), world_m=world
    ), origin_m


def simulations(group: str) -> tuple[Simulated, ...]:
    """Return a group of the scans of ``scans.toml``."""
    return tuple(Simulated(**{"seed": 0, **row}) for row in _SIMULATIONS[group])


_SIMULATIONS = tomllib.loads(Path(__file__).with_name("scans.toml").read_text("utf-8"))
TRAIN = simulations("tuning")
TRAIN_FOREST = simulations("tuning_forests")
TEST_STREETS = simulations("reported")
TEST_FORESTS = simulations("reported_forests")
NOISY_FORESTS = tuple(
    replace(spec, name=f"{spec.name}, 3 cm of noise", seed=spec.seed + 10, mount={"noise_m": 0.03})
    for spec in TEST_FORESTS
)
"""The same with another scanner."""
OAKLAND_NOISE = 0.05
"""Background added to the real strips, to judge noise among real surfaces."""


FEWEST_RETURNS = 32
"""Least returns of a line to estimate the position of the scanner."""


def oakland(strip: int) -> Scan:
    """Return a real push-broom strip with the registered coordinates of the data set."""
    path = DATA / "oakland" / f"oakland_{strip}.csv.gz"
    table: F64 = np.genfromtxt(path, delimiter=",", skip_header=1)
    n_lines = len(np.unique(table[:, 0]))

    def image(column: int) -> F64:
        return table[:, column].reshape(n_lines, -1)

    ranges = image(3).astype(np.float32)
    world = np.stack([image(4), image(5), image(6)], axis=-1)
    angle_rad = np.deg2rad(image(2)[0])
    codes = np.nan_to_num(image(7)).astype(np.int64)
    return Scan(
        f"Oakland strip {strip}",
        ranges,
        angle_rad,
        np.where(np.isnan(ranges), 0, codes),
        "oakland",
        world_m=world,
        scanner_m=scanner_places(world, ranges, angle_rad),
        range_noise_m=0.01,
    )


def oakland_noisy(strip: int) -> Scan:
    """Return a real strip with background at some of its returns.

    Its label is 7, noise, as in simulated scans.
    """
    scan = oakland(strip)
    random = np.random.default_rng(strip)
    there = ~np.isnan(scan.range_m)
    hit = there & (random.random(there.shape) < OAKLAND_NOISE)
    stray = random.random(there.shape) < STRAY_SHARE
    anywhere = random.uniform(1.0, 80.0, there.shape)
    moved = np.where(stray, scan.range_m + random.normal(0.0, STRAY_M, there.shape), anywhere)
    ranges = np.where(hit, np.maximum(np.rint(moved * 100.0) / 100.0, 0.5), scan.range_m).astype(
        np.float32
    )
    assert scan.world_m is not None
    assert scan.scanner_m is not None
    origin = scan.scanner_m[:, None]
    farther = (ranges / scan.range_m)[..., None]
    world = np.where(hit[..., None], origin + (scan.world_m - origin) * farther, scan.world_m)
    codes = np.where(hit, 7, scan.codes)
    return replace(
        scan, name=f"{scan.name}, 5 % background added", range_m=ranges, world_m=world, codes=codes
    )


def kitti() -> Scan:
    """Return the labelled frame in vertical lines, as read by the program."""
    source = DATA / "kitti" / "000000.bin"
    config = ROOT / "sample_configs" / "kitti_frame.toml"
    blocks = list(open_stream(source, load_config(config, preset="street-scan")).blocks())
    reference = np.fromfile(source.with_suffix(".label"), np.uint32).astype(np.int64) & 0xFFFF
    records = np.concatenate([block.records() for block in blocks])
    extras = [
        replace(block.extra, line=(block.extra.line + block.first_line).astype(np.int32))
        for block in blocks
    ]
    extra = joined(extras)
    xyz = np.concatenate([block.xyz_m for block in blocks if block.xyz_m is not None]).astype(
        np.float64
    )
    beam_rad = blocks[0].beam_rad
    assert beam_rad is not None
    ranges = np.concatenate([block.range_m for block in blocks])
    raw = np.fromfile(source, np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    return Scan(
        "KITTI frame",
        ranges,
        beam_rad,
        np.where(np.isnan(ranges), 0, reference[records]),
        "kitti",
        world_m=xyz,
        scanner_m=np.zeros((len(ranges), 3)),
        extra=extra,
        extra_codes=reference[extra.record],
        extra_world_m=raw[extra.record],
        is_upright=True,
        height_m=1.73,
        range_noise_m=0.02,
        source=source,
        config=config,
        record=records,
    )


def view_paths(kind: str) -> list[Path]:
    """Return the files of the range views of a kind."""
    return sorted((DATA / "rangeviews").glob(f"{kind}_train_*.npz"))


def view(path: Path) -> Scan:
    """Read a range view, an image of rings by azimuth, as vertical lines, by the median elevation
    of its rings."""
    with np.load(path) as arrays:
        xyz = arrays["xyz"].astype(np.float64)
        ranges = arrays["range_m"]
        codes = arrays["label"]
    elevation = np.arctan2(xyz[..., 2], np.hypot(xyz[..., 0], xyz[..., 1]))
    rings = np.nanmedian(np.where(np.isfinite(ranges), elevation, np.nan), axis=1)
    order = np.argsort(rings)
    lines = np.ascontiguousarray(ranges[order].T)
    mapping = "views_kitti" if path.stem.startswith("kitti") else "views_nuscenes"
    reference = codes[order].T.astype(np.int64)
    return Scan(
        path.stem,
        lines,
        np.pi / 2 + rings[order],
        reference,
        mapping,
        is_upright=True,
        range_noise_m=0.02,
    )


def scanner_places(world_m: F64, range_m: F32, angle_rad: F64) -> F64:
    """Estimate the position of the scanner at every line of an upright profiler, (lines, 3) [m].

    In the scan plane a return lies ``range * sin`` sideways and ``range * cos`` below the scanner:
    the offset of heights gives its height, a line fit of positions over the sideways distance the
    rest."""
    places = np.full((len(range_m), 3), np.nan)
    aside = range_m * np.sin(angle_rad)
    below = range_m * np.cos(angle_rad)
    for k in range(len(range_m)):
        good = ~np.isnan(range_m[k])
        if np.count_nonzero(good) < FEWEST_RETURNS:
            continue
        places[k, 2] = np.median(world_m[k, good, 2] + below[k, good])
        for axis in (0, 1):
            places[k, axis] = np.polyfit(aside[k, good], world_m[k, good, axis], 1)[1]
    known = np.flatnonzero(~np.isnan(places[:, 0]))
    every = np.arange(len(places))
    return np.stack([np.interp(every, known, places[known, axis]) for axis in range(3)], axis=1)
