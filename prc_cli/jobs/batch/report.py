"""The summary of a batch run, and its exit code."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

from prc_cli.core.classes import Label
from prc_cli.core.errors import ExitCode
from prc_cli.core.own_file import write_own
from prc_cli.core.version import __version__
from prc_cli.jobs.batch.discovery import LeftOut
from prc_cli.jobs.batch.drift import Alarm
from prc_cli.jobs.batch.outcomes import Done, Doubted, Failed
from prc_cli.jobs.batch.references import BatchEvaluation
from prc_cli.jobs.batch.types import Shard, own_name

SCHEMA = 1
"""Version of the form of :func:`as_dict`.

New keys do not change it. Keys are never renamed or removed.
"""
Ended: TypeAlias = Literal["finished", "stopped", "interrupted"]
"""How a run ended: complete, early because of ``batch.fail_fast``, or by a signal."""


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
    """Files that are due but not finished, because of ``--limit``, a failure or a signal."""
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
