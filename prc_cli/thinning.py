"""A reduced stream: noise dropped, chosen classes thinned out by line and column or by spacing: ``prc thin``.

Shots that are dropped become shots without return. LAS and LAZ files lose their records and keep everything else byte
for byte; other formats are written anew, as :mod:`prc_cli.conversion` does.
"""

from __future__ import annotations

import contextlib
import difflib
import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prc_cli.config import SEQUENTIAL_ANGLE, LoadedConfig, RunConfig
from prc_cli.conversion import (
    Facts,
    OpenedItems,
    check_unchanged,
    find_losses,
    how_to_read,
    open_items,
    prepare_output,
    record_of_scanners,
)
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import atomic_output, temporary_name
from prc_cli.core.stream import ExtraReturns, ScanBlock, ScanStream, StreamInfo
from prc_cli.core.types import F64, I32, I64, Mask
from prc_cli.pipeline import Counts, Progress, label_blocks, run_record
from prc_cli.readers import LAS_SUFFIXES, suffix_of
from prc_cli.readers.beams import with_beams
from prc_cli.readers.grid import GridStream
from prc_cli.readers.labels import open_codes
from prc_cli.writers.las_copy import check_copied, copy_las, read_las
from prc_cli.writers.options import HIGH_NOISE_CODE
from prc_cli.writers.record import RunRecord, record_path
from prc_cli.writers.record_values import RecordValues
from prc_cli.writers.spool import Spool
from prc_cli.writers.streams import NO_CODE, StreamItem, open_stream_writer, outputs_of, stream_suffix

CLASSIFY = "classify"
"""Labels: those that the classifier gives on the way."""
MAX_DENOMINATOR = 1_000_000
"""Finest fraction of a class."""
MAX_SPACING_M = 10_000.0
_GOLDEN = 0.618
"""Shift of the pattern from line to line, as a share of its period: no stripes."""


@dataclass(frozen=True, slots=True)
class ThinRule:
    """What is kept of a class."""

    name: str
    codes: tuple[int, ...]
    """Class codes that are meant."""
    share: Fraction | None = None
    """Share of the shots, in a pattern of line and column; 0 = none, 1 = all."""
    spacing_m: float | None = None
    """Least distance between shots of the class in a line [m]."""

    def __str__(self) -> str:
        return f"{self.name}={self.share if self.spacing_m is None else f'{self.spacing_m:g} m'}"


@dataclass(frozen=True, slots=True)
class ClassSaving:
    """What became of one class."""

    code: int
    """Class code, -1 = returns without one."""
    name: str
    n_input: int
    """Returns of the class in the input."""
    n_kept: int
    n_bytes: int
    """Bytes saved: the file's, shared out by the returns that were dropped."""

    @property
    def n_dropped(self) -> int:
        """Returns that were dropped."""
        return self.n_input - self.n_kept


@dataclass(frozen=True, slots=True)
class ThinningSummary:
    """What thinning did."""

    output: Path
    record: RunRecord
    classes: tuple[ClassSaving, ...]
    rules: tuple[str, ...]
    bytes_input: int
    bytes_output: int
    n_lines: int

    def as_dict(self) -> dict[str, object]:
        """Return everything as plain values, for JSON."""
        return {
            "record": self.record.as_dict(),
            "classes": [{**asdict(item), "n_dropped": item.n_dropped} for item in self.classes],
            "rules": list(self.rules),
            "bytes": {"input": self.bytes_input, "output": self.bytes_output},
            "n_lines": self.n_lines,
        }


def parse_rules(
    keep: Iterable[str] = (), spacing: Iterable[str] = (), drop: Iterable[str] = (), codes: ClassCodes | None = None
) -> tuple[ThinRule, ...]:
    """Turn what was typed into rules; noise is dropped unless a rule names it.

    Parameters
    ----------
    keep : iterable of str
        ``CLASS=FRACTION``, as ``ground=1/4`` or ``vegetation=0.5``.
    spacing : iterable of str
        ``CLASS=METRES``, as ``ground=0.1``.
    drop : iterable of str
        Classes of which nothing is kept.
    codes : ClassCodes, optional
        Codes of the class names; a class may be given by its number as well.

    Raises
    ------
    ConfigError
        When a class is unknown (the nearest is named) or named twice, or a number makes no sense.

    Examples
    --------
    >>> [str(rule) for rule in parse_rules(["ground=1/4"], ["building=0.1"])]
    ['ground=1/4', 'building=0.1 m', 'noise=0']
    """
    table = codes or ClassCodes()
    rules: list[ThinRule] = []
    for text in keep:
        name, value = _split(text, "--keep", "FRACTION", "ground=1/4")
        rules.append(ThinRule(name, _codes(name, "--keep", table), share=_share(text, value)))
    for text in spacing:
        name, value = _split(text, "--spacing", "METRES", "ground=0.1")
        rules.append(ThinRule(name, _codes(name, "--spacing", table), spacing_m=_metres(text, value)))
    rules.extend(ThinRule(name.strip(), _codes(name.strip(), "--drop", table), share=Fraction(0)) for name in drop)
    named = {code for rule in rules for code in rule.codes}
    left = tuple(code for code in _codes("noise", "noise", table) if code not in named)
    if left and table.noise not in named:
        rules.append(ThinRule("noise", left, share=Fraction(0)))
    seen: dict[int, str] = {}
    for rule in rules:
        for code in rule.codes:
            if code in seen:
                problem = f"class code {code} is named twice, as {seen[code]} and {rule}"
                raise ConfigError("classes to thin", problem, "give one rule a class")
            seen[code] = str(rule)
    return tuple(rules)


def _split(text: str, option: str, what: str, example: str) -> tuple[str, str]:
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise ConfigError(option, f"found {text!r}, expected CLASS={what}", f"for example {option} {example}")
    return name, value


def _share(text: str, value: str) -> Fraction:
    try:
        share = Fraction(value)
    except (ValueError, ZeroDivisionError):
        share = Fraction(-1)
    if not 0 <= share <= 1 or share.denominator > MAX_DENOMINATOR:
        problem = f"found {text!r}, expected a fraction from 0 to 1 with a denominator up to {MAX_DENOMINATOR}"
        raise ConfigError("--keep", problem, "for example --keep ground=1/4")
    return share


def _metres(text: str, value: str) -> float:
    try:
        metres = float(value)
    except ValueError:
        metres = math.nan
    if not 0 < metres <= MAX_SPACING_M:
        problem = f"found {text!r}, expected a distance above 0, up to {MAX_SPACING_M:g} m"
        raise ConfigError("--spacing", problem, "for example --spacing ground=0.1")
    return metres


def _codes(name: str, option: str, table: ClassCodes) -> tuple[int, ...]:
    """Return the codes of a class name or number."""
    names = {label.name.lower(): table.code(label) for label in Label if label is not Label.MISSING}
    if name.lower() == "noise":
        return tuple(dict.fromkeys((table.noise, HIGH_NOISE_CODE)))
    if name.lower() in names:
        return (names[name.lower()],)
    if name.isdecimal() and int(name) < 2**31:
        return (int(name),)
    near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.4)
    hint = f"did you mean {near[0]!r}?" if near else f"known classes: {', '.join(names)}, or a class code"
    raise ConfigError(option, f"unknown class {name!r}", hint)


def keep_by_pattern(line: NDArray[np.integer], column: NDArray[np.integer], share: Fraction) -> Mask:
    """Mark the shots that a share leaves: evenly along a line, shifted from line to line.

    Examples
    --------
    >>> grid = np.indices((4, 8))
    >>> keep_by_pattern(grid[0], grid[1], Fraction(1, 4)).astype(int)
    array([[1, 0, 0, 0, 1, 0, 0, 0],
           [0, 0, 1, 0, 0, 0, 1, 0],
           [1, 0, 0, 0, 1, 0, 0, 0],
           [0, 0, 1, 0, 0, 0, 1, 0]])
    """
    part, whole = share.numerator, share.denominator
    shift = max(round(_GOLDEN * whole / max(part, 1)), 1)
    place = (column.astype(np.int64) + shift * (line.astype(np.int64) % whole)) % whole
    kept: Mask = place * part % whole < part
    return kept


def keep_by_spacing(position_m: F64, chosen: Mask, spacing_m: float) -> Mask:
    """Mark along every line the first chosen shot and every next one that is far enough from the last one marked.

    Parameters
    ----------
    position_m : (lines, M, d) float64
        Coordinates [m], finite where chosen.
    chosen : (lines, M) bool
    spacing_m : float
        Least distance [m].

    Returns
    -------
    (lines, M) bool

    Examples
    --------
    >>> position = np.arange(6.0)[None, :, None]
    >>> keep_by_spacing(position, np.ones((1, 6), np.bool_), 2.5).astype(int)
    array([[1, 0, 0, 1, 0, 0]])
    """
    kept = np.zeros(chosen.shape, np.bool_)
    last = np.full((len(chosen), position_m.shape[2]), np.inf)
    # all lines together, column by column
    by_column = np.ascontiguousarray(position_m.transpose(1, 0, 2))
    for column in np.flatnonzero(chosen.any(axis=0)):
        away = ((by_column[column] - last) ** 2).sum(axis=1)
        taken = chosen[:, column] & ~(away < spacing_m**2)
        kept[taken, column] = True
        last[taken] = by_column[column][taken]
    return kept


@dataclass(slots=True)
class _Tally:
    """Returns by class code."""

    n_input: dict[int, int] = field(default_factory=dict)
    n_kept: dict[int, int] = field(default_factory=dict)

    def add(self, codes: I32, kept: Mask) -> None:
        """Count returns."""
        for into, part in ((self.n_input, codes), (self.n_kept, codes[kept])):
            for code, count in zip(*(found.tolist() for found in np.unique(part, return_counts=True)), strict=True):
                into[code] = into.get(code, 0) + count


def choose(item: StreamItem, codes: I32, extra_codes: I32, rules: tuple[ThinRule, ...]) -> tuple[Mask, Mask]:
    """Mark the returns of a block that stay.

    A further return follows the share of its own class in its own cell, or, under a spacing, the return that stands for
    its shot.

    Parameters
    ----------
    item : StreamItem
    codes : (lines, M) int32
        Class code of every cell.
    extra_codes : (n,) int32
        Class codes of the further returns.
    rules : tuple of ThinRule

    Returns
    -------
    kept : (lines, M) bool
        False where there is no range.
    kept_extra : (n,) bool
    """
    block, extra = item.block, item.block.extra
    kept = ~np.isnan(block.range_m)
    kept_extra = ~np.isnan(extra.range_m)
    line = (block.first_line + np.arange(block.n_lines, dtype=np.int64))[:, None]
    column = np.arange(block.points_per_line, dtype=np.int64)[None, :]
    spaced = np.zeros(len(extra), np.bool_)
    for rule in rules:
        chosen, chosen_extra = kept & np.isin(codes, rule.codes), np.isin(extra_codes, rule.codes)
        if rule.share is not None:
            kept &= ~chosen | keep_by_pattern(line, column, rule.share)
            if chosen_extra.any():
                cells = (extra.line.astype(np.int64) + block.first_line, extra.column)
                kept_extra &= ~chosen_extra | keep_by_pattern(*cells, rule.share)
        elif rule.spacing_m is not None:
            if chosen.any():
                kept &= ~chosen | keep_by_spacing(_positions(item), chosen, rule.spacing_m)
            spaced |= chosen_extra
    kept_extra &= ~spaced | kept[extra.line, extra.column]
    return kept, kept_extra


def _positions(item: StreamItem) -> F64:
    """Coordinates of every cell: relative to the scanner, else in the scan plane, else as registered."""
    block = item.block
    if block.xyz_m is not None:
        return block.xyz_m.astype(np.float64)
    if block.angle_rad is not None:
        ranges = block.range_m.astype(np.float64)
        return np.stack([ranges * np.cos(block.angle_rad), ranges * np.sin(block.angle_rad)], axis=-1)
    if item.registered_m is not None:
        return item.registered_m
    problem = "found neither scan angles nor coordinates, expected one of them to measure distances by"
    raise ConfigError("--spacing", problem, "give input.angle_start and input.angle_step, or thin with --keep")


def thin(
    source: Path | str,
    output: Path | str,
    rules: tuple[ThinRule, ...] | None = None,
    config: LoadedConfig | RunConfig | None = None,
    *,
    labels: Path | str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ThinningSummary:
    """Write a reduced stream; the output exists whole or not at all.

    Parameters
    ----------
    source : path
        Any readable input.
    output : path
        Any writable format. Between LAS and LAZ, records are left out and everything else stays as it is; classes are
        those of the input, also where others decided what is dropped.
    rules : tuple of ThinRule, optional
        From :func:`parse_rules`; default: noise is dropped.
    config : LoadedConfig or RunConfig, optional
        How the stream is found, and how it is classified under ``labels = "classify"``.
    labels : path or "classify", optional
        A label file, one code a record; or the classifier. Default: the classes of the input.
    overwrite : bool
        Replace an existing output.
    progress : callable, optional
        Called with the number of scan lines that were just finished.

    Returns
    -------
    ThinningSummary

    Raises
    ------
    ConfigError
        When there are no classes, or the lines of a LAS file could not be found again in the output.
    InputError, OutputError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    loaded = config if isinstance(config, LoadedConfig) else LoadedConfig(config or RunConfig())
    source, output = Path(source), Path(output)
    rules = parse_rules(codes=loaded.config.classes) if rules is None else rules
    label_file = Path(labels) if labels is not None and labels != CLASSIFY else None
    prepare_output(source, output, loaded, overwrite=overwrite, more=() if label_file is None else (label_file,))
    run = _Run(source, output, rules, loaded, label_file, classify=labels == CLASSIFY)
    before = source.stat()
    if suffix_of(source) in LAS_SUFFIXES and stream_suffix(output) in LAS_SUFFIXES:
        record = run.copy(progress, before.st_size, before.st_mtime_ns)
    else:
        record = run.write(progress, before.st_size, before.st_mtime_ns)
    return run.summary(record)


class _Run:
    """One call of :func:`thin`."""

    def __init__(
        self, source: Path, output: Path, rules: tuple[ThinRule, ...], loaded: LoadedConfig, labels: Path | None,
        *, classify: bool,
    ) -> None:  # fmt: skip
        self.source, self.output, self.rules, self.loaded = source, output, rules, loaded
        self.labels, self.classify = labels, classify
        self.tally = _Tally()
        self.facts = Facts(Counts.none())

    def copy(self, progress: Progress | None, size: int, mtime_ns: int) -> RunRecord:
        """Leave records out of a LAS or LAZ file."""
        las = read_las(self.source)
        check_copied(las)
        with contextlib.ExitStack() as stack:
            path = temporary_name(self.output)
            stack.callback(lambda: path.unlink(missing_ok=True))
            stays = Spool(path, np.uint8, 1, n_records=las.n_points)
            stack.callback(stays.close)
            with self._open(xyz=any(rule.spacing_m is not None for rule in self.rules)) as (opened, items):
                hints = _check_lines(self.source, opened)
                for item, codes, extra_codes in items:
                    kept, kept_extra = self._choose(item, codes, extra_codes)
                    block = item.block
                    gone = np.concatenate(
                        [block.records()[~kept & ~np.isnan(block.range_m)], block.extra.record[~kept_extra]]
                    )
                    stays.put(gone[gone >= 0], np.zeros(int((gone >= 0).sum()), np.uint8))
                    if progress is not None:
                        progress(block.n_lines)
                self._check_labels(opened.info)
                if len(set(self.facts.scanners.values())) > 1:
                    hints = (
                        *hints,
                        "lines of scanners differ in length: the highest column that is left is taken for it",
                    )
                record = self._record(opened.info, hints)
            temporary = stack.enter_context(atomic_output(self.output))
            notices = copy_las(
                las, self.output, temporary, lambda n: (part.view(np.bool_) for part in stays.chunks(n)), record
            )
            record = replace(record, notices=(*record.notices, *notices))
            check_unchanged(self.source, size, mtime_ns)
            with atomic_output(record_path(self.output)) as beside:
                beside.write_bytes(record.to_json())
        return record

    def write(self, progress: Progress | None, size: int, mtime_ns: int) -> RunRecord:
        """Write the stream anew without the shots that are dropped."""
        with self._open(xyz=True) as (opened, items):
            shape = replace(opened.shape, codes=True)
            with open_stream_writer(self.output, shape, compress=True) as writer:
                for item, codes, extra_codes in items:
                    kept, kept_extra = self._choose(item, codes, extra_codes)
                    writer.add_item(without(replace(item, codes=codes, extra_codes=extra_codes), kept, kept_extra))
                    if progress is not None:
                        progress(item.block.n_lines)
                self._check_labels(opened.info)
                opened = replace(opened, shape=shape)
                losses = tuple(f"not kept: {loss}" for loss in find_losses(self.output, opened, self.facts))
                hints = (*losses, *how_to_read(self.output, opened, self.facts))
                record = self._record(opened.info, hints)
                check_unchanged(self.source, size, mtime_ns)
                return writer.finish(record)

    def summary(self, record: RunRecord) -> ThinningSummary:
        """Return what was done, the bytes saved shared out by the returns dropped."""
        names = self.loaded.config.classes.names()
        bytes_input = self.source.stat().st_size
        bytes_output = sum(path.stat().st_size for path in outputs_of(self.output)[:-1])
        counts = [(code, n, self.tally.n_kept.get(code, 0)) for code, n in sorted(self.tally.n_input.items())]
        n_dropped = sum(n - kept for _, n, kept in counts)
        saved = bytes_input - bytes_output
        classes = tuple(
            ClassSaving(
                code,
                "none" if code == NO_CODE else names.get(code, f"class {code}"),
                n,
                kept,
                round(saved * (n - kept) / n_dropped) if n_dropped else 0,
            )
            for code, n, kept in counts
        )
        rules = tuple(str(rule) for rule in self.rules)
        n_lines = self.facts.counts.n_lines
        return ThinningSummary(self.output, record, classes, rules, bytes_input, bytes_output, n_lines)

    @contextlib.contextmanager
    def _open(self, *, xyz: bool) -> Iterator[tuple[OpenedItems, Iterator[tuple[StreamItem, I32, I32]]]]:
        """Open the stream with the class codes of every block, wherever they come from."""
        labelled: dict[int, tuple[I32, I32]] = {}

        def blocks_of(stream: ScanStream) -> Iterator[ScanBlock]:
            config = self.loaded.config
            if not self.classify:
                yield from stream.blocks()
                return
            if config.method == SEQUENTIAL_ANGLE:
                stream = with_beams(stream, config.input)
            lookup = config.classes.lookup().astype(np.int32)
            lookup[Label.MISSING] = NO_CODE
            for item in label_blocks(stream.blocks(), config.classifier):
                labelled[id(item.block)] = lookup[item.labels], lookup[item.extra_labels]
                yield item.block

        own = self.labels is None and not self.classify
        with contextlib.ExitStack() as stack:
            given = None if self.labels is None else self._read_labels(self.labels, stack)
            opened = stack.enter_context(
                open_items(self.source, self.output, self.loaded, blocks_of=blocks_of, codes=own, xyz=xyz)
            )
            if own and not opened.shape.codes:
                problem = "no class codes in the input, and none were given"
                hint = "give --labels FILE, or --preset or --config to classify on the way"
                raise ConfigError(str(self.source), problem, hint)

            def items() -> Iterator[tuple[StreamItem, I32, I32]]:
                for item in opened.items:
                    self.facts = self.facts.add(item.block)
                    if given is not None:
                        yield item, given.get(item.block.records()), given.get(item.block.extra.record)
                    elif self.classify:
                        yield item, *labelled.pop(id(item.block))
                    elif item.codes is not None and item.extra_codes is not None:
                        yield item, item.codes, item.extra_codes

            yield opened, items()

    def _read_labels(self, path: Path, stack: contextlib.ExitStack) -> RecordValues:
        """Put the codes of a label file where they can be asked for by record."""
        codes = open_codes(path)
        place = temporary_name(self.output)
        stack.callback(lambda: place.unlink(missing_ok=True))
        values = RecordValues(place, np.dtype("<i4"), NO_CODE)
        stack.callback(values.close)
        for chunk in codes.chunks():
            values.append(np.where(np.abs(chunk) < 2**31, chunk, NO_CODE).astype(np.int32))
        self._n_labels = len(values)
        return values

    def _choose(self, item: StreamItem, codes: I32, extra_codes: I32) -> tuple[Mask, Mask]:
        kept, kept_extra = choose(item, codes, extra_codes, self.rules)
        there = ~np.isnan(item.block.range_m)
        self.tally.add(codes[there], kept[there])
        self.tally.add(extra_codes, kept_extra)
        return kept, kept_extra

    def _check_labels(self, info: StreamInfo) -> None:
        """Refuse a label file of another length than the input."""
        if self.labels is None:
            return
        n_records = info.n_records if info.n_records is not None else self.facts.counts.tally.n_records
        if self._n_labels != n_records:
            problem = f"found {self._n_labels} labels, expected {n_records}, one a record of {self.source.name}"
            raise InputError(str(self.labels), problem, "give the labels of this file")

    def _record(self, info: StreamInfo, hints: tuple[str, ...]) -> RunRecord:
        """Return the run record, which says that and how shots were dropped."""
        tally, told = self.tally, []
        for rule in self.rules:
            n = sum(tally.n_input.get(code, 0) for code in rule.codes)
            n_kept = sum(tally.n_kept.get(code, 0) for code in rule.codes)
            if n:
                told.append(f"{rule.name}: {n - n_kept} of {n} dropped ({rule})")
            elif rule.share != 0 or rule.name != "noise":
                told.append(f"{rule.name}: no return has this class (code {', '.join(map(str, rule.codes))})")
        if not sum(tally.n_kept.values()):
            problem = f"all {sum(tally.n_input.values())} returns would be dropped, expected some to stay"
            raise ConfigError(str(self.source), problem, "keep more: --keep noise=1, or other classes")
        dropped = sum(tally.n_input.values()) - sum(tally.n_kept.values())
        note = f"thinned: {dropped} of {sum(tally.n_input.values())} returns were dropped and are missing in this file"
        record = run_record(info, self.facts.counts, self.loaded)
        record = replace(record, notices=(*record.notices, note, *told, *hints))
        return record_of_scanners(record, self.facts)


def without(item: StreamItem, kept: Mask, kept_extra: Mask) -> StreamItem:
    """Return a block without the returns that are dropped; where others of a shot stay, the nearest takes its cell."""
    block, extra = item.block, item.block.extra
    range_m = np.where(kept, block.range_m, np.float32(np.nan))
    xyz = None if block.xyz_m is None else np.where(kept[..., None], block.xyz_m, np.float32(np.nan))
    intensity = None if block.intensity is None else np.where(kept, block.intensity, np.float32(np.nan))
    codes = None if item.codes is None else np.where(kept, item.codes, np.int32(NO_CODE))
    registered = None if item.registered_m is None else np.where(kept[..., None], item.registered_m, np.nan)
    stays = np.flatnonzero(kept_extra)
    orphans = stays[np.isnan(range_m[extra.line[stays], extra.column[stays]])]
    if len(orphans):
        heirs = _first_of_cell(extra, orphans, block.points_per_line)
        at = (extra.line[heirs], extra.column[heirs])
        range_m[at] = extra.range_m[heirs]
        if xyz is not None and block.xyz_m is not None:
            xyz[at] = block.xyz_m[at] * (extra.range_m[heirs] / block.range_m[at])[:, None]
        if codes is not None and item.extra_codes is not None:
            codes[at] = item.extra_codes[heirs]
        if registered is not None and item.extra_registered_m is not None:
            registered[at] = item.extra_registered_m[heirs]
        stays = np.setdiff1d(stays, heirs)
    left = ExtraReturns(extra.line[stays], extra.column[stays], extra.range_m[stays], extra.record[stays])
    return StreamItem(
        replace(block, range_m=range_m, xyz_m=xyz, intensity=intensity, extra=left),
        codes,
        None if item.extra_codes is None else item.extra_codes[stays],
        registered,
        None if item.extra_registered_m is None else item.extra_registered_m[stays],
    )


def _first_of_cell(extra: ExtraReturns, which: I64, points_per_line: int) -> I64:
    """Return the nearest of some further returns for every cell."""
    cell = extra.line[which].astype(np.int64) * points_per_line + extra.column[which]
    order = np.lexsort((extra.range_m[which], cell))
    first = np.unique(cell[order], return_index=True)[1]
    return which[order[first]]


def _check_lines(source: Path, opened: OpenedItems) -> tuple[str, ...]:
    """Refuse a LAS file whose cells follow from the order of its records; say what else has to be given to read it.

    Raises
    ------
    ConfigError
        When records cannot be left out without moving others to another cell.
    """
    grid = opened.grid
    if grid is None:
        by = "the records around them"
    elif grid.rules.lines == "fixed" or grid.rules.columns == "order":
        by = "their order"
    elif grid.rules.columns == "time" and grid.rules.line_hz is None:
        by = "the first return of their line"
    else:
        return _needed(grid)
    problem = f"the cells of shots follow from {by}, so that leaving records out would move others"
    raise ConfigError(str(source), problem, "write .csv.gz, .npz or .parquet, which keep the cells")


def _needed(grid: GridStream) -> tuple[str, ...]:
    """Say which values the reader found in all records have to be given for the thinned ones."""
    rules, told = grid.rules, []
    config = rules.config
    if rules.line_hz is not None and config.time_origin is None:
        first = next(iter(grid.source.chunks(("time",)))).values["time"]
        told.append(f"read it with --set input.time_origin={float(first[0])!r}")
    if rules.columns == "time":
        told.append("columns follow from the times: shots that share a stamp may move by a column")
    if rules.columns == "angle" and (config.angle_start is None or config.angle_step is None):
        for setup in grid.setups.values():
            if setup.angle_grid is not None:
                start, step = math.degrees(setup.angle_grid.start_rad), math.degrees(setup.angle_grid.step_rad)
                told.append(f"read it with --set input.angle_start={start!r} --set input.angle_step={step!r}")
    return tuple(dict.fromkeys(told))


__all__ = ["CLASSIFY", "ClassSaving", "ThinRule", "ThinningSummary", "parse_rules", "thin"]
