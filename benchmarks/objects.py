"""Objects of ``prc objects`` against the simulator's own list: recall, precision and distance.

``python -m benchmarks.objects [--seed N] [--streets] [--preset NAME]``

The list holds the trees of the forest, and the posts and signs of the street, as the scene is built
of them. One counts as seen where enough of its shots are in the scan, by the simulator's classes. A
told object is right where one of the list is near to the middle of its registered coordinates; the
distance of a stem is to its axis at that height, so half its width is part of it. A car that moves
is in no list: it is right where shots of cars are near. A curb is right along the lines where the
simulator has curb in the same columns."""

from __future__ import annotations

import argparse
import csv
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.types import F64, I64, Mask
from prc_cli.jobs.objects import ScanObject, find_objects
from prc_cli.jobs.objects.grow import RULES
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import Kind, load_settings, open_simulation
from prc_cli.simulation.world import Material

NEAR_M = {"stem": 0.5, "pole": 0.6, "car": 2.5}
"""Greatest distance in plan of an object and what it is."""
LINKED_M = {"pole": 0.5, "car": 1.5}
"""Bodies this near are of one thing."""
BODIES = {"pole": (Material.POLE, Material.SIGN), "car": (Material.CAR_BODY,)}
SHOTS_M = 1.0
"""A told car that is none of the list is right if a shot of a car is this near to its middle.

It moves.
"""
CURB_COLUMNS = 20
"""Columns beside a told curb in which the simulator's counts."""
SCENES = {
    "forest": ("mixed", "pine-heath", "dense-spruce"),
    "street": ("residential", "terraces", "boulevard"),
}
LENGTH_M = {"forest": 5.0, "street": 60.0}
RINGS_M = (5.0, 10.0, 20.0)


@dataclass(frozen=True, slots=True)
class Listed:
    """Things of one kind, as the simulator has them."""

    kind: str
    base: F64
    """(n, 3) float64, world coordinates of their foot, or middle [m]."""
    slope: F64
    """(n, 2) float64, metres along x and y per metre of height."""

    def offset(self, xyz: F64, index: F64) -> F64:
        """Return the distance in plan of points from things, each at the height of its point
        [m]."""
        axis_m = (
            self.base[index, :2] + self.slope[index] * (xyz[:, 2] - self.base[index, 2])[:, None]
        )
        distance: F64 = np.linalg.norm(xyz[:, :2] - axis_m, axis=1)
        return distance

    def nearest(self, xyz: F64) -> tuple[Any, F64]:
        """Return the nearest thing of every point, among the four whose feet are nearest, and its
        distance [m]."""
        k = min(4, len(self.base))
        _, near = cKDTree(self.base[:, :2]).query(xyz[:, :2], k=k)
        near = np.asarray(near).reshape(len(xyz), k)
        every = np.stack([self.offset(xyz, near[:, i]) for i in range(k)], axis=1)
        best = np.argmin(every, axis=1)
        rows = np.arange(len(xyz))
        return near[rows, best], every[rows, best]


def trees(path: Path) -> Listed:
    """Read the simulator's list of trees."""
    with path.open(encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    base = np.array([[float(row[name]) for name in ("x_m", "y_m", "z_m")] for row in rows])
    lean, azimuth = (
        np.deg2rad([float(row[name]) for row in rows]) for name in ("lean_deg", "lean_azimuth_deg")
    )
    slope = np.tan(lean)[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    return Listed("stem", base, slope)


def built(kind: str, settings: Any) -> Listed:
    """Return the standing things of a street, put together from the bodies of its scene."""
    scene = open_simulation("street", settings).scene
    parts = []
    for s in np.arange(0.0, LENGTH_M["street"], 20.0):
        place, _ = scene.path_point(np.array([s]))
        bodies = scene.bodies_near(float(place[0, 0]), float(place[0, 1]), 30.0)
        chosen = np.isin(bodies.material, BODIES[kind]) & (np.abs(bodies.velocity).sum(axis=1) == 0)
        parts.append(bodies.numbers[chosen, :3])
    points = np.unique(np.concatenate(parts), axis=0)
    pairs = cKDTree(points[:, :2]).sparse_distance_matrix(cKDTree(points[:, :2]), LINKED_M[kind])
    n, member = connected_components(pairs.tocsr(), directed=False)
    base = np.array([points[member == i].mean(axis=0) for i in range(n)])
    return Listed(kind, base, np.zeros((n, 2)))


def compare(
    listed: Listed,
    shots: F64,
    things: list[ScanObject],
    way: F64,
) -> None:
    """Print a row for every ring around the way."""
    which, off = listed.nearest(shots)
    n_shots = np.bincount(which[off < NEAR_M[listed.kind]], minlength=len(listed.base))
    seen = n_shots >= RULES[listed.kind].least_shots
    listed_m = np.array(
        [[thing.x, thing.y, thing.z] for thing in things if thing.kind == listed.kind]
    ).reshape(-1, 3)
    of, distance = (
        listed.nearest(listed_m) if len(listed_m) else (np.empty(0, np.int64), np.empty(0))
    )
    right = distance < NEAR_M[listed.kind]
    said = right.copy()
    if listed.kind == "car" and len(listed_m):
        said |= cKDTree(shots[:, :2]).query(listed_m[:, :2])[0] < SHOTS_M
    tree = cKDTree(way)
    for ring in RINGS_M:
        inside = tree.query(listed.base[:, :2])[0] < ring
        near: Mask = (
            (tree.query(listed_m[:, :2])[0] < ring) if len(listed_m) else np.empty(0, np.bool_)
        )
        is_found = np.isin(np.arange(len(listed.base)), of[right])
        n_seen = int(np.count_nonzero(seen & inside))
        n_near = int(np.count_nonzero(near))
        recall = np.count_nonzero(is_found & seen & inside) / n_seen if n_seen else float("nan")
        precision = np.count_nonzero(said & near) / n_near if n_near else float("nan")
        n_found = len(np.unique(of[right & near]))
        found_share = np.count_nonzero(right & near) / n_found if n_found else float("nan")
        middle = float(np.median(distance[right & near])) if n_found else float("nan")
        print(
            f"| {listed.kind}, {ring:g} m | {n_seen} | {n_near} | {recall:.2f} | "
            f"{precision:.2f} | {found_share:.2f} | "
            f"{middle:.2f} |",
            flush=True,
        )


def compare_curbs(line: I64, column: I64, things: list[ScanObject]) -> None:
    """Print which share of the simulator's curb is told, and which share of the told lines has one.

    ``line`` and ``column`` are those of the shots on curbs.
    """
    is_found = np.zeros(len(line), np.bool_)
    n_lines = n_right = 0
    curbs = [curb for curb in things if curb.kind == "curb"]
    for curb in curbs:
        inside = (line >= curb.first_line) & (line <= curb.last_line)
        inside &= (column >= curb.first_column - CURB_COLUMNS) & (
            column <= curb.last_column + CURB_COLUMNS
        )
        is_found |= inside
        n_lines += curb.last_line - curb.first_line + 1
        n_right += len(np.unique(line[inside]))
    recall = is_found.mean() if len(line) else float("nan")
    precision = n_right / n_lines if n_lines else float("nan")
    print(
        f"| curb, along the lines |  | {len(curbs)} | {recall:.2f} | {precision:.2f} |  |  |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.objects", description=__doc__)
    parser.add_argument("--seed", type=int, default=921, help="of the first scene")
    parser.add_argument(
        "--streets", action="store_true", help="posts, cars and curbs of streets too"
    )
    parser.add_argument("--preset", help="default: the method is chosen")
    options = parser.parse_args()
    kinds: tuple[Kind, ...] = ("forest", "street") if options.streets else ("forest",)
    for kind in kinds:
        for i, scene in enumerate(SCENES[kind]):
            scene_options = {
                "seed": options.seed + i,
                "scene": {"name": scene},
                "length_m": LENGTH_M[kind],
            }
            settings = load_settings(kind, options=scene_options)
            print(f"\n{kind}, {scene}, seed {options.seed + i}\n")
            print(
                "| within | seen | told | recall | precision | told per thing | distance, "
                "median [m] |"
            )
            print("|---|---:|---:|---:|---:|---:|---:|", flush=True)
            with tempfile.TemporaryDirectory() as name:
                _one(kind, settings, Path(name), options.preset)


def _one(
    kind: Kind,
    settings: Any,
    folder: Path,
    preset: str | None,
) -> None:
    scan = folder / "scan.laz"
    stems = folder / "stems.csv"
    simulate(
        kind,
        scan,
        settings,
        beside=Beside(folder / "way.csv", stems=stems if kind == "forest" else None),
    )
    things: list[ScanObject] = []
    config = load_config(preset=preset, options={"input": {"accept_doubts": list(CHECK_NAMES)}})
    find_objects(scan, None, config, each=things.append)
    las = laspy.read(scan)
    xyz = np.asarray(las.xyz)
    codes = np.asarray(las.classification)
    with (folder / "way.csv").open(encoding="utf-8") as handle:
        way = np.array([[float(row["x"]), float(row["y"])] for row in csv.DictReader(handle)])
    lists = (
        [trees(stems)] if kind == "forest" else [built("pole", settings), built("car", settings)]
    )
    class_codes = ClassCodes()
    for listed in lists:
        compare(listed, xyz[codes == class_codes.code(Label[listed.kind.upper()])], things, way)
    if kind == "street":
        is_curb = codes == class_codes.code(Label.CURB)
        line, column = (
            np.asarray(las[name])[is_curb].astype(np.int64) for name in ("scan_line", "column")
        )
        compare_curbs(line, column, things)


if __name__ == "__main__":
    main()
