"""Labels of spinning scanners on real labelled frames, beside Patchwork++ where it is installed.

    # frames whose names begin so; all by default
    python -m benchmarks.rings [NAME ...] > figures/rings.md

Every frame is a file of its own, read by ``prc_cli.classify`` with nothing told. Ground is judged
in three ways: with vegetation left out, with vegetation lower than 1.3 m below the scanner as
ground (both as in the papers on Patchwork), and with vegetation as a class of its own."""

from __future__ import annotations

import sys
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.contest_data import view_paths
from benchmarks.contest_judge import THINGS, UNKNOWN, mapping_of
from benchmarks.contest_peers import ground_of, installed, patchworkpp
from benchmarks.pages import DATA, duration, heading, say, table
from prc_cli import ClassCodes, DoubtWarning, Label, classify
from prc_cli.core.types import F32, I64, U8, Mask

IGNORED = 255
OTHER = 1
"""Reference codes of what is not judged, and of classes that no figure is of.

People, cycles, signs.
"""
CODES = {label.name.lower(): ClassCodes().code(label) for label in Label}
GROUND = CODES["ground"]
VEGETATION = CODES["vegetation"]
NOISE = CODES["noise"]
LOW_M = -1.3
"""Vegetation lower than this is ground in the second way [m]."""
SCANNER_M = {"kitti": 1.73, "nuscenes": 1.84, "vlp32": 1.8, "av2_up": 1.97, "av2_down": 1.86}
"""Height of the scanners above the ground, which Patchwork++ is told [m]."""
REGULAR_VEHICLE = 19
"""Argoverse 2: boxes of cars; those of lorries and buses are other things here."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A file, and the class of every record."""

    name: str
    group: str
    path: Path
    xyz_m: F32
    """(n, 3) float32, relative to the scanner, z up [m]; NaN = missing."""
    codes: U8
    """(n,) uint8, in the order of the file; IGNORED = not judged."""
    is_tuned: bool
    """Whether limits were chosen on it."""


def frames(folder: Path) -> Iterator[Frame]:
    """Write the files of all frames to a folder.

    Even views chose limits, and the first of two others.
    """
    for kind in ("kitti", "nuscenes", "vlp32"):
        for path in view_paths(kind):
            yield _view(path, kind, folder)
    reference = np.fromfile(DATA / "kitti" / "000000.label", np.uint32).astype(np.int64) & 0xFFFF
    frame = np.fromfile(DATA / "kitti" / "000000.bin", np.float32).reshape(-1, 4)[:, :3]
    yield Frame(
        "kitti_000000",
        "kitti",
        DATA / "kitti" / "000000.bin",
        frame,
        coded(reference, "kitti"),
        False,
    )
    for name in ("000010", "000030"):
        yield _snow(name, folder)
    yield from argoverse(folder)


def coded(codes: I64, kind: str) -> U8:
    """Return codes of prc for those of a data set, (n,) uint8.

    ``kind`` is a key of ``contest_judge.MAPPINGS``. Lorries and buses are cars, fences buildings,
    trunks vegetation; outliers are not judged.
    """
    lookup = np.full(int(codes.max()) + 1, OTHER, np.uint8)
    listed = {**mapping_of(kind).reference, **THINGS[kind]}
    listed["missing"] = (*listed.pop("noise", ()), *UNKNOWN.get(kind, [0]))
    for name, values in listed.items():
        known = [value for value in values if value < len(lookup)]
        lookup[known] = IGNORED if name == "missing" else CODES[name]
    return lookup[codes]


def _view(path: Path, kind: str, folder: Path) -> Frame:
    """Write a range view as lines of rings, from low to high."""
    with np.load(path) as arrays:
        ranges = arrays["range_m"]
        xyz = arrays["xyz"].astype(np.float32)
        codes = arrays["label"].astype(np.int64)
    xyz[np.isnan(ranges)] = np.nan
    elevation = _medians(np.rad2deg(np.arctan2(xyz[..., 2], np.hypot(xyz[..., 0], xyz[..., 1]))))
    order = np.argsort(elevation)[: np.count_nonzero(np.isfinite(elevation))]
    ranges, xyz, codes = (
        np.ascontiguousarray(np.swapaxes(array[order], 0, 1)) for array in (ranges, xyz, codes)
    )
    file = folder / path.name
    np.savez(file, range_m=ranges, xyz=xyz, zenith_deg=90.0 - elevation[order])
    group = f"{kind}_views" if kind == "kitti" else kind
    reference = coded(codes.ravel(), "views_kitti" if kind == "kitti" else "views_nuscenes")
    is_tuned = int(path.stem.rsplit("_", 1)[1]) % 2 == 0
    return Frame(path.stem, group, file, xyz.reshape(-1, 3), reference, is_tuned)


def _medians(values: NDArray[np.floating]) -> NDArray[np.floating]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rings without a return
        return np.asarray(np.nanmedian(values, axis=1))


def _snow(name: str, folder: Path) -> Frame:
    """Write a frame with snow as lines of equal azimuth."""
    stored = np.fromfile(DATA / "snow" / f"{name}.bin", np.float32).reshape(64, -1, 4)
    labels = np.fromfile(DATA / "snow" / f"{name}.label", np.uint32).reshape(64, -1)
    n_lines = stored.shape[1]
    image = np.full((n_lines, 64, 4), np.nan, np.float32)
    codes = np.full((n_lines, 64), IGNORED, np.uint8)
    ring, column = np.nonzero((stored != -1).any(axis=-1))
    shots = stored[ring, column]
    azimuth = np.pi - np.arctan2(shots[:, 1], shots[:, 0])
    line = (azimuth / (2 * np.pi) * n_lines).astype(np.int64) % n_lines
    image[line, ring] = shots
    codes[line, ring] = np.where(labels[ring, column] == 1, NOISE, OTHER)
    seen = np.isfinite(image[..., 0]).any(axis=0)
    xyz = np.ascontiguousarray(image[:, seen][:, ::-1, :3])
    ranges = np.sqrt((xyz**2).sum(axis=-1))
    file = folder / f"snow_{name}.npz"
    np.savez(file, range_m=ranges, xyz=xyz, intensity=image[:, seen][:, ::-1, 3])
    return Frame(
        f"snow_{name}",
        "snow",
        file,
        xyz.reshape(-1, 3),
        codes[:, seen][:, ::-1].ravel(),
        name == "000010",
    )


def argoverse(folder: Path) -> Iterator[Frame]:
    """Write the two scanners of a sweep as PLY, each in its own frame.

    The lower one hangs upside down.
    """
    feather = import_module("pyarrow.feather")
    rotation = import_module("scipy.spatial.transform").Rotation
    home = DATA / "av2"
    sweep = feather.read_table(home / "315966265259836000.feather")
    truth = feather.read_table(home / "315966265259836000_labels.feather")
    poses = {
        row["sensor_name"]: row
        for row in feather.read_table(home / "egovehicle_SE3_sensor.feather").to_pylist()
    }
    is_ground, box = (
        truth[name].to_numpy(zero_copy_only=False) for name in ("is_ground", "box_class")
    )
    vehicle_m = np.stack([sweep[axis].to_numpy().astype(np.float64) for axis in "xyz"], axis=1)
    laser = sweep["laser_number"].to_numpy()
    for k, name in enumerate(("up", "down")):
        pose = poses[f"{name}_lidar"]
        of_scanner = laser // 32 == k
        turn = rotation.from_quat([pose[key] for key in ("qx", "qy", "qz", "qw")])
        xyz = (
            turn.inv()
            .apply(vehicle_m[of_scanner] - [pose[key] for key in ("tx_m", "ty_m", "tz_m")])
            .astype(np.float32)
        )
        kinds = [*((name, "<f4") for name in ("x", "y", "z", "intensity"))]
        kinds += [("ring", "<u2"), ("time", "<f8")]
        rows = np.zeros(len(xyz), kinds)
        rows["x"], rows["y"], rows["z"] = xyz.T
        rows["intensity"] = sweep["intensity"].to_numpy()[of_scanner]
        rows["ring"] = laser[of_scanner] % 32
        rows["time"] = sweep["offset_ns"].to_numpy()[of_scanner] * 1e-9
        file = folder / f"av2_{name}.ply"
        types = {"<f4": "float", "<u2": "ushort", "<f8": "double"}
        head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
        head += [f"property {types[kind]} {field}" for field, kind in kinds]
        file.write_bytes("\n".join([*head, "end_header", ""]).encode() + rows.tobytes())
        codes = np.where(
            is_ground[of_scanner],
            GROUND,
            np.where(box[of_scanner] == REGULAR_VEHICLE, CODES["car"], OTHER),
        ).astype(np.uint8)
        xyz = xyz * np.array([1, 1, 1 if name == "up" else -1], np.float32)
        yield Frame(f"av2_{name}", f"av2_{name}", file, xyz, codes, name == "up")


def label(frame: Frame, folder: Path) -> tuple[U8, str]:
    """Return the codes of a frame's records, and what was doubted."""
    output = folder / f"{frame.name}.labels.npy"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtWarning)
        summary = classify(frame.path, output, overwrite=True)
    doubts = [finding.check for finding in summary.findings if finding.verdict.name != "FINE"]
    codes = np.load(output).ravel().astype(np.uint8)
    return codes, ", ".join(doubts)


def patchwork(frame: Frame) -> Mask | None:
    """Return the ground of Patchwork++, None where it is not installed."""
    if installed("patchwork") is None:
        return None
    filtered = patchworkpp(SCANNER_M[frame.group.removesuffix("_views")])
    there = np.flatnonzero(np.isfinite(frame.xyz_m[:, 0]))
    points = np.column_stack([frame.xyz_m[there], np.zeros(len(there), np.float32)])
    is_ground = np.zeros(len(frame.xyz_m), bool)
    is_ground[there[ground_of(filtered, points)]] = True
    return is_ground


@dataclass(frozen=True, slots=True)
class Score:
    """How well one class was found."""

    precision: float
    recall: float

    @classmethod
    def of(cls, is_found: Mask, reference: Mask) -> Score:
        """Compare two masks."""
        both = int(np.count_nonzero(is_found & reference))
        return cls(
            both / max(np.count_nonzero(is_found), 1), both / max(np.count_nonzero(reference), 1)
        )

    @property
    def f1(self) -> float:
        """F1."""
        return 2 * self.precision * self.recall / max(self.precision + self.recall, 1e-9)


def ground_scores(frame: Frame, is_ground: Mask) -> dict[str, Score]:
    """Judge the ground in the ways that the data set allows."""
    reference = frame.codes
    there = np.isfinite(frame.xyz_m[:, 0]) & (frame.codes != IGNORED)
    is_judged = there & (reference != VEGETATION)
    scores_by_class = {"ground": Score.of(is_ground[is_judged], reference[is_judged] == GROUND)}
    if frame.group.startswith("kitti"):
        is_low = (reference == VEGETATION) & (frame.xyz_m[:, 2] < LOW_M)
        scores_by_class["ground, low plants too"] = Score.of(
            is_ground[there], ((reference == GROUND) | is_low)[there]
        )
    if not frame.group.startswith("av2"):
        scores_by_class["ground, plants apart"] = Score.of(
            is_ground[there], reference[there] == GROUND
        )
    return scores_by_class


def scores(frame: Frame, codes: U8) -> dict[str, Score]:
    """Judge all classes of a frame."""
    there = np.isfinite(frame.xyz_m[:, 0]) & (frame.codes != IGNORED)
    if frame.group == "snow":
        return {"snow": Score.of(codes[there] == NOISE, frame.codes[there] == NOISE)}
    frame_scores = ground_scores(frame, codes == GROUND)
    for name in ("building", "vegetation", "car", "pole"):
        code = CODES[name]
        if np.count_nonzero(frame.codes == code) and not frame.group.startswith("av2"):
            frame_scores[name] = Score.of(codes[there] == code, frame.codes[there] == code)
    return frame_scores


Means = dict[tuple[str, bool], list[tuple[dict[str, Score], dict[str, Score]]]]
"""Scores of prc and of Patchwork++, by group of frames and whether they chose limits."""


def rows_of(wanted: tuple[str, ...], means: Means) -> Iterator[tuple[str, ...]]:
    """Yield a row for every class of every frame, and collect the scores."""
    with tempfile.TemporaryDirectory() as folder:
        for frame in frames(Path(folder)):
            if wanted and not frame.name.startswith(wanted):
                continue
            codes, doubts = label(frame, Path(folder))
            frame_scores = scores(frame, codes)
            mask = None if frame.group == "snow" else patchwork(frame)
            peer_scores = {} if mask is None else ground_scores(frame, mask)
            means.setdefault((frame.group, frame.is_tuned), []).append((frame_scores, peer_scores))
            for name, score in frame_scores.items():
                beside = _cell(peer_scores[name]) if name in peer_scores else ""
                yield frame.name, _yes(frame.is_tuned), name, _cell(score), beside, doubts


def main() -> None:
    """Print the table of all frames, and the means of those that chose limits and those that did
    not."""
    means: Means = {}
    print(heading("Figures of rings", "rings"))
    say("""F1 (precision, recall), nothing told but the file. Patchwork++ 1.4 is told the scanner's
    height.""")
    header = ("frame", "limits chosen on it", "class", "prc", "Patchwork++")
    table((*header, "doubts"), rows_of(tuple(sys.argv[1:]), means))
    print("## Means of F1\n")
    rows = []
    for (group, is_tuned), pairs in means.items():
        for name in pairs[0][0]:
            f1 = [[pair[k][name].f1 for pair in pairs if name in pair[k]] for k in (0, 1)]
            cells = (f"{np.mean(values):.3f}" if values else "" for values in f1)
            rows.append((f"{group} ({len(pairs)})", _yes(is_tuned), name, *cells))
    table(header, rows)
    print(duration())


def _yes(is_so: bool) -> str:
    return "yes" if is_so else "no"


def _cell(score: Score) -> str:
    return f"{score.f1:.3f} ({score.precision:.3f}, {score.recall:.3f})"


if __name__ == "__main__":
    main()
