"""Labels of registered clouds (``--range points``) beside the labels of their raw streams.

    python -m benchmarks.registered > figures/registered.md
    python -m benchmarks.registered photon tiles      # cases whose names contain a word

A cloud has the coordinates (1 mm), times and returns of a simulated drive, without ranges, lines
and columns. The raw stream is the drive as it was simulated. A tile is compared with the raw
stream of the points inside it. Real clouds that are no drive of a profiler must be doubted.
"""

from __future__ import annotations

import re
import shlex
import tempfile
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np

from benchmarks.pages import DATA, duration, heading, parser_of, printed_at, say, table
from benchmarks.user import Done, run
from prc_cli.core.types import F64, I64, U8

PLACE_M = np.array([650_000.0, 6_860_025.0, 40.0])
"""Position of the simulated worlds on a map [m]."""
CLOCK_S = 3.0e8
"""GPS time of the start of a drive [s]."""
TILE_M = 50.0
FEWEST = 20_000
"""Points of a tile at least."""
KINDS = {"noise": 7, "ground": 2, "building": 6, "vegetation": 5, "car": 65, "pole": 69, "stem": 64}
CURB = 66
POINTS = ("--range", "points")
LEAST_COUNTED = 500
"""Points that a class needs in the reference to be in the average."""
FIELD = (
    "--set scene.setback_m=25 --set scene.trees=0 --set scene.parked=0 --set scene.people=0 "
    "--set scene.cars_per_km=0"
)
DRIVES = {
    "photon": "street --scanner photon-80 --duration 12 --seed 5101",
    "focus3d": "street --scanner focus3d-120 --duration 4 --seed 5102",
    "sick": "street --scanner sick-push-broom --duration 12 --seed 5103",
    "profiler": "street --scanner profiler-1mhz --duration 3 --seed 5104",
    "vlp-16": "street --scanner vlp-16 --duration 4 --seed 5105",
    "vlp-32c": "street --scanner vlp-32c --duration 2.5 --seed 5106",
    "hdl-64e": "street --scanner hdl-64e --duration 1.5 --seed 5107",
    "forest": "forest --scanner focus3d-120 --duration 4 --seed 5108",
    "open field": f"street --scanner photon-80 --duration 8 --seed 5109 --set sight_m=25 {FIELD}",
    "standing": "street --scanner photon-80 --duration 18 --seed 5110 --set trajectory.speed_m_s=4 "
    "--set trajectory.stop_every_m=45",
}
TILED = ("photon", "profiler", "vlp-16")
REAL = (
    "profiler/jakarto_0.02s.las",
    "las/als_strip_labelled.laz",
    "registered/UAS_Clip.laz",
    "registered/dbh.laz",
    "las/plane.laz",
    "las/ign_tile_not_chronological.laz",
    "las/mls_not_in_time_order.las",
)


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of a drive in firing order."""

    las: laspy.LasData
    """Records of the raw stream, in the order of its file."""
    order: I64
    """(n,), the record of every point."""
    xyz_m: F64
    """(n, 3), on the map [m]."""
    truth: U8
    """(n,), codes of the reference."""
    path: F64
    """Time, x, y, z of the scanner on the map, (m, 4)."""

    def write(self, target: Path, index: I64) -> None:
        """Write some of the points with nothing but coordinates, times and returns."""
        las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
        las.header.scales = np.full(3, 0.001)
        las.header.offsets = np.floor(self.xyz_m.min(axis=0))
        las.x, las.y, las.z = self.xyz_m[index].T
        record = self.order[index]
        las.gps_time = np.asarray(self.las.gps_time)[record] + CLOCK_S
        for name in ("intensity", "return_number", "number_of_returns"):
            las[name] = self.las[name][record]
        las.write(target)

    def raw_labels(self, index: I64, folder: Path) -> U8:
        """Return the labels of the raw stream without all other points."""
        # rings fire in turns: sorted by time, the lines of their file would be torn apart
        record = np.sort(self.order[index])
        las = laspy.LasData(self.las.header, self.las.points[record])
        las.write(folder / "raw.laz")
        done, codes = labels_of("raw.laz", folder, "--trust-order")
        if codes is None:
            raise RuntimeError(done.stderr)
        return codes[np.searchsorted(record, self.order[index])]


def drive(words: str, folder: Path) -> Cloud:
    """Simulate a drive and register its points."""
    kind, *options = shlex.split(words)
    raw = folder / "drive.laz"
    track = folder / "track.csv"
    run("simulate", kind, raw, *options, "--trajectory", track, "-q", "--overwrite")
    las = laspy.read(raw)
    order = np.argsort(np.asarray(las.gps_time), kind="stable")
    path = np.loadtxt(track, delimiter=",", skiprows=1)[:, :4] + [CLOCK_S, *PLACE_M]
    xyz_m = np.stack([las.x, las.y, las.z], axis=1)[order] + PLACE_M
    truth = np.asarray(las.classification)[order].astype(np.uint8)
    return Cloud(las, order, xyz_m, truth, path)


def labels_of(name: str, folder: Path, *options: str) -> tuple[Done, U8 | None]:
    """Classify a file; for a raw stream (``--trust-order``) doubts are accepted.

    Records without a cell would stay without a class, so this doubt is not.
    """
    output = folder / f"{name}.npy"
    output.unlink(missing_ok=True)
    accepted: list[str] = []
    for _ in range(6):
        done = run(
            "classify", folder / name, output, "--overwrite", *options, *accepted, check=False
        )
        checks = doubts_of(done) - {*accepted, "unplaced"}
        if "--trust-order" not in options or done.code != 1 or not checks:
            break
        accepted += [word for check in checks for word in ("--accept-doubt", check)]
    return done, np.load(output).ravel() if output.exists() else None


def doubts_of(done: Done) -> set[str]:
    """Return the names of the checks in warnings and errors."""
    pattern = r"(?:^warning: |--accept-doubt )([a-z-]+)"
    return set(re.findall(pattern, done.stderr, re.MULTILINE))


def scores(codes: U8, truth: U8) -> dict[str, float]:
    """Return F1 of every class and their mean; curbs are ground."""
    codes, truth = (np.where(side == CURB, KINDS["ground"], side) for side in (codes, truth))
    f1 = {}
    for name, code in KINDS.items():
        is_true = truth == code
        is_named = codes == code
        if is_true.sum() >= LEAST_COUNTED:
            f1[name] = 2.0 * (is_true & is_named).sum() / (is_true.sum() + is_named.sum())
    f1["macro"] = float(np.mean(list(f1.values()))) if f1 else np.nan
    return f1


def path_error(estimate: Path, truth: F64) -> tuple[float, float]:
    """Return the median of the distances to the true path [m], and what 95 % stay below."""
    if not estimate.exists():
        return np.nan, np.nan
    rows = np.loadtxt(estimate, delimiter=",", skiprows=1, usecols=(0, 1, 2, 3))
    rows = rows[(rows[:, 0] >= truth[0, 0]) & (rows[:, 0] <= truth[-1, 0])]
    at = [np.interp(rows[:, 0], truth[:, 0], truth[:, axis]) for axis in (1, 2, 3)]
    off_m = np.linalg.norm(rows[:, 1:] - np.stack(at, axis=1), axis=1)
    return float(np.median(off_m)), float(np.quantile(off_m, 0.95))


def in_tiles(cloud: Cloud) -> list[I64]:
    """Return the points of every tile, sorted in space and not in time."""
    square = np.floor(cloud.xyz_m[:, :2] / TILE_M).astype(np.int64)
    small = np.floor(cloud.xyz_m[:, :2]).astype(np.int64)
    order = np.lexsort((np.random.default_rng(1).random(len(small)), small[:, 0], small[:, 1]))
    tiles = (order[(square[order] == tile).all(axis=1)] for tile in np.unique(square, axis=0))
    return [tile for tile in tiles if len(tile) >= FEWEST]


def row_of(name: str, cloud: Cloud, index: I64, folder: Path) -> list[object]:
    """Return a row: what the labels of the points lose beside those of the raw stream."""
    cloud.write(folder / "points.laz", index)
    done, codes = labels_of("points.laz", folder, *POINTS)
    path = folder / "path.csv"
    path.unlink(missing_ok=True)
    run("info", folder / "points.laz", *POINTS, "--path", path, "--overwrite", check=False)
    raw = scores(cloud.raw_labels(index, folder), cloud.truth[index])
    points = scores(codes, cloud.truth[index]) if codes is not None else {}
    median_m, most_m = path_error(path, cloud.path)
    return [
        name,
        verdict(done, raw["macro"] - points.get("macro", np.nan)),
        *(
            f"{printed_at(raw[kind])} → {printed_at(points.get(kind, np.nan))}"
            if kind in raw
            else ""
            for kind in ("macro", *KINDS)
        ),
        f"{printed_at(median_m)} / {printed_at(most_m)}",
        f"{len(index) / done.cpu_s / 1e6:.2f}",
        f"{done.peak_mib:.0f}",
    ]


def verdict(done: Done, lost: float) -> str:
    """Return right (at most .02 lost), doubted, refused, or silently wrong."""
    doubts = ", ".join(sorted(doubts_of(done)))
    if done.code not in (0, 4):
        return f"refused: {doubts or done.stderr.split(': ', 2)[-1][:60]}"
    right = "right" if lost <= 0.02 else "wrong"
    return f"{right}, doubted: {doubts}" if doubts else right if right == "right" else "SILENT"


def main() -> None:
    """Print the page."""
    parser = parser_of(__doc__)
    parser.add_argument("words", nargs="*", help="print only cases whose names contain a word")
    words = parser.parse_args().words
    print(heading("Figures of registered clouds", "registered"))
    say("""F1 of the raw stream → F1 of the points. The average is over the classes with at least
    500 points. Path: median / 95 % of the distances to the true one.""")
    header = ("case", "verdict", "macro", *KINDS, "path [m]", "M points a CPU second", "MiB")
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for title, options in DRIVES.items():
            cases = [title, *([f"{title}, tiles"] if title in TILED else [])]
            cases = [case for case in cases if not words or any(word in case for word in words)]
            if not cases:
                continue
            cloud = drive(options, folder)
            if title in cases:
                rows.append(row_of(title, cloud, np.arange(len(cloud.truth)), folder))
            for number, tile in enumerate(in_tiles(cloud) if cases[-1] != title else ()):
                rows.append(row_of(f"{title}, tile {number + 1}", cloud, tile, folder))
        table(header, rows)
        print("## Real clouds that are no drive, or no whole one\n")
        table(("file", "verdict"), real_rows(words, folder))
    print(duration())


def real_rows(words: list[str], folder: Path) -> list[tuple[str, str]]:
    """Return what prc says of real clouds; labels without a warning would be wrong."""
    rows = []
    for name in REAL:
        if (DATA / name).exists() and (not words or any(word in name for word in words)):
            output = folder / "real.npy"
            done = run("classify", DATA / name, output, *POINTS, "--overwrite", check=False)
            output.unlink(missing_ok=True)
            rows.append((name, verdict(done, np.inf)))
    return rows


if __name__ == "__main__":
    main()
