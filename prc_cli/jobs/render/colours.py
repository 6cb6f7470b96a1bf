"""Colours of pictures: class tables, label files, scales of values, sources of labels."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from prc_cli.config import LoadedConfig, preset_of
from prc_cli.core.classes import LABEL_COLOURS, LABEL_NAMES, NO_CODE, ClassCodes, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import I64, U8, Mask
from prc_cli.core.version import __version__
from prc_cli.evaluation.mapping import ClassMapping, Side, load_mapping
from prc_cli.formats.labels import open_codes
from prc_cli.formats.writing.record import PROGRAM, record_path
from prc_cli.imaging.page import HandLabels, PaintedClass
from prc_cli.imaging.pictures import (
    MISSING_COLOUR,
    NOT_SCORED_COLOUR,
    Bar,
    Limits,
    critical_picture,
    range_bar,
    range_limits,
    range_picture,
    value_bar,
    value_limits,
    value_picture,
)
from prc_cli.imaging.sheet import Colour, Key
from prc_cli.jobs.render.options import RenderOptions

NOT_SCORED = "not scored"
MAX_CLASSES = 250
LARGEST_RECORD = 4 << 20
"""Larger run records are not read [bytes]."""


class Scale(NamedTuple):
    """How a value is coloured."""

    limits: Callable[..., Limits]
    picture: Callable[..., U8]
    bar: Callable[[Limits], Bar]


SCALES = {
    "range": Scale(range_limits, range_picture, range_bar),
    "critical": Scale(range_limits, critical_picture, partial(range_bar, rises=True)),
    "intensity": Scale(value_limits, value_picture, partial(value_bar, unit="")),
    "ground": Scale(value_limits, value_picture, partial(value_bar, unit="m")),
    "height": Scale(value_limits, value_picture, partial(value_bar, unit="m")),
    # per cent; lower values are drawn as 50
    "confidence": Scale(lambda _: Limits(50.0, 100.0), value_picture, partial(value_bar, unit="%")),
}


@dataclass(frozen=True, slots=True)
class ClassTable:
    """Names and colours of classes; index 0 = no class."""

    names: tuple[str, ...]
    colours: U8
    """(n, 3) uint8."""

    def colour(self, place: int) -> Colour:
        """Return the colour of a class."""
        red, green, blue = self.colours[place].tolist()
        return red, green, blue

    def drawn(self, counts: I64) -> list[int]:
        """Return the classes that occur."""
        return [i for i in range(1, len(self.names)) if counts[i]]

    def key(self, counts: I64) -> Key:
        """Return names, shares of the classified records, and colours of the classes that occur."""
        total = max(int(counts[self.drawn(counts)].sum()), 1)
        return tuple(
            (f"{self.names[i]} {share_text(int(counts[i]), total)}", self.colour(i))
            for i in self.drawn(counts)
        )

    def count_by_name(self, counts: I64) -> dict[str, int]:
        """Return the counts of the classes that occur."""
        return {name: int(count) for name, count in zip(self.names, counts, strict=False) if count}


def share_text(count: int, total: int) -> str:
    """Write a share in per cent.

    >>> share_text(1, 3), share_text(1, 100_000)
    ('33.3 %', '<0.1 %')
    """
    share = 100 * count / total
    return "<0.1 %" if 0 < share < 0.05 else f"{share:.1f} %"


LABEL_TABLE = ClassTable(LABEL_NAMES, np.array([LABEL_COLOURS[label] for label in Label], np.uint8))
"""The classes of prc, in the order of :class:`~prc_cli.core.classes.Label`."""
ASPRS = {
    3: Label.VEGETATION,
    4: Label.VEGETATION,
    5: Label.VEGETATION,
    2: Label.GROUND,
    6: Label.BUILDING,
    7: Label.NOISE,
    11: Label.GROUND,
    18: Label.NOISE,
}
"""Codes of LAS 1.4, table 17, that have a counterpart among the classes of prc."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The classes to show and compare two sides."""

    table: ClassTable
    mapping: ClassMapping | None
    codes: ClassCodes

    @property
    def unscored(self) -> int:
        """Index of returns without a class, the last one of the table."""
        return len(self.table.names) - 1

    @property
    def noise(self) -> set[int]:
        """Indices of noise."""
        return {i for i, name in enumerate(self.table.names) if name == LABEL_NAMES[Label.NOISE]}

    def hand_labels(
        self, labelled: Path, n_records: int | None, *, digest: str = "", predicted: str = ""
    ) -> HandLabels:
        """Return what a page needs to label a file by hand.

        ``digest`` is that of the file, ``predicted`` the name that the evaluation takes.
        """
        name = f"{labelled.stem}_labels.csv"
        command = shlex.join(["prc", "evaluate", predicted or labelled.name, name])
        return HandLabels(self._painted(), digest, labelled.name, n_records, name, command)

    def _painted(self) -> list[PaintedClass]:
        if self.mapping is None:
            labels = [label for label in Label if label > Label.UNCLASSIFIED]
            codes = {LABEL_NAMES[label]: self.codes.code(label) for label in labels}
        else:
            codes = self.mapping.first_codes("reference")
        colours = {name: self.table.colour(k) for k, name in enumerate(self.table.names)}
        return [PaintedClass(code, name, colours[name]) for name, code in codes.items()]

    def mark_unscored(self, places: U8, seen: Mask) -> U8:
        """Give returns without a class the last index; all arrays have one shape."""
        return np.where((places == 0) & seen, np.uint8(self.unscored), places)

    def turn(self, codes: I64, side: Side) -> U8:
        """Convert class codes of a side to indices of the table."""
        if self.mapping is None:
            return self._turn_configured(codes, side)
        names = self.mapping.names(side)
        places = np.array([0, *(self.table.names.index(name) for name in names)], np.uint8)
        turned: U8 = places[self.mapping.class_indices(codes, side) + 1]
        return turned

    def _turn_configured(self, codes: I64, side: Side) -> U8:
        # by the codes of [classes]
        known = np.full(257, 255, np.uint8)
        for label in reversed(Label):  # the first label of a code wins
            known[self.codes.code(label)] = label
        known[256] = Label.MISSING
        inside = (codes >= NO_CODE) & (codes < 256)
        turned: U8 = known[np.where(inside, np.where(codes == NO_CODE, 256, codes), 255)]
        wrong = ~inside | ((turned == 255) & (codes != NO_CODE))
        if wrong.any():
            distinct = np.unique(codes[wrong])
            shown = ", ".join(str(code) for code in distinct[:8])
            if distinct.size > 8:
                shown += ", ..."
            problem = (
                f"found {np.count_nonzero(wrong)} records with codes that are none of [classes]: "
                f"{shown}"
            )
            raise InputError(
                f"{side} codes", problem, "add --mapping NAME|FILE.toml, which says what they mean"
            )
        return turned

    def turn_las(self, codes: I64) -> U8:
        """Convert classes of a LAS file: codes of prc, then of ASPRS; others are unclassified."""
        if self.mapping is not None:
            return self.turn(codes, "predicted")
        table = np.full(256, Label.UNCLASSIFIED, np.uint8)
        for code, label in ASPRS.items():
            table[code] = label
        for label in reversed(Label):
            table[self.codes.code(label)] = label
        turned: U8 = table[np.clip(codes, 0, 255)]
        return turned

    def turn_labels(self, labels: U8) -> U8:
        """Convert labels of prc to indices of the table, as on the predicted side."""
        if self.mapping is None:
            return labels
        lookup = self.codes.lookup().astype(np.int64)
        turned = np.zeros(len(Label), np.uint8)
        for label in np.flatnonzero(np.bincount(labels.ravel(), minlength=len(Label))):
            if label != Label.MISSING:
                turned[label] = self.turn(lookup[label : label + 1], "predicted")[0]
        labels_of_table: U8 = turned[labels]
        return labels_of_table

    def read(
        self,
        path: Path,
        dimension: str | None,
        side: Side | Literal["las"],
        folder: Path,
    ) -> RecordClasses:
        """Read a label file once; keep its classes in a file of one byte per record."""
        n = 0
        target = folder / f"{side}.classes"
        with target.open("wb") as handle:
            for codes in open_codes(path, dimension).codes():
                turned = self.turn_las(codes) if side == "las" else self.turn(codes, side)
                turned.tofile(handle)
                n += len(turned)
        if not n:
            raise InputError(str(path), "no labels, expected one a record", _HINT)
        return RecordClasses(str(path), np.memmap(target, np.uint8, "r", shape=(n,)))


def vocabulary(options: RenderOptions, codes: ClassCodes) -> Vocabulary:
    """Return the classes of prc, or of the mapping."""
    mapping = None
    names = LABEL_NAMES[1:]
    if options.mapping is not None:
        mapping = load_mapping(options.mapping)
        mapped = dict.fromkeys((*mapping.names("reference"), *mapping.names("predicted")))
        # the classes of prc first, in their order
        names = (
            *(name for name in LABEL_NAMES if name in mapped),
            *(name for name in mapped if name not in LABEL_NAMES),
        )
        if len(names) > MAX_CLASSES:
            raise InputError(
                "class mapping", f"found {len(names)} classes, at most {MAX_CLASSES} can be drawn"
            )
    colour_of = {LABEL_NAMES[label]: LABEL_COLOURS[label] for label in Label}
    colours = [
        MISSING_COLOUR,
        *(colour_of.get(name, LABEL_COLOURS[Label.UNCLASSIFIED]) for name in names),
        NOT_SCORED_COLOUR,
    ]
    table = ClassTable(
        (LABEL_NAMES[Label.MISSING], *names, NOT_SCORED), np.array(colours, np.uint8)
    )
    return Vocabulary(table, mapping, codes)


_HINT = "give the labels of this very file, in its order of records"


@dataclass(frozen=True, slots=True)
class RecordClasses:
    """The class of every record of an input."""

    path: str
    places: U8
    """(records,) uint8, indices of the class table; memory-mapped."""

    def look_up(self, record: I64) -> U8:
        """Return the class of records, (...) int64 to (...) uint8; -1 = none."""
        last = int(record.max(initial=-1))
        if last >= len(self.places):
            raise InputError(
                self.path,
                f"found {len(self.places):,} labels, but the input has record {last:,}",
                _HINT,
            )
        classes: U8 = np.where(record >= 0, self.places[np.maximum(record, 0)], np.uint8(0))
        return classes

    def check(self, n_records: int | None) -> None:
        """Refuse labels of another length than the input."""
        if n_records is not None and n_records != len(self.places):
            problem = (
                f"found {len(self.places):,} labels, expected {n_records:,}, "
                "one a record of the input"
            )
            raise InputError(self.path, problem, _HINT)


EPOCH = "SOURCE_DATE_EPOCH"
"""Variable with the day, so that equal runs give equal bytes [seconds since 1970, UTC].

Specified by reproducible-builds.org.
"""


def today() -> str:
    """Return the day in UTC, or the day of ``SOURCE_DATE_EPOCH`` if it is set.

    >>> len(today())
    10
    """
    seconds = os.environ.get(EPOCH)
    if not seconds:
        return f"{datetime.now(UTC):%Y-%m-%d}"
    try:
        return f"{datetime.fromtimestamp(int(seconds), UTC):%Y-%m-%d}"
    except (ValueError, OverflowError, OSError) as error:
        problem = f"found {seconds!r}, expected whole seconds since 1970"
        raise ConfigError(EPOCH, problem, "unset the variable, or set it to a number") from error


def heading(*parts: str) -> str:
    """Return a headline that ends with the day; empty parts are left out."""
    return " · ".join(filter(None, (*parts, today())))


def thinned(step: tuple[int, int]) -> str:
    """Describe the lines and columns that are drawn.

    >>> thinned((3, 2))
    '1 line of 3 and 1 column of 2'
    """
    return " and ".join(
        f"1 {name} of {n}" for name, n in zip(("line", "column"), step, strict=True) if n > 1
    )


def made_with(loaded: LoadedConfig) -> str:
    """Return the preset, or else the method, that classifies a file.

    >>> from prc_cli.config import load_config
    >>> made_with(load_config(preset="prc-2019-forest"))
    'preset prc-2019-forest'
    >>> made_with(load_config(options={"method": "prc"}))
    'prc, urban'
    """
    preset = preset_of(loaded)
    config = loaded.config
    if preset is not None:
        return f"preset {preset}"
    return f"prc, {config.prc.environment}" if config.method == "prc" else str(config.method)


def made_by(labels: Path) -> str:
    """Return the method in the run record beside a label file; empty without a record."""
    return _method_of(_record_of(labels))


def labels_of(labels: Path) -> str:
    """Return the name of a label file, and the method in its run record."""
    return ", ".join(filter(None, (f"labels of {labels.name}", made_by(labels))))


def origin(labels: Sequence[Path]) -> tuple[str, ...]:
    """Return day, version, methods and inputs for a page about label files.

    Methods and inputs are those of the run records.
    """
    records = [_record_of(path) for path in labels]
    methods = dict.fromkeys(filter(None, (_method_of(record) for record in records)))
    inputs = dict.fromkeys(
        filter(None, (_text(record, "input", "name", 200) for record in records))
    )
    source = "".join(f"input {name}" for name in inputs)
    if len(inputs) > 1:
        source = f"{len(inputs):,} inputs"
    return tuple(filter(None, (today(), f"prc {__version__}", ", ".join(methods), source)))


def _record_of(labels: Path) -> Mapping[str, Any]:
    # empty without a readable record: a picture does not need it
    with suppress(OSError, ValueError, RecursionError):
        path = record_path(labels)
        if path.stat().st_size <= LARGEST_RECORD:
            record = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(record, Mapping) and record.get("program") == PROGRAM:
                return record
    return {}


def _method_of(record: Mapping[str, Any]) -> str:
    for assumption in record.get("assumptions") or ():
        if isinstance(assumption, Mapping) and assumption.get("key") == "method":
            return str(assumption.get("value", ""))[:80]
    return _text(record, "config", "method", 80)


def _text(
    record: Mapping[str, Any],
    table: str,
    key: str,
    most: int,
) -> str:
    values = record.get(table)
    text = values.get(key) if isinstance(values, Mapping) else None
    return text[:most] if isinstance(text, str) else ""
