"""What classes are worth to an odometry.

Simulated drives of spinning scanners, with and without some classes.

    python -m benchmarks.odometry > figures/odometry.md
    python -m benchmarks.odometry --picture docs/images/odometry_paths.png  # draw paths, too
    python -m benchmarks.odometry --frames 100 --seeds 11 12 13 --scenes snow

Labels are those of ``prc classify`` with nothing told, frame by frame; ``prc thin`` leaves out the
same points. No limit of prc or of a library was chosen on these scenes."""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import small_gicp

from benchmarks.odometry_runs import CLASS_TO_CLASS, LIBRARIES, Run, run
from benchmarks.pages import duration, heading, parser_of, say, table
from prc_cli import ClassCodes, DoubtWarning, Label, classify
from prc_cli.config import load_config
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.types import F64, I64
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import Kind, load_settings

SEEDS = (71, 72, 73)
N_FRAMES = 30
STEP_DEG = 0.4
TURNS_HZ = 10.0
CODE = {
    label.name.lower(): ClassCodes().code(label) for label in Label if label is not Label.MISSING
}
NOISE = (CODE["noise"],)
STATIC = ("ground", "building", "pole")
KEPT = tuple(CODE[name] for name in STATIC)
TRUE_KEPT = (*KEPT, CODE["stem"], CODE["curb"])
"""The simulator's classes that are ground, buildings and poles to the method of rings."""
COARSE_M = {CODE["ground"]: 0.5, CODE["vegetation"]: 1.0}
"""Class weights: points of these classes are one in so much [m]."""
ONE_CLASS = np.zeros(1, np.int64)


@dataclass(frozen=True, slots=True)
class Scene:
    """A place and a scanner."""

    kind: Kind
    scanner: str
    more: dict[str, Any] = field(default_factory=dict)


SCENES = {
    "street, 16 rings": Scene("street", "vlp-16"),
    "street, 32 rings": Scene("street", "vlp-32c"),
    "street, 64 rings": Scene("street", "hdl-64e"),
    "traffic, 32 rings": Scene(
        "street", "vlp-32c", {"scene": {"cars_per_km": 40.0, "parked": 0.9}}
    ),
    "snow, 32 rings": Scene("street", "vlp-32c", {"flake_m": 80.0}),
    "forest, 16 rings": Scene("forest", "vlp-16", {"trajectory": {"speed_m_s": 2.0}}),
}


@dataclass(frozen=True, slots=True)
class Drive:
    """Frames with their true poses and classes."""

    points: list[F64]
    """(n, 3) float64 each, relative to the scanner [m]."""
    true: list[I64]
    """(n,) int64 each, class codes of the simulator."""
    predicted: list[I64]
    """(n,) int64 each, class codes of prc."""
    poses: F64
    """(frames, 4, 4), from the first."""


def read_frames(folder: Path) -> list[F64]:
    """Return the points of KITTI's frames of a folder."""
    return [
        np.fromfile(path, "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
        for path in sorted(folder.glob("*.bin"))
    ]


def labelled(folder: Path) -> list[I64]:
    """Return the classes that prc gives the frames of a folder."""
    drives = []
    loaded = load_config(options={"input": {"accept_doubts": list(CHECK_NAMES)}})
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtWarning)
        for path in sorted(folder.glob("*.bin")):
            output = Path(place) / f"{path.stem}.npy"
            classify(path, output, loaded)
            drives.append(np.load(output).ravel().astype(np.int64))
    return drives


def make(
    scene: Scene,
    seed: int,
    n_frames: int,
    folder: Path,
) -> Drive:
    """Simulate a drive and label it."""
    scanner = {
        "name": scene.scanner,
        "azimuth_step_deg": STEP_DEG,
        "line_hz": TURNS_HZ * 360.0 / STEP_DEG,
    }
    options = {
        "scanner": scanner,
        "seed": seed,
        "duration_s": n_frames / TURNS_HZ,
        "sight_m": 80.0,
        **scene.more,
    }
    settings = load_settings(scene.kind, options=options)
    simulate(
        scene.kind,
        folder / "drive.npz",
        settings,
        beside=Beside(frames=folder / "frames"),
        threads=1,
    )
    frames = folder / "frames"
    true = [
        np.fromfile(path, "<u4").astype(np.int64) for path in sorted((frames / "labels").iterdir())
    ]
    poses = np.tile(np.eye(4), (len(true), 1, 1))
    poses[:, :3] = np.loadtxt(frames / "poses.txt").reshape(-1, 3, 4)
    velodyne = frames / "velodyne"
    return Drive(read_frames(velodyne), true, labelled(velodyne), poses)


Frames = Callable[[Drive], Iterator[tuple[F64, I64]]]


def but(*dropped: str, is_true: bool = False) -> Frames:
    """Return all points but those of some classes."""
    codes = [CODE[name] for name in dropped]
    return lambda drive: _chosen(drive, lambda classes: ~np.isin(classes, codes), is_true=is_true)


def only_static(*, is_true: bool = False) -> Frames:
    """Return the points of ground, buildings and poles."""
    kept = TRUE_KEPT if is_true else KEPT
    return lambda drive: _chosen(drive, lambda classes: np.isin(classes, kept), is_true=is_true)


def _chosen(
    drive: Drive, choose: Callable[[I64], Any], *, is_true: bool
) -> Iterator[tuple[F64, I64]]:
    for points, classes in zip(
        drive.points, drive.true if is_true else drive.predicted, strict=True
    ):
        keep = choose(classes)
        yield points[keep], classes[keep]


def as_many(frames_like: Frames) -> Frames:
    """Return as many points of every frame as another arm has, drawn at random."""

    def frames(drive: Drive) -> Iterator[tuple[F64, I64]]:
        random = np.random.default_rng(1)
        for points, (wanted, _) in zip(drive.points, frames_like(drive), strict=True):
            keep = np.sort(random.choice(len(points), len(wanted), replace=False))
            yield points[keep], np.zeros(len(keep), np.int64)

    return frames


def weighted(drive: Drive) -> Iterator[tuple[F64, I64]]:
    """Return sparser points of ground and of vegetation, no noise and no cars."""
    for points, classes in but("noise", "car")(drive):
        parts = [points[~np.isin(classes, tuple(COARSE_M))]]
        for code, edge_m in COARSE_M.items():
            if (mine := classes == code).any():
                parts.append(
                    np.array(small_gicp.voxelgrid_sampling(points[mine], edge_m).points()[:, :3])
                )
        yield np.concatenate(parts), ONE_CLASS


def in_one(frames: Frames) -> Frames:
    """Return an arm whose points are of one class to what matches class to class."""
    return lambda drive: ((points, np.zeros(len(points), np.int64)) for points, _ in frames(drive))


GREENLESS = but("noise", "vegetation")
STILL = but("noise", "car")
ARMS: dict[str, Frames] = {
    "all points": but(),
    "− noise": but("noise"),
    "− noise − vegetation": GREENLESS,
    "− noise − cars": STILL,
    "ground, building, pole": only_static(),
    "class weights": weighted,
    "random, as many as − noise": as_many(but("noise")),
    "random, as many as − noise − vegetation": as_many(GREENLESS),
    "random, as many as − noise − cars": as_many(STILL),
    "random, as many as ground, building, pole": as_many(only_static()),
    "true labels: − noise": but("noise", is_true=True),
    "true labels: − noise − vegetation": but("noise", "vegetation", is_true=True),
    "true labels: ground, building, pole": only_static(is_true=True),
}
FEW = ("all points", "ground, building, pole", "random, as many as ground, building, pole")
"""Arms of GenZ-ICP, which takes several times as long as the others."""
MATCHED: dict[str, Frames] = {
    "− noise, any class to any": in_one(but("noise")),
    "− noise, class to class": but("noise"),
}
PLAN = {
    **{
        (library, arm): frames
        for library in LIBRARIES
        for arm, frames in ARMS.items()
        if library != "GenZ-ICP" or arm in FEW
    },
    **{(CLASS_TO_CLASS, arm): frames for arm, frames in MATCHED.items()},
}
"""Frames by library and arm."""
SLOW = ("GenZ-ICP", CLASS_TO_CLASS)
"""Libraries that take several times as long as the others: with the first seed alone."""


Result = tuple[str, int, dict[tuple[str, str], Run], F64]
"""Scene, seed, runs by library and arm, true path, (n, 3)."""


def runs_of(job: tuple[str, int, int, bool]) -> Result:
    """Run the arms of a scene with one seed: all, or without those of the slow libraries."""
    name, seed, n_frames, has_slow = job
    if hasattr(os, "sched_setaffinity"):  # times of one core
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[os.getpid() % len(cores)]})
    with tempfile.TemporaryDirectory() as folder:
        drive = make(SCENES[name], seed, n_frames, Path(folder))
    runs = {
        (library, arm): run(library, frames(drive), drive.poses)
        for (library, arm), frames in PLAN.items()
        if has_slow or library not in SLOW
    }
    print(name, seed, "done", file=sys.stderr, flush=True)
    return name, seed, runs, drive.poses[:, :3, 3]


MEASURES = (
    ("ATE [m]", "ate_m", 3),
    ("RPE [m]", "rpe_m", 4),
)


def spread(values: list[float], digits: int) -> str:
    """Return the median of seeds, with the lowest and the highest."""
    there = [value for value in values if np.isfinite(value)]
    if not there:
        return "–"
    low, mid, high = (f"{value:.{digits}f}" for value in (min(there), np.median(there), max(there)))
    return f"{mid} ({low}–{high})"


def scene_table(runs: dict[tuple[str, str], list[Run]]) -> None:
    """Print the table of a scene."""
    rows = []
    for (library, arm), seeds in runs.items():
        cells = [
            spread([getattr(run, key) for run in seeds], digits) for _, key, digits in MEASURES
        ]
        failed = f"{sum(run.is_failed for run in seeds)} of {len(seeds)}"
        means = (
            f"{np.mean([getattr(run, key) for run in seeds]):,.0f}" for key in ("ms", "points")
        )
        rows.append((f"{library}: {arm}", *cells, failed, *means))
    table(
        (
            "library: points",
            *(name for name, *_ in MEASURES),
            "failed",
            "ms a frame",
            "points a frame",
        ),
        rows,
    )


def summary_table(
    every: dict[str, dict[tuple[str, str], list[Run]]], key: str, digits: int
) -> None:
    """Print the medians of a measure in all scenes, a row an arm, and how many of all runs
    failed."""
    rows = []
    for library, arm in PLAN:
        seeds = [runs.get((library, arm), []) for runs in every.values()]
        cells = [
            f"{np.median([getattr(run, key) for run in scene]):.{digits}f}" if scene else "–"
            for scene in seeds
        ]
        flat = [run for scene in seeds for run in scene]
        rows.append(
            (f"{library}: {arm}", *cells, f"{sum(run.is_failed for run in flat)} of {len(flat)}")
        )
    table(("library: points", *every, "failed"), rows)


def drawn(
    name: str,
    paths: dict[str, F64],
    true_m: F64,
    picture: Path,
) -> None:
    """Draw paths from the side, and how far they are from the true one."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, (side, away) = pyplot.subplots(1, 2, figsize=(8, 2.8), dpi=100)
    side.plot(true_m[:, 0], true_m[:, 2], "k-", label="true", linewidth=3, alpha=0.3)
    for (arm, path_m), style in zip(paths.items(), ("C3--", "C0-"), strict=True):
        side.plot(path_m[:, 0], path_m[:, 2], style, label=arm, linewidth=1.2)
        away.plot(np.linalg.norm(path_m - true_m[: len(path_m)], axis=1), style, linewidth=1.2)
    side.set(xlabel="x [m]", ylabel="z [m]", title=name)
    away.set(xlabel="frame", ylabel="off the true path [m]", title="small_gicp")
    side.legend(fontsize="small")
    figure.tight_layout()
    picture.parent.mkdir(exist_ok=True)
    figure.savefig(picture, metadata={"Software": None})


def results(
    names: list[str],
    seeds: list[int],
    n_frames: int,
    n_jobs: int,
) -> list[Result]:
    """Run all scenes with all seeds."""
    jobs = [(name, seed, n_frames, seed == seeds[0]) for name in names for seed in seeds]
    with ProcessPoolExecutor(n_jobs, mp_context=get_context("spawn")) as pool:
        return list(pool.map(runs_of, jobs))


def page(results: list[Result], n_frames: int, picture: Path | None) -> None:
    """Print the page, and draw the paths of the first seed in snow."""
    every: dict[str, dict[tuple[str, str], list[Run]]] = {}
    for name, _, runs, _ in results:
        for key, run_of_key in runs.items():
            every.setdefault(name, {}).setdefault(key, []).append(run_of_key)
    seeds = sorted({seed for _, seed, _, _ in results})
    name, _, runs, path_m = next(
        (result for result in results if result[0].startswith("snow")), results[0]
    )
    arms = ("all points", "ground, building, pole")
    if picture is not None:
        drawn(name, {arm: runs["small_gicp", arm].path_m for arm in arms}, path_m, picture)
    print(heading("Figures of odometry", "odometry"))
    say(f"""Seeds {", ".join(map(str, seeds))}. Frames of a drive: {n_frames}, 10 turns a second,
    {360 / STEP_DEG:.0f} lines a turn. Median of the seeds (lowest–highest); {" and ".join(SLOW)},
    which are slow, have the first seed alone. A run fails where it stops, or a pose is off by more
    than 2 m and 5 % of the way. Times are of one machine shared with other work: compare them
    within a table alone.""")
    print("## ATE of all scenes [m]\n")
    summary_table(every, "ate_m", 3)
    print("## Time of a frame in all scenes [ms]\n")
    summary_table(every, "ms", 0)
    for name, runs_of_scene in every.items():
        print(f"## {name[0].upper()}{name[1:]}\n")
        scene_table(runs_of_scene)
    print(duration())


def main() -> None:
    """Write the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=N_FRAMES, help="of a drive")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--scenes", nargs="+", default=[""], help="names begin so; all by default")
    parser.add_argument("--jobs", type=int, default=2, help="drives at a time")
    parser.add_argument("--picture", type=Path, help="draw the paths in this file")
    options = parser.parse_args()
    names = [name for name in SCENES if name.startswith(tuple(options.scenes))]
    page(
        results(names, list(options.seeds), options.frames, options.jobs),
        options.frames,
        options.picture,
    )


if __name__ == "__main__":
    main()
