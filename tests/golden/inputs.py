"""Inputs of the golden cases, from one seed, without using the package."""

import json
import re
import struct
import uuid
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from laspy.vlrs.known import VLR

ROOT = Path(__file__).resolve().parents[2]
N_LINES = 110
M = 90
Array = np.ndarray[Any, Any]


def image() -> Array:
    """Ranges [m] of a street, (N_LINES, M) float32.

    Ground below, two walls, noisy leaves, NaN in the sky.
    """
    rng = np.random.default_rng(14)
    angle = np.deg2rad(angles())
    ground = 2.0 / np.maximum(np.cos(angle), 1e-3)
    wall = 7.0 / np.maximum(np.abs(np.sin(angle)), 1e-3)
    range_m = np.minimum(ground, wall) * np.ones((N_LINES, 1)) + rng.normal(0, 0.004, (N_LINES, M))
    range_m[30:80, 60:75] += rng.uniform(-2, 2, (50, 15))
    range_m[:, np.abs(angles()) > 140] = np.nan
    range_m[rng.uniform(size=range_m.shape) < 0.05] = np.nan
    return range_m.astype(np.float32)


def angles() -> Array:
    """Angles of the columns from straight down [deg]."""
    return np.arange(M) * 4.0 - 180


def make(folder: Path) -> None:
    """Write every input into a folder."""
    range_m = image()
    range_m.tofile(folder / "drive.bin")
    range_m[:-1].ravel()[:-7].tofile(folder / "short.bin")
    # a drive in three files, which end within a line and after less than a line
    for number, part in enumerate(np.split(range_m.ravel(), [3677, 3690])):
        part.tofile(folder / f"drive_{number}.bin")
    np.save(folder / "drive.npy", range_m)
    np.save(folder / "three.npy", range_m[None].repeat(3, 0))
    np.savez(
        folder / "drive.npz", range_m=range_m, angle_deg=angles(), line_time=np.arange(N_LINES) / 50
    )
    _layouts(folder, range_m)
    _tables(folder, range_m)
    for form in range(11):
        _las(folder / f"f{form}.las", form, range_m)
    for form in (1, 3, 6, 8):
        _las(folder / f"bare{form}.laz", form, range_m, bare=True)
    las = laspy.read(folder / "f6.las")
    order = np.random.default_rng(2).permutation(len(las))[: len(las) * 9 // 10]
    las.points = las.points[order]
    las.classification[:] = 1
    las.write(folder / "registered.laz")
    _organised(folder, range_m)
    frame().tofile(folder / "frame.bin")
    flat = [(x / 10, y / 10, 0, 2) for x in range(100) for y in range(100)]
    post = [(5, 5, z / 20, 6) for z in range(1, 81)]
    table = np.array(flat + post).T
    _csv(folder / "post.csv", dict(zip(("x", "y", "z", "class"), table, strict=True)))


def frame() -> Array:
    """x, y, z and intensity of a turn of 16 rings as KITTI stores it; two points share a cell."""
    turn, ring = np.meshgrid(np.linspace(-np.pi, np.pi, 720, endpoint=False), np.arange(16))
    turn, ring = (np.insert(part, [5, 900], part.flat[[5, 900]]) for part in (turn, ring))
    up = np.deg2rad(2.0 - ring * 2.0)
    far = 8 + np.sin(turn * 3)
    far[[5, 901]] *= 1.01
    xyz = far * (np.cos(up) * np.cos(turn), -np.cos(up) * np.sin(turn), np.sin(up))
    return np.column_stack([*xyz, np.arange(len(turn)) % 7]).astype("<f4")


def make_spoilt(street: str, forest: str, static: str, rings: str) -> None:
    """Write simulated scans on a grid of 12.5 cm, with stray and missing shots."""
    rng = np.random.default_rng(6)

    def spoilt(values: Array) -> Array:
        image = np.round(8 * values.T) / 8
        return (image * rng.choice([1] * 20 + [0.4, np.nan], image.shape[-2:])).T

    for name, path, step in (("street", street, 9), ("forest", forest, 11)):
        scan = np.load(path)
        ranges = spoilt(scan["range_m"])[:, ::step]
        np.savez(name, range_m=ranges, angle_deg=scan["angle_deg"][::step])
    for name, path, step in (("scan", static, 8), ("rings", rings, 1)):
        np.savez(name, xyz=spoilt(np.load(path)["xyz"])[:, ::step])


def make_misread(source: str) -> None:
    """Write a scan as dumps whose shots or lines are not in the order they were fired."""
    ranges = np.load(source)
    rng = np.random.default_rng(5)
    half = len(ranges) // 2
    two = ranges[:half], np.roll(ranges[half:], 200, axis=1)
    dumps = {
        "right": ranges,
        "shots": rng.permutation(ranges.ravel()),
        "lines": rng.permutation(ranges),
        "columns": ranges.T,
        "zigzag": np.stack([ranges[::2], ranges[1::2, ::-1]], axis=1),
        "lost": np.delete(ranges, slice(144_000, 144_260)),
        "two_by_line": np.stack(two, axis=1),
        "two_by_shot": np.stack(two, axis=2),
    }
    for name, image in dumps.items():
        image.tofile(f"{name}.bin")


def make_doubtful(source: str) -> None:
    """Write a scan as dumps that may be as they should, or not."""
    ranges = np.load(source)
    rng = np.random.default_rng(5)
    chance = rng.random(ranges.shape)
    dumps = {
        "standing": ranges[:1] * rng.normal(1, 5e-4, ranges.shape),
        "dropouts": np.where(chance < 0.1, np.nan, ranges),
        "few": np.where(chance < 0.99, np.nan, ranges),
        "rounded": np.round(ranges / 0.031) * 0.031,
        "code": np.nan_to_num(ranges, nan=120),
        "repeated": np.concatenate([ranges[:200], ranges[150:]]),
    }
    for name, image in dumps.items():
        image.astype(np.float32).tofile(f"{name}.bin")


def make_stored(source: str) -> None:
    """Write a scan as dumps of many types, units and headers, missing shots as 0."""
    ranges = np.nan_to_num(np.load(source)[:160])
    for name, factor, kind, before, after in (
        ("big", 1, ">f4", b"", b""),
        ("double", 1, "f8", b"", b""),
        ("millimetres", 1000, "f4", b"", b""),
        ("u2", 1000, "u2", b"", b""),
        ("centimetres", 100, "u2", b"", b""),
        ("header", 1, "f4", b"ab", b"xy"),
        ("three", 1000, ">u4", b"abc", b"x"),
    ):
        Path(f"{name}.bin").write_bytes(before + (factor * ranges).astype(kind).tobytes() + after)


def _layouts(folder: Path, range_m: Array) -> None:
    centimetres = np.where(np.isnan(range_m), 65535, np.nan_to_num(range_m) * 100).astype(">u2")
    (folder / "u2.dat").write_bytes(b"SCAN v1".ljust(64, b"\0") + centimetres.tobytes())
    shots = np.zeros(
        range_m.size, np.dtype([("range", "<i4"), ("intensity", "<u2"), ("padding", "V2")])
    )
    shots["range"] = np.nan_to_num(range_m * 1000).ravel()
    shots["intensity"] = np.arange(range_m.size) % 900
    shots.tofile(folder / "i4.raw")
    timed = np.zeros(range_m.size, np.dtype([("range", "<f4"), ("angle", "<i4"), ("time", "<f8")]))
    number = np.arange(range_m.size)
    timed["range"] = np.nan_to_num(range_m, nan=-1).ravel()
    timed["angle"] = number % M * 40000
    timed["time"] = 400_000 + number / (50 * M)
    timed[number % 17 != 3].tofile(folder / "rat.raw")
    rows = [
        f"{i / 27050:.6f}  {-1 if np.isnan(r) else round(r * 1000)}\t87  0"
        for i, r in enumerate(range_m.flat)
    ]
    (folder / "noheader.txt").write_text(
        "% time  range  intensity  status\n" + "\n".join(rows) + "\n"
    )
    for name in (
        "big_endian_u2_cm",
        "faro_like_i4_mm",
        "csv_no_header",
        "range_angle_time",
        "ranges_f32",
    ):
        text = (ROOT / "sample_configs" / "layouts" / f"{name}.toml").read_text()
        for m in (1080, 5120, 541, 2154):
            text = text.replace(f"points_per_line = {m}", f"points_per_line = {M}")
        (folder / f"{name}.toml").write_text(text)


def _table(range_m: Array) -> dict[str, Array]:
    line, column = np.divmod(np.arange(range_m.size), M)
    angle = np.deg2rad(angles())[column]
    r = range_m.ravel().astype(np.float64)
    label = np.where(np.abs(angle) < 1.2, 2, np.where((column > 58) & (column < 76), 5, 6))
    return {
        "line": line,
        "column": column,
        "angle_deg": angles()[column],
        "range_m": r.round(4),
        "time_s": 1000 + (line * M + column) / (50 * M),
        "x": line * 0.1,
        "y": (r * np.sin(angle)).round(4),
        "z": (-r * np.cos(angle)).round(4),
        "intensity": column * 7,
        "id": np.arange(range_m.size),
        "class": np.where(np.isnan(r), 0, label),
    }


def _rows(table: dict[str, Array], chosen: Array) -> dict[str, Array]:
    return {name: values[chosen] for name, values in table.items()}


def _csv(path: Path, table: dict[str, Array]) -> None:
    lines = (
        ",".join("" if v != v else f"{v:.12g}" for v in row)
        for row in zip(*table.values(), strict=True)
    )
    path.write_bytes(("\n".join([",".join(table), *lines]) + "\n").encode())


def _tables(folder: Path, range_m: Array) -> None:
    table = _table(range_m)
    there = np.flatnonzero(~np.isnan(table["range_m"]))
    returned = _rows(table, there)
    _csv(folder / "drive.csv", table)
    _csv(folder / "shuffled.csv", _rows(table, np.random.default_rng(3).permutation(there)))
    _csv(
        folder / "gaps.csv",
        {name: v for name, v in returned.items() if name not in ("line", "column")},
    )
    _csv(folder / "xyz.csv", {name: returned[name] for name in "xyz"})
    path = _rows(table, np.arange(0, range_m.size, M // 3))
    _csv(
        folder / "path.csv",
        {"time": path["time_s"], "x": path["x"], "y": 0 * path["x"], "z": 0 * path["x"]},
    )
    np.save(folder / "reference.npy", table["class"].astype(np.uint8))
    steps = [f"{999 + i / 4},{i * 1.25 + 649_995},6860000,0" for i in range(40)]
    (folder / "line.csv").write_text("\n".join(["time,x,y,z", *steps]) + "\n")
    (folder / "gap.csv").write_text("\n".join(["time,x,y,z", *steps[:4], *steps[12:]]) + "\n")
    (folder / "early.csv").write_text("\n".join(["time,x,y,z", *steps[:6]]) + "\n")


def _las(
    path: Path,
    form: int,
    range_m: Array,
    *,
    bare: bool = False,
) -> None:
    """Write a LAS file with VLR, EVLR, extra bytes, several returns and scanners.

    ``bare``: without the extra bytes.
    """
    table = _table(range_m)
    table = _rows(table, ~np.isnan(table["range_m"]))
    n = len(table["x"])
    twice = np.sort(np.r_[np.arange(n), np.arange(5, n, 9)])
    second = np.r_[False, twice[1:] == twice[:-1]]
    double = second | np.r_[second[1:], False]
    table = _rows(table, twice)
    header = laspy.LasHeader(
        point_format=form, version="1.4" if form >= 6 else "1.3" if form >= 4 else "1.2"
    )
    header.scales = np.array([0.001, 0.001, 0.0005])
    header.offsets = np.array([650_000.0, 6_860_000.0, -3.5])
    header.creation_date = None
    header.uuid = uuid.UUID(int=14)
    header.vlrs.append(VLR("golden", 7, "kept as it is", b"\x01\xff" * 30))
    if not bare:
        for name, kind in (
            ("range", "f4"),
            ("scan_line", "u4"),
            ("column", "u2"),
            ("amplitude", "2u2"),
            ("id", "u4"),
        ):
            header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    las = laspy.LasData(header)
    las.x = table["x"] + 650_000
    las.y = table["y"] + 6_860_000 + second
    las.z = table["z"]
    las.intensity = table["intensity"]
    las.classification = table["class"]
    las.return_number = 1 + second
    las.number_of_returns = 1 + double
    head = (table["column"] % 2).astype(np.uint8)
    las.user_data = head
    las.point_source_id = 3 + head
    if form >= 6:
        las.scanner_channel = head
        las.scan_angle = np.round(table["angle_deg"] / 0.006).astype(np.int16)
    else:
        las.scan_angle_rank = (table["angle_deg"] / 2).astype(np.int8)
    if form not in (0, 2):
        las.gps_time = table["time_s"]
    if not bare:
        las.range = table["range_m"] + second
        las.scan_line = table["line"]
        las.column = table["column"]
        las.id = np.arange(len(twice))
        las.amplitude = np.stack([twice % 99, twice % 7], axis=1)
    if form >= 6:
        las.evlrs = laspy.vlrs.vlrlist.VLRList([VLR("golden", 8, "kept too", b"evlr" * 20)])
    las.write(path)
    data = bytearray(path.read_bytes())
    data[26:90] = b"golden system".ljust(32, b"\0") + b"written by hand".ljust(32, b"\0")
    data[90:94] = struct.pack("<HH", 366, 1999)
    path.write_bytes(data)


def _organised(folder: Path, range_m: Array) -> None:
    """Write a static scan as PTX (twice in one file) and a frame of rings."""
    elevation = np.linspace(-70, 80, M)
    azimuth = np.deg2rad(np.linspace(0, 100, N_LINES))[:, None]
    rise = np.deg2rad(elevation)[None, :]
    r = np.clip(np.nan_to_num(range_m[:, ::-1]), 0, 60)
    xyz = np.stack(
        [r * np.cos(rise) * np.cos(azimuth), r * np.cos(rise) * np.sin(azimuth), r * np.sin(rise)],
        axis=-1,
    )
    identity = "1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n"
    rows = "".join("{:.4f} {:.4f} {:.4f} 0.5\n".format(*point) for point in xyz.reshape(-1, 3))
    scan = f"{N_LINES}\n{M}\n0 0 0\n{identity}0 0 0 1\n{rows}"
    (folder / "scan.ptx").write_text(scan)
    (folder / "two.ptx").write_text(scan + scan.replace("0 0 0 1\n", "1 2 3 1\n", 1))
    rings = np.concatenate([xyz[:, ::2].transpose(1, 0, 2), np.ones((M // 2, N_LINES, 1))], axis=-1)
    rings.astype("<f4").tofile(folder / "rings.bin")


def answer(page: str, target: str, person: str, n_other: str) -> None:
    """Answer the page of ``prc check`` as predicted, but for so many places that are other."""
    (about,) = re.findall(r'id="about">(.*?)</script>', Path(page).read_text("utf-8"), re.DOTALL)
    answers = json.loads(about)["answers"]
    answers["person"] = person
    for number, place in enumerate(answers["places"]):
        predicted = answers["strata"][place["stratum"]]["predicted"]
        is_known = number >= int(n_other) and predicted in answers["classes"]
        place["answer"] = predicted if is_known else "other"
    Path(target).write_text(json.dumps(answers))
