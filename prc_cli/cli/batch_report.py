"""What ``prc batch`` shows while it runs and when it has ended, and its log of JSON lines."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from prc_cli import __version__
from prc_cli.batch.clean import Cleaned
from prc_cli.batch.lock import Holder
from prc_cli.batch.plan import Estimate, Plan
from prc_cli.batch.run import Again, Noted, Ready, RunEvent
from prc_cli.batch.summary import Alarm, BatchSummary, done_dict, failed_dict
from prc_cli.batch.types import Done, Entry, Failed, Problem, Run, Started
from prc_cli.batch.types import Progress as Lines
from prc_cli.cli.report import SafeConsole, results
from prc_cli.cli.safe import printable
from prc_cli.evaluation.reports import percent
from prc_cli.evaluation.scores import CLASS_SCORES, scores

Hear = Callable[[RunEvent], None]

SHOWN = 20
"""Files that are listed by name at the end; all of them are in ``summary.json``."""
_BESIDE_NAME = 60
"""Columns of a terminal that bar, counts and time take beside a name."""
LOG_SCHEMA = 1
"""Version of the form of the log; keys are added without a new number, never renamed or taken away."""


class _Patient(SafeConsole):
    """A console that falls silent when nobody reads it any more; rich would end the program."""

    def on_broken_pipe(self) -> None:
        """Go on without printing."""
        self.quiet = True

    def print(self, *objects: Any, **options: Any) -> None:
        """Print; older versions of rich pass on that nobody reads."""
        try:
            super().print(*objects, **options)
        except BrokenPipeError:
            self.quiet = True


@cache
def console() -> SafeConsole:
    """Return the console on stderr."""
    return _Patient(stderr=True, markup=False, highlight=False, emoji=False)


def say(text: str) -> None:
    """Print a line on stderr, whatever names are in it, if anybody is there to read it."""
    with contextlib.suppress(OSError):
        console().print(printable(text), soft_wrap=True)


class Final:
    """Passes events on; a failure only when it is known that the file is not tried again."""

    def __init__(self, *listeners: Hear) -> None:
        self._listeners = listeners
        self._held: Failed | None = None

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        held, self._held = self._held, None
        if held is not None and not (isinstance(event, Again) and event.name == held.name):
            self._tell(held)
        if isinstance(event, Failed):
            self._held = event
        else:
            self._tell(event)

    def close(self) -> None:
        """Pass on what was held back."""
        held, self._held = self._held, None
        if held is not None:
            self._tell(held)

    def _tell(self, event: RunEvent) -> None:
        for listener in self._listeners:
            with contextlib.suppress(OSError):  # a terminal or pipe that is gone must not stop the work
                listener(event)


class PlainLines:
    """One line a finished file, for logs; quiet: only what is wrong."""

    def __init__(self, *, quiet: bool, verbose: bool, stamps: bool) -> None:
        self._quiet, self._verbose, self._stamps = quiet, verbose, stamps
        self._n_todo = 0
        self._n_ended = 0

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        if isinstance(event, Ready):
            self._n_todo = len(event.plan.todo) + len(event.plan.refused)
            if self._verbose:
                self._say(f"{_n(self._n_todo, 'file')} to do, {event.jobs} at a time with {event.threads} threads each")
        elif isinstance(event, Started) and self._verbose:
            self._say(f"begin {event.name} (worker {event.worker})")
        elif isinstance(event, Done):
            self._n_ended += 1
            if not self._quiet:
                self._say(f"{self._count()} done {event.name}: {done_words(event)}")
                if self._verbose:
                    for notice in event.notices:
                        self._say(f"note {event.name}: {notice}")
        elif isinstance(event, Failed):
            self._n_ended += 1
            self._say(f"{self._count()} failed {failed_words(event)}")
        else:
            text = rare_words(event, quiet=self._quiet)
            if text:
                self._say(text)

    def _count(self) -> str:
        return f"[{self._n_ended}/{self._n_todo}]" if self._n_todo else "[-]"

    def _say(self, text: str) -> None:
        say(f"{_now()} {text}" if self._stamps else text)


class Bars:
    """One bar for the archive and a line for every file in work, on a terminal."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=12),
            TextColumn("{task.fields[told]}", markup=False),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=console(),
            transient=True,
        )
        self._archive: TaskID | None = None
        self._files: dict[str, tuple[TaskID, float, int]] = {}
        self._sizes: dict[str, int] = {}
        self._n_todo = self._n_done = self._n_failed = self._n_shots = 0
        self._start = time.perf_counter()

    def __enter__(self) -> Bars:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._progress.stop()

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        if isinstance(event, Ready):
            self._begin(event)
        elif isinstance(event, Started):
            task = self._progress.add_task(f"  {_short(event.name)}", total=None, told="")
            self._files[event.name] = (task, time.perf_counter(), 0)
        elif isinstance(event, Lines):
            self._advance(event)
        elif isinstance(event, Done | Failed):
            self._end(event)
        else:
            text = rare_words(event, quiet=False)
            if isinstance(event, Again):
                self._remove(event.name)
            if text:
                self._progress.console.print(printable(text), soft_wrap=True)

    def _begin(self, event: Ready) -> None:
        self._sizes = {item.task.name: item.size for item in event.plan.todo}
        self._n_todo = len(self._sizes) + len(event.plan.refused)
        self._start = time.perf_counter()
        # empty files count a byte, so that an archive of them has an end
        total = sum(max(1, size) for size in self._sizes.values())
        self._archive = self._progress.add_task("archive", total=total, told=self._told())

    def _advance(self, event: Lines) -> None:
        found = self._files.get(event.name)
        if found is None:
            return
        task, start, n_lines = found
        n_lines += event.n_lines
        self._files[event.name] = (task, start, n_lines)
        seconds = time.perf_counter() - start
        rate = f", {n_lines / seconds:,.0f}/s" if seconds > 1 else ""
        self._progress.update(task, told=f"{n_lines:,} lines{rate}")

    def _end(self, event: Done | Failed) -> None:
        self._remove(event.name)
        if isinstance(event, Failed):
            self._n_failed += 1
            self._progress.console.print(printable(f"failed {failed_words(event)}"), soft_wrap=True)
        else:
            self._n_done += 1
            self._n_shots += event.n_shots
        if self._archive is not None:
            size = max(1, self._sizes[event.name]) if event.name in self._sizes else 0
            self._progress.update(self._archive, advance=size, told=self._told())

    def _remove(self, name: str) -> None:
        found = self._files.pop(name, None)
        if found is not None:
            self._progress.remove_task(found[0])

    def _told(self) -> str:
        seconds = time.perf_counter() - self._start
        rate = f", {self._n_shots / seconds / 1e6:.2g} M/s" if self._n_shots and seconds > 0 else ""
        failed = f", {self._n_failed} failed" if self._n_failed else ""
        return f"{self._n_done + self._n_failed}/{self._n_todo} files{failed}{rate}"


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
        elif isinstance(event, Alarm):
            self._write("alarm", name=event.name, sentence=event.sentence)
        elif isinstance(event, Noted):
            self._write("note", text=event.text)

    def end(self, exit_code: int, summary: BatchSummary | None, error: str = "") -> None:
        """Write that a run has ended."""
        counts = {} if summary is None else {
            "run": summary.run, "found": summary.n_found, "skipped": summary.n_skipped, "done": len(summary.done),
            "failed": len(summary.failed), "waiting": summary.n_waiting, "alarms": len(summary.alarms),
            "shots": summary.n_shots, "seconds": round(summary.seconds, 3),
        }  # fmt: skip
        self._write("run_end", exit_code=exit_code, error=error, **counts)

    def _write(self, event: str, **values: Any) -> None:
        line = json.dumps({"time": _now(), "event": event, **self._who, **values}, allow_nan=False) + "\n"
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


def done_words(event: Done) -> str:
    """Return what became of a file, for people."""
    rate = f", {event.n_shots / event.seconds / 1e6:.2g} M/s" if event.seconds > 0 else ""
    return f"{event.n_shots:,} shots in {event.seconds:.1f} s{rate}"


def failed_words(event: Failed) -> str:
    """Return why a file failed; its name stands once, as it is in the archive."""
    return _about(event.name, event.problem)


def _about(name: str, problem: Problem) -> str:
    where = problem.where
    # the journal holds names that are no UTF-8 escaped
    for written in (name, name.encode("utf-8", "backslashreplace").decode("utf-8")):
        before, found, rest = where.partition(written)
        if found and (not before or before.endswith(("/", "\\"))):
            where = name + rest
            break
    else:
        where = f"{name}: {where}" if where else name
    return f"{where}: {problem.problem}" + (f"; {problem.hint}" if problem.hint else "")


def rare_words(event: RunEvent, *, quiet: bool) -> str:
    """Return a line for what happens seldom; empty for all else."""
    if isinstance(event, Alarm):
        return f"alarm {event.name}: {event.sentence}"
    if quiet:
        return ""
    if isinstance(event, Again):
        return f"again {event.name}: tried once more ({event.problem.kind}: {event.problem.problem})"
    return f"note: {event.text}" if isinstance(event, Noted) else ""


def print_end(summary: BatchSummary, *, quiet: bool, listed: bool, only_failed: bool = False) -> None:
    """Print what a run did: tables on stderr; quiet: a line, and only if something is wrong.

    Parameters
    ----------
    summary : BatchSummary
        The run.
    quiet : bool
        As ``--quiet``.
    listed : bool
        The failures stand just above already.
    only_failed : bool
        Only what failed or was cut off was asked for.
    """
    is_wrong = summary.exit_code or summary.ended != "finished"
    idle = not (summary.done or summary.failed or summary.n_waiting or summary.alarms)
    if idle and summary.evaluation is None:
        if not quiet:
            say(f"nothing to do: {_idle_words(summary, only_failed=only_failed)} ({summary.out})")
        return
    if not quiet:
        _print_classes(summary)
        _print_wrong(summary, listed=listed)
        print_compared(summary)
    elif summary.evaluation is not None and not summary.evaluation.passed:
        _print_gates(summary)
    if is_wrong or not quiet:
        say(end_words(summary))


def _idle_words(summary: BatchSummary, *, only_failed: bool) -> str:
    """Say why a run had nothing to do."""
    if summary.n_found:
        return f"{_n(summary.n_found, 'file')} {'is' if summary.n_found == 1 else 'are'} done"
    return "no file failed or was cut off" if only_failed else "no files were found"


def end_words(summary: BatchSummary) -> str:
    """Return the last line of a run."""
    counts = [
        (len(summary.done), "done"), (summary.n_skipped, "skipped"), (len(summary.failed), "failed"),
        (summary.n_waiting, "left for another run"),
        (len(summary.alarms), f"alarm{'s' * (len(summary.alarms) != 1)}"),
    ]  # fmt: skip
    told = ", ".join(f"{count:,} {what}" for count, what in counts if count)
    rate = summary.shots_per_s
    pace = "" if rate is None else f"; {summary.n_shots:,} shots, {rate / 1e6:.2g} million a second"
    how = "" if summary.ended == "finished" else f"{summary.ended}; "
    return f"{how}{told or 'no files'} of {summary.n_found:,} in {_duration(summary.seconds)}{pace}"


def _print_classes(summary: BatchSummary) -> None:
    counts = dict(summary.labels)
    returned = sum(counts.values()) - counts.get("missing", 0)
    if not returned:
        return
    table = Table(title=f"classes of {_n(len(summary.done), 'file')}")
    for heading in ("class", "shots", "share"):
        table.add_column(heading, justify="left" if heading == "class" else "right")
    for name, count in counts.items():
        table.add_row(name, f"{count:,}", "" if name == "missing" else f"{count / returned:.1%}")
    console().print(table)


def _print_wrong(summary: BatchSummary, *, listed: bool) -> None:
    rows = [] if listed else [f"failed {failed_words(found)}" for found in summary.failed]
    rows += [f"left out {found.name}: {found.reason}" for found in summary.left_out]
    for row in rows[:SHOWN]:
        say(row)
    if len(rows) > SHOWN:
        say(f"and {len(rows) - SHOWN} more, see summary.json")


def print_compared(summary: BatchSummary) -> None:
    """Print scores of every file, and of all together, on stdout."""
    found = summary.evaluation
    if found is None:
        return
    compared = [(item.name, scores(item.matrix)) for item in found.files if item.matrix is not None]
    if compared:
        pooled = scores(found.matrix)
        names = [item.name for item in pooled.classes if item.name in pooled.scored and item.n_reference]
        table = Table(title="recall against the reference")
        table.add_column("file")
        for heading in ("records", *names, "accuracy"):
            table.add_column(heading, justify="right")
        shown = compared if len(compared) <= SHOWN else sorted(compared, key=lambda item: item[1].accuracy)[:SHOWN]
        for name, each in (*shown, ("all files", pooled)):
            recall = {item.name: item.recall for item in each.classes}
            cells = (percent(recall[key]) for key in names)
            table.add_row(printable(name), f"{each.n_scored:,}", *cells, percent(each.accuracy))
        results().print(table)
        if len(compared) > SHOWN:
            results().print(f"the {SHOWN} of {len(compared)} files with the lowest accuracy; all are in summary.json")
        table = Table(title="all files")
        for heading in ("class", *CLASS_SCORES):
            table.add_column(heading, justify="left" if heading == "class" else "right")
        for item in pooled.classes:
            if item.name in names:
                table.add_row(item.name, *(percent(getattr(item, score)) for score in CLASS_SCORES))
        results().print(table)
    for missing in found.unpaired[:SHOWN]:
        if missing.problem is not None:
            say(f"not compared {_about(missing.name, missing.problem)}")
    if len(found.unpaired) > SHOWN:
        say(f"and {len(found.unpaired) - SHOWN} more, see summary.json")
    _print_gates(summary)


def _print_gates(summary: BatchSummary) -> None:
    found = summary.evaluation
    for gate in () if found is None else found.gates:
        value = "undefined" if gate.value != gate.value else f"{gate.value:.4f}"
        verdict = "passed" if gate.passed else "failed"
        say(f"{gate.name}: found {value}, demanded {gate.limit:.4f}: {verdict}")


def plan_dict(plan: Plan, estimate: Estimate) -> dict[str, Any]:
    """Return a dry run as plain values."""
    return {
        "todo": [
            {"name": item.task.name, "output": str(item.task.output), "reason": item.reason, "size": item.size}
            for item in plan.todo
        ],
        "bytes": plan.n_bytes,
        "skipped": len(plan.done),
        "adopted": [found.name for _, found in plan.adopted],
        "refused": [failed_dict(found) for found in plan.refused],
        "left_out": [{"name": found.name, "reason": found.reason} for found in plan.left_out],
        "beyond_limit": plan.n_beyond_limit,
        "not_selected": plan.n_not_selected,
        "estimate": {
            "seconds": estimate.seconds,
            "peak_mib": estimate.peak_mib,
            "sources": list(estimate.sources),
            "unknown": estimate.n_unknown,
        },
    }


def print_plan(plan: Plan, estimate: Estimate, *, verbose: bool) -> None:
    """Print what a run would do, on stdout."""
    shown = plan.todo if verbose else plan.todo[:SHOWN]
    for item in shown:
        name, output = item.task.name, item.task.output.name
        arrow = "" if name.rpartition("/")[2] == output else f" -> {printable(output)}"
        results().print(f"{item.reason:<15} {printable(name)}{arrow}", soft_wrap=True)
    if len(shown) < len(plan.todo):
        results().print(f"and {len(plan.todo) - len(shown):,} more; -v lists all")
    for refused in plan.refused:
        results().print(f"{'refused':<15} {printable(failed_words(refused))}", soft_wrap=True)
    for left in plan.left_out:
        results().print(f"{'left out':<15} {printable(f'{left.name}: {left.reason}')}", soft_wrap=True)
    counts = [
        (len(plan.done), "done already"), (len(plan.adopted), "would be adopted"),
        (plan.n_beyond_limit, "left for another run"), (plan.n_not_selected, "not selected"),
    ]  # fmt: skip
    told = "".join(f", {count:,} {what}" for count, what in counts if count)
    results().print(f"{_n(len(plan.todo), 'file')} to do ({_size(plan.n_bytes)}){told}", soft_wrap=True)
    if not plan.todo:
        return
    for source in estimate.sources:
        results().print(printable(source), soft_wrap=True)
    seconds = "an unknown time" if estimate.seconds is None else f"about {_duration(estimate.seconds)}"
    memory = "an unknown amount" if estimate.peak_mib is None else f"about {_size(int(estimate.peak_mib * 2**20))}"
    unknown = f", without {_n(estimate.n_unknown, 'file')} of formats not seen yet" if estimate.n_unknown else ""
    results().print(f"estimate: {seconds}, {memory} of memory{unknown}; nothing was written")


def _short(name: str) -> str:
    """Return the end of a name, as much as there is room for beside a bar."""
    text = printable(name)
    width = max(12, console().width - _BESIDE_NAME)
    return text if len(text) <= width else f"…{text[1 - width :]}"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _minute(stamp: str) -> str:
    """Shorten a time of the journal.

    >>> _minute("2026-11-21T17:49:02.072890+00:00")
    '2026-11-21 17:49:02'
    """
    return stamp[:19].replace("T", " ")


def _n(count: int, what: str) -> str:
    return f"{count:,} {what}{'s' * (count != 1)}"


def _size(n_bytes: int) -> str:
    for unit, name in ((1 << 40, "TiB"), (1 << 30, "GiB")):
        if n_bytes >= unit:
            return f"{n_bytes / unit:.1f} {name}"
    return f"{n_bytes / 2**20:.1f} MiB"


def _duration(seconds: float) -> str:
    """Return a time for people.

    >>> _duration(5.04), _duration(3725), _duration(7500)
    ('5.0 s', '62 min', '2 h 5 min')
    """
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def status_dict(entries: Sequence[Entry], runs: Sequence[Run], owners: Sequence[Holder]) -> dict[str, Any]:
    """Return the state of an output folder as plain values."""
    return {
        "at_work": [asdict(found.owner) | {"silent_s": round(found.silent_s, 1)} for found in owners if found.alive],
        "dead_owners": [asdict(found.owner) for found in owners if not found.alive],
        "counts": dict(Counter(entry.state for entry in entries)),
        "runs": [asdict(run) | {"totals": dict(run.totals)} for run in runs],
        "files": [_entry_dict(entry) for entry in entries],
    }


def _entry_dict(entry: Entry) -> dict[str, Any]:
    table = {
        "name": entry.name, "state": entry.state, "config_sha256": entry.config_sha256, "version": entry.version,
        "run": entry.run, "attempts": entry.attempts, "started": entry.started, "finished": entry.finished,
        "owner": entry.owner,
    }  # fmt: skip
    if isinstance(entry.outcome, Done):
        table["outcome"] = done_dict(entry.outcome)
    elif entry.outcome is not None:
        table["outcome"] = failed_dict(entry.outcome)
    return table


def print_status(out: Path, entries: Sequence[Entry], runs: Sequence[Run], owners: Sequence[Holder]) -> None:
    """Print the state of an output folder on stdout."""

    def tell(text: str) -> None:
        results().print(printable(text), soft_wrap=True)

    counts = Counter(entry.state for entry in entries)
    living = [found for found in owners if found.alive]
    at_work = {str(found.owner) for found in living}
    # what a dead owner left running was cut off
    n_running = sum(entry.state == "running" and entry.owner in at_work for entry in entries)
    told = [
        (counts["done"], "done"), (counts["failed"], "failed"), (n_running, "running"),
        (counts["running"] - n_running, "cut off"),
    ]  # fmt: skip
    tell(f"{out}: {_n(len(entries), 'file')}: " + ", ".join(f"{count:,} {what}" for count, what in told if count))
    for found in living:
        tell(f"at work: {found.owner}, last heard of {max(0.0, found.silent_s):.0f} s ago")
    if not living:
        tell("no run is at work")
    table = Table(title="last runs")
    for heading in ("begun (UTC)", "shard", "version", "exit code", "counts"):
        table.add_column(heading)
    for run in runs[-5:]:
        ended = "at work" if run.owner in at_work else "cut off"
        code = ended if run.exit_code is None else str(run.exit_code)
        totals = ", ".join(f"{count} {name}" for name, count in run.totals if count)
        table.add_row(_minute(run.started), run.shard or "-", run.version, code, printable(totals))
    if runs:
        results().print(table)
    wrong = [entry for entry in entries if entry.state != "done"]
    for entry in wrong[:SHOWN]:
        tries = f", {_n(entry.attempts, 'attempt')}" if entry.attempts > 1 else ""
        if isinstance(entry.outcome, Failed) and entry.state == "failed":
            tell(f"failed {failed_words(entry.outcome)} ({entry.outcome.problem.kind}{tries})")
        else:
            how = "running" if entry.owner in at_work else "cut off"
            tell(f"{how} {entry.name} (since {_minute(entry.started)}{tries})")
    if len(wrong) > SHOWN:
        tell(f"and {len(wrong) - SHOWN:,} more; --json has all of them")


def print_cleaned(found: Cleaned, *, dry_run: bool) -> None:
    """Print what was removed, on stdout."""
    verb = "would remove" if dry_run else "removed"
    for path in found.files:
        results().print(printable(f"{verb} {path}"), soft_wrap=True)
    for name in found.forgotten[:SHOWN]:
        results().print(printable(f"{'would forget' if dry_run else 'forgot'} {name}"), soft_wrap=True)
    if len(found.forgotten) > SHOWN:
        results().print(f"and {len(found.forgotten) - SHOWN:,} more")
    for path in found.kept:
        results().print(printable(f"kept {path}: another machine may still write it"), soft_wrap=True)
    forgotten = (
        f", {'would forget' if dry_run else 'forgot'} {_n(len(found.forgotten), 'input')}" if found.forgotten else ""
    )
    results().print(f"{verb} {_n(len(found.files), 'file')} ({_size(found.n_bytes)}){forgotten}")
