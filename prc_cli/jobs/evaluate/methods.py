"""Evaluates several methods against one reference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from prc_cli.core.errors import ConfigError
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.methods import ComparedMethods
from prc_cli.formats.writing.record import PROGRAM, read_record
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.options import EvaluateOptions, mapping_of_methods
from prc_cli.matching.pairs import files_of, stem_of

_LONGEST = 80


def evaluate_methods(
    predicted: Mapping[str, Path],
    reference: Path,
    mapping: ClassMapping | str | Path | None = None,
    *,
    options: EvaluateOptions | None = None,
) -> ComparedMethods:
    """Compare the labels of several methods with one reference.

    Parameters
    ----------
    predicted : mapping of path
        A file or folder of every method, by its name; see :func:`named_files`.
    reference : path
        A file or folder.
    mapping : ClassMapping, name or path, optional
        As for :func:`~prc_cli.jobs.evaluate.evaluate_all`. One mapping serves all methods.
    options : EvaluateOptions, optional

    Returns
    -------
    ComparedMethods
        The evaluation of a single run, of every method.

    Raises
    ------
    ConfigError, InputError
        As :func:`~prc_cli.jobs.evaluate.evaluate_all` raises them.
    """
    options = options or EvaluateOptions()
    if mapping is None:
        mapping, _ = mapping_of_methods(
            [files_of([path]) for path in predicted.values()],
            files_of([reference]),
            options.reference_dimension,
        )
    return ComparedMethods(
        {
            name: evaluate_all([path], [reference], mapping, options=options)
            for name, path in predicted.items()
        }
    )


def named_files(paths: Sequence[tuple[str, Path]]) -> dict[str, Path]:
    """Return files by the name of the method.

    Parameters
    ----------
    paths : sequence of (str, path)
        Name and file. Without a name, it is the method of the run record beside the file, else
        the name of the file. The file follows where several files have the same method.

    Raises
    ------
    ConfigError
        If two files have the same given name.
    """
    names = [name or _method_beside(path) or stem_of(path) for name, path in paths]
    n_of_name = Counter(names)
    files: dict[str, Path] = {}
    for (typed, path), name in zip(paths, names, strict=True):
        shown = name if typed or n_of_name[name] == 1 else f"{name} ({stem_of(path)})"
        if shown in files:
            problem = f"found {shown!r} for {files[shown]} and for {path}, expected other names"
            raise ConfigError("PREDICTED", problem, f"give one a name: NAME={path}")
        files[shown] = path
    return files


def _method_beside(path: Path) -> str:
    """Return the method of the run record beside a file; empty without a record."""
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        record: Any = read_record(files_of([path])[0])
        if record["program"] == PROGRAM:
            chosen = {item["key"]: item["value"] for item in record["assumptions"]}
            return str(chosen.get("method", record["config"]["method"]))[:_LONGEST]
    return ""
