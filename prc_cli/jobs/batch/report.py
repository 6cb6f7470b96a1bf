"""What a batch run found: its summary and exit code, scores against a reference tree, files unlike earlier ones."""

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
from prc_cli.core.files import atomic_output, remove_stale, suffix_of
from prc_cli.core.types import F64
from prc_cli.core.version import __version__
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.reports import as_dict as scores_as_dict
from prc_cli.evaluation.reports import gate_dicts
from prc_cli.evaluation.scores import Gate, GateResult, Scores, check_gates, parse_gate, scores
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.labels import code_suffix_of
from prc_cli.jobs.batch.local import LocalEngine
from prc_cli.jobs.batch.types import (
    Alarm,
    Compared,
    Comparison,
    Done,
    Doubted,
    EngineSettings,
    Failed,
    LeftOut,
    Problem,
    ReferenceSettings,
    Shard,
    own_name,
)
from prc_cli.jobs.evaluate.options import (
    DEFAULT_MAPPING,
    MAPPINGS,
    EvaluateOptions,
    mapping_of_runs,
)
from prc_cli.matching.pairs import stem_of

SCHEMA = 1
"""Version of the form of :func:`as_dict`.

Keys are added without a new number, never renamed or taken away.
"""
Ended: TypeAlias = Literal["finished", "stopped", "interrupted"]
"""How a run ended: with nothing left to do, early because of ``--fail-fast``, or by a signal."""


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
    """Of these, done by an earlier run and not changed since."""
    done: tuple[Done, ...] = ()
    """In the order of their names."""
    failed: tuple[Failed, ...] = ()
    """Files that have no output of this run."""
    standing: tuple[Failed, ...] = ()
    """Files of the archive that failed in an earlier run and were not tried in this one."""
    n_waiting: int = 0
    """Files that are due and were not begun or not ended.

    ``--limit``, ``--fail-fast``, a signal.
    """
    reasons: tuple[tuple[str, int], ...] = ()
    """Why files were done, or were to be done: ``new``, ``changed input``, ... and how many."""
    alarms: tuple[Alarm, ...] = ()
    doubts: tuple[Doubted, ...] = ()
    """Of the archive's finished files, whichever run did them, in the order of their names."""
    left_out: tuple[LeftOut, ...] = ()
    notes: tuple[str, ...] = ()
    """What the run met beside the files: a lock taken over, temporary files removed."""
    ended: Ended = "finished"
    shard: Shard | None = None
    config_sha256: str = ""
    """Of the configuration without overrides."""
    evaluation: BatchEvaluation | None = field(default=None)

    @property
    def labels(self) -> tuple[tuple[str, int], ...]:
        """Records by label name, all files of the run together, in the order of :class:`Label`."""
        total: Counter[str] = Counter()
        for found in self.done:
            total.update(dict(found.labels))
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
        return sum(found.n_shots for found in self.done)

    @property
    def shots_per_s(self) -> float | None:
        """Shots by the clock of the run; None where nothing was done."""
        return self.n_shots / self.seconds if self.n_shots and self.seconds > 0 else None

    @property
    def exit_code(self) -> ExitCode:
        """0 done, 1 a file of the archive failed, 3 a gate did, 4 doubt or drift.

        The first of these.
        """
        if self.failed or self.standing:
            return ExitCode.FAILED
        if self.evaluation is not None and not self.evaluation.passed:
            return ExitCode.GATE
        return ExitCode.LOOK if self.alarms or self.doubts else ExitCode.DONE


def as_dict(summary: BatchSummary) -> dict[str, Any]:
    """Return a run as plain values, as in ``summary.json``.

    Bytes that are no UTF-8 are surrogates.
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
        # after a signal the program ends with the signal's own
        "exit_code": None if summary.ended == "interrupted" else summary.exit_code,
        "counts": {
            "found": summary.n_found,
            "skipped": summary.n_skipped,
            "done": len(summary.done),
            "failed": len(summary.failed),
            "failed_before": len(summary.standing),
            "waiting": summary.n_waiting,
            "doubted": summary.n_doubted,
            "alarms": len(summary.alarms),
            "left_out": len(summary.left_out),
        },
        "reasons": dict(summary.reasons),
        "shots": summary.n_shots,
        "shots_per_s": summary.shots_per_s,
        "labels": dict(summary.labels),
        "done": [done_dict(found) for found in summary.done],
        "failed": [failed_dict(found) for found in summary.failed],
        "failed_before": [failed_dict(found) for found in summary.standing],
        "doubts": [asdict(doubt) for doubt in summary.doubts],
        "doubt_counts": dict(Counter(doubt.check for doubt in summary.doubts).most_common()),
        "alarms": [asdict(alarm) for alarm in summary.alarms],
        "left_out": [asdict(found) for found in summary.left_out],
        "notes": list(summary.notes),
        "evaluation": None if summary.evaluation is None else summary.evaluation.as_dict(),
    }


def done_dict(found: Done) -> dict[str, Any]:
    """Return a finished file as plain values."""
    return {
        "name": found.name,
        "input": asdict(found.input),
        "output": found.output_name,
        "output_size": found.output_size,
        "output_sha256": found.output_sha256,
        "seconds": round(found.seconds, 3),
        "cpu_seconds": round(found.cpu_seconds, 3),
        "peak_mib": None if found.peak_mib is None else round(found.peak_mib, 1),
        "lines": found.n_lines,
        "shots": found.n_shots,
        "records": found.n_records,
        "labels": dict(found.labels),
        "notices": list(found.notices),
    }


def failed_dict(found: Failed) -> dict[str, Any]:
    """Return a failed file as plain values."""
    return {"name": found.name, "seconds": round(found.seconds, 3), **asdict(found.problem)}


def write_summary(summary: BatchSummary) -> Path:
    """Write the summary into the output folder, whole or not at all."""
    path = summary.out / own_name("summary", summary.shard, ".json")
    remove_stale(path)  # of a run that was killed just here
    with atomic_output(path, overwrite=True) as temporary:
        text = json.dumps(as_dict(summary), indent=1, allow_nan=False) + "\n"
        temporary.write_text(text, encoding="ascii", newline="\n")
    return path


# -- references --------------------------------------------------------------------------------------------------------


NO_REFERENCE = "NoReference"
"""Kind of the problem of a file that has no reference."""


def check_reference(settings: ReferenceSettings) -> None:
    """Refuse what makes no sense before any file is classified."""
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
    names = (
        (DEFAULT_MAPPING, *MAPPINGS.values())
        if settings.mapping_name is None
        else (settings.mapping_name,)
    )
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
    """Yield every gate with its score.

    One that the classes of the outputs do not have is not reached.
    """
    for text in texts:
        gate = _gate(text, mapping)
        if gate is not None:
            yield from check_gates(found, (gate,))
            continue
        name, _, limit = text.partition("=")
        yield GateResult(name.strip(), float(limit), math.nan)


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
            "gates": gate_dicts(self.gates),
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
    outputs: Sequence[Output], settings: ReferenceSettings, *, jobs: int = 1
) -> BatchEvaluation:
    """Compare outputs with their references, each alone in a process as ``prc evaluate`` does, and pool them."""
    check_reference(settings)
    name = settings.mapping_name or mapping_of_runs([output.path for output in outputs])[0]
    settings = replace(settings, mapping_name=name)
    mapping = load_mapping(name)
    found: dict[str, Compared] = {}
    todo: list[Comparison] = []
    folders: dict[Path, dict[str, list[Path]]] = {}
    for output in outputs:
        try:
            reference = _reference_of(output, settings.tree, folders)
        except InputError as error:
            found[output.name] = Compared(output.name, None, None, Problem.of(error))
            continue
        if reference is None:
            problem = "no reference, expected a file of this name but for the suffix in the reference tree"
            found[output.name] = Compared(
                output.name, None, None, Problem(NO_REFERENCE, output.name, problem)
            )
            continue
        options = EvaluateOptions(match=settings.match)
        if settings.match != "order" and output.path.suffix.lower() not in LAS_SUFFIXES:
            options = replace(
                options, predicted_points=output.source
            )  # labels alone have neither time nor place
        shown = reference.relative_to(settings.tree).as_posix()
        todo.append(Comparison(output.name, output.path, reference, shown, mapping, options))
    shown_as = {item.name: item.shown for item in todo}
    with contextlib.closing(
        LocalEngine().run(todo, EngineSettings(jobs=min(jobs, len(todo))))
    ) as events:
        for event in events:
            if isinstance(event, Compared):
                found[event.name] = event
            elif isinstance(event, Failed):
                found[event.name] = Compared(event.name, shown_as[event.name], None, event.problem)
    files = tuple(found[output.name] for output in outputs)
    matrices = [item.matrix for item in files if item.matrix is not None]
    pooled = sum(matrices, ConfusionMatrix.empty(mapping))
    return BatchEvaluation(
        settings, files, pooled, tuple(_results(settings.gates, mapping, scores(pooled)))
    )


def _reference_of(
    output: Output, tree: Path, folders: dict[Path, dict[str, list[Path]]]
) -> Path | None:
    """Return the reference named as the input, or as any run's output, but for the suffix.

    None = none is.
    """
    name = PurePosixPath(output.name)
    place = tree / name.parent
    if place not in folders:
        folders[place] = _by_stem(place)
    input_stem = name.name[: len(name.name) - len(suffix_of(Path(name.name)))]
    for stem in (stem_of(Path(output.relative)), name.name, input_stem):
        found = folders[place].get(stem, [])
        if len(found) > 1:
            problem = (
                f"{' and '.join(path.name for path in found[:2])} have one name, expected one file"
            )
            raise InputError(str(place), problem, "move one of them away")
        if found:
            return found[0]
    return None


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    """Return the files of classes in a folder by their names without suffix."""
    found: dict[str, list[Path]] = {}
    try:
        for path in sorted(folder.iterdir()) if folder.exists() else ():
            if not path.name.startswith(".") and code_suffix_of(path) and path.is_file():
                found.setdefault(stem_of(path), []).append(path)
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(folder), problem, "check its permissions") from error
    return found


# -- drift -------------------------------------------------------------------------------------------------------------
#
# A sensor that loses range, a wrong preset or a covered window make no file fail, they change what
# is found in it. The shares of the classes are compared with those of earlier files of the same
# configuration. Robust statistics are taken, so that some earlier files that were odd as well
# neither hide the next one nor raise an alarm for good ones.

MIN_EARLIER = 8
"""Least number of earlier files for an alarm."""
FLOOR = 0.05
"""Least total change of the shares for an alarm."""
SPREADS = 6.0
"""Least distance for an alarm, in robust standard deviations above the median distance."""
KNOWN_FRACTION = 0.05
"""An archive holds several kinds of drive.

a file is not odd if so many earlier ones are like it.
"""
KNOWN_FILES = 3
"""The same, as the least number of files."""
_MAD_TO_SIGMA = 1.4826
"""Median absolute deviation to standard deviation, for a normal distribution."""


def drift(labels: Mapping[str, int], earlier: Iterable[Mapping[str, int]]) -> str | None:
    """Compare the classes of a file with those of earlier ones.

    The distance of two files is half the sum of the differences of their shares (total variation, 0
    to 1): the part of the records that would have to change class. A file is odd if its distance
    from the median of the earlier files is above :data:`FLOOR` and above the median of their own
    distances by :data:`SPREADS` robust standard deviations, and there is no small group of earlier
    files within :data:`FLOOR` of it.
    """
    known = [histogram for histogram in earlier if sum(histogram.values()) > 0]
    if len(known) < MIN_EARLIER:
        return None
    names = sorted({name for histogram in (labels, *known) for name in histogram})
    if sum(labels.values()) <= 0:
        return f"there are no records, while {len(known)} earlier files have some"
    shares = _shares(known, names)
    own = _shares([labels], names)[0]
    usual = np.median(shares, axis=0)
    distances = _distance(shares, usual)
    distance = float(_distance(own, usual))
    middle = float(np.median(distances))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(distances - middle)))
    if distance <= max(FLOOR, middle + SPREADS * spread):
        return None
    n_alike = int(np.count_nonzero(_distance(shares, own) <= FLOOR))
    if n_alike >= max(KNOWN_FILES, KNOWN_FRACTION * len(known)):
        return None
    # rounded, so that of two classes that moved by the same the first is named whatever the last
    # bit says
    moved = int(np.argmax(np.round(np.abs(own - usual), 9)))
    low, high = 100.0 * np.quantile(shares[:, moved], [0.1, 0.9])
    return (
        f"{names[moved]} is {100.0 * own[moved]:.1f} % of the records, in {len(known)} earlier files "
        f"{100.0 * usual[moved]:.1f} % ({low:.1f} to {high:.1f} % in most)"
    )


def _shares(histograms: list[Mapping[str, int]], names: list[str]) -> F64:
    """Return the shares of the classes, (files, classes) float64, each row summing to 1."""
    counts = np.array(
        [[histogram.get(name, 0) for name in names] for histogram in histograms], np.float64
    )
    shares: F64 = counts / counts.sum(axis=1, keepdims=True)
    return shares


def _distance(shares: F64, point: F64) -> F64:
    """Return the total variation distance of every row from a point, float64, 0 to 1."""
    distance: F64 = 0.5 * np.abs(shares - point).sum(axis=-1)
    return distance
