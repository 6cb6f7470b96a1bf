"""Plan of a batch run: what to do with every file, and the time and memory it will take."""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Literal, TypeAlias

from prc_cli.config import (
    RunConfig,
)
from prc_cli.core.errors import ConfigError, OutputError, OutputExistsError, PrcError
from prc_cli.core.files import suffix_of
from prc_cli.core.findings import accepted_doubt_of
from prc_cli.core.version import __version__
from prc_cli.formats.writing.record import fingerprint
from prc_cli.jobs.batch.configs import BatchConfig
from prc_cli.jobs.batch.discovery import InputFile, LeftOut, discover
from prc_cli.jobs.batch.journal import Entry
from prc_cli.jobs.batch.outcomes import (
    Done,
    Failed,
    InputPrint,
    Problem,
    is_whole,
)
from prc_cli.jobs.batch.types import BatchSettings, Task
from prc_cli.jobs.drive import is_of_drive, output_name
from prc_cli.streams.evidence.watch import accepted_by

Reason: TypeAlias = Literal[
    "new",
    "unfinished",
    "failed before",
    "changed input",
    "changed config",
    "changed version",
    "output missing",
    "changed output",
    "changed drive",
]
"""Why a file is to be classified."""

BEGIN_S = 2.0
"""Time that workers take to start and to load the compiled loops [s]."""


# -- the plan --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Planned:
    """A file to classify."""

    task: Task
    reason: Reason
    size: int
    """Size of the input [bytes]."""
    keeps: bool = False
    """Whether the existing output is changed or damaged, so that it is moved away."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the files that are classified together, with its name."""
        return self.task.drive or (self.task.name,)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimated time and memory of a plan."""

    seconds: float | None
    """Wall time [s]; None if nothing is known about any format in the plan."""
    peak_mib: float | None
    """Memory of all workers together [MiB]; None if unknown."""
    sources: tuple[str, ...]
    """Source of the figures, one sentence per format."""
    n_unknown: int
    """Number of files of unknown formats, which are not in the figures."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of a run."""

    todo: tuple[Planned, ...]
    """Files to classify, sorted by name; files of one drive together."""
    done: tuple[str, ...] = ()
    """Names of files that are already done with the same input, configuration and version."""
    confirmed: tuple[Done, ...] = ()
    """Done files with a new time but the same content; their names are also in ``done``."""
    refused: tuple[Failed, ...] = ()
    """Files that cannot be started."""
    left_out: tuple[LeftOut, ...] = ()
    """Files and folders in the archive that prc does not read."""
    n_beyond_limit: int = 0
    """Number of files left for another run by ``--limit``."""
    n_not_selected: int = 0
    """Number of inputs excluded by patterns, times or the shard."""
    archive: frozenset[str] = frozenset()
    """Names of all inputs, selected or not: their state decides the exit code."""

    @property
    def n_items(self) -> int:
        """Number of drives, and of files by themselves, to classify."""
        return len({item.names for item in self.todo})

    @property
    def n_bytes(self) -> int:
        """Size of the inputs to classify [bytes]."""
        return sum(item.size for item in self.todo)

    @property
    def n_found(self) -> int:
        """Number of inputs of this run, done or not."""
        known = len(self.done) + len(self.refused)
        return len(self.todo) + known + self.n_beyond_limit


# -- decisions -------------------------------------------------------------------------------------


def plan_archive(settings: BatchSettings, config: BatchConfig, known: Mapping[str, Entry]) -> Plan:
    """List the inputs of an archive, and decide what to do with every one."""
    archive = discover(settings)
    plan = make_plan(settings, archive.files, config, known)
    return replace(
        plan,
        left_out=archive.left_out,
        n_not_selected=archive.n_not_selected,
        archive=archive.older.union(file.name for file in archive.files),
    )


def make_plan(
    settings: BatchSettings,
    files: Sequence[InputFile],
    config: BatchConfig,
    known: Mapping[str, Entry],
) -> Plan:
    """Decide what to do with every file; files of one drive are classified together."""
    drives = [list(drive) for _, drive in groupby(files, key=lambda file: file.drive or file.name)]
    if settings.only_failed:
        drives = [
            drive
            for drive in drives
            if any(file.name in known and known[file.name].state != "done" for file in drive)
        ]
    names = {file.name: output_name(file.name, settings.to) for drive in drives for file in drive}
    twice = collisions(names.values())
    limit = sum(map(len, drives)) if settings.limit is None else settings.limit
    todo: list[Planned] = []
    done: list[str] = []
    confirmed: list[Done] = []
    refused: list[Failed] = []
    n_beyond_limit = 0
    for drive in drives:
        try:
            tasks = list(_tasks(drive, names, twice, config, settings))
            decisions = [
                _decide(file, task, known.get(file.name), settings)
                for file, task in zip(drive, tasks, strict=True)
            ]
        except (PrcError, OSError) as error:
            for file in drive:
                input_print = InputPrint(file.size, file.mtime_ns, None)
                refused.append(Failed(file.name, input_print, 0.0, Problem.of(error)))
            continue
        due = _due_of_drive(drive, tasks, decisions)
        if len(due) + len(todo) > limit and (todo or len(drive) == 1):
            n_beyond_limit += len(due)
        else:
            todo += due
        if due:
            continue
        for task, outcome in zip(tasks, decisions, strict=True):
            done.append(task.name)
            if isinstance(outcome, Done):
                confirmed.append(outcome)
    return Plan(
        tuple(todo),
        tuple(done),
        tuple(confirmed),
        tuple(refused),
        n_beyond_limit=n_beyond_limit,
    )


def collisions(names: Iterable[str]) -> frozenset[str]:
    """Return the outputs that more than one input would write, ignoring upper and lower case.

    >>> sorted(collisions(["a.las", "b.las", "A.LAS"]))
    ['A.LAS', 'a.las']
    """
    names = list(names)
    counts = Counter(name.casefold() for name in names)
    return frozenset(name for name in names if counts[name.casefold()] > 1)


def _tasks(
    drive: Sequence[InputFile],
    names: Mapping[str, str],
    twice: Collection[str],
    config: BatchConfig,
    settings: BatchSettings,
) -> Iterator[Task]:
    """Yield the tasks of the files of a drive, which must have one configuration."""
    drive_names = tuple(file.name for file in drive) if len(drive) > 1 else ()
    first = ""
    for file in drive:
        output = settings.out / names[file.name]
        if names[file.name] in twice:
            problem = (
                "two inputs would write this output "
                "(upper and lower case may be the same on another disk)"
            )
            raise OutputExistsError(str(output), problem, "rename one of them, or --exclude it")
        loaded, digest = config.of(file.name, file.path)
        first = first or digest
        if digest != first:
            problem = (
                f"has another configuration than {drive[0].name}, "
                "expected one for all files of a drive"
            )
            hint = "look at the tables [[override]] and at the name of the trajectory"
            raise ConfigError(file.name, problem, hint)
        yield Task(
            file.name, file.path, output.absolute(), loaded, digest, settings.overwrite, drive_names
        )


def _due_of_drive(
    drive: Sequence[InputFile], tasks: Sequence[Task], decisions: Sequence[Planned | Done | None]
) -> list[Planned]:
    # if one file of a drive is to be classified, all are
    if not any(isinstance(decision, Planned) for decision in decisions):
        return []
    due = []
    for file, task, decision in zip(drive, tasks, decisions, strict=True):
        if isinstance(decision, Planned):
            due.append(decision)
        else:
            due.append(Planned(replace(task, overwrite=True), "changed drive", file.size))
    return due


def _decide(
    file: InputFile,
    task: Task,
    entry: Entry | None,
    settings: BatchSettings,
) -> Planned | Done | None:
    """Return the plan for a file; or the outcome to confirm; or None if it is done."""
    written = _stat(task.output)
    if entry is None or not entry.owns_output:
        if written is not None and not settings.overwrite:
            problem = "exists already, and no journal knows it"
            raise OutputExistsError(str(task.output), problem, "move it away, or --overwrite")
        return Planned(task, "new" if entry is None else "failed before", file.size)
    reason, confirmed = _compare(file, task, entry, written, settings)
    if reason is None:
        return confirmed
    if written is not None and not settings.overwrite and _has_other_source(file, entry):
        problem = f"was made of {entry.source}, not of {file.path}, which is another file"
        raise OutputError(
            str(task.output), problem, "choose another OUT for this archive, or add --overwrite"
        )
    keeps = reason == "changed output"
    if (
        written is not None
        and not keeps
        and entry.state == "done"
        and isinstance(entry.outcome, Done)
    ):
        keeps = _is_changed(task.output, written, entry.outcome, settings)
    return Planned(
        replace(task, overwrite=True), reason, file.size, keeps and not settings.overwrite
    )


def _has_other_source(file: InputFile, entry: Entry) -> bool:
    """Check whether an output was made of another file, as of another archive.

    A copy elsewhere with the same content is the same file.
    """
    if not entry.source or entry.source == os.path.realpath(file.path):
        return False
    before = None if entry.outcome is None else entry.outcome.input
    if before is None or before.size != file.size:
        return True
    return before.mtime_ns != file.mtime_ns and before.sha256 != fingerprint(file.path).sha256


def _compare(
    file: InputFile,
    task: Task,
    entry: Entry,
    written: os.stat_result | None,
    settings: BatchSettings,
) -> tuple[Reason | None, Done | None]:
    """Return why a file in the journal is to be done again; or None and the outcome to record."""
    before = entry.outcome
    if entry.state == "running" or (entry.state == "done" and not isinstance(before, Done)):
        return "unfinished", None
    if not isinstance(before, Done) or entry.state == "failed":
        return "failed before", None
    if entry.version != __version__:
        return "changed version", None
    if entry.config_sha256 != task.config_sha256:
        return "changed config", None
    if _accepts_other_doubts(before, task.config.config):
        return "changed config", None
    if not is_of_drive(before.notices, task.drive_files):
        return "changed drive", None
    if file.size != before.input.size:
        return "changed input", None
    if written is None:
        return "output missing", None
    if (file.mtime_ns != before.input.mtime_ns or settings.verify) and (
        fingerprint(file.path).sha256 != before.input.sha256
    ):
        return "changed input", None
    if _is_changed(task.output, written, before, settings):
        return "changed output", None
    confirmed = replace(
        before,
        input=replace(before.input, mtime_ns=file.mtime_ns),
        output_mtime_ns=written.st_mtime_ns,
    )
    return None, None if confirmed == before else confirmed


def _accepts_other_doubts(done: Done, config: RunConfig) -> bool:
    """Check whether the configuration now accepts a doubt of the output, or no longer does."""
    now = set(accepted_by(config.input))
    doubts = {doubt.check for doubt in done.doubts}
    then = {check for notice in done.notices if (check := accepted_doubt_of(notice)) is not None}
    return bool(doubts & now) or not then <= now


def _stat(output: Path) -> os.stat_result | None:
    # follows a link, unless it is broken
    with contextlib.suppress(OSError):
        return output.stat()
    try:
        return output.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _is_changed(
    output: Path,
    written: os.stat_result,
    before: Done,
    settings: BatchSettings,
) -> bool:
    # by size and time; by content if only the time differs
    if (
        written.st_size == before.output_size
        and written.st_mtime_ns == before.output_mtime_ns
        and not settings.verify
    ):
        return False
    return not is_whole(output, written, before)


# -- estimates -------------------------------------------------------------------------------------


def estimate(todo: Sequence[Planned], known: Mapping[str, Entry], jobs: int) -> Estimate:
    """Estimate time and memory of a plan from earlier files of the archive.

    Files of the same configuration are preferred.
    """
    configs = {item.task.config_sha256 for item in todo}
    sizes: dict[str, list[int]] = {}
    for item in todo:
        sizes.setdefault(suffix_of(item.task.source), []).append(item.size)
    seconds: list[float] = []
    peaks: list[float] = []
    sources = []
    for suffix, sizes_of_suffix in sorted(sizes.items()):
        ended = [
            (entry.config_sha256 in configs, entry.outcome)
            for name, entry in known.items()
            if isinstance(entry.outcome, Done)
            and suffix_of(Path(name)) == suffix
            and entry.outcome.seconds > 0
        ]
        same = [done for is_wanted, done in ended if is_wanted]
        used = same or [done for _, done in ended]
        if not used:
            sources.append(f"{suffix.removeprefix('.')}: nothing known")
            continue
        source = f"from {len(used)} earlier file{'s' * (len(used) != 1)} of this archive"
        if not same:
            source += ", of another configuration"
        sources.append(f"{suffix.removeprefix('.')}: {source}")
        n_bytes = max(1, sum(done.input.size for done in used))
        rate = sum(done.seconds for done in used) / n_bytes
        seconds += [rate * size for size in sizes_of_suffix]
        peaks += [max(done.peak_mib or 0.0 for done in used)] * len(sizes_of_suffix)
    # the longest file may take longer than its share
    work_s = max(sum(seconds) / max(1, jobs), max(seconds, default=0.0))
    return Estimate(
        seconds=BEGIN_S * bool(seconds) + work_s if seconds or not todo else None,
        peak_mib=sum(sorted(peaks)[-max(1, jobs) :]) or None,
        sources=tuple(sources),
        n_unknown=len(todo) - len(seconds),
    )
