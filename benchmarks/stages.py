"""Rate of the classifier in memory, beside the oracle and a plain copy of the same ranges, in one run.

python -m benchmarks.stages
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from prc_cli.classifiers.prc.pipeline import PrcParams, classify_block, initial_state
from prc_cli.config import load_config
from prc_cli.core.types import F32
from prc_cli.kernels import load_kernels, oracle_prc
from prc_cli.readers.regroup import look_ahead_lines
from prc_cli.simulation.street import StreetParams, simulate_street


def classify_all(ranges: F32, params: PrcParams) -> None:
    """Run the block pipeline over a range image."""
    state = initial_state(ranges.shape[1])
    k, ahead = params.lines_per_block, look_ahead_lines(ranges.shape[1])
    for first in range(0, len(ranges), k):
        state = classify_block(ranges[first : first + k], ranges[first + k : first + k + ahead], state, params).state


def rate(job: Callable[[], object], n_shots: int, runs: int) -> float:
    """Median rate of a job [million shots a second], after one run that is not counted."""
    job()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        job()
        seconds.append(time.perf_counter() - start)
    return n_shots / statistics.median(seconds) / 1e6


def main() -> None:
    """Print the table."""
    load_kernels()
    scan = simulate_street(StreetParams(n_lines=594))
    piece = np.concatenate([block.range_m for block in scan.blocks()])
    ranges = np.tile(piece, (20, 1))  # 100 MB: more than any cache holds
    target = np.empty_like(ranges)
    urban = load_config(preset="urban").config.prc
    forest = load_config(preset="forest").config.prc
    settings = oracle_prc.Settings(k=urban.lines_per_block)
    rates = {
        "copy of the ranges": rate(lambda: np.copyto(target, ranges), ranges.size, 5),
        "PRC urban, k 99, M 2154, one core": rate(lambda: classify_all(ranges, urban), ranges.size, 5),
        "PRC forest, k 255, M 2154, one core": rate(lambda: classify_all(ranges, forest), ranges.size, 5),
        "oracle, urban": rate(lambda: oracle_prc.classify_stream(piece, settings), piece.size, 1),
    }
    base = rates["oracle, urban"]
    print("| work | million shots a second | beside the oracle |\n|---|---|---|")
    for name, value in rates.items():
        print(f"| {name} | {value:.2f} | {value / base:.1f} |")


if __name__ == "__main__":
    main()
