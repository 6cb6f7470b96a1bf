"""``prc evaluate CLASSIFIED ANSWERS``: the scores of a file from a check by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.evaluation.answers import load_answers, pool
from prc_cli.evaluation.sampled import SampledEvaluation, evaluate_sample
from prc_cli.formats.writing.record import fingerprint


def evaluate_answers(classified: Path, paths: Sequence[Path]) -> SampledEvaluation:
    """Estimate the scores of a classified file from the answers of one person or of several.

    Parameters
    ----------
    classified : path
        The file whose classes were checked.
    paths : sequence of path
        Answers files.

    Returns
    -------
    SampledEvaluation

    Raises
    ------
    InputError
        If the answers are about another file, or none was given.
    """
    files = [load_answers(path) for path in paths]
    if not classified.is_file():
        raise InputError(str(classified), "no such file, expected the classified one")
    state = fingerprint(classified)
    for path, answers in zip(paths, files, strict=True):
        if answers.classified.sha256 != state.sha256:
            name = answers.classified.name
            same_name = f"a file {name} with other content" if name == state.name else name
            problem = f"contains answers about {same_name}, expected {classified.name}"
            hint = "draw shots from this file: prc check"
            raise InputError(str(path), problem, f"{hint} {classified.name}")
    return evaluate_sample(str(classified), tuple(map(str, paths)), pool(paths, files))
