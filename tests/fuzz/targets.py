"""The commands to try on damaged files, by format."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.oracles import BLOCKS
from tests.fuzz.seeds import SEEDS, seed

INPUTS = {
    "las": (*(f"pf{n}.las" for n in range(11)), "v10.las", "v11.las", "plain.las"),
    "laz": tuple(f"pf{n}.laz" for n in (0, 1, 2, 3, 6, 7, 8)),
    "copc": ("copc6.laz", "copc7.laz"),
    "npy": ("a.npy", "fortran.npy"),
    "npz": ("a.npz", "stored.npz"),
    "csv": ("a.csv",),
    "gz": ("a.csv.gz",),
    "zst": ("a.csv.zst",),
    "txt": ("a.txt",),
    "ply": ("a.ply", "big.ply", "text.ply", "rings.ply"),
    "pcd": ("a.pcd", "text.pcd", "lzf.pcd"),
    "clouds": ("a.xyz", "a.pts"),
    "raw": ("a.bin",),
    "ptx": ("a.ptx",),
    "e57": ("a.e57",),
}
"""Seeds of archive files, by target."""

_P = ("--preset", "prc-2019-urban", "--trust-order")
_DRAWN = ("--preset", "prc-2019-urban", "--set", "input.order=trust")
LABELLED = ("classify", "{case}", "{out}/o.npy", *BLOCKS)
"""The command whose labels are compared with those of other ways."""
_UPRIGHT = (
    "classify",
    "{case}",
    "{out}/o.npy",
    *_P,
    "--range",
    "sensor-xyz",
    "--lines",
    "elevation:20",
)
TAKEN = {"clouds": _UPRIGHT, "copc": ("info", "{case}")}
"""First commands of inputs that :data:`LABELLED` refuses sound.

It names no lines, no columns, no ranges.
"""
STATE = "state"
"""Folder of an output tree, which commands may change."""
READ: tuple[tuple[str, ...], ...] = (
    ("info", "{case}"),
    ("info", "-v", "{case}", "--trust-order"),
    ("info", "--json", "{case}", "--method", "sequential-angle", "--trust-order"),
    ("classify", "{case}", "{out}/o.npy", *_P),
    ("classify", "-v", "{case}", "{out}/o.csv", *_P),
    ("classify", "{case}", "{out}/o.parquet", "--method", "sequential-angle", "--trust-order"),
    ("classify", "{case}", "{out}/o.npy", "-M", "24", *_P, "--lines", "fixed"),
    ("convert", "{case}", "{out}/o.npz", "--trust-order"),
    ("convert", "{case}", "{out}/o.csv.gz", "--trust-order"),
    ("convert", "-v", "{case}", "{out}/o.las", "--trust-order"),
    ("convert", "{case}", "{out}/o.pcd", "--trust-order"),
    (
        "convert",
        "{case}",
        "{out}/o.bin",
        "--trust-order",
        "--lines",
        "dimension:scan_line",
        "--columns",
        "order",
    ),
    (
        "convert",
        "{case}",
        "{out}/o.npz",
        "--lines",
        "time:50",
        "--columns",
        "time:1200",
        "--sort-by-time",
    ),
    (
        "convert",
        "{case}",
        "{out}/o.npz",
        "--lines",
        "angle-wrap",
        "--columns",
        "angle",
        "--trust-order",
    ),
    (
        "convert",
        "{case}",
        "{out}/o.npz",
        "--range",
        "sensor-xyz",
        "--lines",
        "elevation:20",
        "--trust-order",
    ),
    (
        "convert",
        "{case}",
        "{out}/o.npz",
        "--range",
        "sensor-xyz",
        "--lines",
        "rings",
        "--trust-order",
    ),
    ("convert", "{case}", "{out}/o.npz", "--range", "origin:0,0,2", "--trust-order"),
    ("convert", "{case}", "{out}/o.npz", "--scanner", "user_data", "--trust-order"),
    (
        "convert",
        "{case}",
        "{out}/o.npz",
        "--range",
        "trajectory:{seeds}/track.csv",
        "--trust-order",
    ),
    ("evaluate", "{case}", "{case}"),
    ("evaluate", "{case}", "{case}", "--match", "nearest", "--tolerance", "0.1"),
    ("evaluate", "{case}", "{case}", "--match", "time", "--tolerance", "0.1", "--by", "range:5,10"),
    ("evaluate", "{case}", "{case}", "-M", "24", "--by", "lines:4", "--intervals"),
    ("thin", "{case}", "{out}/o.npz", "--keep", "ground=1/4", *_P),
    ("render", "{case}", "{out}/o.png", *_DRAWN),
    ("render", "{case}", "{out}/o.png", *_DRAWN, "--steps", "top", "--range", "sensor-xyz"),
    ("calibrate", "{case}", "-o", "{out}/o.toml", "--trust-order", "--preset", "prc-2019-urban"),
)

LAS = (
    ("classify", "{case}", "{out}/o.laz", *_P),
    ("classify", "{case}", "{out}/o.las", *_P, "--set", "output.segment_ids=true"),
    ("convert", "{case}", "{out}/o.laz"),
    ("convert", "{case}", "{out}/o.las"),
    ("thin", "{case}", "{out}/o.laz", "--keep", "ground=0"),
    ("transfer", "{seeds}/pf6.las", "{case}", "{out}/o.las"),
    ("transfer", "{case}", "{seeds}/pf6.laz", "{out}/o.laz"),
    ("transfer", "{case}", "{seeds}/pf6.laz", "{out}/o.laz", "--by", "record", "--min-match", "0"),
)

LABELS = (
    ("evaluate", "{case}", "{seeds}/labels.npy"),
    ("evaluate", "{seeds}/labels.npy", "{case}", "--json"),
    ("evaluate", "{seeds}/labels.npy", "{case}", "--output", "{out}/o.html"),
    ("evaluate", "{case}", "{seeds}/a.csv", "-o", "{out}/o.md"),
    ("evaluate", "{case}", "{seeds}/a.csv", "--match", "dimension:record"),
    ("transfer", "{case}", "{seeds}/pf6.las", "{out}/o.las", "--points", "{seeds}/a.csv"),
    ("render", "{seeds}/a.csv", "{out}/o.png", "--labels", "{case}"),
    ("thin", "{seeds}/a.csv", "{out}/o.npz", "--labels", "{case}", "--keep", "ground=1/4"),
)

LAYOUT = (
    ("info", "{seeds}/a.bin", "--layout", "{case}"),
    ("classify", "{seeds}/a.bin", "{out}/o.npy", "--layout", "{case}", *_P),
    ("convert", "{seeds}/a.csv", "{out}/o.npz", "--layout", "{case}", *_P[2:]),
    ("config", "show", "--layout", "{case}"),
)


RECORDED = (
    ("info", "{case}"),
    ("info", "--json", "{case}", "--method", "fused", "--trust-order"),
    ("classify", "{case}", "{out}/o.npy", *_P),
    ("classify", "-v", "{case}", "{out}/o.laz", *_P, "--set", "input.return=last"),
    ("classify", "{case}", "{out}/o.csv", "--method", "sequential-angle", "--trust-order"),
    ("convert", "{case}", "{out}/o.npz", "--trust-order"),
    ("convert", "{case}", "{out}/o.las", "--trust-order"),
    ("render", "{case}", "{out}/o.png", *_DRAWN),
)
"""Commands for bags and captures, which hold their lines and columns."""
_META = ("--set", "input.metadata={seeds}/ouster.json")


@dataclass(frozen=True)
class Target:
    """Files to damage and what to do with them."""

    seeds: tuple[str, ...]
    commands: tuple[tuple[str, ...], ...]
    inside: str = ""
    """What commands are given where the seeds are files of a folder."""

    @property
    def many(self) -> tuple[str, ...]:
        """Return the seeds that are put beside each other."""
        top = self.inside.split("/")[0] + "/"
        return tuple(name for name in SEEDS if name.startswith(top)) if self.inside else ()


TARGETS: dict[str, Target] = {
    **{
        name: Target(
            seeds,
            (TAKEN.get(name, LABELLED), *READ, *(LAS if name in ("las", "laz", "copc") else ())),
        )
        for name, seeds in INPUTS.items()
    },
    "echopulse": Target(
        tuple(name for name in SEEDS if name.startswith("pulses/")),
        (LABELLED, *READ),
        inside="pulses/pulse-uint8-n_echo.bin",
    ),
    "state": Target(
        tuple(name for name in SEEDS if name.startswith(f"{STATE}/.prc/")),
        (
            ("batch", "status", "{case}"),
            ("batch", "status", "{case}", "--json"),
            ("batch", "clean", "{case}", "--dry-run"),
            ("batch", "clean", "{case}", "{seeds}"),
        ),
        inside=STATE,
    ),
    "record": Target(
        ("labelled/a.npy.prc.json",),
        (
            ("evaluate", "{case}", "{case}"),
            ("evaluate", "{case}", "{case}", "--json"),
            ("render", "{seeds}/a.npy", "{out}/o.png", "--labels", "{case}"),
        ),
        inside="labelled/a.npy",
    ),
    "raw": Target(
        ("a.bin", "f4.bin"),
        tuple(
            (*command, "--layout", "{seeds}/layout.toml")
            for command in (LABELLED, *READ)
            if command[0] != "evaluate"
        ),
    ),
    "bag": Target(
        ("plain.bag", "bz2.bag", "lz4.bag"),
        (*RECORDED, ("info", "{case}", "--set", "input.topic=/scan")),
    ),
    "mcap": Target(("plain.mcap", "zstd.mcap", "lz4.mcap", "mixed.mcap"), RECORDED),
    "db3": Target(("plain.db3", "zstd.db3", "cloud.db3"), RECORDED),
    "pcap": Target(("velodyne.pcap", "velodyne.pcapng", "hesai.pcap"), RECORDED),
    "ouster": Target(("ouster.pcap",), tuple((*command, *_META) for command in RECORDED)),
    "metadata": Target(
        ("ouster.json",),
        tuple(
            (one[0], "{seeds}/ouster.pcap", *one[2:], "--set", "input.metadata={case}")
            for one in (
                ("info", ""),
                ("classify", "", "{out}/o.npy", *_P),
                ("convert", "", "{out}/o.npz", "--trust-order"),
            )
        ),
    ),
    "labels": Target(
        ("labels.npy", "a.npz", "labels.csv", "a.csv", "a.parquet", "a.label", "pf6.laz"), LABELS
    ),
    "trajectory": Target(
        ("track.csv", "track.sbet", "track.tum", "poses.mcap"),
        (
            ("info", "{seeds}/pf1.las", "--range", "trajectory:{case}"),
            ("convert", "{seeds}/pf6.laz", "{out}/o.npz", "--range", "trajectory:{case}"),
            (
                "convert",
                "{seeds}/a.csv",
                "{out}/o.npz",
                "--range",
                "trajectory:{case}",
                "--set",
                "input.trajectory_crs=EPSG:32635",
            ),
            (
                *("convert", "{seeds}/a.csv", "{out}/o.npz", "--range", "trajectory:{case}"),
                *("--set", "input.trajectory_time_offset=-1"),
            ),
        ),
    ),
    "layout": Target(("layout.toml", "text_layout.toml"), LAYOUT),
    "config": Target(
        ("config.toml",),
        (
            ("config", "check", "{case}"),
            ("config", "show", "--config", "{case}"),
            ("classify", "{seeds}/a.npz", "{out}/o.npy", "--config", "{case}"),
            ("info", "{seeds}/a.csv", "--config", "{case}"),
        ),
    ),
    "mapping": Target(
        ("mapping.toml",),
        tuple(
            (
                "evaluate",
                "{seeds}/labels.npy",
                "{seeds}/labels.npy",
                "--mapping",
                "{case}",
                "-o",
                "{out}/o." + suffix,
            )
            for suffix in ("csv", "md", "html", "json")
        ),
    ),
    "simulate": Target(
        ("simulate.toml",),
        (("simulate", "street", "{out}/o.npz", "--config", "{case}", "--lines", "3", "-q"),),
    ),
    "stream": Target(
        ("a.bin", "f4.bin", "a.npz"),
        (
            ("stream", "-M", "24", "--preset", "prc-2019-urban", "-v"),
            ("stream", "--layout", "{seeds}/layout.toml", "--json"),
            ("stream", "-M", "24", "--method", "sequential-angle"),
            ("stream", "-M", "24", "--method", "sequential-angle"),
        ),
    ),
}
"""Everything that is attacked, by name."""


def suffix_of_seed(name: str) -> str:
    """Return the suffix, with the compression behind it."""
    return "." + name.rpartition("/")[2].split(".", 1)[1]


def lay(
    folder: Path,
    target: Target,
    name: str,
    data: bytes,
    stem: str = "case",
) -> Path:
    """Write a damaged seed, among the others of its folder if it has one.

    Return what a command is given.

    What was laid before is removed: a layout beside a file counts for all files of its folder.
    """
    for old in folder.glob(f"{stem}.*"):
        old.unlink()
    if not target.inside:
        case = folder / f"{stem}{suffix_of_seed(name)}"
        case.write_bytes(data)
        return case
    shutil.rmtree(folder / name.split("/")[0], ignore_errors=True)
    for seed_name in target.many:
        path = folder / seed_name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data if seed_name == name else seed(seed_name))
    return folder / target.inside


def sound_of(seeds: Path, target: Target, name: str) -> Path:
    """Return the undamaged seed as a command would be given it."""
    return seeds / (target.inside or name)


def arguments(
    command: tuple[str, ...],
    case: str,
    out: str,
    seeds: str,
) -> list[str]:
    """Return a command with its names filled in."""
    # not format(): file names may hold braces
    return [
        part.replace("{case}", case).replace("{out}", out).replace("{seeds}", seeds)
        for part in command
    ]
