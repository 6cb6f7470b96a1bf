"""Speed and memory: rates in memory, files, LAS, peak memory, latency and start.

    python -m benchmarks.speed > figures/speed.md     # all parts, on a quiet machine
    python -m benchmarks.speed las files                   # some of them
    python -m benchmarks.speed --lines 600                 # short inputs, to try the program

Jobs of a table run in turn, so that other load affects all of them; the least time counts.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import laspy
import numpy as np

from benchmarks.drives import POINTS_PER_LINE, ranges_of, write_csv, write_drive, write_raw
from benchmarks.pages import commands, duration, heading, parser_of, table
from benchmarks.user import run
from prc_cli.config import load_config
from prc_cli.core.stream import ScanBlock
from prc_cli.core.threads import default_threads
from prc_cli.formats.las.points import set_classes
from prc_cli.jobs.classify import classify, classify_ranges, label_blocks, load_classifier
from prc_cli.simulation.settings import load_settings, open_simulation
from tests.methods.prc import paper

LINES = 4643
"""Lines of the inputs: 10 million shots."""
ROUNDS = 5
PUBLISHED = "prc-2019-"
"""Presets of PRC as published; tables name them without it."""
LIMIT_MIB = 256
"""The goal for any size of an input."""
DOUBTS = ("repeated-lines", "line-order")
"""Warnings about a drive that passes the same street again and again."""


class Took(NamedTuple):
    """Least times of a job [s]."""

    wall: float
    cpu: float
    """Of all cores."""

    def __str__(self) -> str:
        return f"{self.wall:.3f} ({self.cpu:.3f})"


def least_times(jobs: dict[str, Callable[[], object]], rounds: int = ROUNDS) -> dict[str, Took]:
    """Return the least times of every job, after a round that is not counted."""
    least = {name: Took(np.inf, np.inf) for name in jobs}
    for number in range(rounds + 1):
        for name, job in jobs.items():
            start = time.perf_counter()
            start_cpu = time.process_time()
            job()
            wall = time.perf_counter() - start
            cpu = time.process_time() - start_cpu
            if number:
                least[name] = Took(min(least[name].wall, wall), min(least[name].cpu, cpu))
    return least


def compare(took: dict[str, Took], rows: tuple[tuple[str, str, str], ...]) -> None:
    """Print jobs beside what they are compared with, and the goal of the ratio."""
    table(
        ("work", "s (of all cores)", "beside", "s (of all cores)", "ratio", "processor", "goal"),
        (
            (
                work,
                took[work],
                beside,
                took[beside],
                f"{took[work].wall / took[beside].wall:.2f}",
                f"{took[work].cpu / took[beside].cpu:.2f}",
                goal,
            )
            for work, beside, goal in rows
        ),
    )


def in_memory(_: Path, n_lines: int) -> None:
    """Print rates of PRC without files, beside a copy of the ranges and the plain twin."""
    piece = ranges_of("street", 594, scanner={"points_per_line": POINTS_PER_LINE})
    ranges = np.tile(piece, (max(1, 3 * n_lines // len(piece)), 1))  # larger than any cache
    wide = np.tile(
        ranges_of("street", 510, scanner={"points_per_line": 4270}), (max(1, n_lines // 400), 1)
    )
    target = np.empty_like(ranges)
    urban = load_config(preset="prc-2019-urban").config
    forest = load_config(preset="prc-2019-forest").config
    settings = paper.Settings(k=urban.prc.lines_per_block)

    def label_all(image: np.ndarray, params: object, threads: int) -> None:
        for _ in label_blocks(iter([ScanBlock(0, image)]), params, threads=threads):
            pass

    jobs: dict[str, tuple[Callable[[], object], int]] = {
        "copy of the ranges": (lambda: np.copyto(target, ranges), ranges.size)
    }
    for n in sorted({1, default_threads()}):
        jobs[f"PRC urban, k 99, M 2154, threads: {n}"] = (
            partial(label_all, ranges, urban.prc, n),
            ranges.size,
        )
        jobs[f"PRC forest, k 255, M 4270, threads: {n}"] = (
            partial(label_all, wide, forest.prc, n),
            wide.size,
        )
    jobs["classify_ranges(), urban"] = (
        lambda: classify_ranges(ranges, urban).labels,
        ranges.size,
    )
    took = least_times({name: job for name, (job, _) in jobs.items()})
    oracle = "oracle, urban"
    jobs[oracle] = (lambda: paper.classify_stream(piece, settings), piece.size)
    took |= least_times({oracle: jobs[oracle][0]}, 1)
    rates = {name: n_shots / took[name].wall / 1e6 for name, (_, n_shots) in jobs.items()}
    print("## PRC in memory\n")
    table(
        ("work", "million shots a second", "beside the oracle", "of one core's time"),
        (
            (
                name,
                f"{rate:.2f}",
                f"{rate / rates[oracle]:.0f}",
                f"{jobs[name][1] / took[name].cpu / 1e6:.2f}",
            )
            for name, rate in rates.items()
        ),
    )


def static_scans(_: Path, n_lines: int) -> None:
    """Print rates of sequential-angle on a simulated static scan."""
    config = load_config(preset="street-scan")
    options = {"seed": 3, "lines": min(n_lines, 1565)}
    scan = open_simulation("street-scan", load_settings("street-scan", options=options)).scan
    blocks = list(scan.blocks())
    n_shots = sum(block.range_m.size for block in blocks)

    def label_all(threads: int) -> None:
        for _ in label_blocks(iter(blocks), config.config.classifier, threads=threads):
            pass

    jobs: dict[str, Callable[[], object]] = {
        f"all stages, in memory, {n} thread{'s' * (n > 1)}": partial(label_all, n)
        for n in sorted({1, default_threads()})
    }
    print("## Sequential-angle in memory\n")
    table(
        ("work", "million shots a second"),
        ((name, f"{n_shots / t.wall / 1e6:.2f}") for name, t in least_times(jobs, 3).items()),
    )


def files(folder: Path, n_lines: int) -> None:
    """Print times from file to labels, beside reading and writing alone."""
    import pyarrow as pa
    from pyarrow import csv

    raw, array, text = (folder / name for name in ("street.bin", "street.npz", "street.csv"))
    write_raw(raw, n_lines)
    image = np.memmap(raw, "<f4", "r").reshape(-1, POINTS_PER_LINE)
    np.savez(array, range_m=image)
    write_csv(text, raw)
    labels = np.ones(image.size, np.uint8)
    config = load_config(
        preset="prc-2019-urban", options={"input": {"points_per_line": POINTS_PER_LINE}}
    )
    plain_config = load_config(preset="prc-2019-urban")
    kinds = csv.ConvertOptions(column_types={"range": pa.float64()})

    def then_write(read: Callable[[], object]) -> None:
        read()
        np.save(folder / "plain.npy", labels)
        with (folder / "plain.npy").open("rb+") as handle:
            os.fsync(handle.fileno())

    def to_labels(source: Path) -> None:
        used = plain_config if source == array else config
        classify(source, folder / "labels.npy", used, overwrite=True)

    took = least_times(
        {
            "raw: read, write": partial(then_write, raw.read_bytes),
            "raw to labels": partial(to_labels, raw),
            "npz: read, write": partial(then_write, array.read_bytes),
            "npz to labels": partial(to_labels, array),
            "csv: parse, write": partial(
                then_write, partial(csv.read_csv, text, convert_options=kinds)
            ),
            "csv to labels": partial(to_labels, text),
        }
    )
    print(f"## Files\n\n{image.size / 1e6:.1f} million shots, inputs in the cache.\n")
    compare(
        took,
        (
            ("raw to labels", "raw: read, write", "2"),
            ("npz to labels", "npz: read, write", "2"),
            ("csv to labels", "csv: parse, write", "1.15"),
        ),
    )


def las_files(folder: Path, n_lines: int) -> None:
    """Print times on LAS and LAZ, beside reading and writing the same file alone."""
    raw, laz, las = (folder / name for name in ("street.bin", "drive.laz", "drive.las"))
    write_raw(raw, n_lines)
    for path in (laz, las):
        write_drive(path, raw, 6)
    rules = {"points_per_line": POINTS_PER_LINE, "accept_doubts": DOUBTS}
    config = load_config(preset="prc-2019-urban", options={"input": rules})
    backend = laspy.LazBackend.LazrsParallel
    layers = laspy.DecompressionSelection
    needed = layers.base() | layers.GPS_TIME | layers.ALL_EXTRA_BYTES | layers.XY_RETURNS_CHANNEL

    def read_and_write() -> None:
        with (
            laspy.open(laz, laz_backend=backend) as reader,
            laspy.open(folder / "o.laz", "w", header=reader.header, laz_backend=backend) as writer,
        ):
            for points in reader.chunk_iterator(1_000_000):
                writer.write_points(points)

    def read_fields() -> None:
        selection = needed & ~layers.Z
        with laspy.open(laz, laz_backend=backend, decompression_selection=selection) as reader:
            for _ in reader.chunk_iterator(1_000_000):
                pass

    def copy_and_patch(*, flush: bool) -> None:
        shutil.copyfile(las, folder / "o.las")
        with laspy.open(las) as reader:
            header = reader.header
        shape = (header.point_count, header.point_format.size)
        start = header.offset_to_point_data
        points = np.memmap(folder / "o.las", np.uint8, "r+", offset=start, shape=shape)
        set_classes(points, header.point_format.id, np.full(shape[0], 2, np.uint8))
        if flush:
            points.flush()

    def to(source: Path, suffix: str) -> None:
        classify(source, folder / f"classified{suffix}", config, overwrite=True)

    took = least_times(
        {
            "laspy reads and writes LAZ": read_and_write,
            "LAZ to classified LAZ": partial(to, laz, ".laz"),
            "laspy reads the fields": read_fields,
            "LAZ to labels": partial(to, laz, ".npy"),
            "copy and patch": partial(copy_and_patch, flush=False),
            "copy, patch and flush": partial(copy_and_patch, flush=True),
            "LAS to classified LAS": partial(to, las, ".las"),
        },
        3,
    )
    print("## LAS and LAZ\n")
    compare(
        took,
        (
            ("LAZ to classified LAZ", "laspy reads and writes LAZ", "1.10"),
            ("LAZ to labels", "laspy reads the fields", "1.15"),
            ("LAS to classified LAS", "copy and patch", "1.25"),
            ("LAS to classified LAS", "copy, patch and flush", ""),
        ),
    )


def print_peaks(peaks: dict[str, list[float]], sizes: tuple[int, int]) -> None:
    """Print peak memory by job, at two sizes of the input [lines]."""
    shots = [f"{n * POINTS_PER_LINE / 1e6:.1f} M shots [MiB]" for n in sizes]
    table(
        ("job", *shots, "ratio", "goal [MiB]"),
        (
            (job, f"{small:.0f}", f"{large:.0f}", f"{large / small:.2f}", LIMIT_MIB)
            for job, (small, large) in peaks.items()
        ),
    )


def memory(folder: Path, n_lines: int) -> None:
    """Print the peak memory of the formats and of the methods, at a small and a large input."""
    sizes = (min(600, n_lines), n_lines)
    options = ("-q", "--overwrite", "--preset")
    accept = tuple(word for name in DOUBTS for word in ("--accept-doubt", name))
    peaks: dict[str, list[float]] = {}
    for n in sizes:
        raw, array, text = (folder / name for name in ("s.bin", "s.npz", "s.csv"))
        write_raw(raw, n)
        np.savez(array, range_m=np.memmap(raw, "<f4", "r").reshape(-1, POINTS_PER_LINE))
        write_csv(text, raw)
        for suffix in (".laz", ".las"):
            write_drive(folder / f"s{suffix}", raw, 6)
        for source, suffix in (
            (raw, ".npy"),
            (raw, ".laz"),
            (array, ".npy"),
            (text, ".npy"),
            (folder / "s.laz", ".laz"),
            (folder / "s.las", ".las"),
        ):
            m = () if source == array else ("-M", POINTS_PER_LINE)
            done = run(
                "classify", source, folder / f"o{suffix}", *options, "prc-2019-urban", *m, *accept
            )
            name = f"{source.suffix[1:]} → {suffix[1:]}".replace("bin", "raw")
            peaks.setdefault(name, []).append(done.peak_mib)
    print("## Memory\n")
    print_peaks(peaks, sizes)
    presets = {
        "street": ("prc-2019-urban", "street-scan", "fused"),
        "forest": ("prc-2019-forest", "fused-forest"),
    }
    peaks = {}
    checks = ("units", "indoors", "line-length", "down")
    accept = tuple(word for name in checks for word in ("--accept-doubt", name))
    for n in sizes:
        for kind, names in presets.items():
            drive = folder / f"{kind}.laz"
            run("simulate", kind, drive, "--lines", n, "--seed", 7, "-q", "--overwrite")
            for preset in names:
                words = ("classify", drive, folder / "o.laz", *options, preset, *accept)
                run(*words)  # may compile, which takes memory once
                peaks.setdefault(preset, []).append(run(*words).peak_mib)
    print("## Memory of every method\n\nLAZ to LAZ.\n")
    print_peaks(peaks, sizes)


def waits_ms(ranges: np.ndarray, preset: str, block: int) -> np.ndarray:
    """Return the time from the last byte that labels need to their arrival, by block.

    Every block is written after the labels of the block before have arrived.
    """
    n_lines, width = ranges.shape
    options = ["--preset", preset, "--set", f"prc.lines_per_block={block}"]
    command = [sys.executable, "-m", "prc_cli", "stream", "-q", "-M", str(width), *options]
    seconds: list[float] = []
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        # the first labels need two lines more than their own
        process.stdin.write(ranges[:2].tobytes())
        for first in range(2, n_lines - block + 1, block):
            process.stdin.write(ranges[first : first + block].tobytes())
            start = time.perf_counter()
            missing = block * width
            while missing:
                missing -= len(os.read(process.stdout.fileno(), missing))
            seconds.append(time.perf_counter() - start)
        process.stdin.close()
        process.stdout.read()
    # loops load and the block fills
    return 1e3 * np.array(seconds[max(1, 300 // block) :])


def latency(_: Path, n_lines: int) -> None:
    """Print how long ``prc stream`` keeps labels."""
    rows = []
    for title, kind, scanner, preset, block in (
        ("urban, blocks of 99 lines, M 2154", "street", "photon-80", "prc-2019-urban", 99),
        ("forest, blocks of 255 lines, M 4270", "forest", "focus3d-120", "prc-2019-forest", 255),
    ):
        options = {"lines": max(min(n_lines, 900), 600), "scanner": {"name": scanner}}
        settings = load_settings(kind, options=options)  # type: ignore[arg-type]
        ranges = ranges_of(kind, options["lines"], scanner={"name": scanner})
        wait_ms = waits_ms(ranges, preset, block)
        rows.append(
            (
                title,
                *(f"{part:.2f}" for part in np.percentile(wait_ms, [50, 99, 100])),
                f"{1e3 / settings.scanner.line_hz:.1f}",
            )
        )
    print("## Latency\n")
    table(("labels leave", "median [ms]", "99 % [ms]", "longest [ms]", "a line takes [ms]"), rows)


LOAD = (
    "import sys; from prc_cli.config import load_config;"
    "from prc_cli.jobs.classify import load_classifier;"
    "load_classifier(load_config(preset=sys.argv[1]))"
)
"""Compile the loops of a preset, as the command does."""


def python_times(words: list[str], cache: Path) -> Took:
    """Return the times of a Python process with its own caches of loops and bytecode."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPYCACHEPREFIX": str(cache.parent / "bytecode"),
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = os.times()
    start = time.perf_counter()
    subprocess.run([sys.executable, *words], env=environment, check=True, stdout=subprocess.DEVNULL)
    wall = time.perf_counter() - start
    after = os.times()
    users = after.children_user - before.children_user
    return Took(wall, users + after.children_system - before.children_system)


def start(folder: Path, n_lines: int) -> None:
    """Print the time of the first run with empty caches, and of a warm start."""
    rows = []
    for method, preset in {
        "prc": "prc-2019-urban",
        "sequential-angle": "street-scan",
        "fused": "fused",
        "fused-forest": "fused-forest",
    }.items():
        cold = python_times(["-c", LOAD, preset], folder / method)
        rows.append((f"first run: compile all of {method}", cold))
    small = folder / "small.npz"
    run("simulate", "street", small, "--lines", min(n_lines, 186), "--seed", 1, "-q")
    words = ["-m", "prc_cli", "classify", str(small), str(folder / "o.npy"), "--overwrite", "-q"]
    works = {
        "`python -c pass`": ["-c", "pass"],
        "`import numpy, numba`": ["-c", "import numpy, numba"],
        "`prc --version`": ["-m", "prc_cli", "--version"],
    } | {
        f"`prc classify`, {preset.removeprefix(PUBLISHED)}": [*words, "--preset", preset]
        for preset in ("prc-2019-urban", "street-scan", "fused")
    }
    for title, arguments in works.items():
        python_times(arguments, folder / "warm")
        times = [python_times(arguments, folder / "warm") for _ in range(ROUNDS)]
        rows.append((f"warm start, {title}", Took(*map(min, zip(*times, strict=True)))))
    print("## Start\n")
    table(
        ("work", "s", "CPU s"),
        ((title, f"{took.wall:.2f}", f"{took.cpu:.2f}") for title, took in rows),
    )


PARTS: dict[str, Callable[[Path, int], None]] = {
    "memory": memory,
    "in-memory": in_memory,
    "static": static_scans,
    "files": files,
    "las": las_files,
    "latency": latency,
    "start": start,
}


def main() -> None:
    """Print the page."""
    parser = parser_of(__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--lines", type=int, default=LINES, help="lines of the inputs")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.parts if name not in PARTS]
    if unknown:
        parser.error(f"no part {unknown[0]}; there are {', '.join(PARTS)}")
    load_classifier(load_config(preset="prc-2019-urban"))
    print(heading("Speed and memory: figures", "speed"))
    print("What the tables mean: [Speed and memory](../docs/speed.md).\n")
    commands("python -m benchmarks.speed > figures/speed.md")
    for name in arguments.parts or PARTS:
        with tempfile.TemporaryDirectory() as folder:
            PARTS[name](Path(folder), arguments.lines)
    print(duration())


if __name__ == "__main__":
    main()
