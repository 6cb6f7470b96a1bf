"""Texts of ``prc batch``: progress, log, summary, and the state of an output folder."""

from __future__ import annotations

import contextlib
import json
import os
import stat
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from prc_cli.cli.output import console, print_result, results, table_of
from prc_cli.cli.report import accepting
from prc_cli.core.errors import OutputError, message, printable
from prc_cli.core.findings import is_doubt
from prc_cli.core.version import __version__
from prc_cli.evaluation.reports import percent
from prc_cli.evaluation.scores import CLASS_SCORES, scores
from prc_cli.jobs.batch.drift import Alarm
from prc_cli.jobs.batch.engine import Compared, Progress, Started
from prc_cli.jobs.batch.journal import Entry, Run
from prc_cli.jobs.batch.lock import Holder
from prc_cli.jobs.batch.outcomes import Done, Doubted, Failed, Problem
from prc_cli.jobs.batch.outputs import Cleaned, Verified
from prc_cli.jobs.batch.plan import Estimate, Plan
from prc_cli.jobs.batch.report import BatchSummary
from prc_cli.jobs.batch.run import Again, Noted, Ready, RunEvent

SHOWN = 20
"""Files that are listed by name at the end; all of them are in ``summary.json``."""
LOG_SCHEMA = 1
"""Version of the form of the log.

Keys are added without a new number, never renamed or taken away.
"""


def print_note(text: str) -> None:
    """Print a line on stderr, whatever names are in it, if anybody is there to read it."""
    print_message(printable(text))


def print_message(text: str) -> None:
    """Print a message on stderr, whose lines are printable."""
    try:
        sys.stderr.write(text + "\n")
        sys.stderr.flush()
    except (OSError, ValueError):  # else Python fails at exit
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115


def _print_messages(messages: Sequence[str]) -> None:
    """Print the first of many messages on stderr."""
    for text in messages[:SHOWN]:
        print_message(text)
    if len(messages) > SHOWN:
        print_note(f"and {len(messages) - SHOWN} more, see summary.json")


# -- words -----------------------------------------------------------------------------------


def _problem_of(event: Failed | Compared) -> Problem:
    """Return why a file failed, with the name of the file once, as in the archive."""
    name = event.name
    problem = event.problem
    assert problem is not None
    before, text, position = problem.where.partition(name)
    if text and (not before or before.endswith(("/", "\\"))):
        where = name + position
    else:
        where = f"{name}: {problem.where}" if problem.where else name
    return replace(problem, where=where)


def _doubt_of(doubt: Doubted) -> Problem:
    """Return a warning about a file as a problem, whose hint also says how to accept it."""
    problem, _, hint = doubt.sentence.partition("; ")
    return Problem("warning", doubt.name, problem, accepting(doubt.check, hint))


def _message(head: str, problem: Problem) -> str:
    return message(f"{head} {problem.where}", problem.problem, problem.hint)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def count_of(count: int, what: str) -> str:
    """Return a count with its noun.

    >>> count_of(1, "file"), count_of(2000, "file")
    ('1 file', '2,000 files')
    """
    return f"{count:,} {what}{'s' * (count != 1)}"


def size_of(n_bytes: float) -> str:
    """Return a size in MiB, GiB or TiB.

    >>> size_of(3 << 20), size_of(1 << 30), size_of(1 << 40)
    ('3.0 MiB', '1.0 GiB', '1.0 TiB')
    """
    for unit, name in ((1 << 40, "TiB"), (1 << 30, "GiB")):
        if n_bytes >= unit:
            return f"{n_bytes / unit:.1f} {name}"
    return f"{n_bytes / 2**20:.1f} MiB"


def duration(seconds: float) -> str:
    """Return a duration in s, min or h.

    >>> duration(5.04), duration(3725), duration(7500)
    ('5.0 s', '62 min', '2 h 5 min')
    """
    minutes = round(seconds / 60)
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def _listed(counts: Sequence[tuple[int, str]]) -> str:
    return ", ".join(f"{count:,} {what}" for count, what in counts if count)


# -- during a run ----------------------------------------------------------------------------


class Final:
    """Passes events on, and a failure only if the file is not tried again."""

    def __init__(self, *listeners: Callable[[RunEvent], None]) -> None:
        self._listeners = listeners
        self._held: Failed | None = None

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        held = self._held
        self._held = None
        if held is not None and not (isinstance(event, Again) and event.name == held.name):
            self._pass_on(held)
        if isinstance(event, Failed):
            self._held = event
        else:
            self._pass_on(event)

    def close(self) -> None:
        """Pass on the last failure."""
        if self._held is not None:
            self._pass_on(self._held)

    def _pass_on(self, event: RunEvent) -> None:
        for listener in self._listeners:
            # a closed terminal or pipe must not stop the work
            with contextlib.suppress(OSError):
                listener(event)


class ProgressPrinter:
    """Prints a line per finished file or a bar; if quiet, only failures and warnings."""

    def __init__(
        self,
        *,
        quiet: bool,
        verbose: bool,
        stamps: bool,
        bar: bool,
    ) -> None:
        from tqdm import tqdm

        self._quiet = quiet
        self._verbose = verbose
        self._stamps = stamps
        # an empty file counts as one byte, so that the bar of empty files moves
        self._bar = tqdm(
            unit="B", unit_scale=True, leave=False, dynamic_ncols=True, disable=not bar
        )
        self._has_bar = bar
        self._sizes: dict[str, int] = {}
        self._lines: dict[str, int] = {}
        """Number of finished lines of the files that are being classified."""
        self._n_todo = self._n_ended = self._n_failed = 0

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        if isinstance(event, Ready):
            self._begin(event)
        elif isinstance(event, Done):
            self._done(event)
        elif isinstance(event, Failed):
            self._n_failed += 1
            self._end(event.name, "failed", _problem_of(event))
        elif isinstance(event, Started):
            self._lines[event.name] = 0
            if self._verbose:
                self._print(f"start {event.name} (worker {event.worker})")
        elif isinstance(event, Progress):
            self._lines[event.name] = self._lines.get(event.name, 0) + event.n_lines
        elif isinstance(event, Doubted):
            self._print_problem("warning:", _doubt_of(event))
        elif isinstance(event, Alarm):
            self._print(f"alarm {event.name}: {event.sentence}")
        elif isinstance(event, Again) and not self._quiet:
            self._print(
                f"again {event.name}: tried once more ({event.problem.kind}: "
                f"{event.problem.problem})"
            )
        elif isinstance(event, Noted) and not self._quiet:
            self._print(f"note: {event.text}")
        if self._has_bar:
            self._show()

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()

    def _begin(self, event: Ready) -> None:
        self._sizes = {item.task.name: max(1, item.size) for item in event.plan.todo}
        self._n_todo = len(event.plan.todo) + len(event.plan.refused)
        self._bar.total = sum(self._sizes.values())
        if self._verbose:
            self._print(
                f"{count_of(self._n_todo, 'file')} to do, {event.jobs} at a time with "
                f"{event.threads} threads each"
            )

    def _done(self, event: Done) -> None:
        rate = f", {event.n_shots / event.seconds / 1e6:.2g} M/s" if event.seconds > 0 else ""
        text = f"done {event.name}: {event.n_shots:,} shots in {event.seconds:.1f} s{rate}"
        self._end(event.name, "" if self._quiet or self._has_bar else text)
        for notice in event.notices if self._verbose and not self._quiet else ():
            if not is_doubt(notice):  # warnings are printed separately
                self._print(f"note {event.name}: {notice}")

    def _end(self, name: str, text: str, problem: Problem | None = None) -> None:
        self._n_ended += 1
        self._lines.pop(name, None)
        self._bar.update(self._sizes.get(name, 0))
        count = f"[{self._n_ended}/{self._n_todo}]" if self._n_todo else "[-]"
        if problem is not None:
            self._print_problem(f"{count} {text}", problem)
        elif text:
            self._print(f"{count} {text}")

    def _show(self) -> None:
        failed = f", {self._n_failed} failed" if self._n_failed else ""
        at_work = "".join(
            f", {printable(name)[-40:]}: {n:,} lines" for name, n in [*self._lines.items()][:1]
        )
        self._bar.set_postfix_str(
            f"{self._n_ended}/{self._n_todo} files{failed}{at_work}", refresh=False
        )
        self._bar.update(0)

    def _print(self, text: str) -> None:
        self._bar.clear()
        print_note(f"{_now()} {text}" if self._stamps else text)

    def _print_problem(self, head: str, problem: Problem) -> None:
        """Print a message of up to three lines, or one line with its time in a log."""
        if self._stamps:
            self._print(f"{head} {problem}")
        else:
            self._bar.clear()
            print_message(_message(head, problem))


def _check_log(path: Path) -> None:
    """Refuse a file that is not a log: prc appends to it."""
    try:
        status = path.stat()
        is_log = stat.S_ISREG(status.st_mode) and status.st_nlink == 1
        if is_log and status.st_size:
            with path.open("rb") as handle:
                is_log = handle.read(1) == b"{"
    except FileNotFoundError:
        return
    except OSError as error:
        raise OutputError(
            str(path), f"cannot be read ({error.strerror})", "check its permissions"
        ) from error
    if not is_log:
        problem = "is not a log of prc batch: it is another kind of file, or has two names"
        raise OutputError(str(path), problem, "name a new file for --log-json, or - for stdout")


class JsonLog:
    """Log of JSON lines. Every line opens the file again, so that it can be rotated."""

    def __init__(self, target: str) -> None:
        self._path = None if target == "-" else Path(target)
        if self._path is not None:
            _check_log(self._path)
        self._who: dict[str, Any] = {"process": os.getpid()}
        self._has_warned = False

    def start(self, archive: Path, out: Path, shard: str | None) -> None:
        """Write that a run starts."""
        self._who["shard"] = shard
        self._write(
            "run_start", schema=LOG_SCHEMA, archive=str(archive), out=str(out), version=__version__
        )

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        if isinstance(event, Ready):
            plan = event.plan
            self._write(
                "plan",
                todo=len(plan.todo),
                bytes=plan.n_bytes,
                skipped=len(plan.done),
                refused=len(plan.refused),
                beyond_limit=plan.n_beyond_limit,
                jobs=event.jobs,
                threads=event.threads,
            )
        elif isinstance(event, Done):
            self._write("file_done", **event.as_dict())
        elif isinstance(event, Failed):
            self._write("file_failed", **event.as_dict())
        elif isinstance(event, Again):
            problem = event.problem
            self._write("file_again", name=event.name, kind=problem.kind, problem=problem.problem)
        elif isinstance(event, Started | Doubted | Alarm | Noted):
            names = {Started: "file_start", Doubted: "doubt", Alarm: "alarm", Noted: "note"}
            self._write(names[type(event)], **asdict(event))

    def end(self, exit_code: int, summary: BatchSummary | None, error: str = "") -> None:
        """Write that a run has ended."""
        counts = (
            {}
            if summary is None
            else {
                "run": summary.run,
                "found": summary.n_found,
                "skipped": summary.n_skipped,
                "done": len(summary.done),
                "failed": len(summary.failed),
                "waiting": summary.n_waiting,
                "doubted": summary.n_doubted,
                "alarms": len(summary.alarms),
                "shots": summary.n_shots,
                "seconds": round(summary.seconds, 3),
            }
        )
        self._write("run_end", exit_code=exit_code, error=error, **counts)

    def _write(self, event: str, **values: Any) -> None:
        line = (
            json.dumps({"time": _now(), "event": event, **self._who, **values}, allow_nan=False)
            + "\n"
        )
        try:
            if self._path is None:
                sys.stdout.write(line)
                sys.stdout.flush()
            else:
                # one write at the end of the file: lines of shards that share a log do not mix
                with self._path.open("ab", buffering=0) as handle:
                    handle.write(line.encode("ascii"))
        except (OSError, ValueError) as error:  # a pipe that nobody reads, a stream that was closed
            if not self._has_warned:
                name = self._path or "stdout"
                why = getattr(error, "strerror", None) or error
                problem = f"the log cannot be written ({why}); the run continues"
                print_message(message(f"warning: {name}", problem))
            self._has_warned = True
            if self._path is None:
                sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115 - else Python fails at exit


# -- after a run -----------------------------------------------------------------------------


TRUSTING = "prc compared earlier files by size and time only; --verify compares their content"


def print_end(
    summary: BatchSummary,
    *,
    quiet: bool,
    listed: bool,
    only_failed: bool = False,
    trusting: bool = False,
) -> None:
    """Print the summary of a run.

    Parameters
    ----------
    summary : BatchSummary
    quiet : bool
        Print one line, and only if something is wrong.
    listed : bool
        The failures are already on the screen.
    only_failed : bool
        Only earlier failures were to be done.
    trusting : bool
        The run did not read the outputs of earlier runs.
    """
    trusting = trusting and not quiet and summary.n_skipped > 0
    is_wrong = summary.exit_code or summary.ended != "finished"
    idle = not (
        summary.done
        or summary.failed
        or summary.failed_before
        or summary.n_waiting
        or summary.alarms
    )
    if idle and summary.evaluation is None:
        files = count_of(summary.n_found, "file") + (
            " is done" if summary.n_found == 1 else " are done"
        )
        nothing = "no file failed or was interrupted" if only_failed else "no files were found"
        if not quiet:
            print_note(f"nothing to do: {files if summary.n_found else nothing} ({summary.out})")
        if trusting:
            print_note(TRUSTING)
        if is_wrong or not quiet:
            _print_doubts(summary)
        return
    if not quiet:
        _print_classes(summary)
        failed = [] if listed else summary.failed
        failed_before = summary.failed_before
        messages = [_message("failed", _problem_of(failure)) for failure in failed]
        messages += [_message("failed before", _problem_of(failure)) for failure in failed_before]
        messages += [message(f"left out {file.name}", file.reason) for file in summary.left_out]
        _print_messages(messages)
        _print_doubts(summary)
        _print_compared(summary)
    if summary.evaluation is not None and not (quiet and summary.evaluation.passed):
        for gate in summary.evaluation.gates:
            value = "undefined" if gate.value != gate.value else f"{gate.value:.4f}"
            print_note(
                f"{gate.name}: found {value}, expected at least {gate.limit:.4f}: "
                f"{'passed' if gate.passed else 'failed'}"
            )
    if is_wrong or not quiet:
        print_note(_end_words(summary))
    if trusting:
        print_note(TRUSTING)


def _end_words(summary: BatchSummary) -> str:
    states = _listed(
        [
            (len(summary.done), "done"),
            (summary.n_skipped, "skipped"),
            (len(summary.failed), "failed"),
            (len(summary.failed_before), "failed before"),
            (summary.n_waiting, "left for another run"),
            (summary.n_doubted, "with warnings"),
            (len(summary.alarms), f"alarm{'s' * (len(summary.alarms) != 1)}"),
        ]
    )
    rate = summary.shots_per_s
    pace = "" if rate is None else f"; {summary.n_shots:,} shots, {rate / 1e6:.2g} million a second"
    how = "" if summary.ended == "finished" else f"{summary.ended}; "
    return (
        f"{how}{states or 'no files'} of {summary.n_found:,} in {duration(summary.seconds)}{pace}"
    )


def _print_classes(summary: BatchSummary) -> None:
    counts = dict(summary.labels)
    returned = sum(counts.values()) - counts.get("missing", 0)
    if returned:
        table = table_of(
            f"classes of {count_of(len(summary.done), 'file')}", "class", "shots", "share"
        )
        for name, count in counts.items():
            table.add_row(
                name, f"{count:,}", "" if name == "missing" else f"{count / returned:.1%}"
            )
        console().print(table)


def _print_doubts(summary: BatchSummary) -> None:
    """Print the number of files by check; the warnings themselves are printed before."""
    counts = Counter(doubt.check for doubt in summary.doubts)
    if counts:
        checks = ", ".join(f"{check} {count:,}" for check, count in counts.most_common())
        print_note(
            f"{count_of(summary.n_doubted, 'file')} with warnings ({checks}); "
            "all are in summary.json and prc batch status"
        )


def _print_compared(summary: BatchSummary) -> None:
    """Print scores of every file, and of all together, on stdout."""
    evaluation = summary.evaluation
    if evaluation is None:
        return
    compared = [
        (item.name, scores(item.matrix)) for item in evaluation.files if item.matrix is not None
    ]
    if compared:
        pooled = scores(evaluation.matrix)
        names = [
            item.name for item in pooled.classes if item.name in pooled.scored and item.n_reference
        ]
        table = table_of("recall against the reference", "file", "records", *names, "accuracy")
        shown = (
            compared
            if len(compared) <= SHOWN
            else sorted(compared, key=lambda item: item[1].accuracy)[:SHOWN]
        )
        for name, matrix in (*shown, ("all files", pooled)):
            recall = {item.name: item.recall for item in matrix.classes}
            cells = (percent(recall[key]) for key in names)
            table.add_row(printable(name), f"{matrix.n_scored:,}", *cells, percent(matrix.accuracy))
        results().print(table)
        if len(compared) > SHOWN:
            print_result(
                f"the {SHOWN} of {len(compared)} files with the lowest accuracy; "
                "all are in summary.json"
            )
        table = table_of("all files", "class", *CLASS_SCORES)
        for item in pooled.classes:
            if item.name in names:
                table.add_row(item.name, *(percent(getattr(item, score)) for score in CLASS_SCORES))
        results().print(table)
    _print_messages(
        [_message("not compared", _problem_of(missing)) for missing in evaluation.unpaired]
    )


# -- the plan, and the state of an output folder ---------------------------------------------


def plan_dict(plan: Plan, estimate: Estimate) -> dict[str, Any]:
    """Return a dry run as plain values."""
    return {
        "todo": [
            {
                "name": item.task.name,
                "output": str(item.task.output),
                "reason": item.reason,
                "size": item.size,
            }
            for item in plan.todo
        ],
        "bytes": plan.n_bytes,
        "skipped": len(plan.done),
        "refused": [file.as_dict() for file in plan.refused],
        "left_out": [asdict(file) for file in plan.left_out],
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
        name = item.task.name
        output = item.task.output.name
        print_result(
            f"{item.reason:<15} {name}"
            + ("" if name.rpartition("/")[2] == output else f" -> {output}")
        )
    if len(shown) < len(plan.todo):
        print_result(f"and {len(plan.todo) - len(shown):,} more; -v lists all")
    for refused in plan.refused:
        print_result(f"{'refused':<15} {_problem_of(refused)}")
    for left in plan.left_out:
        print_result(f"{'left out':<15} {left.name}: {left.reason}")
    states = _listed(
        [
            (len(plan.done), "done already"),
            (plan.n_beyond_limit, "left for another run"),
            (plan.n_not_selected, "not selected"),
        ]
    )
    print_result(
        f"{count_of(len(plan.todo), 'file')} to do ({size_of(plan.n_bytes)})"
        + (f", {states}" if states else "")
    )
    if not plan.todo:
        return
    for source in estimate.sources:
        print_result(source)
    seconds = (
        "an unknown time" if estimate.seconds is None else f"about {duration(estimate.seconds)}"
    )
    memory = (
        "an unknown amount"
        if estimate.peak_mib is None
        else f"about {size_of(estimate.peak_mib * 2**20)}"
    )
    unknown = (
        f", without {count_of(estimate.n_unknown, 'file')} of formats not seen yet"
        if estimate.n_unknown
        else ""
    )
    print_result(f"estimate: {seconds}, {memory} of memory{unknown}; nothing was written")


def status_dict(
    entries: Sequence[Entry], runs: Sequence[Run], owners: Sequence[Holder]
) -> dict[str, Any]:
    """Return the state of an output folder as plain values."""
    return {
        "at_work": [asdict(holder.owner) for holder in owners if holder.alive],
        "dead_owners": [asdict(holder.owner) for holder in owners if not holder.alive],
        "counts": dict(Counter(entry.state for entry in entries)),
        "doubted": [asdict(doubt) for entry in entries for doubt in entry.doubts],
        "runs": [asdict(run) | {"totals": dict(run.totals)} for run in runs],
        "files": [_entry_dict(entry) for entry in entries],
    }


def _entry_dict(entry: Entry) -> dict[str, Any]:
    same = (
        "name",
        "state",
        "config_sha256",
        "version",
        "run",
        "attempts",
        "started",
        "finished",
        "owner",
    )
    table = {key: getattr(entry, key) for key in same}
    if entry.outcome is not None:
        table["outcome"] = entry.outcome.as_dict()
    return table


def print_status(
    out: Path,
    entries: Sequence[Entry],
    runs: Sequence[Run],
    owners: Sequence[Holder],
) -> None:
    """Print the state of an output folder on stdout."""
    counts = Counter(entry.state for entry in entries)
    doubts = [doubt for entry in entries for doubt in entry.doubts]
    at_work = {str(holder.owner) for holder in owners if holder.alive}
    # a run that died leaves files in the state "running"
    n_running = sum(entry.state == "running" and entry.owner in at_work for entry in entries)
    states = _listed(
        [
            (counts["done"], "done"),
            (counts["failed"], "failed"),
            (n_running, "running"),
            (counts["running"] - n_running, "interrupted"),
            (len({doubt.name for doubt in doubts}), "with warnings"),
        ]
    )
    print_result(f"{out}: {count_of(len(entries), 'file')}: {states}")
    for owner in sorted(at_work):
        print_result(f"running now: {owner}")
    if not at_work:
        print_result("no run is active")
    table = table_of(
        "last runs", "start (UTC)", "shard", "version", "exit code", "counts", n_words=5
    )
    for run in runs[-5:]:
        ended = "running" if run.owner in at_work else "interrupted"
        code = ended if run.exit_code is None else str(run.exit_code)
        totals = ", ".join(f"{count} {name}" for name, count in run.totals if count)
        table.add_row(_minute(run.started), run.shard or "-", run.version, code, printable(totals))
    if runs:
        results().print(table)
    wrong = [entry for entry in entries if entry.state != "done"]
    for entry in wrong[:SHOWN]:
        tries = f", {count_of(entry.attempts, 'attempt')}" if entry.attempts > 1 else ""
        if isinstance(entry.outcome, Failed) and entry.state == "failed":
            print_result(
                f"failed {_problem_of(entry.outcome)} ({entry.outcome.problem.kind}{tries})"
            )
        else:
            how = "running" if entry.owner in at_work else "interrupted"
            print_result(f"{how} {entry.name} (since {_minute(entry.started)}{tries})")
    for doubt in doubts[:SHOWN]:
        how = f"to accept it: --accept-doubt {doubt.check}"
        print_result(f"warning {doubt.name}: {doubt.sentence} ({how})")
    n_more = max(len(wrong) - SHOWN, 0) + max(len(doubts) - SHOWN, 0)
    if n_more:
        print_result(f"and {n_more:,} more; --json has all of them")


def _minute(stamp: str) -> str:
    """Shorten a time of the journal.

    >>> _minute("2026-11-21T17:49:02.072890+00:00")
    '2026-11-21 17:49:02'
    """
    return stamp[:19].replace("T", " ")


def print_verified(out: Path, outputs: Sequence[Verified], *, quiet: bool) -> None:
    """Print which outputs are not as they were written, on stdout."""
    wrong = [output for output in outputs if output.state != "whole"]
    for output in wrong:
        print_result(f"{output.state:<8} {output.name}: {output.why}")
    if wrong or not quiet:
        hint = "; the next prc batch repeats the others" if wrong else ""
        print_result(
            f"{out}: {len(outputs) - len(wrong):,} of {count_of(len(outputs), 'output')} "
            f"whole{hint}"
        )


def print_cleaned(cleaned: Cleaned, *, dry_run: bool) -> None:
    """Print what was removed, on stdout."""
    removed, forgot = ("would remove", "would forget") if dry_run else ("removed", "forgot")
    for path in cleaned.files:
        print_result(f"{removed} {path}")
    for name in cleaned.forgotten[:SHOWN]:
        print_result(f"{forgot} {name}")
    if len(cleaned.forgotten) > SHOWN:
        print_result(f"and {len(cleaned.forgotten) - SHOWN:,} more")
    for path in cleaned.kept:
        print_result(f"kept {path}: another machine may still write it")
    forgotten = (
        f", {forgot} {count_of(len(cleaned.forgotten), 'input')}" if cleaned.forgotten else ""
    )
    print_result(
        f"{removed} {count_of(len(cleaned.files), 'file')} ({size_of(cleaned.n_bytes)}){forgotten}"
    )
