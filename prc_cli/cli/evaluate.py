"""``prc evaluate``: predicted against reference classes of the same records."""

from __future__ import annotations

import math
from pathlib import Path

import click

from prc_cli.cli.report import print_evaluation
from prc_cli.comparison import evaluate as evaluate_files
from prc_cli.core.errors import ConfigError, GateError
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.reports import as_csv, as_json, as_markdown
from prc_cli.evaluation.scores import Scores, gate_value, scores


@click.command()
@click.argument("predicted", type=click.Path(path_type=Path))
@click.argument("reference", type=click.Path(path_type=Path))
@click.option(
    "--mapping",
    default="prc",
    show_default=True,
    metavar="NAME|FILE.toml",
    help="Which codes mean which class: a preset (prc, oakland, ...) or a file.",
)
@click.option("--predicted-dimension", metavar="NAME", help="Column or dimension with the predicted codes.")
@click.option("--reference-dimension", metavar="NAME", help="Column or dimension with the reference codes.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["table", "json", "csv", "markdown"]),
    help="How the result is printed.  [default: table]",
)
@click.option("--json", "as_json_flag", is_flag=True, help="Short for --format json.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors (and what --json or --format asks for).")
@click.option(
    "--fail-under",
    "gates",
    multiple=True,
    metavar="SCORE.CLASS=VALUE",
    help="Exit code 3 if a score is lower, e.g. recall.ground=0.95 or accuracy=0.9.",
)
def evaluate(
    predicted: Path, reference: Path, mapping: str, predicted_dimension: str | None, reference_dimension: str | None,
    form: str | None, as_json_flag: bool, quiet: bool, gates: tuple[str, ...],
) -> None:  # fmt: skip
    """Compare PREDICTED with REFERENCE, record by record.

    Both hold one code a record, in the same order: .npy, .csv(.gz), .parquet, .las or .laz.

    \b
    Examples:
      prc evaluate labels.npy reference.npy
      prc evaluate labels.npy oakland_1.csv.gz --mapping oakland --fail-under recall.ground=0.9
    """
    if as_json_flag and form not in (None, "json"):
        message = f"--json and --format {form} contradict each other"
        raise click.UsageError(message)
    classes = load_mapping(mapping)
    demanded = [_gate(text, classes) for text in gates]
    matrix = evaluate_files(
        predicted, reference, classes,
        predicted_dimension=predicted_dimension, reference_dimension=reference_dimension,
    )  # fmt: skip
    found = scores(matrix)
    chosen = "json" if as_json_flag else form
    if chosen in (None, "table"):
        if not quiet:
            print_evaluation(matrix, found)
    else:
        click.echo({"json": as_json, "csv": as_csv, "markdown": as_markdown}[chosen](matrix).rstrip("\n"))
    for name, limit in demanded:
        _check_gate(found, name, limit)


def _gate(text: str, mapping: ClassMapping) -> tuple[str, float]:
    """Parse a demand, and refuse one that no evaluation with this mapping could answer before anything is read."""
    name, _, value = text.partition("=")
    try:
        limit = float(value)
    except ValueError:
        limit = math.nan
    if not -1 <= limit <= 1:
        problem = f"found {text!r}, expected SCORE.CLASS=VALUE with a value up to 1, such as recall.ground=0.95"
        raise ConfigError("--fail-under", problem)
    gate_value(scores(ConfusionMatrix.empty(mapping)), name.strip())
    return name.strip(), limit


def _check_gate(found: Scores, name: str, limit: float) -> None:
    value = gate_value(found, name)
    # an undefined score (no such records) has not reached the demanded figure either
    if not value >= limit:
        raise GateError(name, f"found {value:.4f}, demanded at least {limit:.4f}")
