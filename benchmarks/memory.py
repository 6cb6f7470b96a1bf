"""Peak resident size of ``prc classify`` and ``prc calibrate`` at two input sizes, each run in a process of its own.

    python -m benchmarks.memory                           # 1.3 and 13 million shots
    python -m benchmarks.memory --lines 3000 30000

The stream is a tiled simulated street; the table is what the documentation quotes.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peak import peak_mib

POINTS_PER_LINE = 2154


def classify(source: Path, output: Path) -> float:
    """Peak resident size of one run [MiB]."""
    options = ["--preset", "urban", "-M", str(POINTS_PER_LINE), "--quiet", "--overwrite"]
    return peak_mib(["classify", str(source), str(output), *options])


def write_raw(path: Path, n_lines: int) -> None:
    """Write a street of any length by repeating a simulated one."""
    from prc_cli.simulate import load_settings, open_simulation

    options = {"lines": 600, "scanner": {"points_per_line": POINTS_PER_LINE}}
    scan = open_simulation("street", load_settings("street", options=options)).scan
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
                peaks.setdefault(job, []).append(classify(source, folder / output))
            config = ["-o", str(folder / "calibrated.toml"), "--overwrite", "-q", "-M", str(POINTS_PER_LINE)]
            peaks.setdefault("raw → calibrate", []).append(peak_mib(["calibrate", str(raw), *config]))
        for job, (small, large) in peaks.items():
            print(f"| {job} | {small:.0f} MiB | {large:.0f} MiB | {large / small:.2f} |")


if __name__ == "__main__":
    main()
