"""Latency of ``prc stream``: block by block through real pipes.

    python -m benchmarks.latency

Every block is written after the labels of the block before have arrived, so that nothing queues:
the latency is the time from the last byte of a block to the labels that waited for it."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np

from prc_cli.core.types import F32
from prc_cli.simulation.settings import Kind, load_settings, open_simulation

LINES = 900
WARM = 300
"""Lines at the start that are not counted, while loops load and the block fills."""
JOBS: tuple[tuple[str, Kind, str, str, int], ...] = (
    ("urban, blocks of 99 lines, M 2154", "street", "photon-80", "urban", 99),
    ("urban, blocks of 16 lines", "street", "photon-80", "urban", 16),
    ("forest, blocks of 255 lines, M 4270", "forest", "focus3d-120", "forest", 255),
)


def lines_of(kind: Kind, scanner: str, n_lines: int) -> tuple[F32, float]:
    """Simulated ranges, (lines, M) float32 [m], and the line frequency of the scanner [Hz]."""
    settings = load_settings(kind, options={"lines": n_lines, "scanner": {"name": scanner}})
    blocks = open_simulation(kind, settings).scan.blocks()
    return np.concatenate([block.range_m for block in blocks]), settings.scanner.line_hz


def waits(ranges: F32, preset: str, block: int) -> list[float]:
    """Seconds from the last byte that labels need to their arrival, line by line."""
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
    return seconds


def main() -> None:
    """Print the table."""
    print(
        "| labels leave | median [ms] | 99 % [ms] | longest [ms] | a line of the scanner "
        "takes [ms] |"
    )
    print("|---|---:|---:|---:|---:|")
    for name, kind, scanner, preset, block in JOBS:
        ranges, line_hz = lines_of(kind, scanner, LINES)
        wait_ms = 1e3 * np.array(waits(ranges, preset, block)[max(1, WARM // block) :])
        middle, high = np.percentile(wait_ms, [50, 99])
        print(f"| {name} | {middle:.2f} | {high:.2f} | {wait_ms.max():.2f} | {1e3 / line_hz:.1f} |")


if __name__ == "__main__":
    main()
