"""Plan of a batch run: what to do with every file, and the time and memory it will take."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

from prc_cli.config import (
    LoadedConfig,
    RunConfig,
    from_folder,
    from_layers,
    preset_table,
    refuse_window,
)
from prc_cli.core.config import read_toml
from prc_cli.core.errors import ConfigError, InputError, OutputError, OutputExistsError, PrcError
from prc_cli.core.files import is_same, parts_of, suffix_of
from prc_cli.core.findings import accepted_doubt_of
from prc_cli.core.version import __version__
from prc_cli.formats.writing.record import RunRecord, fingerprint, read_record, record_path
from prc_cli.jobs.batch.discovery import Found, Patterns, collisions
from prc_cli.jobs.batch.types import (
    BatchSettings,
    ConfigLayers,
    Done,
    Entry,
    Failed,
    InputPrint,
    LeftOut,
    Problem,
    Task,
    doubts_of,
)
from prc_cli.jobs.choice import possible_configs
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

TRAJECTORY = "trajectory:"
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
BEGIN_S = 2.0
"""Time that workers take to start and to load the compiled loops [s]."""


# -- what a plan is ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Planned:
    """A file to classify."""

    task: Task
    reason: Reason
    size: int
    """Size of the input [bytes]."""
    keeps: bool = False
    """Whether the output that is there now is damaged, or somebody else's work, and is to be kept aside."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the files that are done together with it, and its own."""
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
    """Number of files that are not in the figures, because nothing is known about their format."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of a run."""

    todo: tuple[Planned, ...]
    """Files to classify, sorted by name; those of a drive together."""
    done: tuple[str, ...] = ()
    """Names of files that are already done with the same input, configuration and program version."""
    adopted: tuple[tuple[Task, Done], ...] = ()
    """Outputs in no journal whose run record equals the one that would be written."""
    confirmed: tuple[Done, ...] = ()
    """Done files whose input has a new time but the same content.

    Their names are also in ``done``.
    """
    refused: tuple[Failed, ...] = ()
    """Files that cannot be started."""
    left_out: tuple[LeftOut, ...] = ()
    """Files and folders in the archive that no run takes."""
    n_beyond_limit: int = 0
    """Number of files left for another run by ``--limit``."""
    n_not_selected: int = 0
    """Number of inputs excluded by patterns, times or the shard."""
    archive: frozenset[str] = frozenset()
    """Names of all inputs, also of those that this run does not look at.

    Their state decides the exit code.
    """

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
        known = len(self.done) + len(self.adopted) + len(self.refused)
        return len(self.todo) + known + self.n_beyond_limit


# -- configuration of every file --------------------------------------------------------------------------------------


class BatchConfig:
    """The configuration of every file of an archive.

    The TOML file may contain ``[[override]]`` tables: ``match`` selects files by patterns
    (:class:`~prc_cli.jobs.batch.discovery.Patterns`), ``preset`` replaces the preset of the TOML
    file, and all other keys replace its keys. If several tables match, the last one wins. Options
    of the command line override them all.

    The name of a trajectory may contain placeholders: ``{name}`` and ``{stem}`` of the input, its
    ``{folder}``, and ``{subfolder}``, the folder relative to the archive.
    """

    def __init__(self, layers: ConfigLayers) -> None:
        self._layers = layers
        self._where = str(layers.path)
        table = {} if layers.path is None else read_toml(layers.path)
        overrides = table.pop("override", [])
        self._preset = table.pop("preset", None)
        self._table = self._placed(table)
        if not isinstance(overrides, list) or not all(isinstance(item, dict) for item in overrides):
            raise ConfigError(
                self._where, "override: expected tables, each beginning with [[override]]"
            )
        self._overrides = [self._override(number, item) for number, item in enumerate(overrides, 1)]
        self._built: dict[tuple[int, ...], LoadedConfig] = {}
        self._prints: dict[Path, str] = {}
        for number in range(len(self._overrides)):
            self._build((number,))
        self.base = self._build(())
        """The configuration without overrides."""
        self.base_sha256 = config_hash(self.base.config, None)

    def _override(self, number: int, table: dict[str, Any]) -> _Override:
        where = f"{self._where}: override {number}"
        rest = dict(table)
        preset = rest.pop("preset", None)
        match = rest.pop("match", None)
        patterns = [match] if isinstance(match, str) else match
        if (
            not isinstance(patterns, list)
            or not patterns
            or not all(isinstance(item, str) for item in patterns)
        ):
            found = "" if match is None else f", found {match!r}"
            problem = f"match: expected a pattern or a list of patterns{found}"
            raise ConfigError(where, problem, 'for example match = "night/*.laz"')
        return _Override(where, Patterns(patterns), preset, self._placed(rest))

    def _placed(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Resolve a trajectory relative to the folder of the configuration file, unless it begins with ``{folder}``."""
        rule = table["input"].get("range") if isinstance(table.get("input"), Mapping) else None
        if self._layers.path is None or (
            isinstance(rule, str) and rule.startswith(f"{TRAJECTORY}{{folder}}")
        ):
            return table
        return from_folder(table, self._layers.path.parent)

    def _build(self, matching: tuple[int, ...]) -> LoadedConfig:
        if matching not in self._built:
            given = self._layers
            chosen = [self._overrides[number] for number in matching]
            named = [item.preset for item in chosen if item.preset is not None]
            preset = (
                given.preset if given.preset is not None else (named[-1] if named else self._preset)
            )
            layers: list[tuple[str, Mapping[str, Any]]] = []
            if preset is not None:
                layers.append((f"preset {preset}", preset_table(preset)))
            if given.path is not None:
                layers.append((self._where, self._table))
            layers.extend((item.where, item.table) for item in chosen)
            if given.options:
                layers.append(("option", given.options))
            files = (*([] if given.path is None else [given.path]), *given.files)
            self._built[matching] = from_layers(layers, files)
            refuse_window(self._built[matching].config, "prc batch")
        return self._built[matching]

    def of(self, name: str, path: Path) -> tuple[LoadedConfig, str]:
        """Return the configuration of a file and its hash."""
        loaded = self._build(
            tuple(i for i, item in enumerate(self._overrides) if item.patterns.match(name))
        )
        rule = loaded.config.input.range
        if not rule.startswith(TRAJECTORY):
            is_base = loaded.config is self.base.config
            return loaded, self.base_sha256 if is_base else config_hash(loaded.config, None)
        filled = TRAJECTORY + _fill(rule.removeprefix(TRAJECTORY), name, path)
        if filled != rule:
            inputs = loaded.config.input.model_copy(update={"range": filled})
            loaded = replace(loaded, config=loaded.config.model_copy(update={"input": inputs}))
        assert loaded.trajectory is not None
        return loaded, config_hash(loaded.config, self._print(loaded.trajectory))

    def _print(self, path: Path) -> str:
        """Return the hash of a trajectory, computed once per run."""
        if path not in self._prints:
            if path.exists() and not path.is_file():
                raise InputError(
                    str(path), "not a regular file, expected a trajectory", "check [input] range"
                )
            try:
                self._prints[path] = fingerprint(path).sha256 or ""
            except (InputError, OSError) as error:
                why = error.problem if isinstance(error, InputError) else error.strerror
                problem = f"the trajectory cannot be read ({why})"
                raise InputError(
                    str(path), problem, "check [input] range and its placeholders"
                ) from error
        return self._prints[path]


class _Override(NamedTuple):
    where: str
    patterns: Patterns
    preset: Any
    table: Mapping[str, Any]


def _fill(template: str, name: str, path: Path) -> str:
    """Replace the placeholders of a template by the parts of a file's name, without escaping any character."""
    stem = path.name[: len(path.name) - len(suffix_of(path))]
    subfolder = name.rpartition("/")[0] or "."
    values = {"name": path.name, "stem": stem, "folder": str(path.parent), "subfolder": subfolder}

    def value(found: re.Match[str]) -> str:
        if found[1] not in values:
            known = ", ".join(f"{{{key}}}" for key in values)
            raise ConfigError(
                "input.range", f"unknown placeholder {found[0]!r}, expected one of: {known}"
            )
        return values[found[1]]

    return _PLACEHOLDER.sub(value, template)


def config_hash(config: RunConfig, trajectory_sha256: str | None) -> str:
    """Return the hash of a configuration and its trajectory, without folders, other methods, accepted doubts."""
    table = config.of_run()
    table["input"].pop("accept_doubts", None)
    if trajectory_sha256 is not None:
        table["input"]["range"] = f"{TRAJECTORY}{trajectory_sha256}"
    return sha256(json.dumps(table, sort_keys=True, ensure_ascii=True).encode("ascii")).hexdigest()


# -- decisions --------------------------------------------------------------------------------------------------------


def make_plan(
    settings: BatchSettings,
    files: Sequence[Found],
    config: BatchConfig,
    known: Mapping[str, Entry],
) -> Plan:
    """Decide what to do with every file; the files of a drive are done together or not at all."""
    drives = [list(some) for _, some in groupby(files, key=lambda item: item.drive or item.name)]
    if settings.only_failed:
        drives = [
            some
            for some in drives
            if any(item.name in known and known[item.name].state != "done" for item in some)
        ]
    names = {item.name: output_name(item.name, settings.to) for some in drives for item in some}
    twice = collisions(names.values())
    limit = sum(map(len, drives)) if settings.limit is None else settings.limit
    todo: list[Planned] = []
    done: list[str] = []
    adopted: list[tuple[Task, Done]] = []
    confirmed: list[Done] = []
    refused: list[Failed] = []
    n_beyond_limit = 0
    for some in drives:
        try:
            tasks = list(_tasks(some, names, twice, config, settings))
            found = [
                _decide(item, task, known.get(item.name), settings)
                for item, task in zip(some, tasks, strict=True)
            ]
        except (PrcError, OSError) as error:
            for item in some:
                seen = InputPrint(item.size, item.mtime_ns, None)
                refused.append(Failed(item.name, seen, 0.0, Problem.of(error)))
            continue
        due = _together(some, tasks, found)
        if len(due) + len(todo) > limit and (todo or len(some) == 1):
            n_beyond_limit += len(due)
        else:
            todo += due
        if due:
            continue
        for task, outcome in zip(tasks, found, strict=True):
            entry = known.get(task.name)
            if isinstance(outcome, Done) and (entry is None or not entry.owns_output):
                adopted.append((task, outcome))
            else:
                done.append(task.name)
                confirmed += [outcome] if isinstance(outcome, Done) else []
    return Plan(
        tuple(todo),
        tuple(done),
        tuple(adopted),
        tuple(confirmed),
        tuple(refused),
        n_beyond_limit=n_beyond_limit,
    )


def _tasks(
    some: Sequence[Found],
    names: Mapping[str, str],
    twice: Collection[str],
    config: BatchConfig,
    settings: BatchSettings,
) -> Iterator[Task]:
    """Yield the tasks of the files of a drive, or of one alone.

    Refuse another configuration than the first one's.
    """
    drive = tuple(one.name for one in some) if len(some) > 1 else ()
    first = ""
    for item in some:
        output = settings.out / names[item.name]
        if names[item.name] in twice:
            problem = "two inputs would write this output (upper and lower case may be the same on another disk)"
            raise OutputExistsError(str(output), problem, "rename one of them, or --exclude it")
        loaded, digest = config.of(item.name, item.path)
        first = first or digest
        if digest != first:
            problem = f"has another configuration than {some[0].name}, expected one for all files of a drive"
            raise ConfigError(
                item.name,
                problem,
                "look at the tables [[override]] and at the name of the trajectory",
            )
        yield Task(
            item.name, item.path, output.absolute(), loaded, digest, settings.overwrite, drive
        )


def _together(
    some: Sequence[Found], tasks: Sequence[Task], found: Sequence[Planned | Done | None]
) -> list[Planned]:
    """Return what is to be done of a drive: all of it, if one of its files is."""
    if not any(isinstance(one, Planned) for one in found):
        return []
    return [
        one
        if isinstance(one, Planned)
        else Planned(replace(task, overwrite=True), "changed drive", item.size)
        for item, task, one in zip(some, tasks, found, strict=True)
    ]


def _decide(
    item: Found,
    task: Task,
    entry: Entry | None,
    settings: BatchSettings,
) -> Planned | Done | None:
    """Return the plan for a file, the outcome that adopts or confirms its output, or None if it is done."""
    written = _stat(task.output)
    if entry is None or not entry.owns_output:
        if written is not None and not settings.overwrite:
            seen = InputPrint(item.size, item.mtime_ns, None)
            found = outcome_of_record(task, seen, written) if settings.adopt else None
            if found is None:
                raise _foreign(task.output, adopt=settings.adopt)
            if not is_whole(task.output, written, found):
                return Planned(
                    replace(task, overwrite=True), "changed output", item.size, keeps=True
                )
            if _is_accepted_otherwise(found, task.config.config, __version__):
                return Planned(replace(task, overwrite=True), "changed config", item.size)
            return found
        return Planned(task, "new" if entry is None else "failed before", item.size)
    reason, found = _compare(item, task, entry, written, settings)
    if reason is None:
        return found
    if written is not None and not settings.overwrite and _is_of_other(item, entry):
        problem = f"was made of {entry.source}, not of {item.path}, which is another file"
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
        replace(task, overwrite=True), reason, item.size, keeps and not settings.overwrite
    )


def _is_of_other(item: Found, entry: Entry) -> bool:
    """Tell whether an output was made of a file elsewhere with another content.

    Of another archive.
    """
    if not entry.source or entry.source == os.path.realpath(item.path):
        return False
    before = None if entry.outcome is None else entry.outcome.input
    if before is None or before.size != item.size:
        return True
    return before.mtime_ns != item.mtime_ns and before.sha256 != fingerprint(item.path).sha256


def _compare(
    item: Found,
    task: Task,
    entry: Entry,
    written: os.stat_result | None,
    settings: BatchSettings,
) -> tuple[Reason | None, Done | None]:
    """Compare a file with its journal entry.

    Return why it is to be done, or None and the outcome to note.
    """
    before = entry.outcome
    if entry.state == "running" or (entry.state == "done" and not isinstance(before, Done)):
        return "unfinished", None
    if not isinstance(before, Done) or entry.state == "failed":
        return "failed before", None
    if entry.version not in (__version__, *settings.keep_versions):
        return "changed version", None
    # versions may differ in their configuration keys, so hashes are compared only within one
    # version
    if entry.version == __version__ and entry.config_sha256 != task.config_sha256:
        return "changed config", None
    if _is_accepted_otherwise(before, task.config.config, entry.version):
        return "changed config", None
    if not is_of_drive(before.notices, task.drive_files):
        return "changed drive", None
    if item.size != before.input.size:
        return "changed input", None
    if written is None:
        return "output missing", None
    if (item.mtime_ns != before.input.mtime_ns or settings.verify) and (
        fingerprint(item.path).sha256 != before.input.sha256
    ):
        return "changed input", None
    if _is_changed(task.output, written, before, settings):
        return "changed output", None
    times = item.mtime_ns, written.st_mtime_ns
    if times == (before.input.mtime_ns, before.output_mtime_ns):
        return None, None
    return None, replace(
        before, input=replace(before.input, mtime_ns=times[0]), output_mtime_ns=times[1]
    )


def _is_accepted_otherwise(done: Done, config: RunConfig, version: str) -> bool:
    """Tell whether a doubt of an output is accepted now, or one that was accepted then is no more."""
    now = set(accepted_by(config.input))
    standing = {doubt.check for doubt in doubts_of(done)}
    then = {check for notice in done.notices if (check := accepted_doubt_of(notice)) is not None}
    return bool(standing & now) or (version == __version__ and not then <= now)


def _stat(output: Path) -> os.stat_result | None:
    """Return size and time of an output, of a link what it points to.

    Of a link to nothing its own.
    """
    with contextlib.suppress(OSError):
        return output.stat()
    try:
        return output.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _foreign(output: Path, *, adopt: bool) -> OutputExistsError:
    problem = "exists already, and no journal knows it"
    if adopt:
        problem += (
            f"; {record_path(output).name} does not say that it was made of this input like this"
        )
    return OutputExistsError(
        str(output), problem, "move it away, or --overwrite" + ("" if adopt else ", or --adopt")
    )


def _is_changed(
    output: Path,
    written: os.stat_result,
    before: Done,
    settings: BatchSettings,
) -> bool:
    """Tell whether an output is another than was written.

    By size and time, by content where only the time differs.
    """
    if (
        written.st_size == before.output_size
        and written.st_mtime_ns == before.output_mtime_ns
        and not settings.verify
    ):
        return False
    return not is_whole(output, written, before)


# -- outputs that are there already -----------------------------------------------------------------------------------


def outcome_of_record(task: Task, before: InputPrint, written: os.stat_result) -> Done | None:
    """Return the outcome of an output whose record is as it would be written, but for accepted doubts."""
    try:
        record = read_record(task.output)
        trajectory = None if task.config.trajectory is None else fingerprint(task.config.trajectory)
        content = fingerprint(task.source)
        records = [
            RunRecord(config.of_run(), content, "", 1, trajectory=trajectory).as_dict()
            for config in possible_configs(task.config)
        ]
        for one in (record, *records):
            one["config"].get("input", {}).pop("accept_doubts", None)
        keys = ("program", "version", "config", "input", "trajectory")
        wanted = next(
            (one for one in records if all(record[key] == one[key] for key in keys)), None
        )
        if wanted is None or not is_of_drive(record["notices"], task.drive_files):
            return None
        stream = record["stream"]
        missing = ("missing", int(stream["n_missing"]))
        labels = tuple((str(count["name"]), int(count["count"])) for count in record["classes"])
        return Done(
            name=task.name,
            input=InputPrint(before.size, before.mtime_ns, wanted["input"]["sha256"]),
            output_size=int(record["output"]["size"]),
            output_mtime_ns=written.st_mtime_ns,
            seconds=0.0,
            cpu_seconds=0.0,
            peak_mib=None,
            n_lines=int(stream["n_lines"]),
            n_shots=int(stream["n_lines"]) * int(stream["points_per_line"]),
            n_records=int(stream["n_records"] or 0),
            labels=(missing, *labels),
            notices=tuple(str(text) for text in record["notices"]),
            output_name=task.output.name,
            output_sha256=str(record["output"]["sha256"]),
        )
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        RecursionError,
        OverflowError,
    ):
        return None


def is_whole(output: Path, written: os.stat_result, done: Done) -> bool:
    """Tell whether an output has the size and the content that were recorded; reads it."""
    return written.st_size == done.output_size and fingerprint(output).sha256 == done.output_sha256


def remove_unfinished(task: Task) -> bool:
    """Remove an output whose process died before it finished (see :func:`prc_cli.core.files.place`), if it did."""
    found = False
    for path in (record_path(task.output), task.output):
        with contextlib.suppress(OSError):
            for part in tuple(parts_of(path)):
                if is_same(part, path):
                    path.unlink()
                    part.unlink()
                    found = True
    return found


# -- estimates --------------------------------------------------------------------------------------------------------


def estimate(todo: Sequence[Planned], known: Mapping[str, Entry], jobs: int) -> Estimate:
    """Estimate time and memory of a plan from earlier files of the archive, if there are some of its configuration."""
    wanted = {item.task.config_sha256 for item in todo}
    sizes: dict[str, list[int]] = {}
    for item in todo:
        sizes.setdefault(suffix_of(item.task.source), []).append(item.size)
    seconds: list[float] = []
    peaks: list[float] = []
    sources = []
    for suffix, some in sorted(sizes.items()):
        ended = [
            (entry.config_sha256 in wanted, entry.outcome)
            for name, entry in known.items()
            if isinstance(entry.outcome, Done)
            and suffix_of(Path(name)) == suffix
            and entry.outcome.seconds > 0
        ]
        same = [done for is_wanted, done in ended if is_wanted]
        used = same or [done for _, done in ended]
        source = (
            f"from {len(used)} earlier file{'s' * (len(used) != 1)} of this archive"
            if used
            else "nothing known"
        )
        another = ", of another configuration" if used and not same else ""
        sources.append(f"{suffix.removeprefix('.')}: {source}{another}")
        if used:
            rate = sum(done.seconds for done in used) / max(
                1, sum(done.input.size for done in used)
            )
            seconds += [rate * size for size in some]
            peaks += [max(done.peak_mib or 0.0 for done in used)] * len(some)
    # the longest file may take longer than its share
    work_s = max(sum(seconds) / max(1, jobs), max(seconds, default=0.0))
    return Estimate(
        seconds=BEGIN_S * bool(seconds) + work_s if seconds or not todo else None,
        peak_mib=sum(sorted(peaks)[-max(1, jobs) :]) or None,
        sources=tuple(sources),
        n_unknown=len(todo) - len(seconds),
    )
