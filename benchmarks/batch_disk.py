"""Disk space per file of a batch run beside its outputs: ``python -m benchmarks.batch_disk``.

Journal, summary and log of a run of invented files, written by the code of the program.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from prc_cli.cli.batch_report import JsonLog
from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.jobs.batch.journal import Journal
from prc_cli.jobs.batch.plan import Plan
from prc_cli.jobs.batch.report import BatchSummary, write_summary
from prc_cli.jobs.batch.run import Ready
from prc_cli.jobs.batch.types import (
    OWN_FOLDER,
    Done,
    InputPrint,
    Started,
    Task,
)

N_FILES = 10_000


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        log = JsonLog(str(out / "log.jsonl"))
        log.start(Path("archive"), out, None)
        log(Ready(Plan(()), 2, 1))
        done = []
        config = load_config()
        with Journal(out / OWN_FOLDER) as journal:
            journal.begin_run("process 1 of prc on host")
            for k in range(N_FILES):
                outcomes = made_up(f"2026-11-{k % 30:02d}/car1/drive_{k:06d}.laz")
                task = Task(
                    outcomes.name, Path(outcomes.name), out / outcomes.name, config, "a" * 64
                )
                journal.start(task, "process 1 of prc on host")
                journal.finish(outcomes)
                log(Started(outcomes.name, "process 12345"))
                log(outcomes)
                done.append(outcomes)
        summary = BatchSummary("run", Path("archive"), out, "", "", 1.0, N_FILES, 0, tuple(done))
        sizes = {
            "journal": sum(path.stat().st_size for path in (out / OWN_FOLDER).iterdir()),
            "summary.json": write_summary(summary).stat().st_size,
            "log": (out / "log.jsonl").stat().st_size,
        }
    print("| | bytes a file |\n|---|---|")
    for what, size in sizes.items():
        print(f"| {what} | {size / N_FILES:.0f} |")


def made_up(name: str) -> Done:
    """A file of 200 million shots with every class."""
    labels = tuple((label.name.lower(), 12_345_678) for label in Label)
    print_ = InputPrint(10**9, 1_795_283_242_109_404_171, "b" * 64)
    return Done(
        name,
        print_,
        10**9,
        1_795_283_242_109_404_171,
        100.123,
        90.123,
        512.3,
        100_000,
        215_400_000,
        160_000_000,
        labels,
        ("columns taken under another name: range_m as range",),
    )


if __name__ == "__main__":
    main()
