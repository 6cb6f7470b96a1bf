"""Time of ``classify`` on LAS and LAZ, compared with reading and writing the same file alone.

    python -m benchmarks.las                     # 10 million shots, files in the system's cache
    python -m benchmarks.las --cold  # the input is dropped from the cache before every run (Linux)
    # LAZ of an old point format: every record is compressed again
    python -m benchmarks.las --format 1

All jobs run in this process, in turn; the least time counts. The input is a drive past a
simulated street, point format 6 with time, angle, intensity and the dimensions of a scan line,
chunks of 50 000 records. Outputs are new files. ``classify`` flushes its output to disk, so LAS has
a second row with a flush."""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np

from benchmarks.drives import POINTS_PER_LINE, write_drive, write_raw
from prc_cli.config import LoadedConfig, load_config
from prc_cli.formats.las.points import set_classes
from prc_cli.jobs.classify import classify, load_classifier

CHUNK = 1_000_000
"""Records per chunk of laspy."""


def read_and_write(source: Path, output: Path) -> None:
    """Copy with laspy, decompression and compression on all cores."""
    backend = laspy.LazBackend.LazrsParallel
    with (
        laspy.open(source, laz_backend=backend) as reader,
        laspy.open(output, "w", header=reader.header, laz_backend=backend) as writer,
    ):
        for points in reader.chunk_iterator(CHUNK):
            writer.write_points(points)


def read_fields(source: Path, *, intensity: bool = True) -> None:
    """Decompress the layers that PRC uses: returns, time, intensity and the extra bytes.

    Intensity decides between the returns of a shot. In a file without further returns, such as this
    one, ``classify`` does not decompress it."""
    layers = laspy.DecompressionSelection
    wanted = layers.base() | layers.GPS_TIME | layers.ALL_EXTRA_BYTES | layers.XY_RETURNS_CHANNEL
    if intensity:
        wanted |= layers.INTENSITY
    backend = laspy.LazBackend.LazrsParallel
    with laspy.open(
        source, laz_backend=backend, decompression_selection=wanted & ~layers.Z
    ) as reader:
        for _ in reader.chunk_iterator(CHUNK):
            pass


def copy_and_patch(source: Path, output: Path, *, flush: bool) -> None:
    """Copy a LAS file and set the classes through a memory map."""
    shutil.copyfile(source, output)
    with laspy.open(source) as reader:
        start = reader.header.offset_to_point_data
        n = reader.header.point_count
        length = reader.header.point_format.size
        point_format = reader.header.point_format.id
    points = np.memmap(output, np.uint8, "r+", offset=start, shape=(n, length))
    set_classes(points, point_format, np.full(n, 2, np.uint8))
    if flush:
        points.flush()
        with output.open("rb+") as handle:
            os.fsync(handle.fileno())


def forget(path: Path) -> None:
    """Drop a file from the system's cache."""
    with path.open("rb") as handle:
        os.fsync(handle.fileno())
        os.posix_fadvise(handle.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def measure(
    jobs: dict[str, tuple[Path, Callable[[Path, Path], None]]],
    folder: Path,
    runs: int,
    *,
    cold: bool,
) -> dict[str, tuple[float, float]]:
    """Return the least wall time and processor time of every job [s]."""
    least: dict[str, tuple[float, float]] = {}
    for _ in range(runs):
        for number, (name, (source, job)) in enumerate(jobs.items()):
            # touch the memory first, so that the first job does not pay for it
            shutil.copyfile(source, folder / "out")
            for old in folder.glob("out*"):
                old.unlink()
            if cold:
                forget(source)
            output = folder / f"out{number}{source.suffix}"
            start = time.perf_counter()
            start_cpu = time.process_time()
            job(source, output)
            took = time.perf_counter() - start, time.process_time() - start_cpu
            before = least.get(name, took)
            least[name] = min(before[0], took[0]), min(before[1], took[1])
    return least


def jobs_of(
    laz: Path, las: Path, config: LoadedConfig
) -> dict[str, tuple[Path, Callable[[Path, Path], None]]]:
    """Every job by its name, with its input."""

    def labels_alone(source: Path, output: Path) -> None:
        classify(source, output.with_suffix(".npy"), config)

    def whole(source: Path, output: Path) -> None:
        classify(source, output, config)

    return {
        "laspy reads and writes LAZ": (laz, read_and_write),
        "LAZ to classified LAZ": (laz, whole),
        "laspy reads the fields": (laz, lambda source, _: read_fields(source)),
        "without intensity": (laz, lambda source, _: read_fields(source, intensity=False)),
        "LAZ to labels": (laz, labels_alone),
        "copy and patch": (las, lambda source, output: copy_and_patch(source, output, flush=False)),
        "copy, patch and flush": (
            las,
            lambda source, output: copy_and_patch(source, output, flush=True),
        ),
        "LAS to classified LAS": (las, whole),
    }


ROWS = (
    ("LAZ to classified LAZ", "laspy reads and writes LAZ", "1.10"),
    ("LAZ to labels", "laspy reads the fields", "1.15"),
    ("LAZ to labels", "without intensity", ""),
    ("LAS to classified LAS", "copy and patch", "1.25"),
    ("LAS to classified LAS", "copy, patch and flush", ""),
)
"""Job, the job to compare it with, and the target."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lines", type=int, default=4643)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--format", type=int, default=6, choices=(1, 6))
    parser.add_argument("--cold", action="store_true")
    arguments = parser.parse_args()
    # a long drive passes the same street again and again
    accepted = ["repeated-lines", "line-order"]
    rules = {"points_per_line": POINTS_PER_LINE, "accept_doubts": accepted}
    config = load_config(preset="prc-2019-urban", options={"input": rules})
    load_classifier(config)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        raw = folder / "street.bin"
        laz = folder / "drive.laz"
        las = folder / "drive.las"
        write_raw(raw, arguments.lines)
        for path in (laz, las):
            write_drive(path, raw, arguments.format)
        with laspy.open(las) as reader:
            n_points = reader.header.point_count
        took = measure(jobs_of(laz, las, config), folder, arguments.runs, cold=arguments.cold)
    cache = "not in the cache" if arguments.cold else "in the cache"
    print(
        f"{n_points / 1e6:.1f} million records of point format {arguments.format}, input {cache}\n"
    )
    print("| work | s (of all cores) | beside | s (of all cores) | ratio | processor time | goal |")
    print("|---|---|---|---|---|---|---|")
    for work, beside, goal in ROWS:
        (wall, cpu) = took[work]
        (wall_beside, cpu_beside) = took[beside]
        ratios = f"{wall / wall_beside:.2f} | {cpu / cpu_beside:.2f}"
        print(
            f"| {work} | {wall:.2f} ({cpu:.2f}) | {beside} | {wall_beside:.2f} "
            f"({cpu_beside:.2f}) | {ratios} | {goal} |"
        )


if __name__ == "__main__":
    main()
