"""Filters of registered clouds, run on the points of the contest with full 3-D coordinates.

Optional: ``pip install .[peers]`` installs cloth-simulation-filter, pypatchworkpp and open3d;
missing packages are reported. SMRF is implemented here after Pingel et al. (2013), because pip has
no package of it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from benchmarks.contest_data import Scan
from prc_cli.core.types import F64, I32, I64, U8, Mask

Step: TypeAlias = dict[str, Any]
"""A filter and its parameters."""

NOISE = 7
OTHER = 1
GROUND = 2
"""Default codes of this program."""
PACKAGES = {
    "csf": "cloth-simulation-filter",
    "patchwork": "pypatchworkpp",
    "statistical": "open3d",
    "radius": "open3d",
    "smrf": "scipy",
}
"""Package of every filter."""


@dataclass(frozen=True, slots=True)
class Points:
    """All returns of a scan."""

    xyz_m: F64
    line: I32
    scanner_m: F64
    height_m: float

    def some(self, which: Mask) -> Points:
        """Return some of the points."""
        return replace(self, xyz_m=self.xyz_m[which], line=self.line[which])

    def no_codes(self) -> U8:
        """Return codes before any filter, (n,)."""
        return np.full(len(self.xyz_m), OTHER, np.uint8)


def points_of(scan: Scan) -> Points:
    """Return all returns of a scan with registered coordinates, further returns at the end."""
    assert scan.world_m is not None
    assert scan.scanner_m is not None
    there = ~np.isnan(scan.range_m)
    xyz = np.concatenate([scan.world_m[there], scan.extra_world_m])
    line = np.concatenate([np.nonzero(there)[0], scan.extra.line]).astype(np.int32)
    return Points(xyz, line, scan.scanner_m, scan.height_m)


def as_image(scan: Scan, codes: U8) -> tuple[U8, U8]:
    """Split codes of points into those of shots, (lines, M), and of further returns, (e,)."""
    there = ~np.isnan(scan.range_m)
    image = np.zeros(scan.range_m.shape, np.uint8)
    image[there] = codes[: np.count_nonzero(there)]
    return image, codes[np.count_nonzero(there) :]


def installed(name: str) -> str | None:
    """Return the version of the package of a filter, None if not installed."""
    try:
        return version(PACKAGES[name])
    except PackageNotFoundError:
        return None


def statistical(points: Points, neighbours: int, sigmas: float) -> Mask:
    """Statistical outliers: mean distance to the neighbours above the overall mean by a number of
    standard deviations."""
    cloud = _open3d_cloud(points)
    return _left_out(len(points.xyz_m), cloud.remove_statistical_outlier(neighbours, sigmas)[1])


def radius(points: Points, least: int, radius_m: float) -> Mask:
    """Radius outliers: too few points within a radius."""
    cloud = _open3d_cloud(points)
    return _left_out(len(points.xyz_m), cloud.remove_radius_outlier(least, radius_m)[1])


def _open3d_cloud(points: Points) -> Any:
    open3d = import_module("open3d")
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.xyz_m))


def _left_out(n: int, kept: Any) -> Mask:
    is_left_out = np.ones(n, dtype=bool)
    is_left_out[np.asarray(kept, dtype=np.int64)] = False
    return is_left_out


def csf(
    points: Points,
    resolution_m: float,
    threshold_m: float,
    rigidness: int,
    slope_smoothing: bool,
) -> Mask:
    """Cloth simulation filter (Zhang et al. 2016), its authors' package."""
    return cloth(
        points.xyz_m,
        cloth_resolution=resolution_m,
        class_threshold=threshold_m,
        rigidness=rigidness,
        bSloopSmooth=slope_smoothing,
    )


@contextmanager
def quiet() -> Iterator[None]:
    """Let what a library prints go to stderr."""
    before = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(before, 1)
        os.close(before)


@quiet()
def cloth(xyz_m: F64, **parameters: float) -> Mask:
    """Mark the ground by the cloth simulation filter; parameters have the names of its package."""
    module = import_module("CSF")
    simulation = module.CSF()
    for name, value in parameters.items():
        setattr(simulation.params, name, value)
    simulation.setPointCloud(np.ascontiguousarray(xyz_m))
    ground = module.VecInt()
    simulation.do_filtering(ground, module.VecInt(), False)
    return ~_left_out(len(xyz_m), ground)


def patchwork(
    points: Points,
    piece_m: float,
    distance_m: float,
    upright: float,
    reach_m: float,
) -> Mask:
    """Patchwork++ (Lee et al. 2022), its authors' package, which takes clouds around the scanner
    one by one.

    A frame holds the points of some metres of the drive, with the scanner in its middle at the
    origin and z up, because a single line of a profiler has too little ground."""
    filtered = patchworkpp(
        points.height_m,
        # it finds reflections below the ground by intensities of the scanner of that paper
        enable_RNR=False,
        min_range=0.0,
        max_range=reach_m,
        th_dist=distance_m,
        uprightness_thr=upright,
    )
    way_m = np.concatenate(
        [[0.0], np.cumsum(np.hypot(*np.diff(points.scanner_m[:, :2], axis=0).T))]
    )
    piece = (way_m // piece_m).astype(np.int64)
    is_ground = np.zeros(len(points.xyz_m), dtype=bool)
    of_point = piece[points.line]
    for k in range(int(piece[-1]) + 1):
        members = np.flatnonzero(of_point == k)
        lines = np.flatnonzero(piece == k)
        if not len(members):
            continue
        middle = points.scanner_m[lines[len(lines) // 2]]
        is_ground[members[ground_of(filtered, points.xyz_m[members] - middle)]] = True
    return is_ground


@quiet()
def patchworkpp(height_m: float, **parameters: float) -> Any:
    """Return the filter for a scanner; parameters have the names of its package."""
    module = import_module("pypatchworkpp")
    params = module.Parameters()
    for name, value in {"verbose": False, "sensor_height": height_m, **parameters}.items():
        setattr(params, name, value)
    return module.patchworkpp(params)


def ground_of(filtered: Any, points: NDArray[np.floating]) -> I64:
    """Return the indices of the ground points."""
    filtered.estimateGround(np.ascontiguousarray(points, dtype=np.float32))
    return np.asarray(filtered.getGroundIndices(), dtype=np.int64)


def smrf(
    points: Points,
    cell_m: float,
    slope: float,
    window_m: float,
    threshold_m: float,
    scaler: float,
) -> Mask:
    """Simple morphological filter (Pingel et al. 2013).

    An opened surface of lowest points, then a threshold.
    """
    xyz = points.xyz_m
    low = xyz[:, :2].min(axis=0)
    cell = np.floor((xyz[:, :2] - low) / cell_m).astype(np.int64)
    shape = tuple(cell.max(axis=0) + 1)
    surface = np.full(shape, np.inf)
    np.minimum.at(surface, (cell[:, 0], cell[:, 1]), xyz[:, 2])
    empty = ~np.isfinite(surface)
    surface[empty] = np.nan
    surface = _filled(surface)
    # low outliers: the same filter on the surface upside down, one cell, a slope of 500 %
    sunken = _objects(-surface, 5.0, cell_m, 1)
    surface = _filled(np.where(sunken, np.nan, surface))
    objects = _objects(surface, slope, cell_m, max(1, round(window_m / cell_m)))
    terrain = _filled(np.where(objects | empty | sunken, np.nan, surface))
    rise = np.hypot(*np.gradient(terrain, cell_m)) if min(shape) > 1 else np.zeros(shape)
    place = ((xyz[:, :2] - low) / cell_m - 0.5).T
    sample = import_module("scipy.ndimage").map_coordinates
    height = sample(terrain, place, order=1, mode="nearest")
    limit = threshold_m + scaler * sample(rise, place, order=1, mode="nearest")
    is_ground: Mask = np.abs(xyz[:, 2] - height) <= limit
    return is_ground


def _objects(
    surface: F64,
    slope: float,
    cell_m: float,
    most: int,
) -> Mask:
    """Mark cells above what openings with growing discs leave, by more than the slope allows."""
    ndimage = import_module("scipy.ndimage")
    is_object = np.zeros(surface.shape, dtype=bool)
    last = surface
    for k in range(1, most + 1):
        across = np.arange(-k, k + 1)
        disc = across[:, None] ** 2 + across[None] ** 2 <= k * k
        opened = ndimage.grey_opening(last, footprint=disc)
        is_object |= last - opened > slope * k * cell_m
        last = opened
    return is_object


def _filled(surface: F64) -> F64:
    """Fill cells without a height from those around.

    Linearly within them, with the nearest beyond.
    """
    interpolate = import_module("scipy.interpolate")
    known = ~np.isnan(surface)
    if known.all():
        return surface
    cells = np.argwhere(known)
    wanted = np.argwhere(~known)
    result = surface.copy()
    values = interpolate.LinearNDInterpolator(cells, surface[known])(wanted)
    beyond = np.isnan(values)
    if beyond.any():
        values[beyond] = interpolate.NearestNDInterpolator(cells, surface[known])(wanted[beyond])
    result[~known] = values
    return result


FILTERS: dict[str, Callable[..., Mask]] = {
    "statistical": statistical,
    "radius": radius,
    "csf": csf,
    "patchwork": patchwork,
    "smrf": smrf,
}
NOISE_FILTERS = ("statistical", "radius")


def step(points: Points, options: Step, before: U8) -> tuple[U8, float]:
    """Run a filter on the points that are no noise; return codes, and CPU seconds of all cores."""
    name, parameters = options["filter"], {key: options[key] for key in options if key != "filter"}
    codes = before.copy()
    rest = codes != NOISE
    start = time.process_time()
    marked = FILTERS[name](points.some(rest), **parameters)
    codes[np.flatnonzero(rest)[marked]] = NOISE if name in NOISE_FILTERS else GROUND
    return codes, time.process_time() - start


_OUTLIERS: Step = {"filter": "statistical", "neighbours": 20, "sigmas": 2.0}
_CSF: Step = {
    "filter": "csf",
    "resolution_m": 0.5,
    "threshold_m": 0.5,
    "rigidness": 3,
    "slope_smoothing": False,
}
_SMRF: Step = {
    "filter": "smrf",
    "cell_m": 1.0,
    "slope": 0.15,
    "window_m": 18.0,
    "threshold_m": 0.5,
    "scaler": 1.25,
}
_PATCHWORK: Step = {
    "filter": "patchwork",
    "piece_m": 20.0,
    "distance_m": 0.125,
    "upright": 0.707,
    "reach_m": 80.0,
}

# chosen on the first 30 m of the streets of seeds 9001, 9004 and 9006
_BEST_OUTLIERS = {**_OUTLIERS, "sigmas": 0.5}
_BEST_RADIUS: Step = {"filter": "radius", "least": 4, "radius_m": 0.6}
_BEST_CSF = {**_CSF, "threshold_m": 0.3}
_BEST_PATCHWORK = {**_PATCHWORK, "piece_m": 5.0, "distance_m": 0.2}

CHAINS: dict[str, list[Step]] = {
    "statistical outliers, recommended": [_OUTLIERS],
    "statistical outliers, tuned": [_BEST_OUTLIERS],
    "radius outliers, tuned": [_BEST_RADIUS],
    "CSF, recommended": [_CSF],
    "statistical, tuned + CSF, recommended": [_BEST_OUTLIERS, _CSF],
    "statistical, tuned + CSF, tuned": [_BEST_OUTLIERS, _BEST_CSF],
    "Patchwork++, recommended": [_PATCHWORK],
    "statistical, tuned + Patchwork++, recommended": [_BEST_OUTLIERS, _PATCHWORK],
    "statistical, tuned + Patchwork++, tuned": [_BEST_OUTLIERS, _BEST_PATCHWORK],
    "statistical, tuned + SMRF, recommended": [_BEST_OUTLIERS, _SMRF],
}
"""Chains by their name in the table; chains with the same first step share its result."""


def chains() -> dict[str, list[Step]]:
    """Return the chains whose packages are installed."""
    return {
        name: steps
        for name, steps in CHAINS.items()
        if all(installed(one_step["filter"]) for one_step in steps)
    }
