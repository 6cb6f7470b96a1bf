"""The commands to try on damaged files, by format."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.seeds import PULSES, STATE_FILES, seed

URBAN = "--preset prc-2019-urban --trust-order"
DRAWN = "--preset prc-2019-urban --set input.order=trust"
LABELLED = f"classify {{case}} {{out}}/o.npy {URBAN}"
"""The command whose labels are compared with those of other ways."""
STATE = "state"
"""Folder of an output tree, which commands may change."""
READ = (
    "info {case}",
    "info -v {case} --trust-order",
    "info --json {case} --method sequential-angle --trust-order",
    f"classify -v {{case}} {{out}}/o.csv {URBAN}",
    "classify {case} {out}/o.parquet --method sequential-angle --trust-order",
    f"classify {{case}} {{out}}/o.npy -M 24 {URBAN} --lines fixed",
    "convert {case} {out}/o.npz --trust-order",
    "convert {case} {out}/o.csv.gz --trust-order",
    "convert -v {case} {out}/o.las --trust-order",
    "convert {case} {out}/o.pcd --trust-order",
    "convert {case} {out}/o.bin --trust-order --lines dimension:scan_line --columns order",
    "convert {case} {out}/o.npz --lines time:50 --columns time:1200 --sort-by-time",
    "convert {case} {out}/o.npz --lines angle-wrap --columns angle --trust-order",
    "convert {case} {out}/o.npz --range sensor-xyz --lines elevation:20 --trust-order",
    "convert {case} {out}/o.npz --range sensor-xyz --lines rings --trust-order",
    "convert {case} {out}/o.npz --range origin:0,0,2 --trust-order",
    "convert {case} {out}/o.npz --scanner user_data --trust-order",
    "convert {case} {out}/o.npz --range trajectory:{seeds}/track.csv --trust-order",
    "evaluate {case} {case}",
    "evaluate {case} {case} --match nearest --tolerance 0.1",
    "evaluate {case} {case} --match time --tolerance 0.1 --by range:5,10",
    "evaluate {case} {case} -M 24 --by lines:4 --intervals",
    f"thin {{case}} {{out}}/o.npz --keep ground=1/4 {URBAN}",
    f"render {{case}} {{out}}/o.png {DRAWN}",
    f"render {{case}} {{out}}/o.png {DRAWN} --steps top --range sensor-xyz",
    "calibrate {case} -o {out}/o.toml --trust-order --preset prc-2019-urban",
)
LAS = (
    f"classify {{case}} {{out}}/o.laz {URBAN}",
    f"classify {{case}} {{out}}/o.las {URBAN} --set output.segment_ids=true",
    "convert {case} {out}/o.laz",
    "convert {case} {out}/o.las",
    "thin {case} {out}/o.laz --keep ground=0",
    "transfer {seeds}/pf6.las {case} {out}/o.las",
    "transfer {case} {seeds}/pf6.laz {out}/o.laz",
    "transfer {case} {seeds}/pf6.laz {out}/o.laz --by record --min-match 0",
)
RECORDED = (
    LABELLED,
    "info {case}",
    "info --json {case} --method fused --trust-order",
    f"classify -v {{case}} {{out}}/o.laz {URBAN} --set input.return=last",
    "classify {case} {out}/o.csv --method sequential-angle --trust-order",
    "convert {case} {out}/o.npz --trust-order",
    "convert {case} {out}/o.las --trust-order",
    f"render {{case}} {{out}}/o.png {DRAWN}",
)
"""Commands for bags and captures, which hold their lines and columns."""


@dataclass(frozen=True)
class Target:
    """Files to damage and what to do with them."""

    seeds: str
    """Their names, with spaces between them."""
    commands: tuple[str, ...] = (LABELLED, *READ)
    """The first one takes every seed as it is."""
    inside: str = ""
    """What commands are given where the seeds are files of a folder."""

    @property
    def names(self) -> list[str]:
        """Return the names of the seeds."""
        return self.seeds.split()


TARGETS = {
    "las": Target(
        " ".join(f"pf{n}.las" for n in range(11)) + " v10.las v11.las plain.las",
        (LABELLED, *READ, *LAS),
    ),
    "laz": Target(" ".join(f"pf{n}.laz" for n in (0, 1, 2, 3, 6, 7, 8)), (LABELLED, *READ, *LAS)),
    "copc": Target("copc7.laz", (*READ, *LAS)),
    "npy": Target("a.npy fortran.npy"),
    "npz": Target("a.npz stored.npz"),
    "csv": Target("a.csv"),
    "gz": Target("a.csv.gz"),
    "zst": Target("a.csv.zst"),
    "txt": Target("a.txt"),
    "ply": Target("a.ply big.ply text.ply rings.ply"),
    "pcd": Target("a.pcd text.pcd lzf.pcd"),
    "clouds": Target("a.xyz a.pts", (f"{LABELLED} --range sensor-xyz --lines elevation:20", *READ)),
    "ptx": Target("a.ptx"),
    "e57": Target("a.e57"),
    "raw": Target(
        "a.bin f4.bin",
        tuple(
            f"{command} --layout {{seeds}}/layout.toml"
            for command in (LABELLED, *READ)
            if not command.startswith("evaluate")
        ),
    ),
    "echopulse": Target(
        " ".join(f"pulses/{name}" for name in PULSES), inside="pulses/pulse-uint8-n_echo.bin"
    ),
    "state": Target(
        " ".join(f"{STATE}/{name}" for name in STATE_FILES),
        (
            "batch status {case}",
            "batch status {case} --json",
            "batch clean {case} --dry-run",
            "batch clean {case} {seeds}",
        ),
        inside=STATE,
    ),
    "record": Target(
        "labelled/a.npy.prc.json labelled/a.npy",
        (
            "evaluate {case} {case}",
            "evaluate {case} {case} --json",
            "render {seeds}/a.npy {out}/o.png --labels {case}",
        ),
        inside="labelled/a.npy",
    ),
    "bag": Target("plain.bag bz2.bag lz4.bag", (*RECORDED, "info {case} --set input.topic=/scan")),
    "mcap": Target("plain.mcap zstd.mcap lz4.mcap mixed.mcap", RECORDED),
    "db3": Target("plain.db3 zstd.db3 cloud.db3", RECORDED),
    "pcap": Target("velodyne.pcap velodyne.pcapng hesai.pcap", RECORDED),
    "ouster": Target(
        "ouster.pcap",
        tuple(f"{command} --set input.metadata={{seeds}}/ouster.json" for command in RECORDED),
    ),
    "metadata": Target(
        "ouster.json",
        (
            "info {seeds}/ouster.pcap --set input.metadata={case}",
            f"classify {{seeds}}/ouster.pcap {{out}}/o.npy {URBAN} --set input.metadata={{case}}",
            "convert {seeds}/ouster.pcap {out}/o.npz --trust-order --set input.metadata={case}",
        ),
    ),
    "labels": Target(
        "labels.npy a.npz labels.csv a.csv a.parquet a.label pf6.laz",
        (
            "evaluate {case} {seeds}/labels.npy",
            "evaluate {seeds}/labels.npy {case} --json",
            "evaluate {seeds}/labels.npy {case} --output {out}/o.html",
            "evaluate {case} {seeds}/a.csv -o {out}/o.md",
            "evaluate {case} {seeds}/a.csv --match dimension:record",
            "transfer {case} {seeds}/pf6.las {out}/o.las --points {seeds}/a.csv",
            "render {seeds}/a.csv {out}/o.png --labels {case}",
            "thin {seeds}/a.csv {out}/o.npz --labels {case} --keep ground=1/4",
        ),
    ),
    "trajectory": Target(
        "track.csv track.sbet track.tum poses.mcap",
        (
            "info {seeds}/pf1.las --range trajectory:{case}",
            "convert {seeds}/pf6.laz {out}/o.npz --range trajectory:{case}",
            "convert {seeds}/a.csv {out}/o.npz --range trajectory:{case} "
            "--set input.trajectory_crs=EPSG:32635",
            "convert {seeds}/a.csv {out}/o.npz --range trajectory:{case} "
            "--set input.trajectory_time_offset=-1",
        ),
    ),
    "layout": Target(
        "layout.toml text_layout.toml",
        (
            "info {seeds}/a.bin --layout {case}",
            f"classify {{seeds}}/a.bin {{out}}/o.npy --layout {{case}} {URBAN}",
            "convert {seeds}/a.csv {out}/o.npz --layout {case} --trust-order",
            "config show --layout {case}",
        ),
    ),
    "config": Target(
        "config.toml",
        (
            "config check {case}",
            "config show --config {case}",
            "classify {seeds}/a.npz {out}/o.npy --config {case}",
            "info {seeds}/a.csv --config {case}",
        ),
    ),
    "mapping": Target(
        "mapping.toml",
        tuple(
            f"evaluate {{seeds}}/labels.npy {{seeds}}/labels.npy --mapping {{case}} "
            f"-o {{out}}/o.{end}"
            for end in ("csv", "md", "html", "json")
        ),
    ),
    "simulate": Target(
        "simulate.toml", ("simulate street {out}/o.npz --config {case} --lines 3 -q",)
    ),
    "stream": Target(
        "a.bin f4.bin a.npz",
        (
            "stream -M 24 --preset prc-2019-urban -v",
            "stream --layout {seeds}/layout.toml --json",
            "stream -M 24 --method sequential-angle",
        ),
    ),
}
"""Everything that is attacked, by name."""


def suffix_of_seed(name: str) -> str:
    """Return the suffix, with the compression behind it."""
    return "." + name.rpartition("/")[2].split(".", 1)[1]


def lay(folder: Path, target: Target, name: str, data: bytes) -> Path:
    """Write a damaged seed, among the others of its folder if it has one.

    Return what a command is given.

    What was laid before is removed: a layout beside a file counts for all files of its folder.
    """
    for old in folder.glob("case.*"):
        old.unlink()
    if not target.inside:
        case = folder / f"case{suffix_of_seed(name)}"
        case.write_bytes(data)
        return case
    shutil.rmtree(folder / name.split("/")[0], ignore_errors=True)
    for seed_name in target.names:
        path = folder / seed_name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data if seed_name == name else seed(seed_name))
    return folder / target.inside


def arguments(command: str, case: Path, out: Path | str, seeds: Path) -> list[str]:
    """Return the words of a command with its names filled in."""
    # not format(): file names may hold braces
    return [
        word.replace("{case}", str(case)).replace("{out}", str(out)).replace("{seeds}", str(seeds))
        for word in command.split()
    ]
