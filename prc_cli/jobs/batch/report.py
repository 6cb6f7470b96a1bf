"""Results of a batch run: summary and exit code, scores against references, alarms of drift."""

from __future__ import annotations

import contextlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal, TypeAlias

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, ExitCode, InputError
from prc_cli.core.files import suffix_of
from prc_cli.core.own_file import write_own
from prc_cli.core.types import F64
from prc_cli.core.version import __version__
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.reports import as_dict as scores_as_dict
from prc_cli.evaluation.reports import gate_dicts
from prc_cli.evaluation.scores import Gate, GateResult, Scores, check_gates, parse_gate, scores
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.labels import code_suffix_of
from prc_cli.jobs.batch.discovery import LeftOut
from prc_cli.jobs.batch.engine import Compared, Comparison, EngineSettings
from prc_cli.jobs.batch.local import LocalEngine
from prc_cli.jobs.batch.outcomes import Done, Doubted, Failed, Problem
from prc_cli.jobs.batch.types import ReferenceSettings, Shard, own_name
from prc_cli.jobs.evaluate.options import (
    DEFAULT_MAPPING,
    MAPPINGS,
    EvaluateOptions,
    mapping_of_runs,
)
from prc_cli.matching.pairs import stem_of

SCHEMA = 1
"""Version of the form of :func:`as_dict`.

New keys do not change it. Keys are never renamed or removed.
"""
Ended: TypeAlias = Literal["finished", "stopped", "interrupted"]
"""How a run ended: complete, early because of ``--fail-fast``, or by a signal."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """A file whose classes are unlike those of earlier ones."""

    name: str
    sentence: str
    """What is unusual, with the class and both shares."""


@dataclass(frozen=True, slots=True)
class BatchSummary:
    """One run of ``prc batch``."""

    run: str
    """Id of the run, as in the journal."""
    archive: Path
    out: Path
    started: str
    finished: str
    seconds: float
    n_found: int
    """Inputs in the archive after ``--include``, ``--exclude``, ``--since`` and ``--shard``."""
    n_skipped: int
    """Files of ``n_found`` that an earlier run did and that have not changed since."""
    done: tuple[Done, ...] = ()
    """Sorted by name."""
    failed: tuple[Failed, ...] = ()
    """Files that have no output of this run."""
    failed_before: tuple[Failed, ...] = ()
    """Files of the archive that failed in an earlier run and were not tried in this one."""
    n_waiting: int = 0
    """Files that are due but not finished, because of ``--limit``, ``--fail-fast`` or a signal."""
    reasons: tuple[tuple[str, int], ...] = ()
    """Number of files by reason: ``new``, ``changed input``, ..."""
    alarms: tuple[Alarm, ...] = ()
    doubts: tuple[Doubted, ...] = ()
    """Of all finished files of the archive, also of earlier runs, sorted by name."""
    left_out: tuple[LeftOut, ...] = ()
    notes: tuple[str, ...] = ()
    """Events that concern the run, such as a lock that was taken over."""
    ended: Ended = "finished"
    shard: Shard | None = None
    config_sha256: str = ""
    """Of the configuration without overrides."""
    evaluation: BatchEvaluation | None = field(default=None)

    @property
    def labels(self) -> tuple[tuple[str, int], ...]:
        """Records by label name in all files of the run, in the order of :class:`Label`."""
        total: Counter[str] = Counter()
        for file in self.done:
            total.update(dict(file.labels))
        return tuple(
            (label.name.lower(), total[label.name.lower()])
            for label in Label
            if total[label.name.lower()]
        )

    @property
    def n_doubted(self) -> int:
        """Files with a doubt."""
        return len({doubt.name for doubt in self.doubts})

    @property
    def n_shots(self) -> int:
        """Shots that were classified in this run."""
        return sum(file.n_shots for file in self.done)

    @property
    def shots_per_s(self) -> float | None:
        """Shots per second of the run; None if it did nothing."""
        return self.n_shots / self.seconds if self.n_shots and self.seconds > 0 else None

    @property
    def exit_code(self) -> ExitCode:
        """FAILED if a file of the archive failed, else GATE, else LOOK on doubt or drift."""
        if self.failed or self.failed_before:
            return ExitCode.FAILED
        if self.evaluation is not None and not self.evaluation.passed:
            return ExitCode.GATE
        return ExitCode.LOOK if self.alarms or self.doubts else ExitCode.DONE


def as_dict(summary: BatchSummary) -> dict[str, Any]:
    """Return a run as plain values, as in ``summary.json``.

    Bytes of names that are not UTF-8 become surrogates.
    """
    return {
        "schema": SCHEMA,
        "program": "prc-cli",
        "version": __version__,
        "run": summary.run,
        "archive": str(summary.archive),
        "out": str(summary.out),
        "shard": None if summary.shard is None else str(summary.shard),
        "config_sha256": summary.config_sha256,
        "started": summary.started,
        "finished": summary.finished,
        "seconds": round(summary.seconds, 3),
        "ended": summary.ended,
        # after a signal the program ends with the code of the signal
        "exit_code": None if summary.ended == "interrupted" else summary.exit_code,
        "counts": {
            "found": summary.n_found,
            "skipped": summary.n_skipped,
            "done": len(summary.done),
            "failed": len(summary.failed),
            "failed_before": len(summary.failed_before),
            "waiting": summary.n_waiting,
            "doubted": summary.n_doubted,
            "alarms": len(summary.alarms),
            "left_out": len(summary.left_out),
        },
        "reasons": dict(summary.reasons),
        "shots": summary.n_shots,
        "shots_per_s": summary.shots_per_s,
        "labels": dict(summary.labels),
        "done": [file.as_dict() for file in summary.done],
        "failed": [file.as_dict() for file in summary.failed],
        "failed_before": [file.as_dict() for file in summary.failed_before],
        "doubts": [asdict(doubt) for doubt in summary.doubts],
        "doubt_counts": dict(Counter(doubt.check for doubt in summary.doubts).most_common()),
        "alarms": [asdict(alarm) for alarm in summary.alarms],
        "left_out": [asdict(file) for file in summary.left_out],
        "notes": list(summary.notes),
        "evaluation": None if summary.evaluation is None else summary.evaluation.as_dict(),
    }


def write_summary(summary: BatchSummary) -> Path:
    """Write the summary into the output folder; it is complete or absent."""
    path = summary.out / own_name("summary", summary.shard, ".json")
    write_own(path, json.dumps(as_dict(summary), indent=1, allow_nan=False) + "\n")
    return path


# -- references ------------------------------------------------------------------------------------


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


# -- drift -----------------------------------------------------------------------------------------
#
# A sensor that loses range, a wrong preset or a covered window does not make a file fail, but it
# changes its classes. So prc compares the shares of the classes with earlier files of the same
# configuration. The statistics are robust: a few unusual earlier files neither hide the next one
# nor raise an alarm for good files.

MIN_EARLIER = 8
"""Least number of earlier files for an alarm."""
FLOOR = 0.05
"""Least total change of the shares for an alarm."""
SPREADS = 6.0
"""Least distance for an alarm, in robust standard deviations above the median distance."""
KNOWN_FRACTION = 0.05
"""No alarm if this share of the earlier files is like the file.

Archives have several kinds of drive.
"""
KNOWN_FILES = 3
"""Least number of such files for no alarm."""
_MAD_TO_SIGMA = 1.4826
"""Median absolute deviation to standard deviation, for a normal distribution."""


def drift(labels: Mapping[str, int], earlier: Iterable[Mapping[str, int]]) -> str | None:
    """Compare the classes of a file with earlier files; return a sentence if they are unusual.

    The distance of two files is half the sum of the differences of their shares (total variation, 0
    to 1): the share of the records that would have to change class. A file is unusual if its
    distance from the median of the earlier files is above :data:`FLOOR`, and above the median of
    their distances by :data:`SPREADS` robust standard deviations, and if no small group of earlier
    files is within :data:`FLOOR` of it.
    """
    known = [histogram for histogram in earlier if sum(histogram.values()) > 0]
    if len(known) < MIN_EARLIER:
        return None
    names = sorted({name for histogram in (labels, *known) for name in histogram})
    if sum(labels.values()) <= 0:
        return f"there are no records, while {len(known)} earlier files have some"
    shares = _shares(known, names)
    file_shares = _shares([labels], names)[0]
    usual = np.median(shares, axis=0)
    distances = _distance(shares, usual)
    distance = float(_distance(file_shares, usual))
    middle = float(np.median(distances))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(distances - middle)))
    if distance <= max(FLOOR, middle + SPREADS * spread):
        return None
    n_alike = int(np.count_nonzero(_distance(shares, file_shares) <= FLOOR))
    if n_alike >= max(KNOWN_FILES, KNOWN_FRACTION * len(known)):
        return None
    # rounded, so that the first of two classes with the same change is named
    moved = int(np.argmax(np.round(np.abs(file_shares - usual), 9)))
    low, high = 100.0 * np.quantile(shares[:, moved], [0.1, 0.9])
    return (
        f"{names[moved]} is {100.0 * file_shares[moved]:.1f} % of the records, "
        f"in {len(known)} earlier files {100.0 * usual[moved]:.1f} % "
        f"({low:.1f} to {high:.1f} % in most)"
    )


def _shares(histograms: list[Mapping[str, int]], names: list[str]) -> F64:
    # (files, classes); every row sums to 1
    counts = np.array(
        [[histogram.get(name, 0) for name in names] for histogram in histograms], np.float64
    )
    shares: F64 = counts / counts.sum(axis=1, keepdims=True)
    return shares


def _distance(shares: F64, point: F64) -> F64:
    # total variation of every row, 0 to 1
    distance: F64 = 0.5 * np.abs(shares - point).sum(axis=-1)
    return distance
