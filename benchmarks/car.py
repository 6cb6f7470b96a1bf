"""Classification before registration beside one after it (CAR), on a simulated drive with known
classes.

    python -m benchmarks.car > figures/car.md
    python -m benchmarks.car --length 40
    python -m benchmarks.car --large 20000000 40000000  # memory of the match alone

The drive is registered with a trajectory that has 2 cm of error on every axis, cut into tiles of 40
m, shuffled, cleaned of single points and thinned to one point in 5 cm, as an office delivers it.
The CAR is made of what anybody can install: the cloth simulation filter (``pip install
'.[peers]'``) finds the ground, and the shape of 16 neighbours (SciPy) tells buildings from
vegetation; it has the ASPRS codes 2, 5 and 6 alone. It is a plain one: offices have better."""

from __future__ import annotations

import re
import tempfile
import time
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from scipy.spatial import cKDTree

from benchmarks.contest_peers import cloth
from benchmarks.pages import DATA, duration, heading, parser_of, printed_at, say, table
from benchmarks.user import run
from prc_cli.core.types import F64, I64, Mask

ERROR_M = 0.02
THINNED_M = 0.05
TILE_M = 40.0
LONELY_M = 0.25
NEIGHBOURS = 16
GROUND = 2
VEGETATION = 5
BUILDING = 6
NOISE = 7
DIFFERING = 0.02
"""Share of single errors in the large run; the large reference has twice as many."""
SCORES = ("recall", "precision", "f1")


def prc(*arguments: object) -> tuple[Any, float, float]:
    """Run a command; return what it prints as JSON, its time [s] and its peak memory [MiB]."""
    done = run(*arguments)
    is_json = done.stdout.lstrip().startswith("{")
    return done.table() if is_json else None, done.seconds, done.peak_mib


def registered(las: laspy.LasData, seed: int = 1) -> F64:
    """Return coordinates with the error of a trajectory.

    Another one every second, and lines between.
    """
    time_s = np.asarray(las.gps_time)
    random = np.random.default_rng(seed)
    knots = np.arange(time_s.min() - 1, time_s.max() + 2)
    error = [np.interp(time_s, knots, random.normal(0, ERROR_M, len(knots))) for _ in range(3)]
    return np.stack([las.x, las.y, las.z], axis=1) + np.stack(error, axis=1)


def delivered(xyz: F64, keep: Mask) -> I64:
    """Return the points that an office delivers: one in every small cube."""
    kept = np.flatnonzero(keep)
    cubes = np.floor(xyz[kept] / THINNED_M).astype(np.int64)
    return kept[np.unique(cubes, axis=0, return_index=True)[1]]


def is_lonely(xyz: F64) -> Mask:
    """Return points without six others around: what a cleaning step deletes."""
    return np.asarray(cKDTree(xyz).query(xyz, k=7, workers=-1)[0][:, -1] > LONELY_M)


def car_classes(xyz: F64) -> I64:
    """Classify registered points: cloth simulation, then the shape of the neighbourhood."""
    ground = cloth(xyz, cloth_resolution=0.5, class_threshold=0.2, bSloopSmooth=False)
    codes = np.where(ground, GROUND, VEGETATION)
    rest = np.flatnonzero(~ground)
    tree = cKDTree(xyz)
    for part in np.array_split(rest, max(1, len(rest) // 100_000)):
        near = xyz[tree.query(xyz[part], k=NEIGHBOURS, workers=-1)[1]]
        apart = near - near.mean(axis=1, keepdims=True)
        spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", apart, apart))
        planar = (spread[:, 1] - spread[:, 0]) / np.maximum(spread[:, 2], 1e-12)
        codes[part[planar > 0.3]] = BUILDING
    return codes


def write_tiles(
    folder: Path,
    xyz: F64,
    codes: I64,
    seed: int = 2,
) -> None:
    """Write tiles whose points are shuffled."""
    folder.mkdir()
    random = np.random.default_rng(seed)
    tiles = np.floor(xyz[:, :2] / TILE_M).astype(np.int64)
    for column, row in np.unique(tiles, axis=0).tolist():
        mine = random.permutation(np.flatnonzero((tiles == (column, row)).all(axis=1)))
        las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
        las.header.scales = np.full(3, 0.001)
        las.x, las.y, las.z = xyz[mine].T
        las.classification = codes[mine].astype(np.uint8)
        las.write(folder / f"tile_{column}_{row}.laz")


def make(folder: Path, length: float, seed: int) -> dict[str, tuple[float, float]]:
    """Write the drive, what the office delivers with the true classes, and the CAR.

    Return time and memory.
    """
    used = {}
    drive = folder / "drive.laz"
    used["simulate"] = prc("simulate", "street", drive, "--length", length, "--seed", seed, "-q")[
        1:
    ]
    las = laspy.read(drive)
    xyz = registered(las)
    codes = np.asarray(las.classification).astype(np.int64)
    kept = delivered(xyz, codes != NOISE)
    write_tiles(folder / "truth", xyz[kept], codes[kept])
    start = time.perf_counter()
    kept = delivered(xyz, ~is_lonely(xyz))
    write_tiles(folder / "car", xyz[kept], car_classes(xyz[kept]))
    used["CAR"] = time.perf_counter() - start, float("nan")
    return used


def noise_of(matrix: Any) -> tuple[float, float]:
    """Return recall and precision of noise."""
    noise = matrix["classes"]["noise"]
    return noise["recall"], noise["precision"]


def estimated_noise(matrix: Any) -> tuple[float, float]:
    """Return the recall and precision of noise that evaluate estimates."""
    text = next(
        note for note in matrix["match"]["notes"] if note.startswith("noise close to the reference")
    )
    recall, precision = re.findall(r"(?:recall|precision) (\d\.\d+)", text)
    return float(recall), float(precision)


METHODS = {
    "PRC, zeta_p 1.0": ("prc-2019-urban", "prc.support.zeta_p=1.0"),
    "PRC, zeta_p 0.1": ("prc-2019-urban", "prc.support.zeta_p=0.1"),
    "sequential-angle": ("street-scan", ""),
    "fused": ("fused", ""),
}
"""Preset and setting of every method; both zeta_p are those of Lehtola et al. (2019), Table I."""
SURFACES = """unlisted = "ignore"
[predicted]
horizontal = [2]
[reference]
horizontal = [2]
vertical = [6]
vegetation = [3, 4, 5]
"""
"""ASPRS codes of the CAR as classes of sequential-angle."""


def classified(folder: Path, used: dict[str, tuple[float, float]]) -> dict[str, Path]:
    """Classify the drive with every method; return the files by method."""
    files = {}
    for k, (name, (preset, setting)) in enumerate(METHODS.items()):
        files[name] = folder / f"method_{k}.laz"
        arguments = ["--preset", preset, *(("--set", setting) if setting else ()), "-q"]
        used[f"classify, {name}"] = prc("classify", folder / "drive.laz", files[name], *arguments)[
            1:
        ]
    return files


def scores_table(methods: dict[str, Any], classes: tuple[str, ...]) -> None:
    """Print a row for each class and method."""
    rows = []
    for name in classes:
        for method, result in methods.items():
            scores = result["classes"].get(name, {})
            if any(scores.get(score) for score in SCORES):
                cells = (printed_at(scores.get(score) or 0.0) for score in SCORES)
                rows.append((name, method, *cells))
    table(("class", "method", *SCORES), rows)


def used_table(used: dict[str, tuple[float, float]]) -> None:
    """Print time and memory of every command."""
    print("## Time and memory\n")
    say("Times are wall times; peak memory is of the command with its guard.")
    rows = (
        (name, f"{seconds:.1f}", printed_at(memory, 0)) for name, (seconds, memory) in used.items()
    )
    table(("command", "time [s]", "memory [MiB]"), rows)


def drive(folder: Path, length: float, seed: int, *, times: bool) -> None:
    """Run the walk and print its figures."""
    used = make(folder, length, seed)
    used["simulate the drive"] = used.pop("simulate")
    used["clean, thin, classify after registration (CSF, SciPy)"] = used.pop("CAR")
    files = classified(folder, used)
    fused = files["fused"]
    truth = folder / "truth"
    near = ("--match", "nearest", "--json")
    noise = ("--unmatched", "noise")
    named = [f"{name}={path}" for name, path in files.items()]
    urban = [item for item in named if not item.startswith("sequential")]
    exact, *_ = prc("evaluate", fused, folder / "drive.laz", "--mapping", "street", "--json")
    asprs, *used["fused against CAR"] = prc(
        "evaluate", fused, folder / "car", *near, "--mapping", "asprs", *noise
    )
    estimate, *used["fused against the truth as delivered"] = prc(
        "evaluate",
        fused,
        truth,
        *near,
        "--mapping",
        "street",
        *noise,
        "--inside",
        "-500,-500,500,500",
    )
    third = ("--third", folder / "car", "--mapping")
    three, *used["fused, CAR and the truth as delivered"] = prc(
        "evaluate", fused, truth, *near, "--mapping", "lehtola_urban", *noise, *third, "third=asprs"
    )
    towns, *used["PRC and fused against the truth as delivered"] = prc(
        "evaluate", *urban, truth, *near, "--mapping", "lehtola_urban", *noise
    )
    (folder / "surfaces.toml").write_text(SURFACES, encoding="utf-8")
    scans, *_ = prc("evaluate", *named, truth, *near, "--mapping", "street_scan")
    as_scan, *_ = prc(
        "evaluate", fused, truth, *near, "--mapping", "street_scan", *third,
        f"third={folder / 'surfaces.toml'}",
    )  # fmt: skip
    tile = max(truth.iterdir(), key=lambda path: path.stat().st_size)
    used["transfer to the largest tile"] = prc(
        "transfer", fused, tile, folder / "out.laz", "--match", "nearest", "-q"
    )[1:]
    states = three["three"]["states"]
    rows_of_noise = [
        ("true, all shots", *noise_of(exact)),
        ("from the reference without noise, as counted", *noise_of(estimate)),
        ("from the same, as estimated", *estimated_noise(estimate)),
        ("from the CAR", *noise_of(asprs)),
    ]
    print(f"`python -m benchmarks.car --length {length:g}`: {exact['n_scored']:,} shots.\n")
    if times:
        used_table(used)
    print("## Scores against the truth\n")
    say("""Classes of Lehtola et al. (2019), Table I. PRC is their method with both of their zeta_p.
    fused is ours. CAR is scored on the shots that fused and CAR both have.""")
    names = ("ground", "building", "vegetation", "noise")
    scores_table({**towns["methods"], "CAR": three["three"]["third"]}, names)
    say("""Classes of Stamos et al. (2012), Table 1, for every method. Sequential-angle is a method
    for static scans: a drive is not what it was made for.""")
    names = ("horizontal", "vertical", "vegetation", "car")
    scores_table({**scans["methods"], "CAR": as_scan["three"]["third"]}, names)
    print("## Noise\n\nOf fused.\n")
    noises = [(name, *map(printed_at, values)) for name, *values in rows_of_noise]
    table(("figure", "recall", "precision"), noises)
    print("## Agreement\n\nPredicted is fused, third is CAR.\n")
    n_shots = max(sum(states.values()), 1)
    table(("shots", "share"), ((name, f"{n / n_shots:.1%}") for name, n in states.items()))
    print("## What evaluate says of fused\n")
    for title, result in (("CAR", asprs), ("the truth", estimate)):
        print(f"### Against {title}\n")
        for note in result["match"]["notes"]:
            print(f"- {note}".replace(f"{folder}/", ""))
        print()


def oakland(folder: Path) -> None:
    """Compare fused on recovered lines with CAR on the registered points they came from, strip by
    strip."""
    rows: list[tuple[str, ...]] = []
    states: list[tuple[str, ...]] = []
    seconds: list[tuple[str, ...]] = []
    names: tuple[str, ...] = ()
    for strip in ("1", "2", "3"):
        scan = DATA / "oakland" / f"oakland_{strip}.csv.gz"
        labels = folder / f"fused_{strip}.npy"
        car = folder / f"car_{strip}.npy"
        used = prc("classify", scan, labels, "--preset", "fused", "-q")
        points = np.genfromtxt(scan, delimiter=",", skip_header=1)[:, 4:7]
        there = np.isfinite(points).all(axis=1)
        start = time.perf_counter()
        codes = np.zeros(len(points), np.uint8)
        codes[there] = car_classes(points[there])
        took = (f"{used[1]:.1f}", f"{time.perf_counter() - start:.1f}")
        seconds.append((strip, f"{there.sum():,}", *took))
        np.save(car, codes)
        mappings = ("--mapping", "street_oakland", "--mapping", "third=asprs")
        three = prc("evaluate", labels, scan, *mappings, "--third", car, "--json")[0]["three"]
        for name in ("ground", "building", "vegetation"):
            sides = [three[side]["classes"].get(name, {}) for side in ("predicted", "third")]
            if sides[0].get("n_reference"):
                cells = (f"{side.get(score) or 0:.3f}" for side in sides for score in SCORES)
                rows.append((f"{strip} {name}", *cells))
        names = tuple(three["states"])
        total = max(sum(three["states"].values()), 1)
        states.append((strip, *(f"{n / total:.1%}" for n in three["states"].values())))
    print("## Oakland's registered points\n")
    say("""Labels were made by hand on the registered points. CAR reads these points. fused reads
    lines, angles and ranges that were recovered from them by fitting (.5 degrees, 1 cm): its side
    is no raw stream either, and its noise had been deleted. Strip 1 decided limits of the fused
    method, strip 2 one of its rules, strip 3 nothing. Times include Python's start; other work ran
    beside them.""")
    sides_and_scores = (f"{side} {score}" for side in ("fused", "CAR") for score in SCORES)
    table(("strip and class", *sides_and_scores), rows)
    table(("strip", *names), states)
    table(("strip", "points", "fused [s]", "CAR [s]"), seconds)


def large(n: int, folder: Path) -> str:
    """Return time and memory of matching n shots with as many registered points, 200 on every
    square metre."""
    for name, seed in (("run", 1), ("reference", 2)):
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.scales = np.full(3, 0.001)
        random = np.random.default_rng(seed)
        with laspy.open(folder / f"{name}.las", "w", header=header) as writer:
            for first in range(0, n, 1 << 20):
                m = min(1 << 20, n - first)
                points = laspy.ScaleAwarePointRecord.zeros(m, header=header)
                points.x = first / 4000 + random.uniform(0, m / 4000, m)
                points.y = random.uniform(0, 20, m)
                points.z = random.normal(0, 0.005, m)
                is_building = (np.asarray(points.y) > 10.0) ^ (random.random(m) < DIFFERING * seed)
                points.classification[:] = np.where(is_building, BUILDING, GROUND)
                writer.write_points(points)
    summary, seconds, peak = prc(
        "evaluate", folder / "run.las", folder / "reference.las", "--match", "nearest", "--json",
        "--places", folder / "places.csv", "--overwrite",
    )  # fmt: skip
    return (
        f"{n:,} shots: {summary['match']['n_matched']:,} pairs, {seconds:.0f} s, peak "
        f"{peak:.0f} MiB"
    )


def main() -> None:
    """Print the page, or the figures of large files."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "--seed", type=int, default=7, help="of the street; 7 decided the rule of unmatched noise"
    )
    parser.add_argument("--length", type=float, default=60.0, help="length of the street [m]")
    parser.add_argument(
        "--times", action="store_true", help="also time and memory; for a quiet machine"
    )
    parser.add_argument("--large", type=int, nargs="+", default=(), metavar="SHOTS")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for n in options.large:
            print(large(n, Path(folder)), flush=True)
        if not options.large:
            print(heading("Figures before and after registration", "car"))
            drive(Path(folder), options.length, options.seed, times=options.times)
            oakland(Path(folder))
            print(duration())


if __name__ == "__main__":
    main()
