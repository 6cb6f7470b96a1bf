"""Peak memory of ``prc classify`` and ``prc calibrate`` at two input sizes, each in a separate
process.

    python -m benchmarks.memory                           # 1.3 and 13 million shots
    python -m benchmarks.memory --full  # 10 and 100 million shots; takes 10 GB of disk and minutes
    python -m benchmarks.memory --lines 3000 30000
    python -m benchmarks.memory --methods  # every method, LAZ to LAZ, at 1.3 and 10 million shots

The stream is a tiled simulated street; the documentation quotes the table.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.drives import POINTS_PER_LINE, write_csv, write_drive, write_raw
from benchmarks.user import peak_mib

FULL_LINES = (4643, 46_426)
LIMIT_MIB = 256
"""The target for any size [MiB]."""
WITH_M = ("-M", str(POINTS_PER_LINE))


def classify(source: Path, output: Path, preset: str = "urban") -> float:
    """Peak resident size of one run [MiB]."""
    options = [
        "--preset",
        preset,
        "--quiet",
        "--overwrite",
        *(() if source.suffix == ".npz" else WITH_M),
    ]
    return peak_mib(["classify", str(source), str(output), *options])


def measure(folder: Path, n_lines: int) -> Iterator[tuple[str, float]]:
    """Yield every job and its peak [MiB]; inputs are removed again."""
    raw = folder / "street.bin"
    array = folder / "street.npz"
    text = folder / "street.csv"
    write_raw(raw, n_lines)
    yield "raw → npy", classify(raw, folder / "labels.npy")
    yield "raw → npy, fused", classify(raw, folder / "labels.npy", "fused")
    yield "raw → npy, street-scan", classify(raw, folder / "labels.npy", "street-scan")
    yield "raw → laz", classify(raw, folder / "built.laz")
    yield (
        "raw → calibrate",
        peak_mib(
            ["calibrate", str(raw), "-o", str(folder / "c.toml"), "--overwrite", "-q", *WITH_M]
        ),
    )
    np.savez(array, range_m=np.memmap(raw, "<f4", "r").reshape(-1, POINTS_PER_LINE))
    yield "npz → npy", classify(array, folder / "labels.npy")
    array.unlink()
    write_csv(text, raw)
    yield "csv → npy", classify(text, folder / "labels.npy")
    text.unlink()
    for suffix in (".laz", ".las"):
        drive = folder / f"drive{suffix}"
        write_drive(drive, raw, 6)
        yield f"{suffix[1:]} → {suffix[1:]}", classify(drive, folder / f"again{suffix}")
        yield f"{suffix[1:]} → npy", classify(drive, folder / "labels.npy")
        drive.unlink()
        (folder / f"again{suffix}").unlink()


def measure_methods(folder: Path, n_lines: int) -> Iterator[tuple[str, float]]:
    """Yield every preset on a simulated LAZ file, and its peak [MiB]."""
    for kind, presets in (
        ("street", ("urban", "street-scan", "fused")),
        ("forest", ("forest", "fused-forest")),
    ):
        drive = folder / f"{kind}.laz"
        peak_mib(["simulate", kind, str(drive), "--lines", str(n_lines), "--seed", "7", "-q"])
        doubts = [
            word
            for name in ("units", "indoors", "line-length", "down")
            for word in ("--accept-doubt", name)
        ]
        for preset in presets:
            yield (
                preset,
                peak_mib(
                    [
                        "classify",
                        str(drive),
                        str(folder / "o.laz"),
                        "--preset",
                        preset,
                        "-q",
                        "--overwrite",
                        *doubts,
                    ]
                ),
            )
        drive.unlink()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lines", type=int, nargs=2, default=[600, 6000])
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--methods", action="store_true")
    arguments = parser.parse_args()
    lines = (
        FULL_LINES
        if arguments.full
        else (600, FULL_LINES[0])
        if arguments.methods
        else arguments.lines
    )
    peaks: dict[str, list[float]] = {}
    for n_lines in lines:
        with tempfile.TemporaryDirectory() as name:
            for job, peak in (measure_methods if arguments.methods else measure)(
                Path(name), n_lines
            ):
                peaks.setdefault(job, []).append(peak)
    sizes = " | ".join(f"{n * POINTS_PER_LINE / 1e6:.1f} M shots [MiB]" for n in lines)
    print(f"| job | {sizes} | ratio | goal [MiB] |")
    print("|---|---|---|---|---|")
    for job, job_peaks in peaks.items():
        cells = [f"{peak:.0f}" for peak in job_peaks] + [""] * (2 - len(job_peaks))
        ratio = f"{job_peaks[1] / job_peaks[0]:.2f}" if len(job_peaks) == 2 else ""
        print(
            f"| {job} | {' | '.join(cells)} | {ratio} | "
            f"{LIMIT_MIB if 'calibrate' not in job else ''} |"
        )


if __name__ == "__main__":
    main()
