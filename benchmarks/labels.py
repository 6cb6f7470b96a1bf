"""F1 by scan and class of what ``prc classify IN OUT`` finds when nothing is told but the file,
and the share of each class that is called noise.

    python -m benchmarks.labels > figures/labels.md              # simulated seeds, and real scans
    python -m benchmarks.labels --seeds 8901-8906 --only push-broom
    python -m benchmarks.labels --only RIEGL --others FOLDER     # and scans of another simulator
    # another checkout too: after, and the difference
    python -m benchmarks.labels --against OTHER/bin/python

The first seeds chose nothing and were run once for the page of figures; limits were chosen on 9301
to 9342 and 9401 to 9442. The scene of a street goes with its seed. A class counts in a scan with at
least 200 shots of it.

A scan of FOLDER holds reference codes of prc, or has them beside it in NAME.reference.npy, and
options of ``prc classify`` in NAME.options. It is a forest if NAME begins so. Real scans: Oakland
has classes of its own; RIEGL's were marked by hand (riegl_paris.csv, first file apart: it may be
tuned on); Argoverse marks ground and vehicles."""

from __future__ import annotations

import csv
import hashlib
import json
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from skimage.measure import points_in_poly

from benchmarks import contest_data as data
from benchmarks import contest_files, contest_judge, rings
from benchmarks.contest_data import Scan, Simulated
from benchmarks.pages import DATA, commands, duration, heading, parser_of, say, table
from prc_cli.core.types import I32
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.scores import scores

SEEDS = "8801-8806"
SCENES = ("residential", "terraces", "suburb", "boulevard", "mixed", "varied")
WOODS = ("mixed", "pine-heath", "dense-spruce")
MAPPINGS = {"forest": str(contest_judge.MAPPINGS["forest"]), "oakland": "street_oakland"}
"""Where the mapping of a scan does not score every class."""
NAMES = {"horizontal": "ground", "vertical": "building"}
"""Of the reference of a tripod.

Trunks, poles and curbs are vertical there, roofs horizontal; noise is not judged.
"""
LEAST_SHOTS = 200
MARKED = Path(__file__).with_name("riegl_paris.csv")


@dataclass(frozen=True, slots=True)
class Case:
    """A file to classify, and its reference."""

    file: Path
    reference: Path
    """Codes of every record."""
    mapping: str = "street"
    options: tuple[str, ...] = ()
    """Of ``prc classify``."""


Making = Callable[[Path], Case]
"""Makes a case in a folder."""


def scans(seeds: list[int], others: Path | None) -> Iterator[tuple[str, str, Making]]:
    """Yield the group, the name and the making of every scan."""
    for seed in seeds:
        scene = SCENES[seed % len(SCENES)]
        wood = WOODS[seed % len(WOODS)]
        for spec in data.simulations("labels"):
            settings = replace(spec, seed=seed, scene=scene, noise=spec.noise or 0.0)
            yield spec.name, f"{scene} {seed}", partial(written, partial(data.simulated, settings))
        forest = Simulated("", seed, 15, wood, "focus3d-120", kind="forest")
        yield "forest", f"{wood} {seed}", partial(written, partial(data.simulated, forest))
    for strip in (1, 2, 3):
        yield "Oakland", f"strip {strip}", partial(written, partial(data.oakland, strip))
    yield "RIEGL", "file 1", partial(riegl, judged=slice(0, 1))
    yield "RIEGL", "files 2-5", partial(riegl, judged=slice(1, 5))
    for k, name in enumerate(("upper", "lower")):
        yield "Argoverse", name, partial(argoverse, k)
    for file in sorted(others.iterdir()) if others else ():
        if file.is_file() and file.suffix not in {".npy", ".json", ".options"}:
            yield "others", file.stem, partial(scan_of_others, file)


def written(make: Callable[[], Scan], folder: Path) -> Case:
    """Write a scan as ``prc classify`` takes it, and its reference class of every record."""
    scan = make()
    file = contest_files.write(scan, folder)
    codes = scan.codes.ravel()
    if file.record is not None:
        codes = np.zeros(int(max(file.record.max(), file.extra_record.max(initial=-1))) + 1)
        codes[file.record[file.record >= 0]] = scan.codes[file.record >= 0]
        codes[file.extra_record] = scan.extra_codes
    mapping = MAPPINGS.get(scan.mapping, scan.mapping)
    return Case(file.path, saved(codes, folder), mapping, file.options)


def saved(codes: np.ndarray, folder: Path) -> Path:
    """Write reference codes."""
    reference = folder / "reference.npy"
    np.save(reference, codes.astype(np.int32))
    return reference


def riegl(folder: Path, judged: slice) -> Case:
    """Join the five files of the drive; the reference has the classes of some of them."""
    parts = [file.read_bytes() for file in sorted((DATA / "riegl").glob("*.ply"))]
    if hashlib.sha256(b"".join(parts)).hexdigest() not in MARKED.read_text():
        raise SystemExit(f"{DATA / 'riegl'}: not the files that were marked; see {MARKED}")
    head, end, _ = parts[0].partition(b"end_header\n")
    rows = [part.partition(end)[2] for part in parts]
    kinds = {"float64": ">f8", "float32": ">f4", "uint8": "u1"}
    properties = [line.split()[1:] for line in head.decode().splitlines() if "property" in line]
    records = np.frombuffer(b"".join(rows), [(name, kinds[kind]) for kind, name in properties])
    n_rows = len(records) // len(rows)
    count = b"element vertex %d"
    file = folder / "drive.ply"
    file.write_bytes(head.replace(count % n_rows, count % len(records)) + end + records.tobytes())
    codes = np.zeros(len(records), np.int32)
    part = slice(judged.start * n_rows, judged.stop * n_rows)
    codes[part] = marked(records)[part]
    return Case(file, saved(codes, folder))


def marked(records: np.ndarray) -> I32:
    """Return the codes of the classes marked by hand, (n,) int32; 0 = unsure."""
    turn = np.cumsum(np.diff(records["theta"], prepend=records["theta"][0]) < -1.0)
    section_m = np.stack([records[f"{axis}"] - records[f"{axis}_origin"] for axis in "yz"], axis=-1)
    codes = np.zeros(len(records), np.int32)
    is_open = np.ones(len(records), bool)
    rows = [row for row in MARKED.read_text().splitlines() if not row.startswith("#")]
    for row in csv.DictReader(rows):
        corners = np.array(row["corners"].split(), float).reshape(-1, 2)
        inside = is_open & points_in_poly(section_m, corners)
        inside &= (turn >= int(row["first"])) & (turn <= int(row["last"]))
        codes[inside] = CODES[row["class"]]
        is_open &= ~inside
    return codes


CODES = rings.CODES | {"unsure": 0, "other": rings.OTHER}


def argoverse(k: int, folder: Path) -> Case:
    """Write one of the two scanners of a sweep, with its ground and vehicles."""
    frame = list(rings.argoverse(folder))[k]
    return Case(frame.path, saved(frame.codes, folder))


def scan_of_others(file: Path, _: Path) -> Case:
    """Return a scan of another simulator, with its reference."""
    beside = file.with_name(f"{file.stem}.reference.npy")
    forest = file.stem.startswith("forest")
    mapping = MAPPINGS["forest"] if forest else "street"
    words = file.with_suffix(".options")
    options = tuple(words.read_text().split()) if words.exists() else ()
    return Case(file, beside if beside.exists() else file, mapping, options)


def scores_of(python: str, case: Case, folder: Path) -> dict[str, float]:
    """Classify a scan and evaluate it as a user does, by the package of a Python.

    Return the F1 of every class, and the share of its points that are called noise.
    """
    labels = folder / "labels.npy"
    labels.unlink(missing_ok=True)
    run = [*shlex.split(python), "-m", "prc_cli"]
    classify = [*run, "classify", str(case.file), str(labels), *case.options, "--overwrite", "-q"]
    done = subprocess.run(classify, cwd=folder, capture_output=True, text=True, check=False)
    if not labels.exists():
        print(f"refused: {done.stderr.strip()}", file=sys.stderr)
        return {}  # what is refused has no labels
    files = [str(labels), str(case.reference)]
    evaluate = [*run, "evaluate", *files, "--mapping", case.mapping, "--json"]
    process = subprocess.run(evaluate, cwd=folder, capture_output=True, text=True, check=False)
    if process.returncode:
        raise SystemExit(f"{case.file}: {process.stderr.strip()}")
    matrix = json.loads(process.stdout)["confusion"]
    every = scores(
        ConfusionMatrix(
            tuple(matrix["reference"]), tuple(matrix["predicted"]), np.array(matrix["counts"])
        )
    )
    values = {"good": every.called_noise}
    for item in every.classes:
        if item.n_reference >= LEAST_SHOTS:
            values[f"f1 {NAMES.get(item.name, item.name)}"] = float(np.nan_to_num(item.f1))
            values[item.name] = item.called_noise
    return {key: value for key, value in values.items() if not np.isnan(value)}


def numbers(text: str) -> list[int]:
    """Return the seeds of a text, ``3-5, 9``."""
    spans = [part.partition("-") for part in text.replace(" ", "").split(",") if part]
    return [seed for first, _, last in spans for seed in range(int(first), int(last or first) + 1)]


CLASSES = ("noise", "ground", "curb", "building", "vegetation", "car", "pole", "stem")
TABLES = {
    "F1 of the classes": {name: f"f1 {name}" for name in CLASSES},
    "Good points called noise": {name: name for name in ("good", *CLASSES[1:])},
}
"""Columns of every table, by the key of the figure."""

Figures = list[dict[str, float]]
"""Of a scan or of a group, by this checkout and by another."""


def mean(figures: list[Figures]) -> Figures:
    """Return the mean of every figure over the scans that have it."""
    return [
        {
            key: float(np.mean([scan[key] for scan in scans if key in scan]))
            for key in dict.fromkeys(key for scan in scans for key in scan)
        }
        for scans in zip(*figures, strict=True)
    ]


def cell(key: str, after: dict[str, float], before: dict[str, float] | None = None) -> str:
    """Return a figure, with the difference to another checkout, if there is one."""
    if key not in after:
        return ""
    change = "" if before is None else f" ({after[key] - before.get(key, 0.0):+.3f})"
    return f"{after[key]:.3f}{change}"


def main() -> None:
    """Print the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", default=SEEDS, help="of simulated scans, e.g. 8801-8806,8901")
    parser.add_argument("--only", nargs="*", default=[""], metavar="GROUP", help="that begin so")
    parser.add_argument("--others", type=Path, metavar="FOLDER", help="scans with references")
    parser.add_argument(
        "--against", metavar="PYTHON", help="command of a Python with another checkout"
    )
    chosen = parser.parse_args()
    pythons = [sys.executable, *([chosen.against] if chosen.against else [])]
    groups: dict[str, dict[str, Figures]] = {}
    for group, name, make in scans(numbers(chosen.seeds), chosen.others):
        if not group.startswith((*chosen.only, *(["others"] if chosen.others else []))):
            continue
        print(f"{group}: {name}", file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            case = make(Path(folder))
            figures = [scores_of(python, case, Path(folder)) for python in pythons]
        groups.setdefault(group, {})[name] = figures
    print(heading("Labels: figures", "labels"))
    commands(shlex.join(["python", "-m", "benchmarks.labels", *sys.argv[1:]]))
    say("""Nothing is told but the file. No limit was chosen on these seeds; the first file of RIEGL
    and Oakland strips 1 and 2 showed causes. In brackets is the difference to another checkout.""")
    rows = {f"{group}, mean": mean(list(every.values())) for group, every in groups.items()}
    rows |= {f"{group}: {name}": scan for group in groups for name, scan in groups[group].items()}
    for title, keys in TABLES.items():
        print(f"## {title}\n")
        table(
            ("scan", *keys),
            ((name, *(cell(key, *scan) for key in keys.values())) for name, scan in rows.items()),
        )
    print(duration())


if __name__ == "__main__":
    main()
