"""``prc demo``: the whole program on simulated data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import click

from prc_cli.cli.evaluate import print_evaluation
from prc_cli.cli.options import QUIET, add_options
from prc_cli.cli.output import print_json, print_line, print_result
from prc_cli.cli.paths import WRITTEN
from prc_cli.cli.report import compiling_note, line_progress, print_classes, print_run_assumptions
from prc_cli.config import load_config
from prc_cli.evaluation.reports import NO_INTERVALS, as_dict, overall_line
from prc_cli.evaluation.scores import scores
from prc_cli.jobs.classify import load_classifier
from prc_cli.jobs.demo import MAIN, MORE, PARTS, DemoPart, run_demo
from prc_cli.simulation.drive import load_simulator

TITLES = {
    "drive": "default",
    "published": "prc",
    "static": "sequential-angle",
    "walk": "default, forest",
}
"""Titles of the parts."""

OTHERS = {
    "walk": "a walk in a forest, with the method that prc chose",
    "static": "a static scan of a street, with sequential-angle",
    "published": "the same drive, with PRC as published",
}
"""The parts that are shown in a line each."""

OPEN = {
    "3-D view, for your browser": "street.html",
    "accuracy of the labels": "street_report.html",
    "picture (ranges, classes, true classes)": "street.png",
    "classified point cloud": "street.laz",
}
"""The files of the drive."""


@click.command()
@add_options(
    click.option(
        "--output",
        type=WRITTEN,
        default=Path("prc-demo"),
        show_default=True,
        help="Folder for the files.",
    ),
    click.option(
        "--lines",
        type=click.IntRange(100, 100_000),
        default=600,
        show_default=True,
        help="Scan lines of the drive.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(0, 2**63 - 1),
        default=1,
        show_default=True,
        help="Every seed gives another street.",
    ),
)
@click.option(
    "--all",
    "everything",
    is_flag=True,
    help="Also simulate a forest and a static scan, and run the other methods.",
)
@click.option("--overwrite", is_flag=True, help="Write into a folder that contains files.")
@click.option("--json", "json_wanted", is_flag=True, help="Print the evaluation as JSON on stdout.")
@QUIET
def demo(
    output: Path,
    lines: int,
    seed: int,
    everything: bool,
    overwrite: bool,
    json_wanted: bool,
    quiet: bool,
) -> None:
    """Simulate a drive along a street, classify it, evaluate the labels and draw them.

    At the end prc prints which files to open. --all adds a walk in a forest, a static scan, and the
    drive with PRC as published.

    \b
    Example: prc demo --output /tmp/prc-demo
    """
    chosen = tuple(PARTS) if everything else MAIN
    with compiling_note(quiet=quiet, what="simulator and the classifier"):
        load_simulator()
        for name in chosen:  # the method of a walk is chosen later
            load_classifier(load_config(preset=PARTS[name].preset or "fused"))
    with line_progress("simulated scans", quiet=quiet) as progress:
        result = run_demo(
            output, parts=chosen, seed=seed, lines=lines, overwrite=overwrite, progress=progress
        )
    parts = {TITLES[name]: part for name, part in result.parts.items()}
    if json_wanted:
        print_json({method: as_dict(part.matrix) for method, part in parts.items()})
    if quiet:
        return
    if parts:
        _print(result.parts, tables=not json_wanted)
    for what, name in OPEN.items():
        print_line(f"{what}: {output / name}")
    print_line(f"labels, configurations and the parts of --all: {output / MORE}")
    print_line("next, with your own file: prc info FILE")


def _print(parts: Mapping[str, DemoPart], *, tables: bool) -> None:
    """Print the drive as prc classify and prc evaluate would, and a line for every other part."""
    drive = parts["drive"]
    record = drive.summary.record
    print_classes(record.input.name, drive.summary.counts.labels, record.config)
    print_run_assumptions(record, verbose=False)
    if not tables:
        return
    print_result("")
    print_result("a drive along a street: labels compared with the true classes of the simulator")
    print_evaluation(drive.matrix, scores(drive.matrix))
    for name, what in OTHERS.items():
        if name in parts:
            print_result(f"{what}: {overall_line(scores(parts[name].matrix), NO_INTERVALS)}")
