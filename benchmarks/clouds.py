"""Time and memory of reading PLY and PCD, beside plyfile's own read and the same stream as a raw
dump.

    python -m benchmarks.clouds [--copies 40]

The stream is IGN's profiler drive (``riegl/sample_riegl_18_01.ply`` of the real scans) repeated
line after line: 18 properties, big-endian, with returns that are listed again. Memory is that of
``prc classify`` in a process of its own, at two sizes. The least of three times counts."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.user import peak_mib
from prc_cli.formats import open_source
from prc_cli.formats.clouds.ply import read_ply_header
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from tests.conftest import data_folder

RUNS = 3
ROWS = 30_000
ACCEPTED = ("line-order", "repeated-lines", "line-length", "columns-along", "standing")
"""What a repeated drive is doubted for."""


def repeated(target: Path, times: int) -> int:
    """Write the sample several times, one drive after the other; returns the number of points."""
    source = data_folder() / "riegl" / "sample_riegl_18_01.ply"
    header = read_ply_header(source)
    data = source.read_bytes()
    rows = np.frombuffer(data[header.n_bytes :], header.vertex.dtype(">")).copy()
    span = float(rows["GPS_time"][-1] - rows["GPS_time"][0]) + 0.001
    with target.open("wb") as handle:
        handle.write(data[: header.n_bytes].replace(b"vertex 30000", b"vertex %d" % (ROWS * times)))
        for _ in range(times):
            handle.write(rows.tobytes())
            rows["GPS_time"] += span
    return ROWS * times


def least(job: Callable[[], object]) -> float:
    """Return the least time of a job [s]."""
    seconds = []
    for _ in range(RUNS):
        start = time.perf_counter()
        job()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def read_stream(path: Path) -> None:
    """Read all blocks."""
    for _ in open_input(path, InputConfig()).blocks():
        pass


def read_records(path: Path) -> None:
    """Decode range, angle and time of every row."""
    source = open_source(path)
    assert source is not None
    for _ in source.chunks(("range", "angle", "time")):
        pass


def read_with_plyfile(path: Path) -> None:
    """Read the same three properties with plyfile."""
    import plyfile

    vertex = plyfile.PlyData.read(str(path))["vertex"]
    for name in ("range", "theta", "GPS_time"):
        np.asarray(vertex[name], np.float64)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--copies",
        type=int,
        default=40,
        help="repetitions of 30 000 rows; memory also at ten times less",
    )
    copies = parser.parse_args().copies
    with tempfile.TemporaryDirectory() as folder:
        large = Path(folder) / "large.ply"
        small = Path(folder) / "small.ply"
        n = repeated(large, copies)
        repeated(small, max(copies // 10, 1))
        for name, job in (
            ("plyfile, three properties", read_with_plyfile),
            ("prc, three properties", read_records),
            ("prc, blocks of the stream", read_stream),
        ):
            seconds = least(lambda job=job: job(large))
            print(f"{name}: {seconds:.2f} s, {n / seconds / 1e6:.1f} million rows a second")
        for path in (small, large):
            options = [
                "classify",
                str(path),
                str(Path(folder) / f"{path.stem}.npy"),
                "--preset",
                "urban",
                "-q",
            ]
            accepted = [
                "--accept-doubt",
                "line-order",
                "--accept-doubt",
                "repeated-lines",
                "--accept-doubt",
                "line-length",
            ]
            print(
                f"classify {path.stat().st_size >> 20} MiB: "
                f"{peak_mib([*options, *accepted]):.0f} MiB"
            )


if __name__ == "__main__":
    main()
