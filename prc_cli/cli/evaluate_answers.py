"""``prc evaluate CLASSIFIED ANSWERS``: scores from a check by hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from prc_cli.cli.options import form_of_output
from prc_cli.cli.output import print_table, print_text, results
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output, prepare_outputs, whole_set
from prc_cli.evaluation.answers import is_answers
from prc_cli.evaluation.reports import gate_line
from prc_cli.evaluation.sampled import (
    HEADER,
    SampledEvaluation,
    agreement_line,
    as_csv,
    as_json,
    as_markdown,
    sample_gates,
    score_rows,
    summary_line,
)
from prc_cli.evaluation.sampled_html import sampled_html
from prc_cli.evaluation.scores import GateResult, refuse_failed
from prc_cli.jobs.evaluate.answers import evaluate_answers

FORMS = {".json": "json", ".csv": "csv", ".md": "markdown", ".html": "html"}
"""Report formats by the suffix of ``--output``."""
_OPTIONS = {"as_json", "outputs", "overwrite", "quiet", "gates"}
"""Options that make sense for answers; the others belong to a reference."""


def unless_answers(compare: Callable[..., None]) -> Callable[..., None]:
    """Return the command that compares with a reference, or else evaluates answers."""

    @wraps(compare)
    def run(paths: tuple[tuple[str, Path], ...], **options: Any) -> None:
        classified, *answers = (path for _, path in paths)
        if answers and all(map(is_answers, answers)):
            print_answers(classified, answers, options)
        else:
            compare(paths, **options)

    return run


def print_answers(classified: Path, answers: Sequence[Path], options: Mapping[str, Any]) -> None:
    """Evaluate answers, and print and write the result."""
    _refuse_other_options()
    limits = [_limit(text) for text in options["gates"]]
    outputs: tuple[Path, ...] = options["outputs"]
    forms = [form_of_output(path, FORMS) for path in outputs]
    if outputs:
        inputs = (classified, *answers)
        prepare_outputs(*outputs, overwrite=options["overwrite"], inputs=inputs)
    evaluation = evaluate_answers(classified, answers)
    gates = sample_gates(evaluation, limits)
    with whole_set():
        for path, form_of_file in zip(outputs, forms, strict=True):
            text = _text(form_of_file, evaluation, gates)
            with atomic_output(path, overwrite=options["overwrite"]) as temporary:
                temporary.write_text(text, encoding="utf-8", newline="\n")
    if options["as_json"]:
        print_text(_text("json", evaluation, gates))
    elif not options["quiet"]:
        _print(evaluation, gates)
    refuse_failed(gates)


def _refuse_other_options() -> None:
    context = click.get_current_context()
    for parameter in context.command.params:
        name = parameter.name or ""
        is_given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if isinstance(parameter, click.Option) and is_given and name not in _OPTIONS:
            problem = "belongs to a reference, found answers of prc check"
            raise ConfigError(parameter.opts[-1], problem, "leave it out")


def _limit(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        limit = float(value)
    except ValueError:
        limit = math.nan
    if not 0 <= limit <= 1:
        problem = f"found {text!r}, expected SCORE.CLASS=VALUE with a value from 0 to 1"
        raise ConfigError("--fail-under", problem)
    return name.strip(), limit


def _text(form: str, evaluation: SampledEvaluation, gates: Sequence[GateResult]) -> str:
    if form == "csv":
        return as_csv(evaluation)
    if form == "json":
        return as_json(evaluation, gates) + "\n"
    if form == "html":
        return sampled_html(evaluation, gates)
    return as_markdown(evaluation, gates)


def _print(evaluation: SampledEvaluation, gates: Sequence[GateResult]) -> None:
    print_table("estimated from the answers, with 95 % intervals", HEADER, score_rows(evaluation))
    results().print(summary_line(evaluation))
    for gate in gates:
        results().print(gate_line(gate))
    for text in (agreement_line(evaluation), *evaluation.notes):
        if text:
            results().print(text)
