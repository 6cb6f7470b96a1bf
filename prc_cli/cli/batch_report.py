"""What ``prc batch`` prints when it has ended, before it would begin, and about what lies in an output folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from prc_cli.cli.batch_words import about, console, count_of, doubt_words, duration, failed_words, minute, say, size_of
from prc_cli.cli.report import results
from prc_cli.cli.safe import printable
from prc_cli.evaluation.reports import percent
from prc_cli.evaluation.scores import CLASS_SCORES, scores
from prc_cli.jobs.batch.lock import Holder
from prc_cli.jobs.batch.outputs import Cleaned, Verified
from prc_cli.jobs.batch.plan import Estimate, Plan
from prc_cli.jobs.batch.report import BatchSummary, done_dict, failed_dict
from prc_cli.jobs.batch.types import (
    Done,
    Doubted,
    Entry,
    Failed,
    Run,
    doubts_of,
)

SHOWN = 20
"""Files that are listed by name at the end; all of them are in ``summary.json``."""


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
    idle = not (summary.done or summary.failed or summary.standing or summary.n_waiting or summary.alarms)
    if idle and summary.evaluation is None:
        if not quiet:
            say(f"nothing to do: {_idle_words(summary, only_failed=only_failed)} ({summary.out})")
        if is_wrong or not quiet:
            _print_doubts(summary)
        return
    if not quiet:
        _print_classes(summary)
        _print_wrong(summary, listed=listed)
        _print_doubts(summary)
        print_compared(summary)
    elif summary.evaluation is not None and not summary.evaluation.passed:
        _print_gates(summary)
    if is_wrong or not quiet:
        say(end_words(summary))


def _idle_words(summary: BatchSummary, *, only_failed: bool) -> str:
    """Say why a run had nothing to do."""
    if summary.n_found:
        return f"{count_of(summary.n_found, 'file')} {'is' if summary.n_found == 1 else 'are'} done"
    return "no file failed or was cut off" if only_failed else "no files were found"


def end_words(summary: BatchSummary) -> str:
    """Return the last line of a run."""
    counts = [
        (len(summary.done), "done"), (summary.n_skipped, "skipped"), (len(summary.failed), "failed"),
        (len(summary.standing), "failed before"), (summary.n_waiting, "left for another run"),
        (summary.n_doubted, "doubted"), (len(summary.alarms), f"alarm{'s' * (len(summary.alarms) != 1)}"),
    ]  # fmt: skip
    told = ", ".join(f"{count:,} {what}" for count, what in counts if count)
    rate = summary.shots_per_s
    pace = "" if rate is None else f"; {summary.n_shots:,} shots, {rate / 1e6:.2g} million a second"
    how = "" if summary.ended == "finished" else f"{summary.ended}; "
    return f"{how}{told or 'no files'} of {summary.n_found:,} in {duration(summary.seconds)}{pace}"


def _print_classes(summary: BatchSummary) -> None:
    counts = dict(summary.labels)
    returned = sum(counts.values()) - counts.get("missing", 0)
    if not returned:
        return
    table = Table(title=f"classes of {count_of(len(summary.done), 'file')}")
    for heading in ("class", "shots", "share"):
        table.add_column(heading, justify="left" if heading == "class" else "right")
    for name, count in counts.items():
        table.add_row(name, f"{count:,}", "" if name == "missing" else f"{count / returned:.1%}")
    console().print(table)


def _print_doubts(summary: BatchSummary) -> None:
    """Print how many files each check doubts; the sentences stood above."""
    counts = Counter(doubt.check for doubt in summary.doubts)
    if counts:
        told = ", ".join(f"{check} {count:,}" for check, count in counts.most_common())
        say(f"{count_of(summary.n_doubted, 'file')} doubted ({told}); all are in summary.json and prc batch status")


def _print_wrong(summary: BatchSummary, *, listed: bool) -> None:
    rows = [] if listed else [f"failed {failed_words(found)}" for found in summary.failed]
    rows += [f"failed before {failed_words(found)}" for found in summary.standing]
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
            say(f"not compared {about(missing.name, missing.problem)}")
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
    results().print(f"{count_of(len(plan.todo), 'file')} to do ({size_of(plan.n_bytes)}){told}", soft_wrap=True)
    if not plan.todo:
        return
    for source in estimate.sources:
        results().print(printable(source), soft_wrap=True)
    seconds = "an unknown time" if estimate.seconds is None else f"about {duration(estimate.seconds)}"
    memory = "an unknown amount" if estimate.peak_mib is None else f"about {size_of(int(estimate.peak_mib * 2**20))}"
    unknown = f", without {count_of(estimate.n_unknown, 'file')} of formats not seen yet" if estimate.n_unknown else ""
    results().print(f"estimate: {seconds}, {memory} of memory{unknown}; nothing was written")


def status_dict(entries: Sequence[Entry], runs: Sequence[Run], owners: Sequence[Holder]) -> dict[str, Any]:
    """Return the state of an output folder as plain values."""
    return {
        "at_work": [asdict(found.owner) for found in owners if found.alive],
        "dead_owners": [asdict(found.owner) for found in owners if not found.alive],
        "counts": dict(Counter(entry.state for entry in entries)),
        "doubted": [asdict(doubt) for doubt in _doubts(entries)],
        "runs": [asdict(run) | {"totals": dict(run.totals)} for run in runs],
        "files": [_entry_dict(entry) for entry in entries],
    }


def _doubts(entries: Sequence[Entry]) -> list[Doubted]:
    """Return the doubts about the finished files of a journal."""
    return [doubt for entry in entries for doubt in doubts_of(entry)]


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

    counts, doubts = Counter(entry.state for entry in entries), _doubts(entries)
    living = [found for found in owners if found.alive]
    at_work = {str(found.owner) for found in living}
    # what a dead owner left running was cut off
    n_running = sum(entry.state == "running" and entry.owner in at_work for entry in entries)
    told = [
        (counts["done"], "done"), (counts["failed"], "failed"), (n_running, "running"),
        (counts["running"] - n_running, "cut off"), (len({doubt.name for doubt in doubts}), "doubted"),
    ]  # fmt: skip
    tell(f"{out}: {count_of(len(entries), 'file')}: " + ", ".join(f"{count:,} {what}" for count, what in told if count))
    for found in living:
        tell(f"at work: {found.owner}")
    if not living:
        tell("no run is at work")
    table = Table(title="last runs")
    for heading in ("begun (UTC)", "shard", "version", "exit code", "counts"):
        table.add_column(heading)
    for run in runs[-5:]:
        ended = "at work" if run.owner in at_work else "cut off"
        code = ended if run.exit_code is None else str(run.exit_code)
        totals = ", ".join(f"{count} {name}" for name, count in run.totals if count)
        table.add_row(minute(run.started), run.shard or "-", run.version, code, printable(totals))
    if runs:
        results().print(table)
    wrong = [entry for entry in entries if entry.state != "done"]
    for entry in wrong[:SHOWN]:
        tries = f", {count_of(entry.attempts, 'attempt')}" if entry.attempts > 1 else ""
        if isinstance(entry.outcome, Failed) and entry.state == "failed":
            tell(f"failed {failed_words(entry.outcome)} ({entry.outcome.problem.kind}{tries})")
        else:
            how = "running" if entry.owner in at_work else "cut off"
            tell(f"{how} {entry.name} (since {minute(entry.started)}{tries})")
    for doubt in doubts[:SHOWN]:
        tell(doubt_words(doubt))
    n_more = max(len(wrong) - SHOWN, 0) + max(len(doubts) - SHOWN, 0)
    if n_more:
        tell(f"and {n_more:,} more; --json has all of them")


def print_verified(out: Path, found: Sequence[Verified], *, quiet: bool) -> None:
    """Print which outputs are not as they were written, on stdout."""
    wrong = [one for one in found if one.state != "whole"]
    for one in wrong:
        results().print(printable(f"{one.state:<8} {one.name}: {one.why}"), soft_wrap=True)
    if wrong or not quiet:
        hint = "; the next run of prc batch does the others again" if wrong else ""
        told = f"{out}: {len(found) - len(wrong):,} of {count_of(len(found), 'output')} whole{hint}"
        results().print(printable(told), soft_wrap=True)


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
        f", {'would forget' if dry_run else 'forgot'} {count_of(len(found.forgotten), 'input')}"
        if found.forgotten
        else ""
    )
    results().print(f"{verb} {count_of(len(found.files), 'file')} ({size_of(found.n_bytes)}){forgotten}")
