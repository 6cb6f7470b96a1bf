"""Labels of registered clouds beside the labels of their raw streams.

``--range points`` and nothing else.

    python -m benchmarks.registered --work FOLDER > docs/figures/registered.md      # all cases
    # cases whose names contain a word
    python -m benchmarks.registered --work FOLDER --only tile drives
    python -m benchmarks.registered --list

A cloud has coordinates (1 mm), times, intensities and return numbers of a simulated drive, without
ranges, lines and columns. The drive as it was simulated is the raw stream. A part of a cloud is
compared with the raw stream without the records outside this part. FOLDER keeps the inputs, and the
labels of the raw streams: use a new one after a change of a method. Every command runs in its own
process. Cases of real files read ../shared/data or $PRC_DATA."""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import laspy
import numpy as np

from benchmarks.car import delivered
from benchmarks.contest_data import DATA, ROOT
from benchmarks.pages import duration, heading
from prc_cli.core.classes import ClassCodes
from prc_cli.core.types import F64, I64, U8, Mask
from prc_cli.simulation.settings import load_settings, open_simulation
from prc_cli.simulation.trajectory import Platform, Pose, write_trajectory

PLACE_M = np.array([650_000.0, 6_860_025.0, 40.0])
"""Position of the simulated worlds on a map [m]: the street runs along the middle of its tiles."""
CLOCK_S = 3.0e8
"""GPS time of the start of a drive [s]."""
TILE_M = 50.0
POINTS = ("--range", "points")
KINDS = {"noise": 7, "ground": 2, "building": 6, "vegetation": 5, "car": 65, "pole": 69, "stem": 64}
MAIN = ("ground", "building", "vegetation", "noise", "stem")
"""Classes of the macro average."""
FEWEST = 500
"""Records that a class needs in the reference to be in the average."""
WHOLE_LOSS = 0.1
"""Part of a cloud that loses more beside the whole raw stream must be doubted."""
CURB = 66
STEM = 64
NOISE = 7
SECONDS_AT_MOST = 900

Options: TypeAlias = tuple[str, ...]


class NotMadeError(Exception):
    """An input or the labels of a raw stream could not be made."""


# Commands


CHILD = """
import resource, subprocess, sys
# a process inherits the peak of its parent: this parent is small
code = subprocess.run([sys.executable, "-m", "prc_cli", *sys.argv[1:]]).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(f"used {used.ru_maxrss / 1024} {used.ru_utime + used.ru_stime}")
sys.exit(code)
"""


@dataclass(frozen=True, slots=True)
class Run:
    """A finished command."""

    arguments: list[str]
    code: int
    said: str
    """Standard error."""
    printed: str
    seconds: float
    """Wall time."""
    cpu_s: float
    mib: float
    """Peak memory."""

    @property
    def doubts(self) -> frozenset[str]:
        """Names of the checks in warnings and errors."""
        named = re.findall(r"^warning: ([a-z][a-z-]+):", self.said, re.MULTILINE)
        return frozenset(named + re.findall(r"--accept-doubt ([a-z-]+)", self.said))

    @property
    def has_hint(self) -> bool:
        """Whether the messages contain something to type."""
        messages = "\n".join(self.messages())
        return bool(re.search(r"--[a-z]|\bprc [a-z]", messages))

    def messages(self) -> list[str]:
        """Return warnings and errors, with the lines that belong to them."""
        lines: list[str] = []
        inside = False
        for line in self.said.splitlines():
            starts = bool(re.match(r"error:|warning:|\[\d+/\d+\] (?!done)", line))
            inside = starts or (inside and line.startswith(" "))
            if inside:
                lines.append(line.strip())
        return lines or self.said.splitlines()[-1:]


def prc(*arguments: object) -> Run:
    """Run ``prc`` in its own process."""
    words = [str(argument) for argument in arguments]
    start = time.perf_counter()
    command = ["timeout", str(SECONDS_AT_MOST), sys.executable, "-c", CHILD, *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start
    printed, _, used = done.stdout.rpartition("used ")
    mib, cpu_s = (float(value) for value in used.split()) if used else (float("nan"), float("nan"))
    return Run(words, done.returncode, done.stderr, printed, seconds, cpu_s, mib)


def _must(*arguments: object) -> None:
    run = prc(*arguments)
    if run.code not in (0, 4):
        raise NotMadeError(f"{' '.join(run.arguments)}\n{run.said}")


# Clouds


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of a drive and their reference."""

    xyz_m: F64
    """(n, 3) float64, on the map [m]."""
    time_s: F64
    """(n,) float64 [s]."""
    truth: U8
    """(n,) uint8, reference codes."""
    raw: Path
    """The raw stream."""
    record: I64
    """(n,) int64, record of every point in the raw stream."""
    path: Path
    """True path of the scanner on the map, CSV."""
    intensity: I64
    return_number: I64
    n_returns: I64
    scanner: I64
    """(n,) int64, point source ID."""

    def take(self, index: I64 | Mask) -> Cloud:
        """Return some of the points, or another order of them."""
        arrays = (
            "xyz_m",
            "time_s",
            "truth",
            "record",
            "intensity",
            "return_number",
            "n_returns",
            "scanner",
        )
        return replace(self, **{name: getattr(self, name)[index] for name in arrays})


def write_cloud(path: Path, cloud: Cloud) -> Path:
    """Write a registered cloud with nothing but coordinates, times, intensities and return
    numbers."""
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.header.scales = np.full(3, 0.001)
    las.header.offsets = np.floor(cloud.xyz_m.min(axis=0))
    las.x, las.y, las.z = cloud.xyz_m.T
    las.gps_time = cloud.time_s
    las.intensity = np.clip(cloud.intensity, 0, 65_535).astype(np.uint16)
    las.return_number = cloud.return_number.astype(np.uint8)
    las.number_of_returns = cloud.n_returns.astype(np.uint8)
    las.point_source_id = cloud.scanner.astype(np.uint16)
    las.write(path)
    return path


@dataclass(frozen=True, slots=True)
class Drive:
    """A simulated drive or walk."""

    name: str
    scanner: str
    seconds: float
    seed: int
    kind: str = "street"
    options: Options = ()

    def cloud(self, work: Path) -> Cloud:
        """Simulate the drive, unless the folder has it, and register its points."""
        raw = work / f"{self.name}.laz"
        path = work / f"{self.name}_path.csv"
        if not path.exists():
            kept_points = work / f"{self.name}_own.csv"
            settings = ("--scanner", self.scanner, "--duration", self.seconds, "--seed", self.seed)
            _must(
                "simulate",
                self.kind,
                raw,
                *settings,
                "--trajectory",
                kept_points,
                *self.options,
                "-q",
                "--overwrite",
            )
            _move_path(kept_points, path)
        las = laspy.read(raw)
        n = len(las.points)
        cloud = Cloud(
            np.stack([las.x, las.y, las.z], axis=1) + PLACE_M,
            np.asarray(las.gps_time) + CLOCK_S,
            np.asarray(las.classification).astype(np.uint8),
            raw,
            np.arange(n),
            path,
            np.asarray(las.intensity).astype(np.int64),
            np.asarray(las.return_number).astype(np.int64),
            np.asarray(las.number_of_returns).astype(np.int64),
            np.zeros(n, np.int64),
        )
        return cloud.take(np.argsort(cloud.time_s, kind="stable"))


def _move_path(source: Path, path: Path) -> None:
    """Write a path of the simulator on the map, with GPS times."""
    rows = np.loadtxt(source, delimiter=",", skiprows=1)
    rows[:, 0] += CLOCK_S
    rows[:, 1:4] += PLACE_M
    header = source.read_text(encoding="ascii").split("\n", 1)[0]
    np.savetxt(path, rows, "%.6f,%.4f,%.4f,%.4f,%.5f,%.5f,%.5f", header=header, comments="")


def part_of(raw: Path, records: I64, name: str) -> Path:
    """Write the raw stream without the other records; their cells are missing."""
    path = raw.with_name(f"{raw.stem}_{name}_raw{raw.suffix}")
    if path.exists():
        return path
    if raw.suffix == ".npz":
        with np.load(raw) as arrays:
            parts = dict(arrays)
        kept = np.zeros(parts["range_m"].size, np.bool_)
        kept[records] = True
        parts["range_m"] = np.where(kept.reshape(parts["range_m"].shape), parts["range_m"], np.nan)
        np.savez(path, **parts)
        return path
    las = laspy.read(raw)
    las.points = las.points[np.sort(records)]
    las.write(path)
    return path


# Comparison


@dataclass(frozen=True, slots=True)
class Reference:
    """A raw stream with the same points."""

    raw: Path
    options: Options = ()

    def labels(self) -> tuple[U8, Run]:
        """Classify the raw stream, unless this was done before; accept all doubts."""
        output = self.raw.with_suffix(".labels.npy")
        record = self.raw.with_suffix(".run.json")
        if output.exists() and record.exists():
            return np.load(output).ravel(), Run(**json.loads(record.read_text(encoding="utf-8")))
        options = self.options
        for _ in range(6):
            run = prc("classify", self.raw, output, "--overwrite", *options)
            if run.code in (0, 4):
                break
            more = tuple(word for check in sorted(run.doubts) for word in ("--accept-doubt", check))
            if "--trust-order" in run.said:
                more += ("--trust-order",)
            if set(more) <= set(options):
                raise NotMadeError(f"{' '.join(run.arguments)}\n{run.said}")
            options += more
        values = {name: getattr(run, name) for name in Run.__slots__}
        record.write_text(json.dumps(values), encoding="utf-8")
        return np.load(output).ravel(), run


@dataclass(frozen=True, slots=True)
class Part:
    """A cloud as a file, and the labels that are expected."""

    points: Path
    truth: U8 | None = None
    """Reference codes, record by record."""
    references: tuple[Reference, ...] = ()
    rows: tuple[I64, ...] = ()
    """For every raw stream the (n,) int64 records of the points, -1 = another stream."""
    path: Path | None = None
    """True path, CSV."""
    options: Options = POINTS
    own_labels: U8 | None = None
    """Labels of this input by another way, instead of raw streams."""
    whole: tuple[Reference, I64] | None = None
    """The raw stream before points were taken away, and the (n,) int64 records of the points."""

    def expected(self) -> tuple[U8, list[Run]]:
        """Return the labels of the raw streams in the order of the points."""
        assert self.truth is not None
        labels = np.zeros(len(self.truth), np.uint8)
        runs = []
        for reference, rows in zip(self.references, self.rows, strict=True):
            codes, run = reference.labels()
            labels[rows >= 0] = codes[rows[rows >= 0]]
            runs.append(run)
        return labels, runs


def part(
    points: Path,
    cloud: Cloud,
    raw: Path | None = None,
    *,
    options: Options = POINTS,
) -> Part:
    """Return a cloud that is compared with its whole raw stream, or with another one."""
    reference = Reference(cloud.raw if raw is None else raw)
    path = cloud.path
    return Part(
        write_cloud(points, cloud), cloud.truth, (reference,), (cloud.record,), path, options
    )


def masked(
    points: Path,
    cloud: Cloud,
    name: str,
    *,
    options: Options = POINTS,
) -> Part:
    """Return a cloud that is compared with the raw stream without all other records."""
    raw = part_of(cloud.raw, cloud.record, name)
    kept = np.sort(cloud.record)
    is_dense = raw.suffix == ".npz"
    rows = cloud.record if is_dense else np.searchsorted(kept, cloud.record)
    piece = part(points, replace(cloud, record=rows), raw, options=options)
    return replace(piece, whole=(Reference(cloud.raw), cloud.record))


def scores(codes: U8, truth: U8) -> dict[str, float]:
    """Return F1 of every class and the macro average.

    Curbs are ground, without stems they are vegetation.
    """
    codes = _merged(codes, truth)
    truth = _merged(truth, truth)
    f1 = {}
    in_average = []
    for name, code in KINDS.items():
        n_truth = np.count_nonzero(truth == code)
        n_codes = np.count_nonzero(codes == code)
        if not n_truth:
            continue
        both = np.count_nonzero((truth == code) & (codes == code))
        f1[name] = 2.0 * both / (n_truth + n_codes)
        if name in MAIN and n_truth >= FEWEST:
            in_average.append(f1[name])
    f1["macro"] = float(np.mean(in_average)) if in_average else float("nan")
    return f1


def _merged(codes: U8, truth: U8) -> U8:
    codes = np.where(codes == CURB, KINDS["ground"], codes).astype(np.uint8)
    has_stems = bool((truth == STEM).any())
    return (
        codes if has_stems else np.where(codes == STEM, KINDS["vegetation"], codes).astype(np.uint8)
    )


@dataclass(frozen=True, slots=True)
class PathError:
    """Distance of a path from the true one."""

    median_m: float
    most_m: float
    """95 of 100 positions are nearer [m]."""
    covered: float
    """Share of the true time."""


def path_error(estimate: Path, true: Path) -> PathError:
    """Compare two paths at the times of the first one."""
    rows = read_path(estimate)
    truth = read_path(true)
    inside = (rows[:, 0] >= truth[0, 0]) & (rows[:, 0] <= truth[-1, 0])
    rows = rows[inside]
    if not len(rows):
        return PathError(float("nan"), float("nan"), 0.0)
    expected = np.stack(
        [np.interp(rows[:, 0], truth[:, 0], truth[:, 1 + axis]) for axis in range(3)], axis=1
    )
    off_m = np.linalg.norm(rows[:, 1:] - expected, axis=1)
    covered = np.ptp(rows[:, 0]) / np.ptp(truth[:, 0])
    return PathError(float(np.median(off_m)), float(np.quantile(off_m, 0.95)), float(covered))


def read_path(path: Path) -> F64:
    """Return time, x, y, z, (n, 4) float64."""
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=np.float64)
    rows = np.stack([np.atleast_1d(table[name]) for name in ("time", "x", "y", "z")], axis=1)
    return rows[np.argsort(rows[:, 0], kind="stable")]


@dataclass(slots=True)
class Row:
    """A line of the table."""

    name: str
    verdict: str
    whole: dict[str, float] = field(default_factory=dict)
    raw: dict[str, float] = field(default_factory=dict)
    points: dict[str, float] = field(default_factory=dict)
    same: float = float("nan")
    """Share of the points with the label of the raw stream."""
    path: PathError | None = None
    plain_info: Run | None = None
    """``prc info`` without options."""
    info: Run | None = None
    runs: list[Run] = field(default_factory=list)
    n_points: int = 0
    note: str = ""

    @property
    def loss(self) -> float:
        """Macro average that the points lose."""
        return self.raw.get("macro", float("nan")) - self.points.get("macro", float("nan"))


@dataclass(frozen=True, slots=True)
class Case:
    """What is measured under a name."""

    name: str
    make: Callable[[Path], list[Part]]
    limit: float = 0.02
    """Most that the macro average may lose."""
    may_doubt: bool = False
    """Whether a warning or a refusal is an answer too."""
    must_doubt: bool = False
    """Whether labels without a warning are wrong."""
    as_drive: bool = False
    """Whether all parts are given to ``prc batch --drive``."""
    check: Callable[[Path, Path], str] | None = None
    """Compares the path that was found; gets the input and the path."""


def run_case(case: Case, work: Path, output: Path) -> Row:
    """Classify the parts of a case and compare their labels."""
    parts = case.make(work)
    row = Row(case.name, "")
    raw_doubts: frozenset[str] = frozenset()
    wanted: list[U8] = []
    for piece in parts:
        if piece.own_labels is not None:
            wanted.append(piece.own_labels)
        elif piece.references:
            labels, raw_runs = piece.expected()
            raw_doubts |= frozenset[str]().union(*(run.doubts for run in raw_runs))
            wanted.append(labels)
    truths = [piece.truth for piece in parts if piece.truth is not None]
    if wanted:
        row.raw = scores(np.concatenate(wanted), np.concatenate(truths))
    whole = [
        piece.whole[0].labels()[0][piece.whole[1]] for piece in parts if piece.whole is not None
    ]
    if whole:
        row.whole = scores(np.concatenate(whole), np.concatenate(truths))
    _measure_path(case, max(parts, key=lambda piece: piece.points.stat().st_size), row, output)
    codes = _classify_drive(parts, row, output) if case.as_drive else _classify(parts, row, output)
    row.n_points = sum(len(codes_of_tile) for codes_of_tile in codes if codes_of_tile is not None)
    complete = [codes_of_tile for codes_of_tile in codes if codes_of_tile is not None]
    if truths and len(complete) == len(parts):
        row.points = scores(np.concatenate(complete), np.concatenate(truths))
        row.same = float(np.mean(np.concatenate(complete) == np.concatenate(wanted)))
    row.verdict = verdict(case, row, raw_doubts)
    return row


def _measure_path(
    case: Case,
    piece: Part,
    row: Row,
    output: Path,
) -> None:
    if "points" not in piece.options:
        return
    estimate = output / "path.csv"
    row.plain_info = prc("info", piece.points)
    row.info = prc("info", piece.points, *piece.options, "--path", estimate)
    if not estimate.exists():
        return
    if piece.path is not None:
        row.path = path_error(estimate, piece.path)
    if case.check is not None:
        row.note = case.check(piece.points, estimate)


def _classify(parts: Sequence[Part], row: Row, output: Path) -> list[U8 | None]:
    codes: list[U8 | None] = []
    for number, piece in enumerate(parts):
        labels = output / f"{number}.npy"
        run = prc("classify", piece.points, labels, *piece.options)
        row.runs.append(run)
        codes.append(np.load(labels).ravel() if labels.exists() else None)
    return codes


def _classify_drive(parts: Sequence[Part], row: Row, output: Path) -> list[U8 | None]:
    folder = parts[0].points.parent
    run = prc(
        "batch", folder, output / "out", "--drive", "tile_*.laz", *parts[0].options, "--to", "npy"
    )
    row.runs.append(run)
    paths = [output / "out" / f"{piece.points.name}.labels.npy" for piece in parts]
    return [np.load(path).ravel() if path.exists() else None for path in paths]


def verdict(case: Case, row: Row, raw_doubts: frozenset[str]) -> str:
    """Return right, doubted, refused, or the way in which a case fails."""
    codes = {run.code for run in row.runs}
    doubts = frozenset[str]().union(*(run.doubts for run in row.runs))
    if codes - {0, 1, 4}:
        return f"FAILS: exit code {max(codes)}"
    if not all(run.has_hint for run in row.runs if run.code):
        return "FAILS: no hint"
    if row.raw and not row.points and codes <= {0}:
        return "FAILS: no labels"
    is_like_raw = bool(row.points) and row.loss <= case.limit
    whole_loss = row.whole.get("macro", 0.0) - row.points.get("macro", 0.0)
    is_right = is_like_raw and (not row.whole or whole_loss <= WHOLE_LOSS)
    if is_right and not case.must_doubt:
        return "right, but doubted" if doubts - raw_doubts else "right"
    # a doubt that the raw stream shares says nothing about what the points lose beside it
    said = doubts if is_like_raw else doubts - raw_doubts
    stopped = "refused" if 1 in codes else "doubted" if said else ""
    if not stopped:
        return "FAILS: silent"
    return stopped if case.may_doubt or case.must_doubt or is_like_raw else f"FAILS: {stopped}"


# Drives and their parts


FIELD = tuple(
    word
    for value in ("setback_m=25", "trees=0", "parked=0", "people=0", "cars_per_km=0")
    for word in ("--set", f"scene.{value}")
)
"""A street with nothing on the ground within sight."""
DRIVES = {
    drive.name: drive
    for drive in (
        Drive("photon", "photon-80", 12.0, 5101),
        Drive("focus3d", "focus3d-120", 4.0, 5102),
        Drive("sick", "sick-push-broom", 12.0, 5103),
        Drive("profiler", "profiler-1mhz", 3.0, 5104),
        Drive("vlp-16", "vlp-16", 4.0, 5105),
        Drive("vlp-32c", "vlp-32c", 2.5, 5106),
        Drive("hdl-64e", "hdl-64e", 1.5, 5107),
        Drive("forest", "focus3d-120", 4.0, 5108, "forest"),
        Drive("field", "photon-80", 8.0, 5109, options=("--set", "sight_m=25", *FIELD)),
        Drive(
            "standing",
            "photon-80",
            18.0,
            5110,
            options=("--speed", "4", "--set", "trajectory.stop_every_m=45"),
        ),
        Drive("first_pass", "photon-80", 8.0, 5111),
        Drive("second_pass", "photon-80", 10.0, 5111, options=("--speed", "6")),
        Drive("left", "photon-80", 6.0, 5112, options=("--set", "scanner.heading_deg=45")),
        Drive("right", "photon-80", 6.0, 5112, options=("--set", "scanner.heading_deg=-45")),
    )
}


def whole(name: str, work: Path) -> list[Part]:
    """Return a drive in one cloud."""
    cloud = DRIVES[name].cloud(work)
    return [part(work / f"{name}_points.laz", cloud)]


def in_space(cloud: Cloud) -> Cloud:
    """Sort points by small squares on the map, as tiles are sorted.

    The order within a square is random.
    """
    square = np.floor(cloud.xyz_m[:, :2]).astype(np.int64)
    chance = np.random.default_rng(1).random(len(square))
    return cloud.take(np.lexsort((chance, square[:, 0], square[:, 1])))


def tiles_of(cloud: Cloud) -> Iterator[tuple[str, Cloud]]:
    """Cut a cloud into tiles with more than a few points."""
    square = np.floor(cloud.xyz_m[:, :2] / TILE_M).astype(np.int64)
    for column, line in np.unique(square, axis=0).tolist():
        inside = (square == (column, line)).all(axis=1)
        if np.count_nonzero(inside) >= 20_000:
            yield f"tile_{column}_{line}", in_space(cloud.take(inside))


def tiles(name: str, work: Path) -> list[Part]:
    """Return the tiles of a drive."""
    cloud = DRIVES[name].cloud(work)
    folder = work / f"{name}_tiles"
    return [masked(folder / f"{tile}.laz", points, tile) for tile, points in tiles_of(cloud)]


def halves_of_street(name: str, work: Path) -> list[Part]:
    """Return tiles whose border runs along the middle of the street."""
    cloud = DRIVES[name].cloud(work)
    aside_m = np.array([0.0, TILE_M / 2, 0.0])
    folder = work / f"{name}_halves"
    cut = enumerate(half for _, half in tiles_of(replace(cloud, xyz_m=cloud.xyz_m + aside_m)))
    half = ((k, replace(half_street, xyz_m=half_street.xyz_m - aside_m)) for k, half_street in cut)
    return [masked(folder / f"{k}.laz", half_street, f"half_{k}") for k, half_street in half]


def tiles_as_drive(name: str, work: Path) -> list[Part]:
    """Return the tiles of a drive, compared with the raw stream of all of them."""
    cloud = DRIVES[name].cloud(work)
    cut = list(tiles_of(cloud))
    kept = np.sort(np.concatenate([points.record for _, points in cut]))
    raw = part_of(cloud.raw, kept, "all_tiles")
    folder = work / f"{name}_tiles"
    return [
        part(
            folder / f"{tile}.laz",
            replace(points, record=np.searchsorted(kept, points.record)),
            raw,
        )
        for tile, points in cut
    ]


def largest_tile(cloud: Cloud) -> Cloud:
    """Return the tile with the most points."""
    return max((points for _, points in tiles_of(cloud)), key=lambda points: len(points.time_s))


def tile_with_trajectory(name: str, work: Path) -> list[Part]:
    """Return the largest tile, read with the true path."""
    points = largest_tile(DRIVES[name].cloud(work))
    options = ("--range", f"trajectory:{points.path}")
    return [masked(work / f"{name}_tile.laz", points, "tile", options=options)]


def as_text(name: str, work: Path) -> list[Part]:
    """Return a drive as text: x, y, z and a time."""
    cloud = DRIVES[name].cloud(work)
    path = work / f"{name}_points.csv"
    if not path.exists():
        table = np.column_stack([cloud.xyz_m, cloud.time_s])
        np.savetxt(path, table, "%.3f,%.3f,%.3f,%.7f", header="x,y,z,gps_time", comments="")
    return [part(path, cloud)]


def as_ply(name: str, work: Path) -> list[Part]:
    """Return a drive as PLY: x, y, z and a time."""
    cloud = DRIVES[name].cloud(work)
    path = work / f"{name}_points.ply"
    if not path.exists():
        rows = np.zeros(
            len(cloud.time_s),
            np.dtype([(field_name, "<f8") for field_name in ("x", "y", "z", "GPS_time")]),
        )
        rows["x"], rows["y"], rows["z"] = cloud.xyz_m.T
        rows["GPS_time"] = cloud.time_s
        head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
        head += [f"property double {field_name}" for field_name in rows.dtype.names or ()]
        path.write_bytes("\n".join([*head, "end_header", ""]).encode() + rows.tobytes())
    return [part(path, cloud)]


# Hard ones


def changed(
    name: str,
    change: Callable[[Cloud], Cloud],
    word: str,
    work: Path,
) -> list[Part]:
    """Return a drive whose values are changed; all records stay."""
    return [part(work / f"{name}_{word}.laz", change(DRIVES[name].cloud(work)))]


def thinned(
    name: str,
    keep: Callable[[Cloud], I64 | Mask],
    word: str,
    work: Path,
) -> list[Part]:
    """Return some of the points of a drive."""
    cloud = DRIVES[name].cloud(work)
    kept = cloud.take(keep(cloud))
    return [masked(work / f"{name}_{word}.laz", kept, word)]


def in_steps(step_s: float, cloud: Cloud) -> Cloud:
    """Round times down; the order within a step is lost."""
    time_s = np.floor(cloud.time_s / step_s) * step_s
    return in_space(replace(cloud, time_s=time_s))


def scaled(factor: float, cloud: Cloud) -> Cloud:
    """Write coordinates in another unit as if they were metres."""
    return replace(cloud, xyz_m=cloud.xyz_m * factor)


def half(cloud: Cloud) -> Mask:
    """Keep half of the points at random."""
    return np.random.default_rng(2).random(len(cloud.time_s)) < 0.5


def without_noise(cloud: Cloud) -> Mask:
    """Keep all points but noise."""
    return np.asarray(cloud.truth != NOISE)


def one_in_5_cm(cloud: Cloud) -> I64:
    """Keep one point in every cube of 5 cm."""
    return delivered(cloud.xyz_m, np.ones(len(cloud.time_s), np.bool_))


def moved_half(cloud: Cloud) -> Cloud:
    """Move the second half of the drive by the height of a geoid, as after a change of the
    datum."""
    late = cloud.time_s > np.median(cloud.time_s)
    return replace(
        cloud, xyz_m=cloud.xyz_m + np.where(late, 45.0, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    )


def adjusted(cloud: Cloud) -> Cloud:
    """Move points by smooth centimetres, as a strip adjustment does."""
    phase = (cloud.time_s - CLOCK_S)[:, None] / np.array([7.0, 9.0, 11.0])
    return replace(cloud, xyz_m=cloud.xyz_m + 0.03 * np.sin(2.0 * np.pi * phase))


def joined(
    clouds: Sequence[Cloud],
    points: Path,
    order: Callable[[Cloud], I64] | None,
    word: str,
) -> list[Part]:
    """Return several clouds in one file, compared with the raw stream of each."""
    arrays = ("xyz_m", "time_s", "truth", "intensity", "return_number", "n_returns", "scanner")
    merged = {name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in arrays}
    number = np.repeat(np.arange(len(clouds)), [len(cloud.time_s) for cloud in clouds])
    record = np.concatenate(
        [np.searchsorted(np.sort(cloud.record), cloud.record) for cloud in clouds]
    )
    both = replace(clouds[0], **merged, record=np.arange(len(number)))
    index = np.arange(len(number)) if order is None else order(both)
    both = both.take(index)
    number = number[index]
    record = record[index]
    references = tuple(Reference(part_of(cloud.raw, cloud.record, word)) for cloud in clouds)
    rows = tuple(np.where(number == k, record, -1) for k in range(len(clouds)))
    return [Part(write_cloud(points, both), both.truth, references, rows)]


def two_passes(work: Path) -> list[Part]:
    """Return a tile that was passed twice, ten minutes apart."""
    first, second = (DRIVES[name].cloud(work) for name in ("first_pass", "second_pass"))
    second = replace(second, time_s=second.time_s + 600.0)
    corner = np.floor(np.median(first.xyz_m[:, :2], axis=0)) - TILE_M / 2

    def inside(cloud: Cloud) -> Cloud:
        return cloud.take(
            ((cloud.xyz_m[:, :2] >= corner) & (cloud.xyz_m[:, :2] < corner + TILE_M)).all(axis=1)
        )

    def order(cloud: Cloud) -> I64:
        return in_space(cloud).record

    return joined([inside(first), inside(second)], work / "two_passes.laz", order, "tile")


def two_profilers(is_numbered: bool, work: Path) -> list[Part]:
    """Return the clouds of two scanners of one vehicle in one file, sorted by time."""
    clouds = [DRIVES[name].cloud(work) for name in ("left", "right")]
    if is_numbered:
        clouds = [
            replace(cloud, scanner=cloud.scanner + k) for k, cloud in enumerate(clouds, start=1)
        ]
    # the heads are not in phase
    clouds[1] = replace(clouds[1], time_s=clouds[1].time_s + 0.0031)
    word = "numbered" if is_numbered else "not_numbered"

    def order(cloud: Cloud) -> I64:
        return np.argsort(cloud.time_s, kind="stable")

    return joined(clouds, work / f"two_profilers_{word}.laz", order, "whole")


@dataclass(frozen=True, slots=True)
class Turning:
    """A platform that turns sharply and back while it drives on."""

    platform: Platform
    turn_rad: float
    start_s: float
    seconds: float

    def pose(self, time_s: F64) -> Pose:
        """Return the pose, the turn added."""
        pose = self.platform.pose(time_s)
        share = np.clip((time_s - self.start_s) / self.seconds, 0.0, 1.0)
        smooth = 0.5 - 0.5 * np.cos(np.pi * share)
        return replace(pose, yaw=pose.yaw + self.turn_rad * smooth)


def sharp_turn(work: Path) -> list[Part]:
    """Return a drive that turns by 90 degrees within two seconds."""
    raw, path, kept_points = (
        work / f"sharp_turn{suffix}" for suffix in (".npz", "_path.csv", "_own.csv")
    )
    extra = work / "sharp_turn_world.npz"
    if not extra.exists():
        settings = load_settings("street", options={"seed": 5113, "duration_s": 6.0})
        scan = open_simulation("street", settings, with_world=True).scan
        turning = Turning(scan.platform, np.pi / 2, 2.0, 2.0)
        items = list(replace(scan, platform=turning).simulated())
        write_trajectory(kept_points, turning, 6.0)
        _move_path(kept_points, path)
        lookup = ClassCodes().lookup()
        blocks = [item.labelled.block for item in items]
        assert blocks[0].angle_rad is not None
        ranges = np.concatenate([block.range_m for block in blocks])
        time_s = np.concatenate([block.time_s for block in blocks if block.time_s is not None])
        angle_deg = np.rad2deg(blocks[0].angle_rad)
        np.savez(raw, range_m=ranges, angle_deg=angle_deg, time_s=time_s[:, 0])
        truth = np.concatenate([lookup[item.labelled.labels] for item in items])
        world = np.concatenate([item.world_m for item in items if item.world_m is not None])
        np.savez(extra, truth=truth, world=world, time_s=time_s)
    with np.load(extra) as arrays:
        world = arrays["world"].reshape(-1, 3)
        time_s = arrays["time_s"].ravel()
        truth = arrays["truth"].ravel()
    there = np.flatnonzero(np.isfinite(world[:, 0]))
    ones = np.ones(len(there), np.int64)
    codes = truth[there].astype(np.uint8)
    cloud = Cloud(
        world[there] + PLACE_M,
        time_s[there] + CLOCK_S,
        codes,
        raw,
        there,
        path,
        ones,
        ones,
        ones,
        0 * ones,
    )
    return [part(work / "sharp_turn_points.laz", cloud)]


# Real files


def real(name: str, work: Path, *, options: Options = POINTS) -> list[Part]:
    """Return a real file as it is."""
    del work
    return [Part(DATA / name, options=options)]


RIEGL = tuple(f"riegl/sample_riegl_18_0{number}.ply" for number in range(1, 6))


def riegl(work: Path) -> list[Part]:
    """Return the five RIEGL files as one cloud with coordinates and times.

    Their own labels are the reference.

    Without amplitudes nothing tells the strongest return of a shot: both take the first one.
    """
    points = work / "riegl_points.laz"
    labels = work / "riegl_labels"
    rows = np.concatenate([_ply_rows(DATA / name) for name in RIEGL])
    if not labels.exists():
        _must("classify", *(DATA / name for name in RIEGL), labels, "--set", "input.return=first")
    path_rows = np.concatenate(
        [np.load(labels / f"{Path(name).name}.labels.npy").ravel() for name in RIEGL]
    )
    n = len(rows)
    none = np.zeros(n, np.int64)
    xyz = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
    cloud = Cloud(
        xyz,
        rows["GPS_time"].astype(np.float64),
        path_rows,
        points,
        np.arange(n),
        points,
        none,
        none,
        none,
        none,
    )
    path = work / "riegl_path.csv"
    with np.load(DATA / "registered" / "riegl_mirror_centre.npz") as arrays:
        table = np.column_stack([arrays["gps_time"], arrays["centre"]])
    np.savetxt(path, table, "%.7f,%.4f,%.4f,%.4f", header="time,x,y,z", comments="")
    return [Part(write_cloud(points, cloud), path_rows, path=path, own_labels=path_rows)]


def _ply_rows(path: Path) -> np.ndarray[Any, Any]:
    """Read the vertices of a binary PLY."""
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    lines = head.decode().splitlines()
    order = ">" if "big_endian" in lines[1] else "<"
    kinds = {
        "double": "f8",
        "float": "f4",
        "float32": "f4",
        "float64": "f8",
        "int": "i4",
        "uchar": "u1",
        "uint8": "u1",
        "ushort": "u2",
        "uint": "u4",
        "int32": "i4",
    }
    properties = [line.split() for line in lines if line.startswith("property")]
    kind = np.dtype([(words[2], order + kinds[words[1]]) for words in properties])
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    return np.frombuffer(body, kind, count)


def jakarto_path(points: Path, estimate: Path) -> str:
    """Return how far the ranges from a path are from the recovered ranges."""
    las = laspy.read(points)
    with np.load(DATA / "profiler" / "jakarto_0.02s_recovered.npz") as arrays:
        range_m = arrays["range_m"].astype(np.float64)
    path = read_path(estimate)
    time_s = np.asarray(las.gps_time)
    station = np.stack([np.interp(time_s, path[:, 0], path[:, k]) for k in (1, 2, 3)], axis=1)
    apart = np.linalg.norm(np.stack([las.x, las.y, las.z], axis=1) - station, axis=1) - range_m
    return (
        f"ranges off by {np.median(np.abs(apart)):.4f} m, 95 % "
        f"{np.quantile(np.abs(apart), 0.95):.4f} m"
    )


CASES: tuple[tuple[str, tuple[Case, ...]], ...] = (
    (
        "Simulated drives, whole",
        tuple(
            Case(f"drive {name}", partial(whole, name), limit)
            for name, limit in (
                ("photon", 0.005),
                ("focus3d", 0.005),
                ("sick", 0.005),
                ("profiler", 0.005),
                ("vlp-16", 0.02),
                ("vlp-32c", 0.02),
                ("hdl-64e", 0.02),
                ("forest", 0.01),
            )
        ),
    ),
    (
        "Other forms",
        (
            Case("as text", partial(as_text, "sick"), 0.005),
            Case("as ply", partial(as_ply, "sick"), 0.005),
            Case("shuffled", partial(changed, "photon", in_space, "shuffled"), 0.005),
        ),
    ),
    (
        "Tiles of 50 m, sorted in space",
        (
            Case("tiles photon", partial(tiles, "photon")),
            Case("tiles sick", partial(tiles, "sick")),
            Case("tiles profiler", partial(tiles, "profiler")),
            Case("tiles vlp-16", partial(tiles, "vlp-16")),
            Case("tiles as drive photon", partial(tiles_as_drive, "photon"), 0.005, as_drive=True),
            Case(
                "tiles as drive profiler", partial(tiles_as_drive, "profiler"), 0.005, as_drive=True
            ),
            Case(
                "tiles that halve the street", partial(halves_of_street, "photon"), may_doubt=True
            ),
            Case("tile with trajectory", partial(tile_with_trajectory, "photon")),
        ),
    ),
    (
        "Hard ones: right, doubted, or refused",
        (
            Case("open field", partial(whole, "field"), may_doubt=True),
            Case("standing vehicle", partial(whole, "standing"), may_doubt=True),
            Case("sharp turn", sharp_turn, may_doubt=True),
            *(
                Case(
                    f"times in steps of {step_us} us {name}",
                    partial(changed, name, partial(in_steps, step_us * 1e-6), f"{step_us}us"),
                    may_doubt=True,
                )
                for name in ("photon", "profiler")
                for step_us in (1, 10, 100)
            ),
            Case("half deleted", partial(thinned, "photon", half, "half"), may_doubt=True),
            Case(
                "noise deleted",
                partial(thinned, "photon", without_noise, "no_noise"),
                may_doubt=True,
            ),
            Case("5 cm thinning", partial(thinned, "photon", one_in_5_cm, "5cm"), may_doubt=True),
            Case("two passes in a tile", two_passes, may_doubt=True),
            *(
                Case(
                    f"unit {unit}",
                    partial(changed, "photon", partial(scaled, factor), unit),
                    may_doubt=True,
                )
                for unit, factor in (("mm", 1000.0), ("cm", 100.0), ("feet", 1 / 0.3048))
            ),
            Case("strip adjustment", partial(changed, "photon", adjusted, "adjusted")),
            Case(
                "another datum from half on",
                partial(changed, "photon", moved_half, "datum"),
                may_doubt=True,
            ),
            Case("two profilers, numbered", partial(two_profilers, True)),
            Case("two profilers, no number", partial(two_profilers, False), may_doubt=True),
            Case("airborne strip", partial(real, "las/als_strip_labelled.laz"), must_doubt=True),
            Case("airborne profiler", partial(real, "registered/UAS_Clip.laz"), must_doubt=True),
            Case("handheld", partial(real, "registered/dbh.laz"), must_doubt=True),
            Case("one plane", partial(real, "las/plane.laz"), must_doubt=True),
            Case(
                "airborne tile",
                partial(real, "las/ign_tile_not_chronological.laz"),
                must_doubt=True,
            ),
        ),
    ),
    (
        "Real files",
        (
            Case("riegl", riegl, 0.01),
            Case(
                "jakarto",
                partial(real, "profiler/jakarto_0.02s.las"),
                check=jakarto_path,
                may_doubt=True,
            ),
            Case(
                "two heads, leaping clock",
                partial(real, "las/mls_not_in_time_order.las"),
                must_doubt=True,
            ),
        ),
    ),
)


# The page


HEADER = (
    "case",
    "verdict",
    "macro whole",
    "macro raw",
    "macro points",
    "loss",
    "same labels",
    *KINDS,
    "path, median / 95 % [m]",
    "covered",
    "CPU [s]",
    "M points a CPU second",
    "MiB",
    "info proposes points",
    "info CPU [s]",
    "info with points CPU [s]",
)


def cells(row: Row) -> list[str]:
    """Return a row of the table."""
    cpu_s = sum(run.cpu_s for run in row.runs)
    rate = row.n_points / max(cpu_s, 1e-9) / 1e6
    path = row.path
    return [
        row.name,
        row.verdict,
        _number(row.whole.get("macro")),
        _number(row.raw.get("macro")),
        _number(row.points.get("macro")),
        _number(row.loss),
        _number(row.same),
        *(_pair(row.raw.get(name), row.points.get(name)) for name in KINDS),
        "" if path is None else f"{path.median_m:.4f} / {path.most_m:.4f}",
        "" if path is None else f"{path.covered:.2f}",
        f"{cpu_s:.1f}",
        f"{rate:.2f}" if row.n_points else "",
        f"{max((run.mib for run in row.runs), default=float('nan')):.0f}",
        *_info_cells(row.plain_info),
        "" if row.info is None else f"{row.info.cpu_s:.1f}",
    ]


def _info_cells(run: Run | None) -> tuple[str, str]:
    if run is None:
        return "", ""
    return ("yes" if "--range points" in run.printed + run.said else "no"), f"{run.cpu_s:.1f}"


def _number(value: float | None) -> str:
    return "" if value is None or np.isnan(value) else f"{value:.3f}"


def _pair(raw: float | None, points: float | None) -> str:
    if raw is None and points is None:
        return ""
    return f"{_number(raw) or '-'} → {_number(points) or '-'}"


def said(row: Row) -> Iterator[str]:
    """Return the commands of a case and their warnings and errors."""
    runs = [run for run in (row.info, *row.runs) if run is not None]
    for run in runs:
        yield f"$ prc {' '.join(run.arguments)}    # exit code {run.code}"
        yield from run.messages() if run.code else ()
    if row.note:
        yield from (f"# {line}" for line in row.note.splitlines())


def main() -> None:
    """Run the cases and print the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, help="folder that keeps the inputs")
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="WORD", help="cases whose names contain a word"
    )
    parser.add_argument("--list", action="store_true", help="print the names of the cases")
    parser.add_argument(
        "--make",
        action="store_true",
        help="make the inputs and the labels of the raw streams alone",
    )
    options = parser.parse_args()
    if options.list:
        print("\n".join(case.name for _, cases in CASES for case in cases))
        return
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) if options.work is None else options.work.resolve()
        work.mkdir(parents=True, exist_ok=True)
        _page(work, options.only, only_inputs=options.make)


def _page(work: Path, words: Sequence[str], *, only_inputs: bool) -> None:
    print(heading("Figures of registered clouds", "registered"))
    print(
        "Every cell with an arrow is F1 of the raw stream → F1 of the points. The average "
        "is over ground, building,"
    )
    print(
        "vegetation, noise and stem. Memory is the peak of `prc classify`, or of `prc "
        "batch`. Times contain the start."
    )
    for title, cases in CASES:
        chosen = [case for case in cases if not words or any(word in case.name for word in words)]
        if not chosen:
            continue
        print(f"\n## {title}\n\n| {' | '.join(HEADER)} |\n|---|---|{'---:|' * (len(HEADER) - 2)}")
        notes = []
        for case in chosen:
            if only_inputs:
                _make(case, work)
                continue
            with tempfile.TemporaryDirectory(dir=work) as folder:
                try:
                    row = run_case(case, work, Path(folder))
                except NotMadeError as failure:
                    row = Row(case.name, "not measured", note=str(failure))
                text = (
                    "\n".join(said(row))
                    .replace(folder, "OUT")
                    .replace(str(work), "WORK")
                    .replace(str(DATA), "DATA")
                )
            print(f"| {' | '.join(cells(row))} |", flush=True)
            notes.append(f"\n{case.name}:\n\n```text\n{text}\n```")
        print("\n".join(notes), flush=True)
    print(duration())


def _make(case: Case, work: Path) -> None:
    """Make the inputs of a case and the labels of its raw streams; print their scores."""
    try:
        parts = case.make(work)
    except NotMadeError as failure:
        print(f"| {case.name}: {failure} |")
        return
    labelled = [piece for piece in parts if piece.references]
    if not labelled:
        return
    expected = [piece.expected() for piece in labelled]
    truth = np.concatenate([piece.truth for piece in labelled if piece.truth is not None])
    f1 = scores(np.concatenate([codes for codes, _ in expected]), truth)
    doubts = sorted(frozenset[str]().union(*(run.doubts for _, runs in expected for run in runs)))
    values = ", ".join(f"{name} {value:.3f}" for name, value in f1.items())
    print(
        f"| {case.name}, {len(parts)} files, {len(truth):,} points: {values} | "
        f"{', '.join(doubts)} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
