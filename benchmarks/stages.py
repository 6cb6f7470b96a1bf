"""Rates of the classifier in memory, compared with the oracle, plain NumPy and a copy of the same
ranges.

python -m benchmarks.stages
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from prc_cli.config import load_config
from prc_cli.core.loops import load_loops
from prc_cli.core.stream import ScanBlock
from prc_cli.core.threads import default_threads
from prc_cli.core.types import F32
from prc_cli.jobs.classify import classify_ranges, label_blocks
from prc_cli.methods.base import Wanted
from prc_cli.methods.prc.pipeline import LOOPS, PrcParams
from prc_cli.methods.prc.support import stream_window
from prc_cli.reference.prc import stages as oracle
from prc_cli.simulation.settings import load_settings, open_simulation
from tests.methods.prc import paper

ROUNDS = 7
"""Rounds; each runs every job once, so that other load affects all. The best time counts."""


def classify_all(
    ranges: F32,
    params: PrcParams,
    threads: int,
    *,
    segments: bool = False,
) -> None:
    """Run the block pipeline over a range image; labels are dropped block by block."""
    for _ in label_blocks(
        iter([ScanBlock(0, ranges)]), params, threads=threads, wanted=Wanted(segments=segments)
    ):
        pass


def numpy_support(ranges: F32, lines: int) -> None:
    """Find supported shots with array operations of NumPy, block by block."""
    width = ranges.shape[1]
    for first in range(0, len(ranges) - 2, lines):
        tail = np.full(width + 1, np.nan, np.float32)
        window = stream_window(
            tail, ranges[first : first + lines], ranges[first + lines : first + lines + 2]
        )
        oracle.support_mask(window, len(ranges[first : first + lines]), width, 1.0, 1.0, 3, 2)


def street(n_lines: int, points_per_line: int) -> F32:
    """Ranges of a simulated street."""
    options = {"lines": n_lines, "scanner": {"points_per_line": points_per_line}}
    scan = open_simulation("street", load_settings("street", options=options)).scan
    return np.concatenate([block.range_m for block in scan.blocks()])


def best_times(
    jobs: dict[str, tuple[Callable[[], object], int]], rounds: int
) -> Iterator[tuple[str, float, float]]:
    """Name of every job and its best rates [million shots a second].

    By the clock, and by the time of one core.
    """
    walls: dict[str, list[float]] = {name: [] for name in jobs}
    cores: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, (job, _) in jobs.items():
            wall = time.perf_counter()
            core = time.process_time()
            job()
            walls[name].append(time.perf_counter() - wall)
            cores[name].append(time.process_time() - core)
    for name, (_, n_shots) in jobs.items():
        yield name, n_shots / min(walls[name]) / 1e6, n_shots / min(cores[name]) / 1e6


def main() -> None:
    """Print the table."""
    load_loops(LOOPS)
    piece = street(594, 2154)
    ranges = np.tile(piece, (20, 1))  # 100 MB: larger than any cache
    wide = np.tile(street(510, 4270), (12, 1))
    target = np.empty_like(ranges)
    urban = load_config(preset="prc-2019-urban").config
    forest = load_config(preset="prc-2019-forest").config
    settings = paper.Settings(k=urban.prc.lines_per_block)
    cores = default_threads()
    jobs: dict[str, tuple[Callable[[], object], int]] = {
        "copy of the ranges": (lambda: np.copyto(target, ranges), ranges.size),
        "support stage alone, plain NumPy": (lambda: numpy_support(piece, 99), piece.size),
    }
    for n in sorted({1, cores}):
        job = partial(classify_all, threads=n)
        jobs[f"PRC urban, k 99, M 2154, threads: {n}"] = (
            partial(job, ranges, urban.prc),
            ranges.size,
        )
        jobs[f"PRC urban with segment ids, threads: {n}"] = (
            partial(job, ranges, urban.prc, segments=True),
            ranges.size,
        )
        jobs[f"PRC forest, k 255, M 4270, threads: {n}"] = partial(job, wide, forest.prc), wide.size
    jobs[f"classify_ranges(), urban, threads: {cores}"] = (
        lambda: classify_ranges(ranges, urban).labels,
        ranges.size,
    )
    times = list(best_times(jobs, ROUNDS))
    times += best_times(
        {"oracle, urban": (lambda: paper.classify_stream(piece, settings), piece.size)}, 1
    )
    base = times[-1][1]
    print(
        "| work | million shots a second | beside the oracle | million shots a second of "
        "one core's time |"
    )
    print("|---|---|---|---|")
    for name, by_clock, by_core in times:
        print(f"| {name} | {by_clock:.2f} | {by_clock / base:.0f} | {by_core:.2f} |")


if __name__ == "__main__":
    main()
