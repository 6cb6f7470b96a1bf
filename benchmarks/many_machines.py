"""Core hours per billion records, to plan archives on many machines.

    python -m benchmarks.many_machines                   # about 5 million shots a job
    python -m benchmarks.many_machines --lines 9286      # 20 million
    python -m benchmarks.many_machines plan --rate 1.3 --read 5.9 --written 5.9 --records 1e13
    --cores 512

The last one only computes hours and cost from a row of the first. The others run in one thread of
this process and give the least processor time of several runs, so that other work on the machine
matters little. Inputs are in the cache of the system: disk and network times come on top, see the
bytes."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.drives import POINTS_PER_LINE, write_drive, write_raw
from prc_cli.config import LoadedConfig, load_config
from prc_cli.jobs.classify import classify, load_classifier

BILLION = 1e9


def least_cpu_s(job: Callable[[], object], runs: int) -> float:
    """Least processor time of some runs [s]."""
    took = []
    for _ in range(runs):
        begun = time.process_time()
        job()
        took.append(time.process_time() - begun)
    return min(took)


def configured(preset: str) -> LoadedConfig:
    return load_config(preset=preset, options={"input": {"points_per_line": POINTS_PER_LINE}})


def rates(folder: Path, n_lines: int, runs: int) -> Iterator[str]:
    """Rows of the table of formats."""
    raw, las, laz = (folder / f"drive.{suffix}" for suffix in ("bin", "las", "laz"))
    write_raw(raw, n_lines)
    for path in (las, laz):
        write_drive(path, raw, 6)
    n_shots = n_lines * POINTS_PER_LINE
    n_returns = int(np.count_nonzero(np.fromfile(raw, "<f4") > 0))
    urban = configured("urban")
    jobs: dict[str, tuple[Path, str, LoadedConfig, int]] = {
        "raw ranges to labels, urban": (raw, "labels.npy", urban, n_shots),
        "raw ranges to labels, forest": (raw, "forest.npy", configured("forest"), n_shots),
        "LAS to labels": (las, "las.npy", load_config(preset="urban"), n_returns),
        "LAS to LAS": (las, "out.las", load_config(preset="urban"), n_returns),
        "LAZ to labels": (laz, "laz.npy", load_config(preset="urban"), n_returns),
        "LAZ to LAZ": (laz, "out.laz", load_config(preset="urban"), n_returns),
    }
    yield (
        "| work | million records a second of one core | core hours for 10⁹ | bytes read a "
        "record | written |"
    )
    yield "|---|---:|---:|---:|---:|"
    for name, (source, output, config, n) in jobs.items():
        load_classifier(config)
        target = folder / output

        def job(
            source: Path = source, target: Path = target, config: LoadedConfig = config
        ) -> None:
            classify(source, target, config, overwrite=True, threads=1)

        seconds = least_cpu_s(job, runs)
        hours = BILLION / n * seconds / 3600
        read = source.stat().st_size / n
        written = target.stat().st_size / n
        yield f"| {name} | {n / seconds / 1e6:.1f} | {hours:.3f} | {read:.1f} | {written:.1f} |"
        target.unlink()


def plan(
    rate: float,
    read: float,
    written: float,
    options: argparse.Namespace,
) -> Iterator[str]:
    """Hours and cost of an archive.

    Parameters
    ----------
    rate : float
        Million records a second of one core.
    read, written : float
        Bytes a record.
    """
    core_hours = options.records / (rate * 1e6) / 3600
    by_cores = core_hours / options.cores
    moved = options.records * (read + written)
    by_share = moved / (options.gigabytes * 1e9) / 3600
    yield f"core hours          {core_hours:,.0f}"
    yield f"cost of the cores   {core_hours * options.price:,.0f} at {options.price:g} a core hour"
    yield (
        f"read, written       {options.records * read / 1e12:,.0f} TB, "
        f"{options.records * written / 1e12:,.0f} TB"
    )
    yield f"hours by the cores  {by_cores:,.1f} with {options.cores}"
    yield f"hours by the share  {by_share:,.1f} at {options.gigabytes:g} GB a second"
    busy = options.gigabytes * 1e9 / (rate * 1e6 * (read + written))
    yield (
        f"cores that the share feeds: {busy:,.0f}; a core moves {rate * (read + written):,.0f} "
        "MB a second"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", nargs="?", choices=["formats", "plan"], default="formats")
    parser.add_argument("--lines", type=int, default=2400)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--rate", type=float, help="plan: million records a second of one core")
    parser.add_argument("--read", type=float, help="plan: bytes a record")
    parser.add_argument("--written", type=float, help="plan: bytes a record")
    parser.add_argument("--records", type=float, default=1e13)
    parser.add_argument("--cores", type=int, default=512)
    parser.add_argument(
        "--gigabytes", type=float, default=10.0, help="plan: throughput of the share a second"
    )
    parser.add_argument("--price", type=float, default=0.04, help="plan: of a core hour")
    options = parser.parse_args()
    if options.what == "plan":
        print(*plan(options.rate, options.read, options.written, options), sep="\n")
        return
    with tempfile.TemporaryDirectory() as folder:
        for row in rates(Path(folder), options.lines, options.runs):
            print(row, flush=True)


if __name__ == "__main__":
    main()
