"""``prc thin``: drops noise and thins chosen classes, by line and column or by spacing.

Dropped shots become shots without return. prc removes their records from LAS and LAZ files and
keeps the other bytes. It also removes points of bags and of PLY and PCD frames. It writes other
formats again, as :mod:`prc_cli.jobs.convert` does. A folder of frames becomes a folder of frames.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.config import LoadedConfig, RunConfig, refuse_window, resolve
from prc_cli.core.classes import NO_CODE, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import (
    atomic_outputs,
    output_errors,
    prepare_outputs,
    suffix_of,
)
from prc_cli.core.findings import Finding
from prc_cli.core.stream import LabelledBlock, StreamInfo
from prc_cli.core.types import Mask
from prc_cli.formats import LAS_SUFFIXES, scan_file
from prc_cli.formats.input import Input
from prc_cli.formats.labels import NAMES, open_codes
from prc_cli.formats.las.rewrite import check_copied, copy_las, read_las
from prc_cli.formats.outputs import open_stream_writer, open_writer, outputs_of
from prc_cli.formats.registry import format_of, is_bag
from prc_cli.formats.writing.base import StreamItem
from prc_cli.formats.writing.columns import LabelOutput
from prc_cli.formats.writing.disk import DiskColumn
from prc_cli.formats.writing.record import Fingerprint, RunRecord, record_path
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import Judge
from prc_cli.jobs.convert import (
    OpenedItems,
    find_losses,
    how_to_read,
    open_items,
    prepare_output,
    record_of_scanners,
)
from prc_cli.jobs.run import Counts, Progress, Run, RunSummary
from prc_cli.jobs.thin.frames import frames_of, labels_of, thin_frames
from prc_cli.jobs.thin.rules import ThinRule, choose, parse_rules, without
from prc_cli.matching.sides import CONFIDENCE
from prc_cli.methods.base import Wanted
from prc_cli.streams.beams import with_beams
from prc_cli.streams.evidence.watch import watched
from prc_cli.streams.grid import GridStream
from prc_cli.streams.stream import Stream

CLASSIFY = "classify"
"""Value of ``labels`` for classifying the input on the fly."""


@dataclass(frozen=True, slots=True)
class ClassSaving:
    """Result for one class."""

    code: int
    """Class code, -1 = returns without a class."""
    name: str
    n_input: int
    """Returns of the class in the input."""
    n_kept: int
    n_bytes: int
    """Bytes saved: the difference of file sizes, in proportion to the dropped returns."""

    @property
    def n_dropped(self) -> int:
        """Returns that were dropped."""
        return self.n_input - self.n_kept


@dataclass(frozen=True, slots=True, repr=False)
class ThinningSummary(RunSummary):
    """Summary of a thinning."""

    classes: tuple[ClassSaving, ...] = ()
    rules: tuple[str, ...] = ()
    bytes_input: int = 0
    bytes_output: int = 0

    @property
    def n_lines(self) -> int:
        """Scan lines of the input."""
        return self.counts.n_lines

    def as_dict(self) -> dict[str, object]:
        """Return everything as plain values, for JSON."""
        return {
            "record": self.record.as_dict(),
            "classes": [{**asdict(item), "n_dropped": item.n_dropped} for item in self.classes],
            "rules": list(self.rules),
            "bytes": {"input": self.bytes_input, "output": self.bytes_output},
            "n_lines": self.n_lines,
        }


def thin(
    source: Path | str,
    output: Path | str,
    rules: tuple[ThinRule, ...] | None = None,
    config: LoadedConfig | RunConfig | None = None,
    *,
    labels: Path | str | None = None,
    min_confidence: int | None = None,
    keep_empty: bool = False,
    every_frame: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ThinningSummary:
    """Write a reduced stream; the output is complete or absent.

    Parameters
    ----------
    source : path
        Any readable input, or a folder of frames of one kind.
    output : path
        Any writable format, a bag of an input of the same kind, or of a folder a new folder.
        Between LAS and LAZ, prc removes records and keeps the bytes of the others. The classes in
        the file stay, even if ``labels`` decided which returns were dropped.
    rules : tuple of ThinRule, optional
        From :func:`parse_rules`; default: drop noise.
    config : LoadedConfig or RunConfig, optional
        How the stream is read, and, with ``labels = "classify"``, classified.
    labels : path or "classify", optional
        A label file with one code per record (of a folder: a folder with a file for every frame),
        or the classifier. Default: the classes of the input, or the classifier if it has none.
    min_confidence : int, optional
        Also drop returns whose label has less confidence [per cent]. The confidence is the
        dimension ``confidence`` of the label file or the input, or comes from the classifier.
    keep_empty : bool
        Write a row for every cell of the grid to ``.ply``, ``.pcd`` and ``.bin``, too. Default:
        only returns. A ``.bin`` then contains x, y, z and intensity, as KITTI's frames, if the
        input has coordinates from the scanner.
    every_frame : bool
        Number the frames of a folder from 000000. Default: they keep their names.
    overwrite : bool
        Replace an existing output, but not a folder.
    progress : callable, optional
        Called with the number of scan lines that were just finished.

    Returns
    -------
    ThinningSummary

    Raises
    ------
    ConfigError
        If the lines of a LAS output could not be restored, or all returns would be dropped.
    InputError, OutputError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    loaded = LoadedConfig.of(config)
    refuse_window(loaded.config, "prc thin")
    source = scan_file(Path(source))
    output = Path(output)
    rules = parse_rules(codes=loaded.config.classes) if rules is None else rules
    if min_confidence is not None and not 0 <= min_confidence <= 100:
        raise ConfigError(
            "--min-confidence", f"found {min_confidence}, expected per cent, 0 to 100"
        )
    common: dict[str, Any] = {"min_confidence": min_confidence, "keep_empty": keep_empty}
    if source.is_dir():
        return _thin_folder(
            source,
            output,
            rules,
            loaded,
            labels,
            every_frame=every_frame,
            progress=progress,
            **common,
        )
    if every_frame:
        raise ConfigError(
            "--every-frame", f"{source.name} is a file", "it numbers the frames of a folder"
        )
    return _thin_file(
        source, output, rules, loaded, labels, overwrite=overwrite, progress=progress, **common
    )


def _thin_file(
    source: Path,
    output: Path,
    rules: tuple[ThinRule, ...],
    loaded: LoadedConfig,
    labels: Path | str | None,
    *,
    overwrite: bool,
    progress: Progress | None,
    **common: Any,
) -> ThinningSummary:
    scan, loaded = resolve(source, loaded)
    if labels is None:
        labels = _labels_of_input(scan)
    if labels == CLASSIFY:
        loaded = decide(scan, loaded)
    label_file = None if labels is None or labels == CLASSIFY else Path(labels)
    label_files = () if label_file is None else (label_file,)
    if is_bag(output):
        scan.check()
        inputs = loaded.inputs(scan.path, *label_files)
        prepare_outputs(output, record_path(output), overwrite=overwrite, inputs=inputs)
    else:
        prepare_output(scan, output, loaded, overwrite=overwrite, more=label_files)
    run = Run(scan, loaded, progress)
    thinner = _Thinner(run, output, rules, label_file, classify=labels == CLASSIFY, **common)
    is_copied = scan.is_las and suffix_of(output) in LAS_SUFFIXES
    return thinner.summary(thinner.copy() if is_copied else thinner.write())


def _labels_of_input(scan: Input) -> Path | str | None:
    """Return the source of the classes: None = the records, a bag's clouds, or the classifier."""
    if scan.is_bag:
        with contextlib.suppress(InputError):
            next(open_codes(scan.path).codes())
            return scan.path
        return CLASSIFY
    records = scan.records()
    if records is not None:
        return None if any(name.lower() in NAMES for name in records.dimensions) else CLASSIFY
    columns = format_of(scan.path, "codes")
    with contextlib.suppress(ConfigError, InputError):
        if columns is not None and open_codes(scan.path, "class").n_records:
            return None
    return CLASSIFY


def _thin_folder(
    source: Path,
    output: Path,
    rules: tuple[ThinRule, ...],
    loaded: LoadedConfig,
    labels: Path | str | None,
    *,
    every_frame: bool,
    **common: Any,
) -> ThinningSummary:
    frames = frames_of(source)
    known = labels_of(Path(labels), frames) if labels is not None and labels != CLASSIFY else {}
    first = next((frame for frame in frames if frame.stat().st_size), None)
    if first is None:
        raise InputError(
            str(source), f"all {len(frames)} frames are empty, expected points", "copy them again"
        )
    if not known:
        scan, loaded_of_first = resolve(first, loaded)
        if labels == CLASSIFY or _labels_of_input(scan) == CLASSIFY:
            loaded = decide(scan, loaded_of_first)
            labels = CLASSIFY

    def thin_one(frame: Path, thinned: Path) -> ThinningSummary:
        return _thin_file(
            frame,
            thinned,
            rules,
            loaded,
            known.get(frame, labels),
            overwrite=False,
            is_frame=True,
            **common,
        )

    with thin_frames(frames, output, thin_one, every_frame=every_frame) as summaries:
        summary = _folder_summary(source, output, frames, summaries)
        with output_errors(output):
            record_path(output).write_bytes(summary.record.to_json())
    return summary


def _folder_summary(
    source: Path,
    output: Path,
    frames: list[Path],
    summaries: list[ThinningSummary],
) -> ThinningSummary:
    n_input = Counter[int]()
    n_kept = Counter[int]()
    n_bytes = Counter[int]()
    names = {}
    n_empty = len(frames)
    for summary in summaries:
        n_empty -= any(saving.n_kept for saving in summary.classes)
        for saving in summary.classes:
            names[saving.code] = saving.name
            n_input[saving.code] += saving.n_input
            n_kept[saving.code] += saving.n_kept
            n_bytes[saving.code] += saving.n_bytes
    n_all = n_input.total()
    n_left = n_kept.total()
    if not n_left:
        problem = f"all {n_all} returns would be dropped, expected some to stay"
        raise ConfigError(str(source), problem, "keep more: --keep noise=1, or other classes")
    first = summaries[0]
    texts = [text for text in first.record.notices if text.startswith(_METHOD)]
    texts.append(
        f"thinned: {n_all - n_left} of {n_all} returns of {len(frames)} frames were dropped"
    )
    if n_empty:
        texts.append(f"{n_empty} frames have no point: their files are there")
    record = replace(
        first.record,
        input=Fingerprint(source.name, sum(frame.stat().st_size for frame in frames), None),
        output=None,
        n_lines=None,
        n_records=None,
        n_missing=None,
        classes=(),
        notices=tuple(texts),
    )
    classes = tuple(
        ClassSaving(code, names[code], n, n_kept[code], n_bytes[code])
        for code, n in sorted(n_input.items())
    )
    doubts = {doubt.check: doubt for summary in summaries for doubt in summary.doubts}
    return ThinningSummary(
        output,
        record,
        sum((summary.counts for summary in summaries), Counts.none()),
        findings=tuple(doubts.values()),
        classes=classes,
        rules=first.rules,
        bytes_input=sum(summary.bytes_input for summary in summaries),
        bytes_output=sum(summary.bytes_output for summary in summaries),
    )


_METHOD = "classified on the way: "


class _Thinner:
    """Thins the file of a run."""

    def __init__(
        self,
        run: Run,
        output: Path,
        rules: tuple[ThinRule, ...],
        labels: Path | None,
        *,
        classify: bool,
        min_confidence: int | None,
        keep_empty: bool,
        is_frame: bool = False,
    ) -> None:
        self.run = run
        self.scan = run.scan
        self.output = output
        self.rules = rules
        self.loaded = run.loaded
        self.labels = labels
        self.classify = classify
        self.min_confidence = min_confidence
        self.keep_empty = keep_empty
        self.is_frame = is_frame
        self.n_unsure = 0
        """Returns that only ``min_confidence`` drops."""
        self._confidence: DiskColumn | None = None
        """Confidence of the records of a file [per cent]."""
        self.n_input = Counter[int]()
        self.n_kept = Counter[int]()
        """Returns by class code."""
        self._judge: Judge | None = None
        self._findings: tuple[Finding, ...] = ()

    def copy(self) -> RunRecord:
        """Copy a LAS or LAZ file without the records of dropped returns."""
        las = read_las(self.scan.path)
        check_copied(las)
        with contextlib.ExitStack() as stack:
            temporary, record_file = stack.enter_context(
                atomic_outputs(self.output, record_path(self.output))
            )
            stays = stack.enter_context(
                DiskColumn(self.output, np.uint8, 1, n_records=las.n_records)
            )
            needs_xyz = any(rule.spacing_m is not None for rule in self.rules)
            with self._open(xyz=needs_xyz) as (opened, items):
                hints = _check_lines(self.scan, opened)
                for item in items:
                    kept, kept_extra = self._choose(item)
                    block = item.block
                    dropped = block.records()[~kept & ~np.isnan(block.range_m)]
                    dropped = np.concatenate([dropped, block.extra.record[~kept_extra]])
                    dropped = dropped[dropped >= 0]
                    stays.put(dropped, np.zeros(len(dropped), np.uint8))
                    self.run.see(block, opened.info)
                self._check_labels(opened.info)
                if len(set(self.run.counts.scanners.values())) > 1:
                    hints += (
                        "lines of scanners differ in length: "
                        "the highest column that is left is taken for it",
                    )
                record = self._record(opened.info, hints)
            notices = copy_las(
                las,
                self.output,
                temporary,
                lambda n: (part.view(np.bool_) for part in stays.chunks(n)),
                record,
            )
            record = replace(record, notices=(*record.notices, *notices))
            self.run.check_unchanged()
            record_file.write_bytes(record.to_json())
        return record

    def write(self) -> RunRecord:
        """Write the stream without the dropped shots, or the points of the input without them."""
        with self._open(xyz=not is_bag(self.output)) as (opened, items):
            if is_bag(self.output) or (
                opened.shape.rings and not self.keep_empty and self.scan.keeps_points(self.output)
            ):
                return self._rewrite(opened, items)
            shape = replace(opened.shape, codes=True)
            with open_stream_writer(self.output, replace(shape, compress=True)) as writer:
                for item in items:
                    writer.add_item(without(item, *self._choose(item)))
                    self.run.see(item.block, opened.info)
                self._check_labels(opened.info)
                opened = replace(opened, shape=shape)
                losses = (
                    f"not kept: {loss}"
                    for loss in find_losses(self.output, opened, self.run.counts, writer.losses)
                )
                hints = (
                    *opened.notices,
                    *losses,
                    *how_to_read(self.output, opened, self.run.counts),
                )
                return self.run.finish(writer, self._record(opened.info, hints))

    def _rewrite(self, opened: OpenedItems, items: Iterator[StreamItem]) -> RunRecord:
        """Remove points from a cloud or a bag, and add the classes of the other points."""
        config = self.loaded.config
        labels = LabelOutput(
            path=self.output,
            source=self.scan,
            n_records=opened.info.n_records,
            points_per_line=opened.info.points_per_line,
            codes=config.classes,
            is_thinned=True,
            rules=config.input,
        )
        with open_writer(labels, overwrite=True) as writer:
            for item in items:
                kept, kept_extra = self._choose(item)
                codes = _codes_of(item.codes, kept), _codes_of(item.extra_codes, kept_extra)
                writer.add_item(StreamItem(item.block, *codes))
                self.run.see(item.block, opened.info)
            self._check_labels(opened.info)
            return self.run.finish(writer, self._record(opened.info, opened.notices))

    def summary(self, record: RunRecord) -> ThinningSummary:
        names = {**self.loaded.config.classes.names(), NO_CODE: "none"}
        bytes_input = self.scan.path.stat().st_size
        outputs = (self.output,) if is_bag(self.output) else outputs_of(self.output)[:-1]
        bytes_output = sum(path.stat().st_size for path in outputs)
        counts = [(code, n, self.n_kept[code]) for code, n in sorted(self.n_input.items())]
        n_dropped = sum(n - kept for _, n, kept in counts)
        saved = bytes_input - bytes_output
        classes = tuple(
            ClassSaving(
                code,
                names.get(code, f"class {code}"),
                n,
                kept,
                round(saved * (n - kept) / max(1, n_dropped)),
            )
            for code, n, kept in counts
        )
        rules = tuple(map(str, self.rules))
        return ThinningSummary(
            self.output,
            record,
            self.run.counts,
            self._findings,
            classes,
            rules,
            bytes_input,
            bytes_output,
        )

    @contextlib.contextmanager
    def _open(self, *, xyz: bool) -> Iterator[tuple[OpenedItems, Iterator[StreamItem]]]:
        """Open the stream, with the class codes of every block."""
        config = self.loaded.config

        def labelled(stream: Stream) -> Iterator[LabelledBlock]:
            directed = with_beams(stream, config.input) if config.needs_beams else stream
            needs = config.classifier.method().needs
            wanted = Wanted(confidence=self.min_confidence is not None)
            watch = watched(directed, config.input, needs=needs, others=self.loaded.findings)
            self._judge = Judge(watch, config)
            return self._judge.label(watch.blocks(), wanted=wanted)

        with contextlib.ExitStack() as stack:
            items_of = open_items(
                self.scan,
                self.output,
                self.loaded,
                blocks_of=labelled if self.classify else None,
                codes=self.labels is None and not self.classify,
                xyz=xyz,
                points=not self.keep_empty,
            )
            opened = stack.enter_context(items_of)
            file_codes: DiskColumn | None = None
            self._n_labels = 0
            if self.labels is not None:
                file_codes = self._read_values(self.labels, None, opened.info, stack)
                self._n_labels = len(file_codes)
            if self.min_confidence is not None and not self.classify:
                self._confidence = self._read_values(
                    self.labels or self.scan.path, CONFIDENCE, opened.info, stack
                )
            lookup = config.classes.lookup().astype(np.int32)
            lookup[Label.MISSING] = NO_CODE

            def items() -> Iterator[StreamItem]:
                for item in opened.items:
                    block = item.block
                    labels = item.labelled
                    if file_codes is not None:
                        codes = file_codes.get(block.records())
                        extra_codes = file_codes.get(block.extra.record)
                        yield replace(item, codes=codes, extra_codes=extra_codes)
                    elif labels is not None:
                        codes = lookup[labels.labels]
                        yield replace(item, codes=codes, extra_codes=lookup[labels.extra_labels])
                    else:
                        yield item

            yield opened, items()

    def _read_values(
        self,
        path: Path,
        dimension: str | None,
        info: StreamInfo,
        stack: contextlib.ExitStack,
    ) -> DiskColumn:
        """Load codes, or another dimension of whole numbers, for access by record."""
        try:
            codes = open_codes(path, dimension)
        except (ConfigError, InputError) as refusal:
            if dimension is None:
                raise
            hint = (
                "classify again with --set output.confidence=true, to .las, .laz, .csv or .parquet"
            )
            raise ConfigError("--min-confidence", f"{path}: {refusal.problem}", hint) from refusal
        # before it reads a long file
        if None not in (codes.n_records, info.n_records) and codes.n_records != info.n_records:
            raise self._other_labels(path, codes.n_records, info.n_records)
        values = stack.enter_context(DiskColumn(self.output, "<i4", NO_CODE))
        for chunk in codes.codes():
            values.append(np.where(np.abs(chunk) < 2**31, chunk, NO_CODE).astype(np.int32))
        return values

    def _choose(self, item: StreamItem) -> tuple[Mask, Mask]:
        """Mark the returns to keep, by the rules and by confidence, and count them."""
        assert item.codes is not None
        assert item.extra_codes is not None
        kept, kept_extra = choose(item, self.rules)
        block = item.block
        if self.min_confidence is not None:
            confidence: Any = None
            extra_confidence: Any = None
            if item.labelled is not None:
                confidence = item.labelled.confidence
                extra_confidence = item.labelled.extra_confidence
            elif self._confidence is not None:
                confidence = self._confidence.get(block.records())
                extra_confidence = self._confidence.get(block.extra.record)
            n_kept = int(kept.sum() + kept_extra.sum())
            kept &= confidence >= self.min_confidence
            kept_extra &= extra_confidence >= self.min_confidence
            self.n_unsure += n_kept - int(kept.sum() + kept_extra.sum())
        returned = ~np.isnan(block.range_m)
        _count(self.n_input, item.codes[returned], item.extra_codes)
        _count(self.n_kept, item.codes[kept], item.extra_codes[kept_extra])
        return kept, kept_extra

    def _check_labels(self, info: StreamInfo) -> None:
        """Refuse a label file of another length than the input."""
        if self.labels is None:
            return
        n_records = (
            info.n_records if info.n_records is not None else self.run.counts.tally.n_records
        )
        if self._n_labels != n_records:
            raise self._other_labels(self.labels, self._n_labels, n_records)

    def _other_labels(self, path: Path, n_labels: int | None, n_records: int | None) -> InputError:
        problem = f"found {n_labels} labels, expected {n_records}, one a record of {self.scan.name}"
        return InputError(str(path), problem, "give the labels of this file")

    def _record(self, info: StreamInfo, hints: tuple[str, ...]) -> RunRecord:
        """Return the run record, whose notices say how many shots every rule dropped."""
        n_input = self.n_input.total()
        n_all_kept = self.n_kept.total()
        texts = [text for rule in self.rules if (text := self._rule_notice(rule))]
        if self.min_confidence is not None:
            texts.append(
                f"confidence below {self.min_confidence} %: {self.n_unsure} more returns dropped"
            )
        if not n_all_kept and not self.is_frame:
            problem = f"all {n_input} returns would be dropped, expected some to stay"
            raise ConfigError(
                str(self.scan), problem, "keep more: --keep noise=1, or other classes"
            )
        note = (
            f"thinned: {n_input - n_all_kept} of {n_input} returns were dropped "
            "and are missing in this file"
        )
        choice = self.loaded.choice if self.classify else None
        method = () if choice is None else (f"{_METHOD}method {choice.method}: {choice.why}",)
        self._findings = () if self._judge is None else self._judge.findings()
        record = self.run.record(info, self._findings, (*method, note, *texts, *hints))
        return record_of_scanners(record, self.run.counts)

    def _rule_notice(self, rule: ThinRule) -> str:
        n = _n_of_rule(self.n_input, rule)
        n_dropped = n - _n_of_rule(self.n_kept, rule)
        if n:
            suffix = "" if rule.is_rest else f" ({rule})"
            return f"{rule.name}: {n_dropped} of {n} dropped{suffix}"
        if rule.is_rest or (rule.name == "noise" and rule.share == 0):
            return ""
        return f"{rule.name}: no return has this class (code {', '.join(map(str, rule.codes))})"


def _count(counts: Counter[int], *codes: NDArray[np.integer]) -> None:
    for part in codes:
        values, numbers = np.unique(part, return_counts=True)
        counts.update(dict(zip(values.tolist(), numbers.tolist(), strict=True)))


def _n_of_rule(counts: Counter[int], rule: ThinRule) -> int:
    return sum(n for code, n in counts.items() if rule.holds(np.array(code)))


def _codes_of(codes: Any, kept: Mask) -> Any:
    # a class code of an output is a byte
    return np.where(kept, np.where((codes >= 0) & (codes < 256), codes, 0), NO_CODE)


def _check_lines(scan: Input, opened: OpenedItems) -> tuple[str, ...]:
    """Return the options that read the thinned file.

    Refuse a LAS file in which the cell of a shot depends on other records.
    """
    grid = opened.grid
    if grid is None:
        basis = "the records around it"
    elif grid.rules.lines == "fixed" or grid.rules.columns == "order":
        basis = "the order of the records"
    elif grid.rules.columns == "time" and grid.rules.line_hz is None:
        basis = "the first return of its line"
    else:
        return _options_to_read(grid)
    problem = f"the cell of a shot depends on {basis}: without some records, other shots move"
    raise ConfigError(str(scan), problem, "write .csv.gz, .npz or .parquet, which keep the cells")


def _options_to_read(grid: GridStream) -> tuple[str, ...]:
    # they replace the values that the reader estimated from all records
    rules = grid.rules
    texts = []
    if rules.line_hz is not None and rules.config.time_origin is None:
        first = next(iter(grid.source.chunks(("time",)))).values["time"]
        texts.append(f"read it with --set input.time_origin={float(first[0])!r}")
    if rules.columns == "time":
        texts.append("columns follow from the times: shots that share a stamp may move by a column")
    if rules.columns == "angle" and (
        rules.config.angle_start is None or rules.config.angle_step is None
    ):
        for setup in grid.setup.scanners.values():
            if (angles := setup.columns.grid) is not None:
                start = math.degrees(angles.start_rad)
                step = math.degrees(angles.step_rad)
                texts.append(
                    f"read it with --set input.angle_start={start!r} "
                    f"--set input.angle_step={step!r}"
                )
    return tuple(dict.fromkeys(texts))


__all__ = ["CLASSIFY", "ClassSaving", "ThinRule", "ThinningSummary", "parse_rules", "thin"]
