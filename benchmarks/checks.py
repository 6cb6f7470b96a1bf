"""Time of every check of an input, beside the run that it belongs to.

python -m benchmarks.checks
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.stages import street
from prc_cli.config import load_config
from prc_cli.core.stream import LabelledBlock
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.classify import classify, label_blocks, load_classifier
from prc_cli.streams.evidence import checks as cells
from prc_cli.streams.evidence import geometry, lines
from prc_cli.streams.evidence.figures import LineSample, figures_of, most_turned
from prc_cli.streams.evidence.repeats import LineRepeats
from prc_cli.streams.evidence.result import ResultWatch
from prc_cli.streams.evidence.watch import EvidenceStream
from prc_cli.streams.open import open_input

ROUNDS = 7
"""The middle of so many runs counts."""
M = 2154
SIZES = (600, 4800)
"""Scan lines: 1.3 and 10 million shots."""


def seconds(job: Callable[[], object]) -> float:
    """Return the processor time of a job [s], the middle of several runs."""
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        job()
        times.append(time.process_time() - start)
    return median(times)


def jobs_of(path: Path) -> dict[str, Callable[[], object]]:
    """Return what is asked of a file, by name."""
    stream = open_input(path, InputConfig())
    blocks = list(stream.blocks())
    watch = EvidenceStream(stream, refuses=False)
    for _ in watch.blocks():
        pass
    (seen,) = watch.seen()
    figures = figures_of(seen.windows)
    turned = most_turned(seen.windows)
    config = load_config(preset="urban").config
    labelled: list[LabelledBlock] = list(label_blocks(iter(blocks), config.classifier))

    def sample() -> None:
        lines_kept = LineSample(M)
        for block in blocks:
            lines_kept.add(block)

    def repeats() -> None:
        repeats = LineRepeats()
        for block in blocks:
            repeats.add(block)

    def result() -> None:
        watch = ResultWatch(config.classifier.method().usual)
        for item in labelled:
            watch.see(item)
        watch.findings()

    return {
        "keeping the sample": sample,
        "figures of the sample": lambda: figures_of(seen.windows),
        "ranges, rounding, missing-code": lambda: (
            cells.check_ranges(seen),
            cells.check_rounding(seen),
            cells.check_missing_code(seen),
        ),
        "line-length": lambda: lines.check_line_length(seen, figures, turned),
        "columns-along": lambda: most_turned(seen.windows),
        "units": lambda: geometry.check_height(seen),
        "repeated-lines": repeats,
        "labels": result,
    }


def main() -> None:
    """Print the tables."""
    print("<!-- written by python -m benchmarks.checks; do not edit -->\n\n## Time of the checks\n")
    print(
        "Processor time; the checks of the sample are asked twice in files of more than a "
        "million shots.\n"
    )
    load_classifier()
    with tempfile.TemporaryDirectory() as folder:
        columns: list[dict[str, float]] = []
        for n_lines in SIZES:
            path = Path(folder) / f"{n_lines}.npy"
            np.save(path, street(n_lines, M))
            times = {name: seconds(job) for name, job in jobs_of(path).items()}
            out = Path(folder) / "labels.npy"

            def run(path: Path = path, out: Path = out) -> None:
                classify(path, out, load_config(preset="urban"), overwrite=True)

            times["the run, `prc classify` to .npy, without the start of Python"] = seconds(run)
            columns.append(times)
    print("| work | " + " | ".join(f"{n * M / 1e6:.1f} M shots [ms] | share" for n in SIZES) + " |")
    print("|---|" + "---:|---:|" * len(SIZES))
    for name in columns[0]:
        cells_ = [
            f"{1e3 * times[name]:.1f} | {times[name] / list(times.values())[-1]:.1%}"
            for times in columns
        ]
        print(f"| {name} | {' | '.join(cells_)} |")


if __name__ == "__main__":
    main()
