"""``prc evaluate``: predicted against reference classes of the same records."""

from __future__ import annotations

from pathlib import Path

import click

from prc_cli.cli.report import print_evaluation
from prc_cli.comparison import evaluate as evaluate_files
from prc_cli.core.errors import ConfigError, GateError
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
    default="table",
    show_default=True,
    help="How the result is printed.",
)
@click.option("--json", "as_json_flag", is_flag=True, help="Short for --format json.")
@click.option(
    "--fail-under",
    "gates",
    multiple=True,
    metavar="SCORE.CLASS=VALUE",
    help="Exit code 3 if a score is lower, e.g. recall.ground=0.95 or accuracy=0.9.",
)
def evaluate(
    predicted: Path, reference: Path, mapping: str, predicted_dimension: str | None, reference_dimension: str | None,
    form: str, as_json_flag: bool, gates: tuple[str, ...],
) -> None:  # fmt: skip
    """Compare PREDICTED with REFERENCE, record by record.

    Both hold one code a record, in the same order: .npy, .csv(.gz), .parquet, .las or .laz.

    \b
    Examples:
      prc evaluate labels.npy reference.npy
      prc evaluate labels.npy oakland_1.csv.gz --mapping oakland --fail-under recall.ground=0.9
    """
    demanded = [_gate(text) for text in gates]
    matrix = evaluate_files(
        predicted, reference, mapping,
        predicted_dimension=predicted_dimension, reference_dimension=reference_dimension,
    )  # fmt: skip
    found = scores(matrix)
    chosen = "json" if as_json_flag else form
    if chosen == "table":
        print_evaluation(matrix, found)
    else:
        click.echo({"json": as_json, "csv": as_csv, "markdown": as_markdown}[chosen](matrix))
    for name, limit in demanded:
        _check_gate(found, name, limit)


def _gate(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        problem = f"found {text!r}, expected SCORE.CLASS=VALUE such as recall.ground=0.95"
        raise ConfigError("--fail-under", problem) from None


def _check_gate(found: Scores, name: str, limit: float) -> None:
    value = gate_value(found, name)
    # an undefined score (no such records) has not reached the demanded figure either
    if not value >= limit:
        raise GateError(name, f"found {value:.4f}, demanded at least {limit:.4f}")
