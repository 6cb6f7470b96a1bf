"""``prc classify``: one input, one output."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.next_step import after_classify
from prc_cli.cli.options import (
    Sectioned,
    Word,
    config_from,
    output_options,
    stream_options,
    window_options,
)
from prc_cli.cli.output import print_json, print_line
from prc_cli.cli.paths import WRITTEN, ScanPath, in_folder
from prc_cli.cli.report import (
    compiling_note,
    end_with,
    line_progress,
    lines_of_shots,
    notices_of_files,
    print_classes,
    print_notices,
    print_profile,
    print_run_assumptions,
    profile_of,
)
from prc_cli.core.errors import printable
from prc_cli.core.loops import ENGINES, Engine
from prc_cli.core.profile import profiling, timed
from prc_cli.jobs.classify import classify as classify_file
from prc_cli.jobs.classify import load_classifier, threads_of
from prc_cli.jobs.run import RunSummary

FEW_SHOTS = 100
"""The checks and the rate need at least so many shots."""


@click.command(
    cls=Sectioned,
    brief=(
        "--preset",
        "--config",
        "--set",
        "--range",
        "--points-per-line",
        "--accept-doubt",
        "--only",
        "--confidence",
        "--reason",
        "--overwrite",
        "--json",
    ),
)
@click.argument("sources", metavar="IN...", nargs=-1, required=True, type=ScanPath())
@click.argument("output", metavar="OUT", type=WRITTEN)
@stream_options
@window_options
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
@click.option(
    "--confidence",
    is_flag=True,
    help="Also write how sure every label is [%] (fused).",
)
@click.option(
    "--reason", is_flag=True, help="Also write the number of the rule that gave the label."
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    help="Number of threads. Default: one per core. The output does not depend on it.",
)
@click.option(
    "--engine",
    type=Word(ENGINES),
    default="compiled",
    show_default=True,
    help="reference: the methods of the papers in plain NumPy and SciPy. Slow, one thread, "
    "same labels.",
)
@click.option(
    "--profile",
    is_flag=True,
    help="Print the time of every stage.",
)
@output_options
def classify(
    sources: tuple[Path, ...],
    output: Path,
    overwrite: bool,
    engine: Engine,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Give every shot of IN its class and write OUT.

    OUT is .las, .laz, .ply or .pcd, a bag if IN is a bag, or only the labels: .npy, .csv, .parquet.
    prc records the run in OUT and in OUT.prc.json.

    If OUT is an existing folder, the output gets the name of IN in it. If you name several files,
    prc reads them as one drive, in this order. OUT is then a folder with one output per file.

    If you name no method, prc chooses one from the input: rings for spinning scanners, fused if the
    beam angles are known, else PRC 2019. It prints the method and the reason.

    prc checks the input and its own labels. If a check fails, nothing is written (exit code 1). If
    a check is unsure, labels and a warning are written (exit code 4).

    \b
    Examples:
      prc classify drive.laz drive_classified.laz
      prc classify drive.bin labels.npy -M 2154
      prc classify drive_01.laz drive_02.laz drive_03.laz classified/
      prc classify plot.laz out.laz --preset fused-forest --range trajectory:plot.csv \\
        --lines time:97 --columns time:414190
    """
    columns = {
        "output.confidence=true": options.pop("confidence"),
        "output.reason=true": options.pop("reason"),
    }
    wanted = (assignment for assignment, is_wanted in columns.items() if is_wanted)
    options["assignments"] = (*options["assignments"], *wanted)
    loading_s = 0.0

    @contextmanager
    def loading() -> Iterator[None]:
        nonlocal loading_s
        start = time.perf_counter()
        with compiling_note(quiet=quiet), timed("loading compiled loops"):
            yield
        loading_s += time.perf_counter() - start

    threads = threads_of(engine, options.pop("threads"))
    wants_profile = options.pop("profile")
    loaded = config_from(options)
    source = sources[0]
    with profiling() if wants_profile else nullcontext() as profile:
        # a missing file is refused without waiting for the compiler
        if source.is_file() and loaded.config.is_decided:
            with loading():
                load_classifier(loaded, engine)
        start = time.perf_counter()
        loading_s = 0.0
        with line_progress(source.name, quiet=quiet) as progress:
            common: dict[str, Any] = {
                "overwrite": overwrite,
                "progress": progress,
                "threads": threads,
                "engine": engine,
                "loading": loading,
            }
            if len(sources) == 1:
                if output.is_dir():
                    from prc_cli.jobs.drive import SAME, output_name

                    output = in_folder(output, output_name(source.name, SAME))
                summaries = [classify_file(source, output, loaded, **common)]
            else:
                from prc_cli.jobs.drive import classify_drive  # few need it

                summaries = classify_drive(sources, output, loaded, **common)
        seconds = time.perf_counter() - start - loading_s
    n_shots = sum(summary.counts.n_shots for summary in summaries)
    if as_json:
        results = [summary.as_dict() for summary in summaries]
        if profile is not None:
            results[0]["profile"] = profile_of(profile, n_shots, threads)
        print_json(results[0] if len(sources) == 1 else results, sort_keys=True)
    if not quiet:
        _print_summaries(summaries, seconds, verbose=verbose)
        for command in after_classify(source, summaries[0].output, options):
            print_line(printable(command))
    if profile is not None and not (quiet and as_json):
        print_profile(profile, n_shots, threads)
    end_with(dict.fromkeys(doubt for summary in summaries for doubt in summary.doubts))


def _print_summaries(summaries: Sequence[RunSummary], seconds: float, *, verbose: bool) -> None:
    """Print classes, notes and rate of all files together, and a line for each file."""
    first = summaries[0].record
    more = f" and {len(summaries) - 1} more" if len(summaries) > 1 else ""
    labels = sum((summary.counts.labels for summary in summaries[1:]), summaries[0].counts.labels)
    print_classes(f"{first.input.name}{more}", labels, first.config)
    print_run_assumptions(first, verbose=verbose)
    n_back = sum(summary.record.tally.n_time_steps_back for summary in summaries)
    if n_back:
        print_line(f"note: the time goes back {n_back:,} times: prc info prints where")
    print_notices(notices_of_files(summary.record.notices for summary in summaries))
    n_shots = sum(summary.counts.n_shots for summary in summaries)
    rate = f"{n_shots / seconds / 1e6 if seconds else 0.0:.2g} million shots a second"
    if n_shots < FEW_SHOTS:
        rate = "too few to check the labels"
    for summary in summaries:
        what = lines_of_shots(summary.counts.n_lines, summary.record.points_per_line)
        print_line(f"{summary.output}: {what}" + ("" if more else f" in {seconds:.1f} s ({rate})"))
    if more:
        print_line(f"{n_shots:,} shots in {seconds:.1f} s ({rate})")
