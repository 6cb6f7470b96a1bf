"""Classes of records from label files, cached on disk as one byte per record for random access."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import LABEL_COLOURS, LABEL_NAMES, ClassCodes, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import I64, U8, Mask
from prc_cli.evaluation.mapping import ClassMapping, Side, load_mapping
from prc_cli.formats.labels import NO_CODE, open_codes
from prc_cli.imaging.pictures import MISSING_COLOUR, NOT_SCORED_COLOUR
from prc_cli.jobs.render.options import RenderOptions

NOT_SCORED = "not scored"
UNCLASSIFIED_COLOUR = LABEL_COLOURS[Label.UNCLASSIFIED]
MAX_CLASSES = 250


@dataclass(frozen=True, slots=True)
class ClassTable:
    """Names and colours of classes; index 0 means none."""

    names: tuple[str, ...]
    colours: U8
    """(n, 3) uint8."""
    hidden: frozenset[int] = frozenset()
    """Indices of classes that are not drawn."""

    def without(self, names: Collection[str]) -> ClassTable:
        """Return the table with some classes hidden, if it has them; they are white in pictures of lines.

        >>> sorted(LABEL_TABLE.without(["noise"]).hidden)
        [2]
        """
        hidden = frozenset(place for place, name in enumerate(self.names) if place and name in names)
        colours = self.colours.copy()
        colours[sorted(hidden)] = MISSING_COLOUR
        return replace(self, colours=colours, hidden=hidden)

    def key(self, counts: I64) -> tuple[tuple[str, tuple[int, int, int]], ...]:
        """Return names and colours of the classes that occur, with their shares of all classified records."""
        drawn = [place for place in range(1, len(self.names)) if counts[place] and place not in self.hidden]
        total = max(int(counts[drawn].sum()), 1)
        return tuple(
            (f"{self.names[place]} {share_text(int(counts[place]), total)}", _as_colour(self.colours[place]))
            for place in drawn
        )


def _as_colour(colour: U8) -> tuple[int, int, int]:
    return int(colour[0]), int(colour[1]), int(colour[2])


def share_text(count: int, total: int) -> str:
    """Write a share in per cent.

    >>> share_text(1, 3), share_text(1, 100_000)
    ('33.3 %', '<0.1 %')
    """
    share = 100 * count / total
    return "<0.1 %" if 0 < share < 0.05 else f"{share:.1f} %"


LABEL_TABLE = ClassTable(LABEL_NAMES, np.array([LABEL_COLOURS[label] for label in Label], np.uint8))
"""The program's own classes, in the order of :class:`~prc_cli.core.classes.Label`."""


ASPRS = {
    3: Label.VEGETATION, 4: Label.VEGETATION, 5: Label.VEGETATION, 2: Label.GROUND, 6: Label.BUILDING, 7: Label.NOISE,
    11: Label.GROUND, 18: Label.NOISE,
}  # fmt: skip
"""Codes of LAS 1.4, table 17, that have a counterpart among the program's classes."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The classes used to show and compare two sides."""

    table: ClassTable
    mapping: ClassMapping | None
    codes: ClassCodes

    @property
    def unscored(self) -> int:
        """Index of returns without a class, the last one of the table."""
        return len(self.table.names) - 1

    def mark_unscored(self, places: U8, seen: Mask) -> U8:
        """Give returns without a class their own index, (...) uint8 and (...) bool to (...) uint8."""
        return np.where((places == 0) & seen, np.uint8(self.unscored), places)

    def turn(self, codes: I64, side: Side) -> U8:
        """Convert class codes of a side to indices of the table."""
        if self.mapping is None:
            return self._own(codes, side)
        names = self.mapping.names(side)
        places = np.array([0, *(self.table.names.index(name) for name in names)], np.uint8)
        found: U8 = places[self.mapping.class_indices(codes, side) + 1]
        return found

    def _own(self, codes: I64, side: Side) -> U8:
        known = np.full(257, 255, np.uint8)
        for label in reversed(Label):  # the first label of a code wins
            known[self.codes.code(label)] = label
        known[256] = Label.MISSING
        inside = (codes >= NO_CODE) & (codes < 256)
        found: U8 = known[np.where(inside, np.where(codes == NO_CODE, 256, codes), 255)]
        wrong = ~inside | ((found == 255) & (codes != NO_CODE))
        if wrong.any():
            distinct = np.unique(codes[wrong])
            shown = ", ".join(str(code) for code in distinct[:8]) + (", ..." if distinct.size > 8 else "")
            problem = f"found {np.count_nonzero(wrong)} records with codes that are none of [classes]: {shown}"
            where = f"{side} codes"
            raise InputError(where, problem, "add --mapping NAME|FILE.toml, which says what they mean")
        return found

    def turn_las(self, codes: I64) -> U8:
        """Convert classes of a LAS file: the program's own codes first, then ASPRS codes; others are unclassified."""
        if self.mapping is not None:
            return self.turn(codes, "predicted")
        table = np.full(256, Label.UNCLASSIFIED, np.uint8)
        for code, label in ASPRS.items():
            table[code] = label
        for label in reversed(Label):
            table[self.codes.code(label)] = label
        found: U8 = table[np.clip(codes, 0, 255)]
        return found

    def turn_labels(self, labels: U8) -> U8:
        """Convert labels of the program to indices of the table, as on the predicted side."""
        if self.mapping is None:
            return labels
        lookup = self.codes.lookup().astype(np.int64)
        turned = np.zeros(len(Label), np.uint8)
        for label in np.flatnonzero(np.bincount(labels.ravel(), minlength=len(Label))):
            if label != Label.MISSING:
                turned[label] = self.turn(lookup[label : label + 1], "predicted")[0]
        found: U8 = turned[labels]
        return found


def vocabulary(options: RenderOptions, codes: ClassCodes) -> Vocabulary:
    """Return the classes of a run: the program's own, or those of a mapping."""
    words = _vocabulary(options, codes)
    known = words.table.names[1:]
    for name in options.hide:
        if name not in known:
            raise ConfigError("--hide", f"found {name!r}, expected classes: {', '.join(known)}")
    return replace(words, table=words.table.without(options.hide))


def _vocabulary(options: RenderOptions, codes: ClassCodes) -> Vocabulary:
    if options.mapping is None:
        return Vocabulary(
            ClassTable(
                (*LABEL_NAMES, NOT_SCORED), np.vstack([LABEL_TABLE.colours, NOT_SCORED_COLOUR]).astype(np.uint8)
            ),
            None,
            codes,
        )
    mapping = load_mapping(options.mapping)
    names = dict.fromkeys((*mapping.names("reference"), *mapping.names("predicted")))
    # the program's own classes first, in their order, then unknown ones
    ordered = sorted(names, key=lambda name: LABEL_NAMES.index(name) if name in LABEL_NAMES else len(LABEL_NAMES))
    if len(ordered) > MAX_CLASSES:
        where = "class mapping"
        raise InputError(where, f"found {len(ordered)} classes, at most {MAX_CLASSES} can be drawn")
    colours = [LABEL_COLOURS[Label.MISSING]]
    colours += [
        LABEL_COLOURS[Label(LABEL_NAMES.index(name))] if name in LABEL_NAMES else UNCLASSIFIED_COLOUR
        for name in ordered
    ]
    names_of = (LABEL_NAMES[Label.MISSING], *ordered, NOT_SCORED)
    return Vocabulary(ClassTable(names_of, np.array([*colours, NOT_SCORED_COLOUR], np.uint8)), mapping, codes)


@dataclass(frozen=True, slots=True)
class RecordClasses:
    """The class of every record of an input."""

    path: str
    places: NDArray[np.uint8]
    """(records,) uint8, indices of the class table; memory-mapped."""

    def look_up(self, record: I64) -> U8:
        """Return the class of records, (...) int64 to (...) uint8; -1 = none."""
        last = int(record.max(initial=-1))
        if last >= len(self.places):
            raise InputError(self.path, f"found {len(self.places):,} labels, but the input has record {last:,}", _HINT)
        found: U8 = np.where(record >= 0, self.places[np.maximum(record, 0)], np.uint8(0))
        return found

    def check(self, n_records: int | None) -> None:
        """Refuse labels of another length than the input."""
        if n_records is not None and n_records != len(self.places):
            problem = f"found {len(self.places):,} labels, expected {n_records:,}, one a record of the input"
            raise InputError(self.path, problem, _HINT)


_HINT = "give the labels of this very file, in its order of records"


def read_classes(
    path: Path, dimension: str | None, turn: Callable[[I64], U8], folder: Path, name: str
) -> RecordClasses:
    """Read a label file once and keep its classes in a file of one byte per record."""
    source = open_codes(path, dimension)
    target = folder / name
    n = 0
    with target.open("wb") as handle:
        for codes in source.chunks():
            turned = turn(codes)
            turned.tofile(handle)
            n += len(turned)
    if not n:
        raise InputError(str(path), "no labels, expected one a record", _HINT)
    return RecordClasses(str(path), np.memmap(target, np.uint8, "r", shape=(n,)))
