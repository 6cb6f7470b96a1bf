"""Time of ``classify`` from file to label file, compared with reading and writing alone.

    python -m benchmarks.files                     # 10 million shots, inputs in the system's cache
    python -m benchmarks.files --lines 46426       # 100 million (text stays at 10)
    python -m benchmarks.files --cold  # inputs are dropped from the cache before every run (Linux)

All jobs run in this process, in turn; the least time counts. Every output is flushed to disk. The
last rows are classifier and fingerprint alone, a lower limit for any pipeline."""

from __future__ import annotations

import argparse
import hashlib
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.drives import POINTS_PER_LINE, write_csv, write_raw
from benchmarks.las import forget
from benchmarks.memory import FULL_LINES
from prc_cli.config import load_config
from prc_cli.core.types import U8
from prc_cli.jobs.classify import classify, classify_ranges, load_classifier

CHUNK_BYTES = 1 << 20


def write_labels(output: Path, labels: U8) -> None:
    """Write labels in the simplest way, and flush them."""
    np.save(output, labels)
    with output.open("rb+") as handle:
        os.fsync(handle.fileno())


def read_plainly(source: Path) -> None:
    """Read all bytes of a file into the same memory."""
    piece = bytearray(CHUNK_BYTES)
    with source.open("rb", buffering=0) as handle:
        while handle.readinto(piece):
            pass


def parse(source: Path) -> None:
    """Parse a column of numbers with pyarrow alone: all at once, on all cores."""
    import pyarrow as pa
    from pyarrow import csv

    csv.read_csv(source, convert_options=csv.ConvertOptions(column_types={"range": pa.float64()}))


def jobs_of(
    folder: Path, n_lines: int
) -> tuple[dict[str, tuple[Path, Callable[[], object]]], dict[str, int]]:
    """Every job by its name with its input, and the shots of each input."""
    raw, array, text, small = (
        folder / name for name in ("street.bin", "street.npz", "street.csv", "small.bin")
    )
    write_raw(raw, n_lines)
    image = np.memmap(raw, "<f4", "r").reshape(-1, POINTS_PER_LINE)
    np.savez(array, range_m=image)
    write_raw(small, min(n_lines, FULL_LINES[0]))
    write_csv(text, small)
    labels = np.ones(image.size, np.uint8)
    few = labels[: min(n_lines, FULL_LINES[0]) * POINTS_PER_LINE]
    with_m = load_config(
        preset="prc-2019-urban", options={"input": {"points_per_line": POINTS_PER_LINE}}
    )
    without = load_config(preset="prc-2019-urban")
    load_classifier(with_m)
    in_memory = np.array(image[: FULL_LINES[0]])

    def plain(source: Path, read: Callable[[Path], None], written: U8) -> Callable[[], None]:
        def run() -> None:
            read(source)
            write_labels(folder / "plain.npy", written)

        return run

    return {
        "raw: read, write": (raw, plain(raw, read_plainly, labels)),
        "raw to labels": (raw, lambda: classify(raw, folder / "a.npy", with_m, overwrite=True)),
        "npz: read, write": (array, plain(array, read_plainly, labels)),
        "npz to labels": (
            array,
            lambda: classify(array, folder / "b.npy", without, overwrite=True),
        ),
        "csv: parse, write": (text, plain(text, parse, few)),
        "csv to labels": (text, lambda: classify(text, folder / "c.npy", with_m, overwrite=True)),
        "PRC in memory": (small, lambda: classify_ranges(in_memory, with_m).labels),
        "SHA-256": (raw, lambda: hashlib.file_digest(raw.open("rb"), "sha256")),
    }, {
        "raw": image.size,
        "npz": image.size,
        "csv": len(few),
        "PRC": in_memory.size,
        "SHA-256": image.size,
    }


ROWS = (
    ("raw to labels", "raw: read, write", "2"),
    ("npz to labels", "npz: read, write", "2"),
    ("csv to labels", "csv: parse, write", "1.15"),
)
"""Job, the job to compare it with, and the target."""


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lines", type=int, default=FULL_LINES[0])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--cold", action="store_true")
    arguments = parser.parse_args()
    took: dict[str, tuple[float, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        jobs, shots = jobs_of(Path(name), arguments.lines)
        for _ in range(arguments.runs):
            for job, (source, run) in jobs.items():
                if arguments.cold:
                    forget(source)
                start = time.perf_counter()
                start_cpu = time.process_time()
                run()
                this = time.perf_counter() - start, time.process_time() - start_cpu
                best = took.get(job, this)
                took[job] = min(best[0], this[0]), min(best[1], this[1])
    cache = "not in the cache" if arguments.cold else "in the cache"
    print(
        f"{shots['raw'] / 1e6:.1f} million shots ({shots['csv'] / 1e6:.1f} as text), "
        f"inputs {cache}\n"
    )
    print(
        "| work | s (of all cores) | Mshots/s | beside | s (of all cores) | ratio | "
        "processor time | goal |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for work, beside, goal in ROWS:
        (wall, cpu) = took[work]
        (wall_beside, cpu_beside) = took[beside]
        rate = shots[work.split()[0]] / wall / 1e6
        print(
            f"| {work} | {wall:.3f} ({cpu:.3f}) | {rate:.0f} | {beside} | "
            f"{wall_beside:.3f} ({cpu_beside:.3f}) "
            f"| {wall / wall_beside:.2f} | {cpu / cpu_beside:.2f} | {goal} |"
        )
    for work in ("PRC in memory", "SHA-256"):
        wall, cpu = took[work]
        print(
            f"| {work} | {wall:.3f} ({cpu:.3f}) | "
            f"{shots[work.split()[0]] / wall / 1e6:.0f} | | | | | |"
        )


if __name__ == "__main__":
    main()
