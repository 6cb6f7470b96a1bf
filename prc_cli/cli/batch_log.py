"""The log of ``prc batch`` for machines: JSON lines."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from prc_cli import __version__
from prc_cli.cli.batch_words import now, say
from prc_cli.jobs.batch.report import BatchSummary, done_dict, failed_dict
from prc_cli.jobs.batch.run import (
    Again,
    Noted,
    Ready,
    RunEvent,
)
from prc_cli.jobs.batch.types import Alarm, Done, Doubted, Failed, Started

LOG_SCHEMA = 1
"""Version of the form of the log; keys are added without a new number, never renamed or taken away."""


class JsonLog:
    """One JSON object a line; a file is opened for every line, so that it may be rotated away at any moment."""

    def __init__(self, target: str) -> None:
        self._path = None if target == "-" else Path(target)
        self._who: dict[str, Any] = {"process": os.getpid()}
        self._told = False

    def start(self, archive: Path, out: Path, shard: str | None) -> None:
        """Write that a run begins."""
        self._who["shard"] = shard
        self._write(
            "run_start", schema=LOG_SCHEMA, archive=str(archive), out=str(out), shard=shard, version=__version__
        )

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        if isinstance(event, Ready):
            plan = event.plan
            self._write(
                "plan", todo=len(plan.todo), bytes=plan.n_bytes, skipped=len(plan.done), adopted=len(plan.adopted),
                refused=len(plan.refused), beyond_limit=plan.n_beyond_limit, jobs=event.jobs, threads=event.threads,
            )  # fmt: skip
        elif isinstance(event, Started):
            self._write("file_start", name=event.name, worker=event.worker)
        elif isinstance(event, Done):
            self._write("file_done", **done_dict(event))
        elif isinstance(event, Failed):
            self._write("file_failed", **failed_dict(event))
        elif isinstance(event, Again):
            problem = event.problem
            self._write("file_again", name=event.name, kind=problem.kind, problem=problem.problem)
        elif isinstance(event, Doubted):
            self._write("doubt", name=event.name, check=event.check, sentence=event.sentence)
        elif isinstance(event, Alarm):
            self._write("alarm", name=event.name, sentence=event.sentence)
        elif isinstance(event, Noted):
            self._write("note", text=event.text)

    def end(self, exit_code: int, summary: BatchSummary | None, error: str = "") -> None:
        """Write that a run has ended."""
        counts = {} if summary is None else {
            "run": summary.run, "found": summary.n_found, "skipped": summary.n_skipped, "done": len(summary.done),
            "failed": len(summary.failed), "waiting": summary.n_waiting, "doubted": summary.n_doubted,
            "alarms": len(summary.alarms), "shots": summary.n_shots, "seconds": round(summary.seconds, 3),
        }  # fmt: skip
        self._write("run_end", exit_code=exit_code, error=error, **counts)

    def _write(self, event: str, **values: Any) -> None:
        line = json.dumps({"time": now(), "event": event, **self._who, **values}, allow_nan=False) + "\n"
        try:
            if self._path is None:
                sys.stdout.write(line)
                sys.stdout.flush()
            else:
                # one write at the end of the file: lines of shards that share a log do not mix
                with self._path.open("ab", buffering=0) as handle:
                    handle.write(line.encode("ascii"))
        except (OSError, ValueError) as error:  # a pipe that nobody reads, a stream that was closed
            if not self._told:
                name, why = self._path or "stdout", getattr(error, "strerror", None) or error
                say(f"warning: {name}: the log cannot be written ({why}); the run goes on")
            self._told = True
            if self._path is None:
                sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115 - else Python fails at exit
