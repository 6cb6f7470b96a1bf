"""A batch run from lock to summary."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import groupby
from typing import TypeAlias

from prc_cli.core.errors import BusyError, ExitCode, PrcError
from prc_cli.core.files import output_errors
from prc_cli.core.own_file import make_folder
from prc_cli.core.threads import close_items, share_cores
from prc_cli.jobs.batch.configs import BatchConfig
from prc_cli.jobs.batch.discovery import check
from prc_cli.jobs.batch.drift import Alarm, find_alarms
from prc_cli.jobs.batch.engine import Engine, EngineSettings, Event
from prc_cli.jobs.batch.journal import Entry, Journal, read_entries
from prc_cli.jobs.batch.local import LocalEngine
from prc_cli.jobs.batch.lock import Lock
from prc_cli.jobs.batch.outcomes import Done, Doubted, Failed, Outcome, Problem
from prc_cli.jobs.batch.plan import Estimate, Plan, Planned, estimate, plan_archive
from prc_cli.jobs.batch.references import BatchEvaluation, Output, check_reference, evaluate_tree
from prc_cli.jobs.batch.report import BatchSummary, Ended, write_summary
from prc_cli.jobs.batch.types import OWN_FOLDER, BatchSettings, Task
from prc_cli.jobs.drive import output_name

PAUSE_S = 1.0
LONGEST_PAUSE_S = 30.0
"""Pause before files are tried again; it doubles every time [s]."""
ALONE = frozenset({"killed", "memory"})
"""Problems that are less likely if the file is the only one in work."""


@dataclass(frozen=True, slots=True)
class Noted:
    """A message about the run for the operator."""

    text: str


@dataclass(frozen=True, slots=True)
class Ready:
    """The plan is made, and work starts."""

    plan: Plan
    jobs: int
    threads: int


@dataclass(frozen=True, slots=True)
class Again:
    """A file that failed will be tried again in this run."""

    name: str
    problem: Problem


RunEvent: TypeAlias = Ready | Event | Again | Doubted | Alarm | Noted
"""What a listener gets; a :class:`Failed` that is followed by :class:`Again` is not final."""

Listener: TypeAlias = Callable[[RunEvent], None]


def _ignore(event: RunEvent) -> None:
    pass


def plan_batch(settings: BatchSettings) -> tuple[Plan, Estimate]:
    """Return the plan of :func:`run_batch` and its estimate; nothing is written."""
    config = BatchConfig(settings.config)
    folder = settings.out / OWN_FOLDER
    check(settings)
    known = {entry.name: entry for entry in read_entries(folder)} if folder.is_dir() else {}
    plan = plan_archive(settings, config, known)
    return plan, estimate(plan.todo, known, share_cores(settings.jobs, 1, plan.n_items)[0])


def run_batch(
    settings: BatchSettings, engine: Engine | None = None, listener: Listener = _ignore
) -> BatchSummary:
    """Classify every file of an archive that is not done yet."""
    config = BatchConfig(settings.config)
    if settings.reference is not None:
        check_reference(settings.reference)
    check(settings)
    folder = settings.out / OWN_FOLDER
    with Lock(folder, settings.shard) as lock, Journal(folder, settings.shard) as journal:
        known = {entry.name: entry for entry in journal.entries()}
        run = _BatchRun(settings, engine or LocalEngine(), listener, lock, journal)
        return run.execute(plan_archive(settings, config, known), config, known)


class _BatchRun:
    """A run of a batch, which holds the lock of the output folder."""

    def __init__(
        self,
        settings: BatchSettings,
        engine: Engine,
        listener: Listener,
        lock: Lock,
        journal: Journal,
    ) -> None:
        self._settings = settings
        self._engine = engine
        self._listener = listener
        self._lock = lock
        self._journal = journal
        self._owner = str(lock.owner)
        self._notes: list[str] = []
        self._alarms: list[Alarm] = []
        self._outcomes: dict[str, Outcome] = {}
        self._running: set[str] = set()
        self._stopping = False
        self._started = datetime.now(UTC).isoformat(timespec="seconds")
        self._clock = time.monotonic()

    def execute(self, plan: Plan, config: BatchConfig, known: Mapping[str, Entry]) -> BatchSummary:
        run = self._journal.begin_run(self._owner)
        if self._lock.inherited_from is not None:
            self._note(f"took over from a run that died: {self._lock.inherited_from}")
        ended: Ended = "finished"
        evaluation: BatchEvaluation | None = None
        stop: BaseException | None = None
        try:
            self._settle(plan, known)
            self._classify(plan)
            self._lock.check()  # the folder may have been removed, and with it the journal
            self._compare_classes(plan, known)
            evaluation = self._evaluate(plan)
            if self._stopping:
                ended = "stopped"
        except (KeyboardInterrupt, SystemExit) as raised:
            ended = "interrupted"
            stop = raised
            # these files stay "running" in the journal: the next run classifies them
            for name in self._running:
                self._outcomes.pop(name, None)
        except BusyError:  # the journal now belongs to another run
            raise
        except PrcError as error:
            with contextlib.suppress(PrcError):  # the journal itself may not be writable
                self._journal.end_run(error.exit_code)
            raise
        summary = self._summarise(plan, config, run, ended, evaluation)
        code = summary.exit_code if stop is None else getattr(stop, "code", ExitCode.INTERRUPTED)
        totals = {
            "done": len(summary.done),
            "failed": len(summary.failed),
            "doubted": summary.n_doubted,
        }
        self._journal.end_run(code, totals)
        write_summary(summary)
        if summary.evaluation is not None:
            # the modules of the page load slowly
            from prc_cli.jobs.batch.night import write_night

            write_night(summary, self._settings.to)
        if stop is not None:
            raise stop
        return summary

    def _settle(self, plan: Plan, known: Mapping[str, Entry]) -> None:
        """Record in the journal the files that need no work, and report their doubts."""
        due = {item.task.name for item in plan.todo}
        for name in sorted(plan.archive.intersection(known) - due):
            self._doubt(known[name])
        for done in plan.confirmed:
            self._journal.finish(done)
        for failed in plan.refused:
            entry = self._journal.entry(failed.name)
            # a done file stays done: perhaps only its trajectory is missing tonight
            if entry is None or entry.state != "done":
                self._journal.finish(failed)

    def _classify(self, plan: Plan) -> None:
        """Run the files, and repeat files whose problem may pass."""
        jobs, threads = share_cores(self._settings.jobs, self._settings.threads, plan.n_items)
        self._listener(Ready(plan, jobs, threads))
        for failed in plan.refused:
            self._listener(failed)
            self._outcomes[failed.name] = failed
        if plan.refused and self._settings.fail_fast:
            self._stopping = True
        settings = EngineSettings(
            jobs, threads, self._settings.stall_s, self._settings.memory_limit_mib
        )
        self._pass(plan.todo, settings, attempt=0)
        attempt = 1
        while retries := self._to_try_again(plan.todo, attempt):
            together = [planned for planned, is_alone in retries if not is_alone]
            alone = [planned for planned, is_alone in retries if is_alone]
            if together:
                time.sleep(min(LONGEST_PAUSE_S, PAUSE_S * 2 ** (attempt - 1)))
            self._pass(together, settings, attempt)
            self._pass(alone, replace(settings, jobs=1), attempt)
            attempt += 1

    def _to_try_again(self, todo: Sequence[Planned], attempt: int) -> list[tuple[Planned, bool]]:
        # the drives with a file to try again, and whether they must be the only work
        if self._stopping:
            return []
        again = {}
        for item in todo:
            outcome = self._outcomes.get(item.task.name)
            if isinstance(outcome, Failed) and self._is_tried_again(outcome, attempt - 1):
                again[item.names] = outcome.problem.kind in ALONE
        return [(item, again[item.names]) for item in todo if item.names in again]

    def _is_tried_again(self, failed: Failed, attempt: int) -> bool:
        # a file whose worker was killed gets a second attempt in any case: the worker may
        # have renamed its output just before it died, and the next one recognises it
        allowed = max(self._settings.retry, 1 if failed.problem.kind == "killed" else 0)
        return attempt < allowed and failed.problem.may_pass

    def _pass(self, items: Sequence[Planned], settings: EngineSettings, attempt: int) -> None:
        """Run files once; all workers have ended when this returns or raises."""
        if not items or self._stopping:
            return
        settings = replace(settings, jobs=min(settings.jobs, len({item.names for item in items})))
        events = self._engine.run(self._feed(items), settings)
        try:
            for event in events:
                self._listener(event)
                if isinstance(event, Done | Failed):
                    self._end(event, attempt)
        finally:
            close_items(events)

    def _feed(self, items: Iterable[Planned]) -> Iterator[Task]:
        """Yield files and drives; the journal has each of them before a worker writes anything."""
        for _, drive in groupby(items, key=lambda item: item.names):
            self._lock.check()
            if self._stopping:
                return
            tasks = []
            for item in drive:
                is_again = item.task.name in self._outcomes
                if item.keeps and not is_again:
                    self._keep_aside(item.task)
                self._journal.start(item.task, self._owner)
                self._running.add(item.task.name)
                # files of a drive may have been finished before it failed
                may_overwrite = item.task.overwrite or bool(item.task.drive and is_again)
                tasks.append(replace(item.task, overwrite=may_overwrite))
            yield replace(tasks[0], others=tuple(tasks[1:]))

    def _keep_aside(self, task: Task) -> None:
        """Move a changed or damaged output away; of a link, the link."""
        kept = self._settings.out / OWN_FOLDER / "changed" / task.name
        kept = kept.with_name(f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{task.output.name}")
        make_folder(kept.parent)
        with output_errors(kept), contextlib.suppress(FileNotFoundError):
            task.output.rename(kept)
            self._note(
                f"{task.name}: its output was changed or damaged; it is made again, "
                f"and the old one is kept: {kept}"
            )

    def _end(self, outcome: Outcome, attempt: int) -> None:
        self._journal.finish(outcome)
        self._running.discard(outcome.name)
        self._outcomes[outcome.name] = outcome
        if isinstance(outcome, Failed):
            if self._is_tried_again(outcome, attempt):
                self._listener(Again(outcome.name, outcome.problem))
            elif self._settings.fail_fast:
                self._stopping = True
        else:
            self._doubt(outcome)

    def _doubt(self, file: Done | Entry) -> None:
        for doubt in file.doubts:
            self._listener(doubt)

    def _compare_classes(self, plan: Plan, known: Mapping[str, Entry]) -> None:
        """Raise an alarm for every file whose class shares are far from those of earlier runs."""
        if not self._settings.drift:
            return
        tasks = [item.task for item in plan.todo]
        for alarm in find_alarms(tasks, self._outcomes, known.values()):
            self._alarms.append(alarm)
            self._listener(alarm)

    def _evaluate(self, plan: Plan) -> BatchEvaluation | None:
        """Compare all finished outputs of the archive, also of earlier runs, with the reference."""
        settings = self._settings
        if settings.reference is None:
            return None
        names = set(plan.done)
        names |= {name for name, outcome in self._outcomes.items() if isinstance(outcome, Done)}
        self._note(f"{len(names)} outputs are compared with {settings.reference.tree}")
        outputs = []
        for name in sorted(names):
            relative = output_name(name, settings.to)
            outputs.append(Output(name, relative, settings.out / relative, settings.archive / name))
        return evaluate_tree(
            outputs, settings.reference, jobs=share_cores(settings.jobs, 1, len(outputs))[0]
        )

    def _summarise(
        self,
        plan: Plan,
        config: BatchConfig,
        run: str,
        ended: Ended,
        evaluation: BatchEvaluation | None,
    ) -> BatchSummary:
        outcomes = [self._outcomes[name] for name in sorted(self._outcomes)]
        entries = [entry for entry in self._journal.entries() if entry.name in plan.archive]
        before = (
            entry.outcome
            for entry in entries
            if entry.state == "failed" and entry.name not in self._outcomes
        )
        n_ended = sum(item.task.name in self._outcomes for item in plan.todo)
        return BatchSummary(
            run=run,
            archive=self._settings.archive,
            out=self._settings.out,
            started=self._started,
            finished=datetime.now(UTC).isoformat(timespec="seconds"),
            seconds=time.monotonic() - self._clock,
            n_found=plan.n_found,
            n_skipped=len(plan.done),
            done=tuple(item for item in outcomes if isinstance(item, Done)),
            failed=tuple(item for item in outcomes if isinstance(item, Failed)),
            failed_before=tuple(item for item in before if isinstance(item, Failed)),
            n_waiting=plan.n_beyond_limit + len(plan.todo) - n_ended,
            reasons=tuple(Counter(item.reason for item in plan.todo).most_common()),
            alarms=tuple(self._alarms),
            doubts=tuple(doubt for entry in entries for doubt in entry.doubts),
            left_out=plan.left_out,
            notes=tuple(self._notes),
            ended=ended,
            shard=self._settings.shard,
            config_sha256=config.base_sha256,
            evaluation=evaluation,
        )

    def _note(self, text: str) -> None:
        self._notes.append(text)
        self._listener(Noted(text))
