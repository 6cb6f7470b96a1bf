"""Scores of the outputs of an archive against a tree of reference classes."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import suffix_of
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.reports import as_dict as scores_as_dict
from prc_cli.evaluation.reports import gate_dicts
from prc_cli.evaluation.scores import Gate, GateResult, Scores, check_gates, parse_gate, scores
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.labels import code_suffix_of
from prc_cli.jobs.batch.engine import Compared, Comparison, EngineSettings
from prc_cli.jobs.batch.local import LocalEngine
from prc_cli.jobs.batch.outcomes import Failed, Problem
from prc_cli.jobs.batch.types import ReferenceSettings
from prc_cli.jobs.evaluate.options import (
    DEFAULT_MAPPING,
    MAPPINGS,
    EvaluateOptions,
    mapping_of_runs,
)
from prc_cli.matching.pairs import stem_of

NO_REFERENCE = "NoReference"
"""Kind of the problem of a file that has no reference."""


def check_reference(settings: ReferenceSettings) -> None:
    """Refuse wrong settings of the reference before a file is classified."""
    if not settings.tree.is_dir():
        raise ConfigError(
            str(settings.tree),
            "no such folder, expected a tree of reference classes",
            "check --reference",
        )
    kind, _, name = settings.match.partition(":")
    if settings.match not in ("order", "time", "nearest") and not (kind == "dimension" and name):
        problem = f"found {settings.match!r}, expected one of: order, time, dimension:NAME, nearest"
        raise ConfigError("--match", problem)
    names = [settings.mapping_name]
    if settings.mapping_name is None:
        # the outputs will decide which of these it is
        names = [DEFAULT_MAPPING, *MAPPINGS.values()]
    mappings = [load_mapping(name) for name in names if name is not None]
    for text in settings.gates:
        if all(_gate(text, mapping) is None for mapping in mappings):
            parse_gate(text, mappings[0])


def _gate(text: str, mapping: ClassMapping) -> Gate | None:
    # None = the mapping has no such score
    try:
        return parse_gate(text, mapping)
    except ConfigError:
        return None


def _results(texts: Sequence[str], mapping: ClassMapping, pooled: Scores) -> Iterator[GateResult]:
    # a gate for a class that the outputs do not have has no score and fails
    for text in texts:
        gate = _gate(text, mapping)
        if gate is not None:
            yield from check_gates(pooled, (gate,))
            continue
        name, _, limit = text.partition("=")
        yield GateResult(name.strip(), float(limit), math.nan)


@dataclass(frozen=True, slots=True)
class BatchEvaluation:
    """Scores of a run against references."""

    settings: ReferenceSettings
    files: tuple[Compared, ...]
    matrix: ConfusionMatrix
    """All files together."""
    gates: tuple[GateResult, ...] = field(default=())

    @property
    def passed(self) -> bool:
        """Whether every gate was reached; a gate without a score was not."""
        return all(gate.passed for gate in self.gates)

    @property
    def unpaired(self) -> tuple[Compared, ...]:
        """Files that could not be compared."""
        return tuple(file for file in self.files if file.matrix is None)

    def as_dict(self) -> dict[str, Any]:
        """Return scores and counts as plain values; undefined scores are None."""
        return {
            "reference": str(self.settings.tree),
            "mapping": self.settings.mapping_name,
            "match": self.settings.match,
            "pooled": scores_as_dict(self.matrix),
            "gates": gate_dicts(self.gates),
            "files": [
                {
                    "name": file.name,
                    "reference": file.reference,
                    "scores": None if file.matrix is None else scores_as_dict(file.matrix),
                    "problem": None if file.problem is None else asdict(file.problem),
                }
                for file in self.files
            ],
        }


@dataclass(frozen=True, slots=True)
class Output:
    """An output that may be compared."""

    name: str
    """Name of the input in the archive."""
    relative: str
    """Name in the output folder, with POSIX slashes."""
    path: Path
    source: Path
    """The input, which has the points of a label file."""


def evaluate_tree(
    outputs: Sequence[Output], settings: ReferenceSettings, *, jobs: int = 1
) -> BatchEvaluation:
    """Compare outputs with their references, each in a process of its own, and pool the results."""
    check_reference(settings)
    name = settings.mapping_name or mapping_of_runs([output.path for output in outputs])[0]
    settings = replace(settings, mapping_name=name)
    mapping = load_mapping(name)
    compared: dict[str, Compared] = {}
    todo: list[Comparison] = []
    folders: dict[Path, dict[str, list[Path]]] = {}
    for output in outputs:
        try:
            reference = _reference_of(output, settings.tree, folders)
        except InputError as error:
            compared[output.name] = Compared(output.name, None, None, Problem.of(error))
            continue
        if reference is None:
            problem = (
                "no reference, expected a file with this name and any suffix in the reference tree"
            )
            compared[output.name] = Compared(
                output.name, None, None, Problem(NO_REFERENCE, output.name, problem)
            )
            continue
        options = EvaluateOptions(match=settings.match)
        if settings.match != "order" and output.path.suffix.lower() not in LAS_SUFFIXES:
            # label files have neither times nor coordinates
            options = replace(options, predicted_points=output.source)
        shown = reference.relative_to(settings.tree).as_posix()
        todo.append(Comparison(output.name, output.path, reference, shown, mapping, options))
    shown_as = {item.name: item.shown for item in todo}
    with contextlib.closing(
        LocalEngine().run(todo, EngineSettings(jobs=min(jobs, len(todo))))
    ) as events:
        for event in events:
            if isinstance(event, Compared):
                compared[event.name] = event
            elif isinstance(event, Failed):
                compared[event.name] = Compared(
                    event.name, shown_as[event.name], None, event.problem
                )
    files = tuple(compared[output.name] for output in outputs)
    matrices = [item.matrix for item in files if item.matrix is not None]
    pooled = sum(matrices, ConfusionMatrix.empty(mapping))
    return BatchEvaluation(
        settings, files, pooled, tuple(_results(settings.gates, mapping, scores(pooled)))
    )


def _reference_of(
    output: Output, tree: Path, folders: dict[Path, dict[str, list[Path]]]
) -> Path | None:
    """Return the reference with the name of the input or of an output, and any suffix; or None."""
    name = PurePosixPath(output.name)
    folder = tree / name.parent
    if folder not in folders:
        folders[folder] = _by_stem(folder)
    input_stem = name.name[: len(name.name) - len(suffix_of(Path(name.name)))]
    for stem in (stem_of(Path(output.relative)), name.name, input_stem):
        references = folders[folder].get(stem, [])
        if len(references) > 1:
            names = " and ".join(path.name for path in references[:2])
            problem = f"{names} have one name, expected one file"
            raise InputError(str(folder), problem, "move one of them away")
        if references:
            return references[0]
    return None


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    """Return the class files of a folder by their names without suffix."""
    files: dict[str, list[Path]] = {}
    try:
        for path in sorted(folder.iterdir()) if folder.exists() else ():
            if not path.name.startswith(".") and code_suffix_of(path) and path.is_file():
                files.setdefault(stem_of(path), []).append(path)
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(folder), problem, "check its permissions") from error
    return files
