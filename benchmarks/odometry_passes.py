"""Two passes of one place without GNSS.

Strips of profilers by ICP, forests by ICP and by their stems.

    python -m benchmarks.odometry_passes             # writes docs/figures/odometry_passes.md
    python -m benchmarks.odometry_passes --seeds 81 --streets 60 --walk 10 --page /tmp/page.md

The second pass is of the same world at another speed, so that its lines, its noise and the moving
cars are others. Its trajectory drifts as with an IMU alone: an error of acceleration and one of the
turn rate, other ones with every seed. The first pass is the map. Labels are those of ``prc
classify`` with nothing told, stems those of ``prc objects``."""

from __future__ import annotations

import argparse
import csv
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import small_gicp
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from skimage.measure import ransac
from skimage.transform import EuclideanTransform

from benchmarks.car import table
from benchmarks.odometry import CODE, DOCS, spread
from prc_cli import DoubtWarning, classify
from prc_cli.config import load_config
from prc_cli.core.types import F64, I64
from prc_cli.jobs.objects import find_objects
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import Kind, load_settings

PAGE = DOCS / "figures" / "odometry_passes.md"
SEEDS = (81, 82, 83)
STRIP_M = 20.0
STREET_M = 40.0
WALK_M = 10.0
ACCELERATION = (0.02, 0.02, 0.005)
TURN_DEG = 0.05
"""Standard deviations of the drift: acceleration [m/s²], turn rate [deg/s]."""
START_M = 1.0
START_DEG = 5.0
"""Forests: how far off the second pass begins, on x and y, and its heading."""
DOWN_M = 0.2
NEAR_M = 1.5
STATIC = tuple(CODE[name] for name in ("ground", "building", "pole", "curb"))
MOVABLE = tuple(CODE[name] for name in ("noise", "vegetation", "car"))
BUDDIES = 4
CLOSE_M = 0.4
MOST_M = 1.0
"""Stems: neighbours that make the pattern of distances, how well two have to agree, residual of
RANSAC [m]."""


@dataclass(frozen=True, slots=True)
class Pass:
    """A pass, registered."""

    path: Path
    xyz_m: F64
    """(n, 3) true coordinates."""
    time_s: F64
    true: I64
    predicted: I64
    way_s: F64
    """(m,) times of the trajectory."""
    way_m: F64
    """(m, 3) true places of the scanner."""


def drive(
    kind: Kind,
    options: dict[str, Any],
    folder: Path,
    name: str,
) -> Pass:
    """Simulate a pass and label it."""
    path = folder / f"{name}.laz"
    way = folder / f"{name}.csv"
    simulate(
        kind, path, load_settings(kind, options=options), beside=Beside(trajectory=way), threads=1
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtWarning)
        classify(path, folder / f"{name}.npy")
    las = laspy.read(path)
    with way.open(encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    time_s, *places = (
        np.array([float(row[key]) for row in rows]) for key in _columns(list(rows[0]))
    )
    codes = (
        np.asarray(las.classification).astype(np.int64),
        np.load(folder / f"{name}.npy").ravel().astype(np.int64),
    )
    return Pass(
        path,
        np.asarray(las.xyz),
        np.asarray(las.gps_time),
        *codes,
        time_s,
        np.stack(places, axis=1),
    )


def _columns(names: list[str]) -> list[str]:
    """Return the columns of time and place."""
    return [
        next(name for name in names if name.lower().startswith(axis))
        for axis in ("t", "x", "y", "z")
    ]


class Drift:
    """What an IMU alone makes of a trajectory."""

    def __init__(
        self,
        drive_pass: Pass,
        seed: int,
        start_m: float = 0.0,
        start_deg: float = 0.0,
    ) -> None:
        random = np.random.default_rng(seed)
        self._one = drive_pass
        self._from_s = float(drive_pass.way_s[0])
        self._acceleration = random.normal(0.0, ACCELERATION)
        self._turn = np.deg2rad(random.normal(0.0, TURN_DEG))
        self._start_m = np.array([*random.uniform(-start_m, start_m, 2), 0.0])
        self._start = np.deg2rad(random.uniform(-start_deg, start_deg))

    def __call__(self, xyz_m: F64, time_s: F64) -> F64:
        """Return where points come to lie, (n, 3)."""
        drive_pass = self._one
        after = time_s - self._from_s
        place = np.stack(
            [np.interp(time_s, drive_pass.way_s, drive_pass.way_m[:, axis]) for axis in range(3)],
            axis=1,
        )
        upright = np.array([0.0, 0.0, 1.0])
        swung = Rotation.from_rotvec((self._turn * after)[:, None] * upright).apply(xyz_m - place)
        drifted = swung + place + 0.5 * self._acceleration * after[:, None] ** 2
        return Rotation.from_rotvec(self._start * upright).apply(drifted) + self._start_m


def icp(target_m: F64, source_m: F64) -> F64:
    """Return the matrix that brings points onto others, (4, 4)."""
    middle = target_m.mean(axis=0)
    alignment = small_gicp.align(
        target_m - middle,
        source_m - middle,
        downsampling_resolution=DOWN_M,
        max_correspondence_distance=NEAR_M,
        max_iterations=50,
    )
    back = np.eye(4)
    matrix = np.array(alignment.T_target_source)
    back[:3, 3] = middle
    return back @ matrix @ np.linalg.inv(back)


def moved(matrix: F64, points_m: F64) -> F64:
    """Apply a matrix."""
    return points_m @ matrix[:3, :3].T + matrix[:3, 3]


def off(found_m: F64, true_m: F64) -> float:
    """Return how far points are from their true places, root mean square [m]."""
    return float(np.sqrt(((found_m - true_m) ** 2).sum(axis=1).mean()))


Choice = Callable[[I64, I64], Any]
STRIPS: dict[str, Choice] = {
    "all points": lambda found, true: np.ones(len(found), np.bool_),
    "− noise": lambda found, true: found != CODE["noise"],
    "− noise − cars": lambda found, true: ~np.isin(found, (CODE["noise"], CODE["car"])),
    "− noise − vegetation − cars": lambda found, true: ~np.isin(found, MOVABLE),
    "random, as many as − noise − vegetation − cars": lambda found, true: _as_many(
        ~np.isin(found, MOVABLE)
    ),
    "true labels: − noise − vegetation − cars": lambda found, true: ~np.isin(true, MOVABLE),
}


def _as_many(mask: Any) -> Any:
    return np.random.default_rng(1).permutation(mask)


def strips(seed: int, length_m: float) -> dict[str, list[float]]:
    """Return how far the points of every strip of a street are off, before and after ICP, by arm
    [m]."""
    common = {
        "seed": seed,
        "length_m": length_m,
        "scene": {"curves": 0.0, "cars_per_km": 40.0},
        "sight_m": 60.0,
    }
    with tempfile.TemporaryDirectory() as folder:
        first, second = (
            drive(
                "street",
                {**common, "trajectory": {"speed_m_s": speed, "stop_every_m": 0.0}},
                Path(folder),
                name,
            )
            for name, speed in (("a", 8.33), ("b", 6.5))
        )
    drifted = Drift(second, seed)(second.xyz_m, second.time_s)
    result: dict[str, list[float]] = {"before": [], **{arm: [] for arm in STRIPS}}
    start = max(drive_pass.way_m[0, 0] for drive_pass in (first, second))
    for low in np.arange(start, start + length_m - STRIP_M / 2, STRIP_M):
        ours, theirs = (
            (drive_pass.xyz_m[:, 0] >= low) & (drive_pass.xyz_m[:, 0] < low + STRIP_M)
            for drive_pass in (first, second)
        )
        near = (
            np.abs(second.xyz_m[theirs, 1] - np.interp(low, second.way_m[:, 0], second.way_m[:, 1]))
            < 30.0
        )
        judged = np.flatnonzero(theirs)[near & ~np.isin(second.true[theirs], MOVABLE)]
        result["before"].append(off(drifted[judged], second.xyz_m[judged]))
        for arm, choose in STRIPS.items():
            target = first.xyz_m[ours][choose(first.predicted[ours], first.true[ours])]
            source = drifted[theirs][choose(second.predicted[theirs], second.true[theirs])]
            result[arm].append(
                off(moved(icp(target, source), drifted[judged]), second.xyz_m[judged])
            )
    return result


def stems_of(drive_pass: Pass, folder: Path) -> tuple[F64, F64]:
    """Return places, (n, 2), and times, (n,), of the stems that prc objects tells of a pass."""
    output = folder / f"{drive_pass.path.stem}_stems.csv"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtWarning)
        anew = load_config(preset="fused-forest")
        find_objects(drive_pass.path, output, anew, kinds=("stem",))
    with output.open(encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    lines = np.array([(int(row["first_line"]) + int(row["last_line"])) / 2 for row in rows])
    n_lines = max(int(row["last_line"]) for row in rows) + 1
    every = np.linspace(drive_pass.time_s.min(), drive_pass.time_s.max(), n_lines)
    places = np.array([[float(row["x"]), float(row["y"]), float(row["z"])] for row in rows])
    return places, np.interp(lines, np.arange(n_lines), every)


def _rigid(source_m: F64, target_m: F64) -> F64:
    """Return the matrix that brings points onto their partners best, (4, 4)."""
    turn, _ = Rotation.align_vectors(
        target_m - target_m.mean(axis=0), source_m - source_m.mean(axis=0)
    )
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    pose[:3, 3] = target_m.mean(axis=0) - turn.apply(source_m.mean(axis=0))
    return pose


def pairs_by_pattern(ours_m: F64, theirs_m: F64) -> I64:
    """Return pairs of stems whose distances to their neighbours are alike, (k, 2)."""
    patterns = []
    for places in (ours_m, theirs_m):
        apart, _ = cKDTree(places).query(places, k=min(BUDDIES + 1, len(places)))
        patterns.append(apart[:, 1:])
    matches = []
    for j, theirs in enumerate(patterns[1]):
        near = np.abs(theirs[None, :, None] - patterns[0][:, None, :]).min(axis=2) < CLOSE_M
        matches += [(i, j) for i in np.flatnonzero(near.sum(axis=1) >= 2)]
    return np.array(matches, np.int64).reshape(-1, 2)


def matched(ours_m: F64, theirs_m: F64) -> F64 | None:
    """Return the matrix that brings stems onto others, (4, 4), by RANSAC over pairs.

    None where none agree.
    """
    pairs = pairs_by_pattern(ours_m[:, :2], theirs_m[:, :2])
    if len(pairs) < 3:
        return None
    sides = theirs_m[pairs[:, 1], :2], ours_m[pairs[:, 0], :2]
    model, inliers = ransac(sides, EuclideanTransform, 2, CLOSE_M, max_trials=5000, rng=1)
    if model is None or inliers is None or inliers.sum() < 4:
        return None
    pose = np.eye(4)
    pose[:2, :2] = model.params[:2, :2]
    pose[:2, 3] = model.params[:2, 2]
    return pose


def forest(seed: int, length_m: float) -> dict[str, float]:
    """Return how far the second pass's trajectory is off, by way of matching [m], and the stems of
    both passes."""
    common = {"seed": seed, "length_m": length_m, "sight_m": 30.0}
    with tempfile.TemporaryDirectory() as folder:
        first, second = (
            drive("forest", {**common, "trajectory": {"speed_m_s": speed}}, Path(folder), name)
            for name, speed in (("a", 1.4), ("b", 1.7))
        )
        ours = stems_of(first, Path(folder))[0]
        (theirs, times) = stems_of(second, Path(folder))
    drift = Drift(second, seed, START_M, START_DEG)
    way = drift(second.way_m, second.way_s)
    drifted = drift(second.xyz_m, second.time_s)

    def apart(matrix: F64) -> float:
        # stems tell nothing of the height
        return off(moved(matrix, way)[:, :2], second.way_m[:, :2])

    result = {
        "before": apart(np.eye(4)),
        "best of all rigid moves": apart(_rigid(way, second.way_m)),
    }
    chosen: dict[str, Callable[[I64], Any]] = {
        "ICP, all points": lambda codes: np.ones(len(codes), np.bool_),
        "ICP, − noise": lambda codes: codes != CODE["noise"],
        "ICP, points of stems alone": lambda codes: codes == CODE["stem"],
    }
    for arm, choose in chosen.items():
        result[arm] = apart(
            icp(first.xyz_m[choose(first.predicted)], drifted[choose(second.predicted)])
        )
    matrix = matched(ours, drift(theirs, times))
    result["stems by their pattern, RANSAC"] = float("nan") if matrix is None else apart(matrix)
    return {**result, "stems, first pass": len(ours), "stems, second pass": len(theirs)}


def page(
    of_seeds: list[tuple[int, dict[str, list[float]], dict[str, float]]],
    street_m: float,
    walk_m: float,
) -> str:
    """Return the page of what every seed gave: strips and walk."""
    seeds = [seed for seed, _, _ in of_seeds]
    errors: dict[str, list[float]] = {}
    walks: dict[str, list[float]] = {}
    for _, of_strips, of_walk in of_seeds:
        for arm, values in of_strips.items():
            errors.setdefault(arm, []).extend(values)
        for arm, value in of_walk.items():
            walks.setdefault(arm, []).append(value)
    rows = [(arm, spread(values, 3), str(len(values))) for arm, values in errors.items()]
    of_walks = [
        (
            arm,
            *(
                f"{value:.0f}"
                if arm.startswith("stems,")
                else "none found"
                if np.isnan(value)
                else f"{value:.3f}"
                for value in values
            ),
        )
        for arm, values in walks.items()
    ]
    return "\n".join(
        (
            (
                "<!-- written by python -m benchmarks.odometry_passes; do not edit -->\n\n# "
                "Figures of two passes\n"
            ),
            f"`python -m benchmarks.odometry_passes --streets {street_m:g} --walk {walk_m:g}"
            f" --seeds {' '.join(map(str, seeds))}`\n",
            "Streets are of a Photon 80, walks of a Focus3D.\n",
            "## Strips of a street\n",
            (
                f"How far what stands still is off in strips of {STRIP_M:g} m, root mean "
                "square [m]: median (least–most).\n"
            ),
            table(("points", "off [m]", "strips"), rows),
            "## Walks in a forest\n",
            (
                "How far the second pass's trajectory is off in x and y, root mean square [m], "
                "and stems of prc objects.\n"
            ),
            table(("way", *(f"seed {seed}" for seed in seeds)), of_walks),
        )
    )


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--streets", type=float, default=STREET_M, help="length of a street [m]")
    parser.add_argument("--walk", type=float, default=WALK_M, help="length of a walk [m]")
    parser.add_argument("--page", type=Path, default=PAGE)
    options = parser.parse_args()
    passes = []
    for seed in options.seeds:
        passes.append((seed, strips(seed, options.streets), forest(seed, options.walk)))
        print(seed, "done", flush=True)
    options.page.write_text(page(passes, options.streets, options.walk), encoding="utf-8")


if __name__ == "__main__":
    main()
