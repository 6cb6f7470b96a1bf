"""``prc objects``: lists stems, poles, cars and curbs as they pass.

The input is classified on the way. Runs of shots of one class in a line are joined to objects across lines; an object
is told when it has passed. Memory holds the objects in view.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory

from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import atomic_output, check_output, file_state, remove_stale
from prc_cli.core.findings import Finding, Verdict, accept, doubts, refuse
from prc_cli.core.stream import LabelledBlock, ScanBlock, ScanStream
from prc_cli.formats import check_input
from prc_cli.formats.writing.record import RunRecord, record_path
from prc_cli.formats.writing.stream_writer import StreamItem
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import Counts, Progress, label_blocks, run_record, usual_labels
from prc_cli.jobs.convert import check_unchanged, open_items
from prc_cli.jobs.objects.grow import RULES, Grower, Rule, Thing
from prc_cli.jobs.objects.runs import runs_of
from prc_cli.jobs.objects.write import check_suffix, open_things
from prc_cli.jobs.progress import advance
from prc_cli.streams.beams import with_beams
from prc_cli.streams.evidence.result import ResultWatch
from prc_cli.streams.evidence.watch import EvidenceStream, watched

KINDS: tuple[str, ...] = tuple(RULES)
"""Classes that are objects, where the method tells them."""


@dataclass(frozen=True, slots=True)
class ObjectsSummary:
    """Summary of a list of objects."""

    record: RunRecord
    """Provenance, as stored beside the output."""
    counts: Counts
    n_objects: dict[str, int]
    """By kind."""
    findings: tuple[Finding, ...] = ()

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """Findings that the user has to look at."""
        return doubts(self.findings)


def rules_for(config: RunConfig, kinds: tuple[str, ...] = ()) -> dict[Label, Rule]:
    """Return the rule of every class that is an object and that the method may give.

    Raises
    ------
    ConfigError
        When a kind is unknown, or the method gives none.

    Examples
    --------
    >>> [label.name for label in rules_for(RunConfig.model_validate({"prc": {"environment": "forest"}}))]
    ['STEM']
    """
    for kind in kinds:
        if kind not in KINDS:
            where = "--kind"
            raise ConfigError(where, f"found {kind!r}, expected one of: {', '.join(KINDS)}")
    labels = {label.name.lower(): label for label in config.classifier.method().gives}
    found = {labels[kind]: rule for kind, rule in RULES.items() if kind in labels and (not kinds or kind in kinds)}
    if not found:
        problem = f"found {config.method}, which tells none of: {', '.join(kinds or KINDS)}"
        raise ConfigError("method", problem, "give --preset fused, fused-forest or street-scan")
    return found


def find_objects(
    source: Path | str,
    output: Path | str | None = None,
    config: LoadedConfig | RunConfig | None = None,
    *,
    kinds: tuple[str, ...] = (),
    each: Callable[[Thing], None] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ObjectsSummary:
    """Classify a file and list its objects; the output is complete or absent.

    Parameters
    ----------
    source : path
        Any readable input whose beam directions are known.
    output : path, optional
        ``.csv``, ``.geojson`` or ``.parquet``.
    config : LoadedConfig or RunConfig, optional
        Default: the method that labels the input best.
    kinds : tuple of str
        Some of :data:`KINDS`; default: all that the method tells.
    each : callable, optional
        Called with every object as soon as it has passed.
    overwrite : bool
        Replace an existing output.
    progress : callable, optional
        Called with the number of lines just finished.

    Raises
    ------
    InputError, EvidenceError, OutputError, ConfigError
        As :func:`prc_cli.jobs.classify.classify`; nothing is left behind.
    """
    source = Path(source)
    loaded = config if isinstance(config, LoadedConfig) else LoadedConfig(config or RunConfig())
    out = None if output is None else Path(output)
    trajectory = loaded.trajectory
    inputs = (source, *loaded.files, *([] if trajectory is None else [trajectory]))
    check_input(source)
    if out is not None:
        check_suffix(out)
        for path in (out, record_path(out)):
            check_output(path, overwrite=overwrite, inputs=inputs)
            remove_stale(path)
    loaded = decide(source, loaded)
    before = file_state(source)
    with ExitStack() as stack:
        put = None if out is None else stack.enter_context(open_things(out))
        run = _Run(source, loaded, rules_for(loaded.config, kinds))
        # coordinates of the records wait beside the output, or where there is room for temporary files
        folder = out or Path(stack.enter_context(TemporaryDirectory(prefix="prc-objects-"))) / "objects.csv"
        for thing in run.things(folder, progress):
            for call in (put, each):
                if call is not None:
                    call(thing)
        check_unchanged(source, before)
        summary = run.summary()
        if out is not None:
            beside = stack.enter_context(atomic_output(record_path(out)))
            beside.write_bytes(summary.record.to_json())
    return summary


class _Run:
    """One call of :func:`find_objects`."""

    def __init__(self, source: Path, loaded: LoadedConfig, rules: dict[Label, Rule]) -> None:
        self._source, self._loaded, self._rules = source, loaded, rules
        self._labelled: dict[int, LabelledBlock] = {}
        self._growers: dict[int, Grower] = {}
        self._counts, self._n = Counts.none(), Counter[str]()
        self._watch: EvidenceStream | None = None
        self._result: ResultWatch | None = None
        self._found: tuple[Finding, ...] = ()

    def things(self, output: Path, progress: Progress | None) -> Iterator[Thing]:
        """Classify, and yield the objects as they end."""
        with open_items(self._source, output, self._loaded, blocks_of=self._blocks, codes=False) as opened:
            for item in opened.items:
                for thing in self._add(item):
                    yield self._numbered(thing)
                advance(progress, item.block, opened.info, self._loaded.config.input.window)
            for _, grower in sorted(self._growers.items()):
                for thing in grower.finish():
                    yield self._numbered(thing)
        assert self._watch is not None
        assert self._result is not None
        accepted = self._loaded.config.input.accept_doubts or ()
        self._found = (*self._watch.findings(), *accept(self._result.findings(), accepted))
        refuse(str(self._source), self._found)

    def summary(self) -> ObjectsSummary:
        """Return the summary of a finished run."""
        assert self._watch is not None
        told = tuple(finding.notice() for finding in self._found if finding.verdict is not Verdict.FINE)
        record = run_record(self._watch.info, self._counts, self._loaded)
        record = replace(record, notices=(*record.notices, *told))
        kinds = (label.name.lower() for label in self._rules)
        return ObjectsSummary(record, self._counts, {kind: self._n[kind] for kind in kinds}, self._found)

    def _blocks(self, stream: ScanStream) -> Iterator[ScanBlock]:
        """Yield the blocks of a stream once they are labelled."""
        config = self._loaded.config
        method = config.classifier.method()
        first = next(stream.blocks(), None)
        # coordinates that come with the directions of a leaning plane are not those of the input
        is_own = first is not None and first.xyz_m is not None
        stream = with_beams(stream, config.input, from_ground=True)
        self._result = ResultWatch(usual_labels(config, stream.info))
        self._watch = watched(stream, config.input, most_noise_m=method.needs.most_noise_m)
        wanted = config.output.confidence
        for item in label_blocks(self._watch.blocks(), config.classifier, stages=True, confidence=wanted):
            self._counts = self._counts.add(item)
            self._result.see(item)
            block = item.block if is_own else replace(item.block, xyz_m=None)
            self._labelled[id(block)] = item
            yield block

    def _add(self, item: StreamItem) -> Iterator[Thing]:
        block = item.block
        labelled = self._labelled.pop(id(block))
        if labelled.block.beam_rad is None:
            raise InputError(str(self._source), "no beam angles, expected those of every column", "see prc info")
        grower = self._growers.setdefault(block.scanner, Grower(block.scanner, self._rules))
        runs = runs_of(labelled, tuple(self._rules), item.registered_m)
        for line, of_line in groupby(runs, attrgetter("line")):
            yield from grower.add(of_line, line)
        yield from grower.add((), block.first_line + block.n_lines)

    def _numbered(self, thing: Thing) -> Thing:
        number = sum(self._n.values())
        self._n[thing.kind] += 1
        return replace(thing, id=number)


__all__ = ["KINDS", "ObjectsSummary", "Thing", "find_objects"]
