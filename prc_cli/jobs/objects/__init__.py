"""``prc objects``: lists stems, poles, cars and curbs as they pass.

The classes are those of the input where it has some and no method is named, else it is classified
on the way. Runs of shots of one class in a line are joined to objects across lines; an object is
told when it has passed. Memory holds the objects in view.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from itertools import chain, groupby, repeat
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import (
    atomic_output,
    check_unchanged,
    file_state,
    output_errors,
    prepare_outputs,
    whole_set,
)
from prc_cli.core.findings import Doubted, Finding, notices
from prc_cli.core.stream import LabelledBlock, ScanBlock, ScanStream
from prc_cli.core.types import U8
from prc_cli.formats import check_input, open_source
from prc_cli.formats.labels import NAMES
from prc_cli.formats.writing.base import StreamItem
from prc_cli.formats.writing.record import RunRecord, record_path
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import Counts, Judge, Progress, run_record
from prc_cli.jobs.convert import open_items
from prc_cli.jobs.objects.grow import RULES, Grower, Rule, Thing, runs_of
from prc_cli.jobs.progress import advance
from prc_cli.methods.base import Wanted
from prc_cli.streams.beams import with_beams
from prc_cli.streams.evidence.watch import EvidenceStream, watched

COLUMNS = tuple(one.name for one in fields(Thing))
SUFFIXES = (".csv", ".geojson", ".parquet")
ROWS_AT_ONCE = 10_000
"""Rows of a group of a Parquet file."""
_TEXT = ("kind",)
_WHOLE = ("id", "scanner", "first_line", "last_line", "first_column", "last_column", "n_shots")


def check_suffix(path: Path) -> str:
    """Return the suffix of an output, which decides its format."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        problem = f"found suffix {path.suffix!r}, expected one of {', '.join(SUFFIXES)}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    return suffix


@contextmanager
def open_things(path: Path) -> Iterator[Callable[[Thing], None]]:
    """Open an output; call what is yielded with every object."""
    writer = {".csv": _csv, ".geojson": _geojson, ".parquet": _parquet}[check_suffix(path)]
    with atomic_output(path) as temporary, output_errors(path), writer(temporary) as put:
        yield put


def plain(value: Any) -> Any:
    """Return a value for a text: metres and degrees to a tenth of a millimetre, NaN as None."""
    if isinstance(value, float):
        return None if math.isnan(value) else round(value, 4)
    return value


@contextmanager
def _csv(path: Path) -> Iterator[Callable[[Thing], None]]:
    with path.open("w", encoding="utf-8", newline="\n") as handle:
        handle.write(",".join(COLUMNS) + "\n")

        def put(thing: Thing) -> None:
            values = (plain(getattr(thing, name)) for name in COLUMNS)
            handle.write(",".join("" if value is None else str(value) for value in values) + "\n")

        yield put


@contextmanager
def _geojson(path: Path) -> Iterator[Callable[[Thing], None]]:
    with path.open("w", encoding="utf-8", newline="\n") as handle:
        handle.write('{"type": "FeatureCollection", "features": [')
        comma = chain([""], repeat(","))

        def put(thing: Thing) -> None:
            values = {name: plain(getattr(thing, name)) for name in COLUMNS}
            x, y, z = (values.pop(axis) for axis in ("x", "y", "z"))
            place = None if x is None else {"type": "Point", "coordinates": [x, y, z]}
            feature = {"type": "Feature", "geometry": place, "properties": values}
            handle.write(f"{next(comma)}\n{json.dumps(feature)}")

        yield put
        handle.write("\n]}\n")


@contextmanager
def _parquet(path: Path) -> Iterator[Callable[[Thing], None]]:
    # imported here: only this format needs it
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {**dict.fromkeys(_TEXT, pa.string()), **dict.fromkeys(_WHOLE, pa.int64())}
    schema = pa.schema([(name, kinds.get(name, pa.float64())) for name in COLUMNS])
    rows: list[dict[str, Any]] = []
    with pq.ParquetWriter(path, schema) as writer:

        def put(thing: Thing) -> None:
            rows.append({name: plain(getattr(thing, name)) for name in COLUMNS})
            if len(rows) == ROWS_AT_ONCE:
                flush()

        def flush() -> None:
            writer.write_table(pa.Table.from_pylist(rows, schema))
            rows.clear()

        yield put
        if rows:
            flush()


KINDS: tuple[str, ...] = tuple(RULES)
"""Classes that are objects, where the method tells them."""


@dataclass(frozen=True, slots=True, repr=False)
class ObjectsSummary(Doubted):
    """Summary of a list of objects."""

    record: RunRecord
    """Provenance, as stored beside the output."""
    counts: Counts
    n_objects: dict[str, int]
    """By kind."""
    findings: tuple[Finding, ...] = ()


def rules_for(config: RunConfig, kinds: tuple[str, ...] = ()) -> dict[Label, Rule]:
    """Return the rule of every class that is an object and that the method may give.

    >>> [label.name for label in rules_for(RunConfig.model_validate({"prc": {"environment": "forest"}}))]
    ['STEM']
    """
    for kind in kinds:
        if kind not in KINDS:
            where = "--kind"
            raise ConfigError(where, f"found {kind!r}, expected one of: {', '.join(KINDS)}")
    labels = {label.name.lower(): label for label in config.classifier.method().gives}
    found = {
        labels[kind]: rule
        for kind, rule in RULES.items()
        if kind in labels and (not kinds or kind in kinds)
    }
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
    """List the objects of a file; the output is complete or absent.

    Parameters
    ----------
    source : path
        Any readable input whose beam directions are known.
    output : path, optional
        ``.csv``, ``.geojson`` or ``.parquet``.
    config : LoadedConfig or RunConfig, optional
        A method that is named classifies the file. Default: its own classes are taken where it has
        some of
        :data:`KINDS`, else the method that labels it best; a notice says so.
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
    loaded = LoadedConfig.of(config)
    out = None if output is None else Path(output)
    check_input(source)
    if out is not None:
        check_suffix(out)
        prepare_outputs(out, record_path(out), overwrite=overwrite, inputs=loaded.inputs(source))
    before = file_state(source)
    with whole_set(), ExitStack() as stack:
        own, told = ({}, "") if loaded.config.is_decided else _own_rules(source, loaded, kinds)
        loaded = loaded if own else decide(source, loaded)
        put = None if out is None else stack.enter_context(open_things(out))
        run = _Run(
            source, loaded, own or rules_for(loaded.config, kinds), told, takes_classes=bool(own)
        )
        # coordinates of the records wait beside the output, or where there is room for temporary
        # files
        folder = (
            out
            or Path(stack.enter_context(TemporaryDirectory(prefix="prc-objects-"))) / "objects.csv"
        )
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


def _own_rules(
    source: Path, loaded: LoadedConfig, kinds: tuple[str, ...]
) -> tuple[dict[Label, Rule], str]:
    """Return the rule of every object class that records of the input have, and what the user has to know."""
    records = open_source(source, loaded.config.layout)
    names = () if records is None else records.dimensions
    name = next((one for one in names if one.lower() in NAMES), None)
    if records is None or name is None:
        return {}, ""
    there: set[int] = set()
    for chunk in records.chunks((name,)):
        codes = np.asarray(chunk.values[name], np.float64)
        there |= set(np.unique(codes[np.isfinite(codes)]).astype(int).tolist())
    table = loaded.config.classes
    labels = {kind: Label[kind.upper()] for kind in kinds or KINDS}
    found = {label: RULES[kind] for kind, label in labels.items() if table.code(label) in there}
    if found:
        told = "the classes of the file are taken, without heights above the ground; --method classifies it anew"
        return found, told
    if not there - {0, table.unclassified}:
        return {}, ""
    return {}, f"the file has classes, but none of: {', '.join(labels)}; it is classified anew"


class _Run:
    """One call of :func:`find_objects`."""

    def __init__(
        self,
        source: Path,
        loaded: LoadedConfig,
        rules: dict[Label, Rule],
        told: str,
        *,
        takes_classes: bool,
    ) -> None:
        self._source = source
        self._loaded = loaded
        self._rules = rules
        self._told = told
        self._takes_classes = takes_classes
        self._label_of: U8 = np.full(256, Label.UNCLASSIFIED, np.uint8)
        """Label by class code."""
        for label in reversed([one for one in Label if one is not Label.MISSING]):
            self._label_of[loaded.config.classes.code(label)] = label
        self._growers: dict[int, Grower] = {}
        self._counts = Counts.none()
        self._n = Counter[str]()
        self._watch: EvidenceStream | None = None
        self._judge: Judge | None = None
        self._found: tuple[Finding, ...] = ()

    def things(self, output: Path, progress: Progress | None) -> Iterator[Thing]:
        """Classify, and yield the objects as they end."""
        with open_items(
            self._source, output, self._loaded, blocks_of=self._blocks, codes=self._takes_classes
        ) as opened:
            for item in opened.items:
                for thing in self._add(item):
                    yield self._numbered(thing)
                advance(progress, item.block, opened.info, self._loaded.config.input.window)
            for _, grower in sorted(self._growers.items()):
                for thing in grower.finish():
                    yield self._numbered(thing)
        assert self._watch is not None
        self._found = self._watch.findings() if self._judge is None else self._judge.findings()

    def summary(self) -> ObjectsSummary:
        """Return the summary of a finished run."""
        assert self._watch is not None
        record = run_record(self._watch.info, self._counts, self._loaded)
        told = filter(None, (self._told, *notices(self._found)))
        record = replace(record, notices=(*record.notices, *told))
        kinds = (label.name.lower() for label in self._rules)
        return ObjectsSummary(
            record, self._counts, {kind: self._n[kind] for kind in kinds}, self._found
        )

    def _blocks(self, stream: ScanStream) -> Iterator[ScanBlock] | Iterator[LabelledBlock]:
        """Watch the blocks of a stream, and label them unless their own classes are taken."""
        config = self._loaded.config
        method = config.classifier.method()
        first = next(stream.blocks(), None)
        # coordinates that come with the directions of a leaning plane are not those of the input
        is_own = first is not None and first.xyz_m is not None
        stream = with_beams(stream, config.input)
        self._watch = watched(
            stream, config.input, needs=method.needs, others=self._loaded.findings
        )
        if self._takes_classes:
            return (
                block if is_own else replace(block, xyz_m=None) for block in self._watch.blocks()
            )
        wanted = Wanted(stages=True, confidence=config.output.confidence)
        self._judge = Judge(self._watch, config)
        labelled = self._judge.label(self._watch.blocks(), wanted=wanted)
        return (
            item if is_own else replace(item, block=replace(item.block, xyz_m=None))
            for item in labelled
        )

    def _add(self, item: StreamItem) -> Iterator[Thing]:
        block = item.block
        labelled = self._as_stored(item) if item.labelled is None else item.labelled
        self._counts = self._counts.add(labelled)
        if labelled.block.beam_rad is None:
            raise InputError(
                str(self._source), "no beam angles, expected those of every column", "see prc info"
            )
        grower = self._growers.setdefault(block.scanner, Grower(block.scanner, self._rules))
        runs = runs_of(labelled, tuple(self._rules), item.registered_m)
        for line, of_line in groupby(runs, attrgetter("last_line")):
            yield from grower.add(of_line, line)
        yield from grower.add((), block.first_line + block.n_lines)

    def _as_stored(self, item: StreamItem) -> LabelledBlock:
        """Return a block with the labels that its codes stand for."""
        block = item.block
        codes = item.codes
        further = item.extra_codes
        assert codes is not None
        assert further is not None
        own, extra = (
            self._label_of[np.where((each >= 0) & (each < 256), each, 0)]
            for each in (codes, further)
        )
        return LabelledBlock(
            block, np.where(np.isnan(block.range_m), np.uint8(Label.MISSING), own), extra
        )

    def _numbered(self, thing: Thing) -> Thing:
        number = sum(self._n.values())
        self._n[thing.kind] += 1
        return replace(thing, id=number)


__all__ = ["KINDS", "ObjectsSummary", "Thing", "find_objects"]
