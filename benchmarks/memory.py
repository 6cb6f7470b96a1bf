"""Peak resident size of ``prc classify`` at two input sizes, each run in a process of its own.

    python -m benchmarks.memory                           # 1.3 and 13 million shots
    python -m benchmarks.memory --lines 3000 30000

The stream is a tiled simulated street; the table is what the documentation quotes.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

POINTS_PER_LINE = 2154

CHILD = """
import resource, sys
from prc_cli.cli import main
try:
    main(sys.argv[1:])
except SystemExit as stop:
    code = stop.code or 0
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(peak / 1024 if sys.platform != "darwin" else peak / 1024**2)
sys.exit(code)
"""


def classify(source: Path, output: Path) -> tuple[float, float]:
    """Peak resident size [MiB] and time [s] of one run."""
    arguments = [str(source), str(output), "--preset", "urban", "-M", str(POINTS_PER_LINE), "--quiet", "--overwrite"]
    start = time.perf_counter()
    result = subprocess.run(
        [sys.executable, "-c", CHILD, "classify", *arguments], capture_output=True, text=True, check=True
    )
    return float(result.stdout), time.perf_counter() - start


def write_raw(path: Path, n_lines: int) -> None:
    """Write a street of any length by repeating a simulated one."""
    from prc_cli.simulation.street import StreetParams, simulate_street

    scan = simulate_street(StreetParams(n_lines=600, points_per_line=POINTS_PER_LINE))
    tile = np.concatenate([block.range_m for block in scan.blocks()])
    with path.open("wb") as handle:
        for first in range(0, n_lines, len(tile)):
            tile[: n_lines - first].tofile(handle)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lines", type=int, nargs=2, default=[600, 6000])
    arguments = parser.parse_args()
    print(f"| job | {' | '.join(f'{n * POINTS_PER_LINE / 1e6:.1f} M shots' for n in arguments.lines)} | ratio |")
    print("|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        peaks: dict[str, list[float]] = {}
        for n_lines in arguments.lines:
            raw = folder / "street.bin"
            write_raw(raw, n_lines)
            jobs = {"raw → npy": (raw, "labels.npy"), "raw → laz": (raw, "built.laz")}
            jobs["laz → laz"] = (folder / "built.laz", "again.laz")
            jobs["laz → npy"] = (folder / "built.laz", "again.npy")
            for job, (source, output) in jobs.items():
                peaks.setdefault(job, []).append(classify(source, folder / output)[0])
        for job, (small, large) in peaks.items():
            print(f"| {job} | {small:.0f} MiB | {large:.0f} MiB | {large / small:.2f} |")


if __name__ == "__main__":
    main()
