"""Runs of the contest, cached by content: only changed ones are run again."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import contest_data as data
from benchmarks import contest_peers as peers
from benchmarks import slow
from benchmarks.contest_data import ROOT, Scan, Simulated
from benchmarks.contest_judge import CURB, FOLDER, MAPPINGS, Verdict, judge, judge_things
from benchmarks.contest_methods import Method, label_scan
from prc_cli.core.types import F64

Progress = Callable[[str], None]
POINTS = "points.npz"
_MAKERS = ("simulation",)
_READERS = ("cli/classify.py", "config.py", "formats", "jobs/classify.py", "streams")
"""What is between a file and a method."""


@dataclass(frozen=True, slots=True)
class DataSet:
    """A scan, by the parameters that make it."""

    name: str
    group: str
    make: Callable[[], Scan]
    how: str
    """Its origin, for the cache and for the reader."""
    with_peers: bool = False
    source: Path | None = None
    """The real file behind it."""


def _simulated(spec: Simulated, group: str, *, with_peers: bool = False) -> DataSet:
    return DataSet(spec.name, group, partial(data.simulated, spec), repr(spec), with_peers)


PHOTON = "streets, photon-80"
SICK_GROUP = "streets, sick-push-broom"
PROFILER = "streets, profiler-1mhz"
OAKLAND = "Oakland 2, 3"
OAKLAND_NOISY = "Oakland 2, 3, background added"
OAKLAND_TRAIN = "Oakland 1 (tuned on)"
KITTI = "KITTI frame"
FOREST = "forests"
FOREST_CYLINDERS = "forests, reference of cylinders"
FOREST_NOISY = "forests, 3 cm of noise"
SLOW = "slow drives"
VIEWS = {"kitti": "KITTI views", "nuscenes": "nuScenes views", "vlp32": "VLP-32 views"}
"""By kind; those with odd numbers, the even ones chose parameters of rings.

VLP-32 views chose none.
"""
SLOW_DRIVES = ("normal", "1/4", "1/16", "stop and go")
PEER_SEEDS = (7201, 7202, 7205, 7208, 7209, 7210)
"""Streets for the filters of registered clouds, which take minutes instead of seconds."""
STREET_GROUPS = (PHOTON, SICK_GROUP, PROFILER)
_GROUP_OF = {"photon-80": PHOTON, "sick-push-broom": SICK_GROUP, "profiler-1mhz": PROFILER}


def data_sets() -> tuple[DataSet, ...]:
    """Return all scans for reporting, real ones if available."""
    sets = [
        _simulated(spec, _GROUP_OF[spec.scanner], with_peers=spec.seed in PEER_SEEDS)
        for spec in data.TEST_STREETS
    ]
    sets += _slow_drives()
    if (data.DATA / "oakland").exists():
        for n in (2, 3):
            name = f"Oakland strip {n}"
            path = data.DATA / "oakland" / f"oakland_{n}.csv.gz"
            sets.append(
                DataSet(name, OAKLAND, partial(data.oakland, n), f"oakland {n}", True, path)
            )
            noisy = partial(data.oakland_noisy, n)
            sets.append(
                DataSet(
                    f"{name}, 5 % background added",
                    OAKLAND_NOISY,
                    noisy,
                    f"oakland noisy {n}",
                    True,
                    path,
                )
            )
        path = data.DATA / "oakland" / "oakland_1.csv.gz"
        sets.append(
            DataSet(
                "Oakland strip 1", OAKLAND_TRAIN, partial(data.oakland, 1), "oakland 1", source=path
            )
        )
    if (data.DATA / "kitti").exists():
        sets.append(
            DataSet(
                "KITTI frame", KITTI, data.kitti, "kitti", True, data.DATA / "kitti" / "000000.bin"
            )
        )
    for kind, group in VIEWS.items():
        sets += [
            DataSet(path.stem, group, partial(data.view, path), path.stem, source=path)
            for path in data.view_paths(kind)
            if kind == "vlp32" or int(path.stem.rsplit("_", 1)[1]) % 2
        ]
    sets += [_simulated(spec, FOREST) for spec in data.TEST_FORESTS]
    sets += [_simulated(spec, FOREST_NOISY) for spec in data.NOISY_FORESTS]
    sets += [
        _simulated(replace(spec, cylinders=True), FOREST_CYLINDERS) for spec in data.TEST_FORESTS
    ]
    return tuple(sets)


def _slow_drives() -> list[DataSet]:
    """Return streets driven normally and slowly, of benchmarks.slow."""
    drives = []
    for spec in data.SLOW_STREETS:
        for name in SLOW_DRIVES:
            drive = slow.DRIVES[name]
            drives.append(
                DataSet(
                    f"{spec.name}, {name}", SLOW, partial(_slowed, spec, drive), f"{spec!r} {name}"
                )
            )
    return drives


def _slowed(spec: Simulated, places: Callable[[int], F64]) -> Scan:
    scan = data.simulated(spec)
    return slow.slowed(scan, places(len(scan.range_m)), spec.seed)


@dataclass(frozen=True, slots=True)
class Run:
    """Result of a method on a scan."""

    verdict: Verdict
    shots: int
    returns: int
    cpu_s: float
    when: str
    """UTC, to the minute."""
    peak_mib: float = float("nan")
    said: tuple[str, ...] = ()
    """What was said of the file, doubts and refusals."""
    is_down_told: bool = False
    """Whether straight down had to be told."""
    things: dict[str, list[float]] = field(default_factory=dict)
    """Counts of ``contest_judge.judge_things``."""


@dataclass(slots=True)
class Store:
    """Results by content, as JSON files in a folder."""

    folder: Path
    told: Progress
    scans: dict[str, Scan] = field(default_factory=dict)
    n_new: int = 0
    only_kept: bool = False
    """Whether scans without runs of all filters of registered clouds are left out."""

    def scan(self, item: DataSet) -> Scan:
        """Return a scan, cached; coordinates only where filters of registered clouds or curbs need
        them."""
        if item.how not in self.scans:
            scan = item.make()
            kept = item.with_peers or item.group in STREET_GROUPS
            self.scans[item.how] = scan if kept else replace(scan, world_m=None)
        return self.scans[item.how]

    def content(self, item: DataSet) -> str:
        """Return the hash of the content of a scan, cached by the hash of its parameters."""
        real = "" if item.source is None else _file_hash(item.source)
        makers = [_file_hash(FOLDER / name) for name in ("contest_data.py", "slow.py")]
        key = _digest([item.how, source_hash(_MAKERS), *makers, real])
        path = self.folder / f"scan-{key}.txt"
        if not path.exists():
            scan = self.scan(item)
            parts = [scan.range_m, scan.codes, scan.angle_rad, scan.extra.range_m, scan.extra_codes]
            parts += (
                [] if scan.world_m is None else [scan.world_m]
            )  # filters of registered clouds get nothing else
            digest = hashlib.blake2b(digest_size=16)
            for part in parts:
                digest.update(np.ascontiguousarray(part).data)
            self._keep(path, digest.hexdigest())
        return path.read_text(encoding="utf-8")

    def stream_run(self, item: DataSet, method: Method) -> Run:
        """Return the result of a method of the stream, from the cache if nothing has changed."""
        content = self.content(item)
        scan = self.scan(item)
        config = method.config(scan).config
        table = json.dumps(config.to_table(), sort_keys=True)
        written = [_file_hash(FOLDER / "contest_files.py"), source_hash(_READERS)]
        sources = sources_of(config.method) if config.is_decided else ("",)
        key = _digest([content, table, source_hash(sources), judge_hash(), *written])
        path = self.folder / f"stream-{key}.json"
        if not path.exists():
            self.told(f"{item.name}: {method.name}")
            self.n_new += 1
            labelled = label_scan(scan, method)
            verdict = judge(scan, labelled.codes, labelled.extra_codes)
            table_of_run = _table(verdict, scan, labelled.cpu_s, None)
            door = {"said": labelled.said, "is_down_told": labelled.is_down_told}
            door["things"] = judge_things(scan, labelled.codes)
            self._keep(path, json.dumps({**table_of_run, **door}))
        return _run(path)

    def peer_runs(self, item: DataSet, chains: dict[str, list[dict[str, Any]]]) -> dict[str, Run]:
        """Return the results of chains of filters on the registered points; two run at a time."""
        content = self.content(item)
        paths = {}
        for name, steps in chains.items():
            versions = [peers.installed(step["filter"]) for step in steps]
            if None in versions:
                continue
            code = _file_hash(FOLDER / "contest_peers.py")
            key = _digest([content, json.dumps([steps, versions]), code, judge_hash()])
            paths[name] = self.folder / f"peer-{key}.json"
        missing = [name for name, path in paths.items() if not path.exists()]
        if missing and self.only_kept:
            return {}
        if missing:
            scan = self.scan(item)
            with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
                write_points(points_of(scan), Path(folder) / POINTS)
                # run common first steps of several chains once, before them
                begin = {json.dumps(chains[name][:-1]): chains[name][:-1] for name in missing}
                list(
                    pool.map(
                        partial(_run_chain, Path(folder)),
                        [steps for steps in begin.values() if steps],
                    )
                )

                def work(name: str) -> None:
                    self.told(f"{item.name}: {name}")
                    self.n_new += 1
                    with np.load(_run_chain(Path(folder), chains[name])) as arrays:
                        codes = arrays["codes"]
                        cpu_s = float(arrays["cpu_s"])
                        peak_mib = float(arrays["peak_mib"])
                    verdict = judge(scan, *as_image(scan, codes))
                    self._keep(paths[name], json.dumps(_table(verdict, scan, cpu_s, peak_mib)))

                list(pool.map(work, missing))
        return {name: _run(path) for name, path in paths.items()}

    def _keep(self, path: Path, text: str) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".part")
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)


def points_of(scan: Scan) -> peers.Points:
    """Return all returns of a scan with registered coordinates, further returns at the end."""
    assert scan.world_m is not None
    assert scan.scanner_m is not None
    there = ~np.isnan(scan.range_m)
    xyz = np.concatenate([scan.world_m[there], scan.extra_world_m])
    line = np.concatenate([np.nonzero(there)[0], scan.extra.line]).astype(np.int32)
    return peers.Points(xyz, line, scan.scanner_m, scan.height_m)


def write_points(points: peers.Points, path: Path) -> None:
    """Write points for a separate process."""
    np.savez(
        path,
        xyz_m=points.xyz_m,
        line=points.line,
        scanner_m=points.scanner_m,
        height_m=points.height_m,
    )


def as_image(scan: Scan, codes: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Split codes of points into those of shots, (lines, M), and of further returns, (e,)."""
    there = ~np.isnan(scan.range_m)
    n = np.count_nonzero(there)
    image = np.zeros(scan.range_m.shape, np.uint8)
    image[there] = codes[:n]
    return image, codes[n:]


def _run_chain(folder: Path, steps: list[dict[str, Any]]) -> Path:
    """Run a chain of filters in a separate process, unless cached.

    Start from its cached first steps if any.
    """
    output = _output_of(folder, steps)
    before = _output_of(folder, steps[:-1])
    if output.exists():
        return output
    command = [sys.executable, "-m", "benchmarks.contest_peers", str(folder / POINTS), str(output)]
    command += (
        [json.dumps(steps[-1]), "--after", str(before)]
        if before.exists()
        else [json.dumps(s) for s in steps]
    )
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        problem = f"{' '.join(command)}\n{done.stderr}"
        raise RuntimeError(problem)
    return output


def _output_of(folder: Path, steps: list[dict[str, Any]]) -> Path:
    return folder / f"{_digest([json.dumps(steps)])}.npz"


def _table(
    verdict: Verdict,
    scan: Scan,
    cpu_s: float,
    peak_mib: float | None,
) -> dict[str, Any]:
    returns = int((~np.isnan(scan.range_m)).sum()) + len(scan.extra)
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
    table = {
        "verdict": verdict.as_dict(),
        "shots": scan.n_shots,
        "returns": returns,
        "cpu_s": cpu_s,
        "when": when,
    }
    return table if peak_mib is None else {**table, "peak_mib": peak_mib}


def _run(path: Path) -> Run:
    table = json.loads(path.read_text(encoding="utf-8"))
    said = tuple(table.get("said", ()))
    return Run(**{**table, "verdict": Verdict.of(table["verdict"]), "said": said})


def sources_of(method: str) -> tuple[str, ...]:
    """Return the source files that the labels of a method depend on."""
    name = method.replace("-", "_")
    return (f"methods/{name}", "methods/returns.py")


@lru_cache(maxsize=8)
def source_hash(names: tuple[str, ...]) -> str:
    """Return the hash of source files of the package."""
    digest = hashlib.blake2b(digest_size=8)
    for name in names:
        path = ROOT / "prc_cli" / name
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()


@lru_cache(maxsize=1)
def judge_hash() -> str:
    files = [
        FOLDER / "contest_judge.py",
        *(path for path in MAPPINGS.values() if isinstance(path, Path)),
    ]
    return _digest([_file_hash(file) for file in files])


def _file_hash(path: Path) -> str:
    return hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()


def _digest(parts: list[str]) -> str:
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=12).hexdigest()


NAMES = ("car", "pole", CURB)
LEAST_SHOTS = 100
"""Fewest shots of a thing in a scan that is judged: below, the score depends on a few."""


def f1(counts: list[float]) -> float:
    """Return F1 of shots that agree, that are predicted, and of the reference."""
    agree, predicted, reference = counts
    return 2 * agree / (predicted + reference)


def judged(method_runs: dict[str, Run], items: list[DataSet], name: str) -> list[list[float]]:
    """Return the counts of a thing in the scans that hold enough of it."""
    there = (method_runs[item.how].things.get(name) for item in items if item.how in method_runs)
    return [counts for counts in there if counts is not None and counts[2] >= LEAST_SHOTS]


def print_things(groups: dict[str, list[DataSet]], runs: dict[str, dict[str, Run]]) -> None:
    """One table a thing: methods that know it by group."""
    for name in NAMES:
        counts_by_method = {
            method: {group: judged(method_runs, items, name) for group, items in groups.items()}
            for method, method_runs in runs.items()
        }
        counts_by_method = {
            method: cells
            for method, cells in counts_by_method.items()
            if any(c[1] for counts in cells.values() for c in counts)
        }
        shown = [
            group for group in groups if any(cells[group] for cells in counts_by_method.values())
        ]
        if not shown:
            continue
        print(f"### {name[0].upper()}{name[1:]}: F1 (precision, recall; worst scan)\n")
        print(f"| | {' | '.join(shown)} |\n|---|{'---:|' * len(shown)}")
        for method, cells in counts_by_method.items():
            print(f"| {method} | {' | '.join(_cell(cells[group]) for group in shown)} |")
        print()


def _cell(counts: list[list[float]]) -> str:
    """Return the mean F1, the means of precision and recall, and the worst F1 if there are several
    scans."""
    if not counts:
        return ""
    scores = [f1(label_counts) for label_counts in counts]
    precision = [agree / predicted if predicted else 0.0 for agree, predicted, _ in counts]
    recall = [agree / reference for agree, _, reference in counts]
    worst = f"; {min(scores):.2f}" if len(scores) > 1 else ""
    return f"{np.mean(scores):.3f} ({np.mean(precision):.2f}, {np.mean(recall):.2f}{worst})"
