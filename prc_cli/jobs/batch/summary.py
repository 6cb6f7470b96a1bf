"""What a batch run did: for the table at its end, for its exit code, and for ``summary.json`` in the output folder."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

from prc_cli import __version__
from prc_cli.core.classes import Label
from prc_cli.core.errors import BusyError, ConfigError, DriftError, GateError
from prc_cli.core.files import atomic_output, remove_stale
from prc_cli.jobs.batch.reference import BatchEvaluation
from prc_cli.jobs.batch.types import Alarm, Done, Doubted, Failed, LeftOut, Shard

SUMMARY_NAME = "summary.json"
"""File in the output folder."""
SCHEMA = 1
"""Version of the form of :func:`as_dict`; keys are added without a new number, never renamed or taken away."""
FAILED = 1
"""Exit code when a file failed."""

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
    """UTC, ISO 8601."""
    finished: str
    """UTC, ISO 8601."""
    seconds: float
    """Wall time [s]."""
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
    """Files that are due and were not begun or not ended: ``--limit``, ``--fail-fast``, a signal."""
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
        return tuple((label.name.lower(), total[label.name.lower()]) for label in Label if total[label.name.lower()])

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
    def exit_code(self) -> int:
        """0 done, 1 a file failed, 3 a gate failed, 4 a file is doubted or its classes drifted; the first of these.

        Failures and doubts are those of the archive, whichever run met them.
        """
        if self.failed or self.standing:
            return FAILED
        if self.evaluation is not None and not self.evaluation.passed:
            return GateError.exit_code
        return DriftError.exit_code if self.alarms or self.doubts else 0


EXIT_CODES: dict[int, str] = {
    0: "done: every file that was due has its output, and no doubt stands",
    FAILED: "at least one file of the archive failed, now or in an earlier run; or archive, output folder or journal "
    "cannot be used",
    ConfigError.exit_code: "wrong usage or configuration; nothing was done",
    GateError.exit_code: "an evaluation gate was not reached; nothing failed",
    DriftError.exit_code: "done, look at it: a file is doubted, or its classes are unlike earlier ones; nothing failed",
    BusyError.exit_code: "another run is at work in the output folder; nothing was done",
    129: "the terminal was closed; what was finished stays, the next run goes on",
    130: "Ctrl-C; the same",
    143: "SIGTERM; the same",
}
"""What ``prc batch`` ends with."""


def as_dict(summary: BatchSummary) -> dict[str, Any]:
    """Return a run as plain values, as in ``summary.json``.

    Names are exact: bytes that are no UTF-8 are surrogates, which JSON holds escaped.
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
        "alarms": [{"name": alarm.name, "sentence": alarm.sentence} for alarm in summary.alarms],
        "left_out": [{"name": found.name, "reason": found.reason} for found in summary.left_out],
        "notes": list(summary.notes),
        "evaluation": None if summary.evaluation is None else summary.evaluation.as_dict(),
    }


def done_dict(found: Done) -> dict[str, Any]:
    """Return a finished file as plain values."""
    return {
        "name": found.name,
        "input": {"size": found.input.size, "mtime_ns": found.input.mtime_ns, "sha256": found.input.sha256},
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


def to_json(summary: BatchSummary) -> str:
    """Return :func:`as_dict` as ASCII JSON that ends in a line feed."""
    return json.dumps(as_dict(summary), indent=1, allow_nan=False) + "\n"


def summary_path(out: Path, shard: Shard | None) -> Path:
    """Return the name of the summary; every shard has its own, for they run at the same time.

    >>> summary_path(Path("out"), Shard(3, 8)).name
    'summary.3-of-8.json'
    """
    return out / (SUMMARY_NAME if shard is None else f"summary.{shard.index}-of-{shard.count}.json")


def write_summary(summary: BatchSummary) -> Path:
    """Write the summary into the output folder, whole or not at all."""
    path = summary_path(summary.out, summary.shard)
    remove_stale(path)  # of a run that was killed just here
    with atomic_output(path, overwrite=True) as temporary:
        temporary.write_text(to_json(summary), encoding="ascii", newline="\n")
    return path


def reasons_of(found: Iterable[str]) -> tuple[tuple[str, int], ...]:
    """Count reasons, the most frequent first.

    >>> reasons_of(["new", "changed input", "new"])
    (('new', 2), ('changed input', 1))
    """
    return tuple(Counter(found).most_common())
