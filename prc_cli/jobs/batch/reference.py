"""Outputs of a batch run against a tree of reference classes: every file alone, and all of them as one matrix.

A file is compared as ``prc evaluate`` compares it (:func:`prc_cli.jobs.evaluate.evaluate_all`), so that memory does not
grow with it; of a file only its confusion matrix is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from prc_cli.core.errors import ConfigError, InputError, PrcError
from prc_cli.core.files import suffix_of
from prc_cli.core.threads import ordered
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.gates import Gate, GateResult, check_gates, parse_gate
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.reports import as_dict as scores_as_dict
from prc_cli.evaluation.scores import Scores, scores
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.labels import code_suffix_of
from prc_cli.jobs.batch.judges import Judges, Pair
from prc_cli.jobs.batch.types import Problem, ReferenceSettings
from prc_cli.jobs.evaluate.chosen import DEFAULT_MAPPING, MAPPINGS, mapping_of_runs
from prc_cli.jobs.evaluate.options import EvaluateOptions
from prc_cli.matching.pairs import stem_of

NO_REFERENCE = "NoReference"
"""Kind of the problem of a file that has no reference."""


def check_reference(settings: ReferenceSettings) -> None:
    """Refuse what makes no sense before any file is classified."""
    if not settings.tree.is_dir():
        raise ConfigError(
            str(settings.tree), "no such folder, expected a tree of reference classes", "check --reference"
        )
    kind, _, name = settings.match.partition(":")
    if settings.match not in ("order", "time", "nearest") and not (kind == "dimension" and name):
        problem = f"found {settings.match!r}, expected one of: order, time, dimension:NAME, nearest"
        raise ConfigError("--match", problem)
    names = (DEFAULT_MAPPING, *MAPPINGS.values()) if settings.mapping_name is None else (settings.mapping_name,)
    mappings = [load_mapping(name) for name in names]
    for text in settings.gates:
        # which of them it is, the outputs will say
        if all(_gate(text, mapping) is None for mapping in mappings):
            parse_gate(text, mappings[0])


def _gate(text: str, mapping: ClassMapping) -> Gate | None:
    """Return a gate, None if the mapping has no such score."""
    try:
        return parse_gate(text, mapping)
    except ConfigError:
        return None


def _results(texts: Sequence[str], mapping: ClassMapping, found: Scores) -> Iterator[GateResult]:
    """Yield every gate with its score; one that the classes of the outputs do not have is not reached."""
    for text in texts:
        gate = _gate(text, mapping)
        if gate is not None:
            yield from check_gates(found, (gate,))
            continue
        name, _, limit = text.partition("=")
        yield GateResult(name.strip(), float(limit), math.nan)


@dataclass(frozen=True, slots=True)
class Compared:
    """One output and its reference."""

    name: str
    """Of the input in the archive."""
    reference: str | None
    """File of reference classes, its path in the tree; None if there is none."""
    matrix: ConfusionMatrix | None
    """None if it could not be compared."""
    problem: Problem | None = None
    """Why not."""


@dataclass(frozen=True, slots=True)
class BatchEvaluation:
    """What came out for all files that were compared."""

    settings: ReferenceSettings
    files: tuple[Compared, ...]
    matrix: ConfusionMatrix
    """All files together."""
    gates: tuple[GateResult, ...] = field(default=())

    @property
    def passed(self) -> bool:
        """Whether every gate was reached; one that nothing could be compared for was not."""
        return all(gate.passed for gate in self.gates)

    @property
    def unpaired(self) -> tuple[Compared, ...]:
        """Files that could not be compared, for whatever reason."""
        return tuple(found for found in self.files if found.matrix is None)

    def as_dict(self) -> dict[str, Any]:
        """Return scores and counts as plain values; undefined scores are None."""
        return {
            "reference": str(self.settings.tree),
            "mapping": self.settings.mapping_name,
            "match": self.settings.match,
            "pooled": scores_as_dict(self.matrix),
            "gates": [
                {"name": gate.name, "limit": gate.limit, "value": _number(gate.value), "passed": gate.passed}
                for gate in self.gates
            ],
            "files": [
                {
                    "name": found.name,
                    "reference": found.reference,
                    "scores": None if found.matrix is None else scores_as_dict(found.matrix),
                    "problem": None if found.problem is None else asdict(found.problem),
                }
                for found in self.files
            ],
        }


@dataclass(frozen=True, slots=True)
class Output:
    """An output that may be compared."""

    name: str
    """Of the input in the archive."""
    relative: str
    """Of the output in its tree, POSIX slashes."""
    path: Path
    source: Path
    """The input: the points that labels alone belong to."""


def evaluate_tree(
    outputs: Iterable[Output],
    settings: ReferenceSettings,
    *,
    threads: int = 1,
) -> BatchEvaluation:
    """Compare outputs with their references and pool them."""
    check_reference(settings)
    outputs = list(outputs)
    name = settings.mapping_name or mapping_of_runs([output.path for output in outputs])[0]
    settings, mapping = replace(settings, mapping_name=name), load_mapping(name)
    tree = _Tree(settings.tree)
    pooled = ConfusionMatrix.empty(mapping)
    files: list[Compared] = []
    with Judges() as judges:

        def compare(output: Output) -> Compared:
            return _compare(output, tree, mapping, settings, judges)

        for found in ordered(compare, outputs, threads=threads):
            if found.matrix is not None:
                pooled = pooled + found.matrix
            files.append(found)
    return BatchEvaluation(settings, tuple(files), pooled, tuple(_results(settings.gates, mapping, scores(pooled))))


def _compare(
    output: Output, tree: _Tree, mapping: ClassMapping, settings: ReferenceSettings, judges: Judges
) -> Compared:
    try:
        reference = tree.find(output)
    except PrcError as error:
        return Compared(output.name, None, None, Problem.of(error))
    if reference is None:
        problem = "no reference, expected a file of this name but for the suffix in the reference tree"
        return Compared(output.name, None, None, Problem(NO_REFERENCE, output.name, problem))
    shown = reference.relative_to(settings.tree).as_posix()
    options = EvaluateOptions(match=settings.match)
    if settings.match != "order" and output.path.suffix.lower() not in LAS_SUFFIXES:
        options = replace(options, predicted_points=output.source)  # labels alone have neither time nor place
    found = judges.compare(Pair(output.path, reference, mapping, options))
    if isinstance(found, Problem):
        return Compared(output.name, shown, None, found)
    return Compared(output.name, shown, found)


class _Tree:
    """The reference tree, one listing a folder."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._folders: dict[PurePosixPath, dict[str, list[Path]]] = {}

    def find(self, output: Output) -> Path | None:
        """Return the file of reference classes of an output.

        A reference has the name of the output, as another run would write it, or that of the input; but for the suffix.
        """
        name = PurePosixPath(output.name)
        written = PurePosixPath(output.relative)
        if name.parent not in self._folders:
            self._folders[name.parent] = dict(_by_stem(self._root / name.parent))
        folder = self._folders[name.parent]
        input_stem = name.name[: len(name.name) - len(suffix_of(Path(name.name)))]
        for stem in (stem_of(Path(written.name)), name.name, input_stem):
            found = folder.get(stem, [])
            if len(found) > 1:
                problem = f"{' and '.join(path.name for path in found[:2])} have one name, expected one file"
                raise InputError(str(found[0].parent), problem, "move one of them away")
            if found:
                return found[0]
        return None


def _by_stem(folder: Path) -> Iterator[tuple[str, list[Path]]]:
    try:
        paths = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except FileNotFoundError:
        return
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(folder), problem, "check its permissions") from error
    found: dict[str, list[Path]] = {}
    for path in paths:
        if code_suffix_of(path) and path.is_file():
            found.setdefault(stem_of(path), []).append(path)
    yield from found.items()


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
