"""``prc objects``: lists stems, poles, cars and curbs as they pass.

If the input has classes and no method is named, its classes are used. Otherwise it is classified on
the way. Runs of shots of one class in a line are joined to objects across lines. An object is
listed when it has passed, so memory holds only the objects in view.
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

from prc_cli.config import LoadedConfig, RunConfig, resolve
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import (
    atomic_output,
    output_errors,
    prepare_outputs,
    whole_set,
)
from prc_cli.core.findings import Doubted, Finding
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F64, U8
from prc_cli.formats.input import Input
from prc_cli.formats.labels import NAMES
from prc_cli.formats.writing.base import StreamItem
from prc_cli.formats.writing.record import RunRecord, record_path
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import Judge
from prc_cli.jobs.convert import open_items
from prc_cli.jobs.objects.grow import RULES, Grower, Rule, ScanObject, runs_of
from prc_cli.jobs.run import Counts, Progress, Run
from prc_cli.methods.base import Wanted
from prc_cli.streams.beams import with_beams
from prc_cli.streams.evidence.watch import watched
from prc_cli.streams.stream import Stream

COLUMNS = tuple(column.name for column in fields(ScanObject))
SUFFIXES = (".csv", ".geojson", ".parquet")
ROWS_AT_ONCE = 10_000
"""Rows of a group of a Parquet file."""
_TEXT_COLUMNS = ("kind",)
_INTEGER_COLUMNS = (
    "id",
    "scanner",
    "first_line",
    "last_line",
    "first_column",
    "last_column",
    "n_shots",
)


def check_suffix(path: Path) -> str:
    """Return the suffix of an output, which decides its format."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        problem = f"found suffix {path.suffix!r}, expected one of {', '.join(SUFFIXES)}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    return suffix


@contextmanager
def open_list(path: Path) -> Iterator[Callable[[ScanObject], None]]:
    """Open an output and yield the function that writes an object to it."""
    writer = {".csv": _csv, ".geojson": _geojson, ".parquet": _parquet}[check_suffix(path)]
    with atomic_output(path) as temporary, output_errors(path), writer(temporary) as put:
        yield put


def plain(value: Any) -> Any:
    """Round a value of an object to 4 decimals; NaN becomes None."""
    if isinstance(value, float):
        return None if math.isnan(value) else round(value, 4)
    return value


@contextmanager
def _csv(path: Path) -> Iterator[Callable[[ScanObject], None]]:
    with path.open("w", encoding="utf-8", newline="\n") as handle:
        handle.write(",".join(COLUMNS) + "\n")

        def put(scan_object: ScanObject) -> None:
            values = (plain(getattr(scan_object, name)) for name in COLUMNS)
            handle.write(",".join("" if value is None else str(value) for value in values) + "\n")

        yield put


@contextmanager
def _geojson(path: Path) -> Iterator[Callable[[ScanObject], None]]:
    with path.open("w", encoding="utf-8", newline="\n") as handle:
        handle.write('{"type": "FeatureCollection", "features": [')
        comma = chain([""], repeat(","))

        def put(scan_object: ScanObject) -> None:
            values = {name: plain(getattr(scan_object, name)) for name in COLUMNS}
            x, y, z = (values.pop(axis) for axis in ("x", "y", "z"))
            place = None if x is None else {"type": "Point", "coordinates": [x, y, z]}
            feature = {"type": "Feature", "geometry": place, "properties": values}
            handle.write(f"{next(comma)}\n{json.dumps(feature)}")

        yield put
        handle.write("\n]}\n")


@contextmanager
def _parquet(path: Path) -> Iterator[Callable[[ScanObject], None]]:
    # only this format needs pyarrow
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = dict.fromkeys(COLUMNS, pa.float64())
    types |= dict.fromkeys(_TEXT_COLUMNS, pa.string())
    types |= dict.fromkeys(_INTEGER_COLUMNS, pa.int64())
    schema = pa.schema(list(types.items()))
    rows: list[dict[str, Any]] = []
    with pq.ParquetWriter(path, schema) as writer:

        def put(scan_object: ScanObject) -> None:
            rows.append({name: plain(getattr(scan_object, name)) for name in COLUMNS})
            if len(rows) == ROWS_AT_ONCE:
                flush()

        def flush() -> None:
            writer.write_table(pa.Table.from_pylist(rows, schema))
            rows.clear()

        yield put
        if rows:
            flush()


KINDS: tuple[str, ...] = tuple(RULES)
"""Classes that are objects."""


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

    >>> forest = RunConfig.model_validate({"prc": {"environment": "forest"}})
    >>> [label.name for label in rules_for(forest)]
    ['STEM']
    """
    for kind in kinds:
        if kind not in KINDS:
            where = "--kind"
            raise ConfigError(where, f"found {kind!r}, expected one of: {', '.join(KINDS)}")
    labels = {label.name.lower(): label for label in config.classifier.method().gives}
    rules = {
        labels[kind]: rule
        for kind, rule in RULES.items()
        if kind in labels and (not kinds or kind in kinds)
    }
    if not rules:
        problem = f"found {config.method}, which tells none of: {', '.join(kinds or KINDS)}"
        raise ConfigError("method", problem, "give --preset fused, fused-forest or street-scan")
    return rules


def find_objects(
    source: Path | str,
    output: Path | str | None = None,
    config: LoadedConfig | RunConfig | None = None,
    *,
    kinds: tuple[str, ...] = (),
    each: Callable[[ScanObject], None] | None = None,
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
        If it names a method, that method classifies the file. Default: the classes of the file, if
        it has some of :data:`KINDS`, else the method that labels it best; a notice says which.
    kinds : tuple of str
        Some of :data:`KINDS`; default: all kinds that the method labels.
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
    scan, loaded = resolve(source, config)
    out = None if output is None else Path(output)
    scan.check()
    if out is not None:
        check_suffix(out)
        prepare_outputs(out, record_path(out), overwrite=overwrite, inputs=loaded.inputs(scan.path))
    run = Run(scan, loaded, progress)
    with whole_set(), ExitStack() as stack:
        rules: dict[Label, Rule] = {}
        notice = ""
        if not loaded.config.is_decided:
            rules, notice = _rules_of_file(scan, loaded, kinds)
        takes_classes = bool(rules)
        if not takes_classes:
            run.loaded = decide(scan, loaded)
            rules = rules_for(run.loaded.config, kinds)
        put = None if out is None else stack.enter_context(open_list(out))
        finder = _Finder(run, rules, notice, takes_classes=takes_classes)
        # coordinates of the records wait beside the output, or in the folder for temporary files
        beside = out
        if beside is None:
            folder = stack.enter_context(TemporaryDirectory(prefix="prc-objects-"))
            beside = Path(folder) / "objects.csv"
        for scan_object in finder.objects(beside):
            for call in (put, each):
                if call is not None:
                    call(scan_object)
        run.check_unchanged()
        summary = finder.summary()
        if out is not None:
            record_file = stack.enter_context(atomic_output(record_path(out)))
            record_file.write_bytes(summary.record.to_json())
    return summary


def _rules_of_file(
    scan: Input, loaded: LoadedConfig, kinds: tuple[str, ...]
) -> tuple[dict[Label, Rule], str]:
    """Return the rules of the object classes that the input has (empty = none), and a notice."""
    records = scan.records()
    names = () if records is None else records.dimensions
    name = next((name for name in names if name.lower() in NAMES), None)
    if records is None or name is None:
        return {}, ""
    codes_of_file: set[int] = set()
    for chunk in records.chunks((name,)):
        codes = np.asarray(chunk.values[name], np.float64)
        codes_of_file |= set(np.unique(codes[np.isfinite(codes)]).astype(int).tolist())
    table = loaded.config.classes
    labels = {kind: Label[kind.upper()] for kind in kinds or KINDS}
    rules = {
        label: RULES[kind] for kind, label in labels.items() if table.code(label) in codes_of_file
    }
    if rules:
        notice = (
            "the classes of the file are taken, without heights above the ground; "
            "--method classifies it again"
        )
        return rules, notice
    if not codes_of_file - {0, table.unclassified}:
        return {}, ""
    return {}, f"the file has classes, but none of: {', '.join(labels)}; it is classified again"


class _Finder:
    """Finds the objects of a run."""

    def __init__(
        self,
        run: Run,
        rules: dict[Label, Rule],
        notice: str,
        *,
        takes_classes: bool,
    ) -> None:
        self._run = run
        self._rules = rules
        self._notice = notice
        self._takes_classes = takes_classes
        self._label_of: U8 = np.full(256, Label.UNCLASSIFIED, np.uint8)
        """Label by class code."""
        # the first of several labels with one code wins
        for label in reversed(Label):
            if label is not Label.MISSING:
                self._label_of[run.loaded.config.classes.code(label)] = label
        self._growers: dict[int, Grower] = {}
        self._n = Counter[str]()
        self._watch: Stream | None = None
        self._judge: Judge | None = None
        self._findings: tuple[Finding, ...] = ()

    def objects(self, output: Path) -> Iterator[ScanObject]:
        run = self._run
        with open_items(
            run.scan, output, run.loaded, blocks_of=self._blocks, codes=self._takes_classes
        ) as opened:
            for item in opened.items:
                labelled = item.labelled or self._stored_labels(item)
                for scan_object in self._add(labelled, item.registered_m):
                    yield self._numbered(scan_object)
                run.see(labelled, opened.info)
            for _, grower in sorted(self._growers.items()):
                for scan_object in grower.finish():
                    yield self._numbered(scan_object)
        assert self._watch is not None
        if self._judge is None:
            self._findings = tuple(self._watch.observed.findings)
        else:
            self._findings = self._judge.findings()

    def summary(self) -> ObjectsSummary:
        assert self._watch is not None
        notes = (self._notice,) if self._notice else ()
        record = self._run.record(self._watch.info, self._findings, notes)
        kinds = (label.name.lower() for label in self._rules)
        return ObjectsSummary(
            record, self._run.counts, {kind: self._n[kind] for kind in kinds}, self._findings
        )

    def _blocks(self, stream: Stream) -> Iterator[ScanBlock] | Iterator[LabelledBlock]:
        """Watch the blocks of a stream, and label them unless the input has classes."""
        config = self._run.loaded.config
        # classes of the input need no method: it is checked as for PRC, which needs the least
        params = config.prc if self._takes_classes else config.classifier
        first = next(stream.first_blocks(), None)
        has_xyz = first is not None and first.xyz_m is not None
        stream = with_beams(stream, config.input)
        self._watch = watched(
            stream, config.input, needs=params.method().needs, others=self._run.loaded.findings
        )
        # with_beams adds coordinates to blocks of a leaning scan plane: they are not of the input
        if self._takes_classes:
            return (
                block if has_xyz else replace(block, xyz_m=None) for block in self._watch.blocks()
            )
        wanted = Wanted(stages=True, confidence=config.output.confidence)
        self._judge = Judge(self._watch, config)
        labelled = self._judge.label(self._watch.blocks(), wanted=wanted)
        return (
            item if has_xyz else replace(item, block=replace(item.block, xyz_m=None))
            for item in labelled
        )

    def _add(self, labelled: LabelledBlock, registered_m: F64 | None) -> Iterator[ScanObject]:
        block = labelled.block
        if block.beam_rad is None:
            raise InputError(
                str(self._run.scan),
                "no beam angles, expected those of every column",
                "see prc info",
            )
        grower = self._growers.setdefault(block.scanner, Grower(block.scanner, self._rules))
        runs = runs_of(labelled, tuple(self._rules), registered_m)
        for line, runs_of_line in groupby(runs, attrgetter("last_line")):
            yield from grower.add(runs_of_line, line)
        yield from grower.add((), block.first_line + block.n_lines)

    def _stored_labels(self, item: StreamItem) -> LabelledBlock:
        block = item.block
        codes = item.codes
        extra_codes = item.extra_codes
        assert codes is not None
        assert extra_codes is not None
        labels, extra_labels = (
            self._label_of[np.where((stored >= 0) & (stored < 256), stored, 0)]
            for stored in (codes, extra_codes)
        )
        return LabelledBlock(
            block, np.where(np.isnan(block.range_m), np.uint8(Label.MISSING), labels), extra_labels
        )

    def _numbered(self, scan_object: ScanObject) -> ScanObject:
        number = sum(self._n.values())
        self._n[scan_object.kind] += 1
        return replace(scan_object, id=number)


__all__ = ["KINDS", "ObjectsSummary", "ScanObject", "find_objects"]
