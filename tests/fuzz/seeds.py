"""Small valid files of every format that the program reads, made by code."""

import gzip
import io
import json
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from tests.clouds import seen
from tests.formats import cloud_files
from tests.formats.bags import recordings as made
from tests.formats.organised_files import Scan, e57_fields, grid_points, ptx_scan, write_e57
from tests.formats.packets import captures

N_LINES = 14
M = 24
"""Lines and columns of every seed."""
LINE_HZ = 50.0
FORMATS = Path(cloud_files.__file__).parent

LAYOUT = """\
[layout]
endian = "little"
points_per_line = 24
header_bytes = 0

[[layout.fields]]
name = "range"
type = "f4"
missing = 0

[[layout.fields]]
name = "intensity"
type = "u2"
scale = 0.5
"""

TEXT_LAYOUT = """\
[layout]
delimiter = ","
[[layout.fields]]
name = "range"
source = "range"
unit = "m"
"""

CONFIG = """\
preset = "prc-2019-urban"
method = "prc"

[input]
points_per_line = 24
lines = "auto"
range = "auto"
max_range = 90.0
order = "trust"

[prc]
lines_per_block = 9
[prc.support]
zeta_p = 0.1
[prc.surfaces]
area = "auto"

[classes]
noise = 7
"""

MAPPING = """\
unlisted = "error"
ignore = [0, "20-30"]
ignore_reference = []

[predicted]
ground = [2]
vegetation = [3, 4, 5]
building = [6]
noise = [7, 1]

[reference]
ground = [2]
vegetation = ["3-5"]
building = [6]
noise = [7, 1]
"""


def written(name: str, write: Callable[[Path], object]) -> bytes:
    """Content of the file that a function writes."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


def ranges(seed: int = 1) -> np.ndarray:
    """(lines, M) float32 [m]: a ground and two walls, some missing."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(M) / M
    with np.errstate(divide="ignore"):
        ground = np.where(np.cos(angle) > 0.1, 2.0 / np.cos(angle), 60.0)
        wall = np.where(np.abs(np.sin(angle)) > 0.1, 8.0 / np.abs(np.sin(angle)), 60.0)
    image = np.minimum(ground, wall) + rng.normal(0, 0.005, (N_LINES, M))
    image[image > 40] = np.nan
    image[rng.random(image.shape) < 0.05] = np.nan
    return image.astype(np.float32)


@cache
def _flat() -> dict[str, np.ndarray]:
    image = ranges()
    line, column = np.indices(image.shape)
    there = np.isfinite(image)
    angle = np.rad2deg(2 * np.pi * column / M)
    points = {
        "line": line[there],
        "column": column[there],
        "range": image[there].astype(float),
        "angle": angle[there],
        "time": ((line + column / M) / LINE_HZ + 1e-7)[there],
    }
    turn = np.deg2rad(points["angle"])
    points["x"] = points["line"] * 0.1
    points["y"] = points["range"] * np.sin(turn)
    points["z"] = 2 - points["range"] * np.cos(turn)
    points["class"] = np.where(points["z"] < 0.1, 2, np.where(points["z"] > 3, 6, 5))
    return points


def _las(
    version: str, point_format: int, *, compressed: bool = False, with_range: bool = True
) -> bytes:
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales = np.full(3, 0.001)
    header.offsets = np.zeros(3)
    if with_range:
        unit = {"scales": np.ones(1), "offsets": np.zeros(1)}
        header.add_extra_dim(laspy.ExtraBytesParams("range", "f4"))
        header.add_extra_dim(laspy.ExtraBytesParams("scan_line", "u2", **unit))
        header.add_extra_dim(laspy.ExtraBytesParams("column", "u2"))
    header.vlrs.append(laspy.VLR("hello", 7, "a description", b"some text"))
    header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "wkt", b'PROJCS["made up"]\0'))
    data = laspy.LasData(header)
    points = _flat()
    columns = points | {
        "classification": points["class"],
        "gps_time": points["time"],
        "scan_line": points["line"],
        "scan_angle": (points["angle"] / 0.006).astype(np.int64).clip(-30000, 30000),
        "scan_angle_rank": (points["angle"] - 180).clip(-90, 90),
    }
    names = {"x", "y", "z", *header.point_format.dimension_names}
    for name in names & set(columns):
        data[name] = columns[name]
    if version == "1.4":
        extended = laspy.VLR("extended", 9, "an extended one", b"y" * 40)
        data.evlrs = laspy.vlrs.vlrlist.VLRList([extended])
    out = io.BytesIO()
    data.write(out, do_compress=compressed)
    return out.getvalue()


def _text(delimiter: str, columns: dict[str, Any]) -> bytes:
    """A row a record below the names."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [delimiter.join(columns), *(delimiter.join(map(repr, row)) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _csv() -> bytes:
    points = _flat()
    first = {"scan_line": points["line"], "column": points["column"], "angle_deg": points["angle"]}
    rest = ("range", "x", "y", "z", "time", "class")
    return _text(",", first | {name: points[name] for name in rest})


def _trajectory_csv() -> bytes:
    time_s = np.arange(-0.1, N_LINES / LINE_HZ + 0.2, 0.02).round(3)
    still = np.zeros(len(time_s))
    return _text(",", {"time": time_s, "x": 5 * time_s, "y": still, "z": still + 2})


def _labels_csv() -> bytes:
    codes = _flat()["class"]
    return _text(",", {"record": np.arange(len(codes)), "class": codes})


def _zst(data: bytes) -> bytes:
    return bytes(pa.Codec("zstd").compress(data))


def _npy(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def _npz(*, packed: bool = True) -> bytes:
    out = io.BytesIO()
    image = ranges()
    save = np.savez_compressed if packed else np.savez
    save(
        out,
        range_m=image,
        angle_deg=360.0 * np.arange(M) / M,
        time_s=np.arange(N_LINES) / LINE_HZ,
        intensity=np.ones(image.shape, np.uint16),
        **{"class": np.where(np.isfinite(image), 2, 0).astype(np.uint8)},
    )
    return out.getvalue()


def _parquet() -> bytes:
    points = _flat()
    table = pa.table(
        {name: points[name] for name in ("line", "column", "range", "class", "time", "x", "y", "z")}
    )
    out = io.BytesIO()
    parquet.write_table(table, out)
    return out.getvalue()


def _e57() -> bytes:
    fields = e57_fields(grid_points(N_LINES, M))
    scan = Scan(
        fields, rotation=(1.0, 0.0, 0.0, 0.0), bounds=(0, M - 1, 0, N_LINES - 1), limits=(0.0, 1.0)
    )
    return written("a.e57", lambda path: write_e57(path, [scan]))


def _ptx() -> bytes:
    return "".join(ptx_scan(grid_points(N_LINES, M, seed)) for seed in (1, 2)).encode()


def _sbet() -> bytes:
    times = np.arange(-0.1, N_LINES / LINE_HZ + 0.2, 0.02)
    rows = np.zeros((len(times), 17))
    rows[:, 0] = times
    rows[:, 1] = 1.05
    rows[:, 2] = 0.43 + times * 1e-7
    rows[:, 3] = 40.0
    return rows.astype("<f8").tobytes()


def _coordinates() -> bytes:
    points = _flat()
    return "".join(
        f"{x:.3f} {y:.3f} {z:.3f}\n"
        for x, y, z in zip(points["x"], points["y"], points["z"], strict=True)
    ).encode()


def _raw() -> bytes:
    record = np.zeros(N_LINES * M, np.dtype([("range", "<f4"), ("intensity", "<u2")]))
    record["range"] = np.nan_to_num(ranges().ravel())
    return record.tobytes()


def _recorded(name: str) -> bytes:
    """A bag of every container: two scanners, and a topic that is not read."""
    clouds = made.clouds(made.drive(60), made.kind_of("t", "u4", ring="u1"), every=20)
    stem, _, kind = name.partition(".")
    packing = {"plain": "", "cloud": "", "mixed": "zstd"}.get(stem, stem)
    version = 1 if kind == "bag" else 2
    lasers = [*made.lasers(version), *made.lasers(version, "/left", "left", 2)]
    sent = {
        "cloud": clouds,
        "mixed": [*clouds, *made.echoes(2, [[3.0, 5.0], [], [7.0]], n=12, topic="/echoes")],
    }.get(stem, [*lasers, *made.strings(version)])
    if kind == "bag":
        return written(name, lambda path: made.write_bag(path, sent, packing, 3000))
    if kind == "db3":
        return written(name, lambda path: made.write_db3(path, sent, packed=bool(packing)))
    return written(name, lambda path: made.write_mcap(path, sent, packing or "none", 3000))


def _captured(name: str) -> bytes:
    """A capture of a Velodyne, some of it in fragments, of several Hesai, or of an Ouster."""
    if name.startswith("ouster"):
        frames = captures.framed(captures.ouster()[1], 7502)
    elif name.startswith("hesai"):
        packets = [
            captures.hesai("40P", 6)[0],
            captures.hesai("OT128", 6, mode=0x39)[0],
            captures.hesai("64", 6, mode=0x39)[0],
            captures.velodyne(9, 0xA1),
        ]
        frames = []
        for i, sent in enumerate(packets):
            frames += captures.framed(sent, 2368 + i)
    else:
        frames = captures.framed(captures.vlp16(6))
        body = captures.udp(captures.vlp16(7)[6])
        for offset, part in ((0, body[:600]), (600, body[600:])):
            fragment = captures.ip4(part, offset=offset, more=not offset, number=9)
            frames.append((frames[-1][0] + 1e-3, captures.ethernet(fragment)))
    write = captures.write_pcapng if name.endswith("ng") else captures.write_pcap
    return written(name, lambda path: write(path, frames))


def _poses(name: str) -> bytes:
    """The trajectory with orientations."""
    from tests.formats.test_poses import odometry, poses, tum

    if name.endswith("tum"):
        return written(name, lambda path: tum(path, poses()))
    return written(name, lambda path: made.write_mcap(path, odometry(poses())))


PULSES = (
    *(
        "pulse-float32-theta.bin",
        "pulse-uint8-n_echo.bin",
        "echo-float32-range.bin",
        "echo-float32-amplitude.bin",
    ),
    "time.txt",
)
"""Files of a folder of pulses and echoes."""
STATE_FILES = (".prc/journal.sqlite", ".prc/lock.json", ".prc/command.json")
"""What a run of ``prc batch`` keeps in its output folder, and leaves there when it is killed."""


@cache
def _pulse_folder() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        cloud_files.pulse_folder(Path(folder) / "p", 8, 24)
        return {path.name: path.read_bytes() for path in (Path(folder) / "p").iterdir()}


def _record() -> bytes:
    """The record of labels that ``prc classify`` wrote."""
    from prc_cli.config import load_config
    from prc_cli.jobs.classify import classify

    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "a.npy"
        output = Path(folder) / "o.npy"
        source.write_bytes(_npy(ranges()))
        classify(source, output, load_config(preset="prc-2019-urban"), threads=1)
        return output.with_name("o.npy.prc.json").read_bytes()


@cache
def _state() -> dict[str, bytes]:
    """A journal of three files, one of them done, one failed and one running.

    Whose run was killed; how it began.
    """
    from prc_cli.jobs.batch.journal import Journal
    from tests.jobs.batch.test_journal import done, failed, task

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with Journal(folder) as journal:
            journal.begin_run("process 7 of me on here")
            for entry in ("a.laz", "b.laz", "day 1/c.laz"):
                journal.start(task(entry), "worker 1")
            journal.finish(done("a.laz"))
            journal.finish(failed("b.laz"))
        lock = {
            "host": "elsewhere",
            "pid": 2**22 + 7,
            "user": "me",
            "since": "2026-11-23T00:00:00+00:00",
            "shard": "",
            "version": "0.1.0",
            "token": "0" * 32,
        }
        typed = ["pulses", "out", "--preset", "prc-2019-urban", "--jobs", "1", "-q"]
        command = {"schema": 2, "folder": "/", "arguments": typed}
        return {
            ".prc/journal.sqlite": (folder / "journal.sqlite").read_bytes(),
            ".prc/lock.json": json.dumps(lock).encode(),
            ".prc/command.json": json.dumps(command).encode(),
        }


RECORDINGS = (
    *(
        "plain.bag",
        "bz2.bag",
        "lz4.bag",
        "plain.mcap",
        "zstd.mcap",
        "lz4.mcap",
        "plain.db3",
        "zstd.db3",
        "cloud.db3",
    ),
    *("mixed.mcap", "velodyne.pcap", "velodyne.pcapng", "hesai.pcap", "ouster.pcap"),
)


def _cloud(*, with_nan: bool = False) -> dict[str, np.ndarray]:
    points = _flat()
    columns = {name: points[name].astype("f4") for name in ("range", "x", "y", "z")}
    columns |= {"theta": np.deg2rad(points["angle"]).astype("f4"), "GPS_time": points["time"]}
    columns |= {name: np.ones(len(points["range"]), "u1") for name in ("num_echo", "nb_of_echo")}
    if with_nan:
        image = ranges()
        columns = {
            "x": np.full(image.size, 3.0, "f4"),
            "y": np.full(image.size, 1.0, "f4"),
            "z": image.ravel(),
        }
    return columns


def _frame() -> dict[str, np.ndarray]:
    """A frame in column order, ring after ring in a column."""
    column, ring = np.divmod(np.arange(360 * 8), 8)
    azimuth = np.deg2rad(column)
    elevation = np.deg2rad(ring * 2.0 - 10)
    xyz = seen(9.0, azimuth, elevation).astype("f4")
    return {
        **dict(zip("xyz", xyz.T, strict=True)),
        "t": (column * 1000).astype("u4"),
        "ring": ring.astype("u1"),
        "range": np.full(len(ring), 9000, "u4"),
    }


SEEDS: dict[str, Callable[[], bytes]] = {
    **{
        f"pf{n}.las": lambda n=n: _las("1.2" if n < 4 else "1.3" if n < 6 else "1.4", n)
        for n in range(11)
    },
    **{
        f"pf{n}.laz": lambda n=n: _las("1.2" if n < 4 else "1.4", n, compressed=True)
        for n in (0, 1, 2, 3, 6, 7, 8)
    },
    "v10.las": lambda: _las("1.1", 1).replace(b"\1\1", b"\1\0", 1),
    "v11.las": lambda: _las("1.1", 1),
    "plain.las": lambda: _las("1.4", 6, with_range=False),
    "a.csv": _csv,
    "a.csv.gz": lambda: gzip.compress(_csv(), mtime=0),
    "a.csv.zst": lambda: _zst(_csv()),
    "a.txt": lambda: _csv().replace(b",", b" "),
    "a.bin": _raw,
    "a.ply": lambda: cloud_files.ply(_cloud(), comments=("offset Pos 1.0 2.0 0.0",)),
    "big.ply": lambda: cloud_files.ply(_cloud(), "binary_big_endian"),
    "text.ply": lambda: cloud_files.ply(_cloud(), "ascii"),
    "rings.ply": lambda: cloud_files.ply(_frame()),
    "a.pcd": lambda: cloud_files.pcd(_cloud(with_nan=True), height=N_LINES),
    "text.pcd": lambda: cloud_files.pcd(_cloud(), "ascii"),
    "lzf.pcd": lambda: cloud_files.pcd(_cloud(with_nan=True), "binary_compressed", height=N_LINES),
    "a.xyz": lambda: _coordinates().replace(b".", b","),
    "a.pts": lambda: b"%d\n" % len(_flat()["x"]) + _coordinates(),
    "f4.bin": lambda: ranges().tobytes(),
    "a.npy": lambda: _npy(ranges()),
    "fortran.npy": lambda: _npy(np.asfortranarray(ranges())),
    "labels.npy": lambda: _npy(_flat()["class"].astype(np.uint8)),
    "a.npz": _npz,
    "stored.npz": lambda: _npz(packed=False),
    "a.ptx": _ptx,
    "a.e57": _e57,
    "a.parquet": _parquet,
    "a.label": lambda: _flat()["class"].astype("<u4").tobytes(),
    "labels.csv": _labels_csv,
    "track.csv": _trajectory_csv,
    "track.sbet": _sbet,
    "track.tum": lambda: _poses("track.tum"),
    "poses.mcap": lambda: _poses("poses.mcap"),
    "layout.toml": lambda: LAYOUT.encode(),
    "text_layout.toml": lambda: TEXT_LAYOUT.encode(),
    "config.toml": lambda: CONFIG.encode(),
    "mapping.toml": lambda: MAPPING.encode(),
    **{
        name: lambda name=name: _captured(name) if "pcap" in name else _recorded(name)
        for name in RECORDINGS
    },
    "ouster.json": lambda: json.dumps(captures.ouster()[0]).encode(),
    "copc7.laz": lambda: (FORMATS / "las" / "octree.copc.laz").read_bytes(),
    **{f"pulses/{name}": lambda name=name: _pulse_folder()[name] for name in PULSES},
    **{f"state/{name}": lambda name=name: _state()[name] for name in STATE_FILES},
    "labelled/a.npy": lambda: _npy(_flat()["class"].astype(np.uint8)),
    "labelled/a.npy.prc.json": _record,
    "simulate.toml": lambda: b"seed = 3\nlength_m = 5.0\n[scanner]\npoints_per_line = 24\n",
}
"""Content of a valid file by its name."""


@cache
def seed(name: str) -> bytes:
    """Content of a valid file."""
    return SEEDS[name]()


def write_seeds(folder: Path) -> None:
    """Write every seed under its name."""
    for name in SEEDS:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(seed(name))
