"""``prc check``: a random sample of shots to be checked by hand."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.next_step import typed
from prc_cli.cli.options import MAPPING, QUIET, config_from, input_options
from prc_cli.cli.output import print_json, print_line, print_table
from prc_cli.cli.paths import READ, WRITTEN, ScanPath
from prc_cli.cli.report import line_progress
from prc_cli.jobs.check import CheckOptions, CheckResult
from prc_cli.jobs.check import check as check_file


@click.command()
@click.argument("classified", metavar="CLASSIFIED", type=ScanPath())
@click.argument("output", metavar="[PAGE.html]", type=WRITTEN, required=False)
@click.option(
    "--shots",
    type=click.IntRange(10, 5_000),
    default=300,
    show_default=True,
    help="Number of shots to check.",
)
@click.option("--labels", type=READ, metavar="FILE", help="Classes, if CLASSIFIED has none itself.")
@click.option(
    "--dimension", "labels_dimension", metavar="NAME", help="Column or dimension of the classes."
)
@MAPPING
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Another number draws other shots.",
)
@input_options
@click.option("--overwrite", is_flag=True, help="Replace an existing page.")
@click.option("--json", "as_json", is_flag=True, help="Print what was drawn as JSON on stdout.")
@QUIET
def check(
    classified: Path,
    output: Path | None,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Write a page to check classes by hand.

    prc draws shots at random from every predicted class. The page shows each one with its
    surroundings, and you press a key for its true class. prc evaluate computes the scores from your
    answers.

    \b
    Examples:
      prc check out.laz
      prc check drive.npz check.html --labels labels.npy --shots 100
      prc evaluate out.laz out_answers.json
    """
    labels = options["labels"]
    chosen = CheckOptions(
        shots=options["shots"],
        seed=options["seed"],
        labels=labels,
        labels_dimension=options["labels_dimension"],
        mapping=options["mapping"],
    )
    source = classified if labels is None else labels
    page = Path(f"{source.stem}_check.html") if output is None else output
    loaded = config_from(options)
    with line_progress(classified.name, quiet=quiet) as progress:
        result = check_file(
            classified, page, loaded, chosen, overwrite=overwrite, progress=progress
        )
    if as_json:
        strata = [stratum.model_dump() for stratum in result.strata]
        print_json(
            {
                "page": str(result.page),
                "answers": result.answers,
                "n_shots": result.n_shots,
                "n_places": result.n_places,
                "classes": list(result.classes),
                "strata": strata,
            }
        )
    elif not quiet:
        _print(result, source)


def _print(result: CheckResult, source: Path) -> None:
    is_divided = any(stratum.low is not None for stratum in result.strata)
    rows = [
        (
            stratum.predicted,
            *((f"{stratum.low} to {stratum.high} %",) if is_divided else ()),
            f"{stratum.n_shots:,}",
            f"{stratum.n_drawn:,}",
        )
        for stratum in result.strata
    ]
    words = ("predicted", "confidence") if is_divided else ("predicted",)
    print_table("shots drawn at random", (*words, "shots", "drawn"), rows, n_words=len(words))
    print_line(f"{result.page} ({result.n_bytes:,} bytes): open it, answer, save")
    evaluate = ["prc", "evaluate", typed(source), typed(result.answers)]
    print_line(f"then type: {shlex.join(evaluate)}")
