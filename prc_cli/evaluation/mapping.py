"""Class mappings: which codes mean which class, on the predicted and on the reference side.

A mapping is a TOML file; a few come with the package.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, StringConstraints, field_validator, model_validator

from prc_cli.core.classes import NO_CODE
from prc_cli.core.config import Params, build, read_toml, samples_folder
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.near import did_you_mean, same_name
from prc_cli.core.types import I64

Side: TypeAlias = Literal["predicted", "reference"]
ClassName: TypeAlias = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_ -]*$")]
Codes: TypeAlias = tuple[int | str, ...]

OTHER = "other"
"""Name of the row or column without a counterpart; it is shown and counted but can never agree."""

MAX_CODE = 2**32 - 1
IGNORED = -1
_UNLISTED = -2
_TABLE_SIZE = 2**16
_SHOWN = 8


class ClassMapping(Params):
    """Which codes mean which class.

    Classes with the same name on both sides are scored. A class of one side only is kept as a row
    or a column and never agrees with anything, like the row "Other" of Lehtola et al. (2019), Table
    I.

    >>> mapping = ClassMapping(
    ...     predicted={"ground": [2]}, reference={"ground": ["1200-1206"], "car": [1501]}
    ... )
    >>> mapping.scored_names
    ('ground',)
    >>> mapping.class_indices(np.array([1203, 1501]), "reference")
    array([0, 1])
    """

    unlisted: Literal["error", "other", "ignore"] = Field(
        "error",
        description=(
            "codes that stand in no list: refuse the file, count them as other, "
            "or do not score them"
        ),
    )
    ignore: Codes = Field(
        (), description="codes of either side that are not scored, for example 0 = missing"
    )
    ignore_reference: Codes = Field(
        (), description="codes of the reference alone that are not scored"
    )
    coarser: dict[ClassName, ClassName] = Field(
        {},
        description=(
            "predicted class = the predicted class it counts as where the reference never has it"
        ),
    )
    predicted: dict[ClassName, Codes] = Field(
        description="class name = list of predicted codes, or ranges 'a-b'"
    )
    reference: dict[ClassName, Codes] = Field(
        description="class name = list of reference codes, or ranges 'a-b'"
    )

    @field_validator("ignore", "ignore_reference")
    @classmethod
    def _check_ignored(cls, codes: Codes) -> Codes:
        for code in codes:
            _span(code)
        return codes

    @field_validator("predicted", "reference")
    @classmethod
    def _check_side(cls, side: dict[str, Codes]) -> dict[str, Codes]:
        if not side:
            problem = "at least one class with its codes"
            raise ValueError(problem)
        for codes in side.values():
            cls._check_ignored(codes)
        return side

    @model_validator(mode="after")
    def _check_both(self) -> ClassMapping:
        sides: tuple[Side, Side] = ("predicted", "reference")
        for side in sides:
            for (_, last, name), (first, _, second_name) in pairwise(sorted(self._spans(side))):
                if first <= last:
                    problem = (
                        f"every {side} code listed once, but {first} stands under {name!r} "
                        f"and again under {second_name!r}"
                    )
                    raise ValueError(problem)
        for name in (name for pair in self.coarser.items() for name in pair):
            if name not in self.names("predicted"):
                problem = f"classes of [predicted] in coarser, found {name!r}"
                raise ValueError(problem)
        if not self.scored_names:
            problem = "at least one class name that stands under both [predicted] and [reference]"
            raise ValueError(problem)
        return self

    def names(self, side: Side) -> tuple[str, ...]:
        """Class names of one side, in the order of the file.

        ``other`` last where unlisted codes go there.
        """
        listed = tuple(self.predicted if side == "predicted" else self.reference)
        return (*listed, OTHER) if self.unlisted == "other" and OTHER not in listed else listed

    def first_codes(self, side: Side) -> dict[str, int]:
        """Return the first code of every class of a side but ``other``."""
        listed = self.predicted if side == "predicted" else self.reference
        return {
            name: _span(codes[0])[0] for name, codes in listed.items() if codes and name != OTHER
        }

    @property
    def scored_names(self) -> tuple[str, ...]:
        """Names of both sides, in the order of the reference; never ``other``."""
        return scored_names(self.names("reference"), self.names("predicted"))

    def class_indices(self, codes: NDArray[np.integer], side: Side) -> I64:
        """Look up the class of every code."""
        codes = np.asarray(codes)
        if not np.issubdtype(codes.dtype, np.integer):
            where = f"{side} codes"
            raise InputError(where, f"found {codes.dtype}, expected integer class codes")
        table = self._tables[side]
        if codes.dtype.itemsize <= 2 and codes.dtype.kind == "u":
            indices: I64 = table[codes]
        elif not codes.size or (codes.min() >= 0 and codes.max() < _TABLE_SIZE):
            indices = table[codes.astype(np.intp)]
        else:
            indices = self._search(codes.astype(np.int64), side)
        if self.unlisted == "error" and (indices == _UNLISTED).any():
            raise UnlistedError.of(self, side, [codes])
        return indices

    def is_unlisted(self, codes: I64, side: Side) -> NDArray[np.bool_]:
        """Return which codes stand in no list."""
        unlisted: NDArray[np.bool_] = self._search(codes, side) == _UNLISTED
        return unlisted

    def fitting(self, codes: NDArray[np.integer], side: Side) -> list[str]:
        """Names of the presets that list these codes, and this mapping's codes of the other side.

        The preset most like this mapping comes first.
        """
        other_side: Side = "reference" if side == "predicted" else "predicted"
        spans = np.array([span[:2] for span in self._spans(other_side)], dtype=np.int64)
        # the ends of a range stand for it
        kept = spans[spans[:, 1] < _TABLE_SIZE].ravel()
        known = codes[codes.astype(np.int64) != NO_CODE].astype(np.int64)
        presets = []
        for name in preset_names():
            if name == TRAINING:  # small numbers mean anything
                continue
            preset = load_mapping(name)
            classes = preset._search(known, side)
            names = preset.names(side)
            # user codes are "other" in a list of another kind of data: a mapping that scores
            # nothing does not fit
            useful = (
                OTHER not in names
                or 2 * np.count_nonzero(classes == names.index(OTHER)) <= classes.size
            )
            if (
                useful
                and (classes != _UNLISTED).all()
                and (preset._search(kept, other_side) != _UNLISTED).all()
            ):
                apart = len({*preset.names(side)} ^ {*self.names(side)})
                width = sum(
                    high - low
                    for low, high, _ in (*preset._spans(side), *preset._spans(other_side))
                )
                presets.append((apart, width, name))
        return [name for *_, name in sorted(presets)]

    @cached_property
    def _tables(self) -> dict[Side, I64]:
        """Class index of every code below 65536, by side, for fast lookup."""
        every = np.arange(_TABLE_SIZE, dtype=np.int64)
        return {
            "predicted": self._search(every, "predicted"),
            "reference": self._search(every, "reference"),
        }

    def _search(self, codes: I64, side: Side) -> I64:
        names = self.names(side)
        spans = sorted(self._spans(side))
        low = np.array([span[0] for span in spans], dtype=np.int64)
        high = np.array([span[1] for span in spans], dtype=np.int64)
        ignored = {"ignore", "ignore_reference"}
        index = np.array(
            [IGNORED if name in ignored else names.index(name) for *_, name in spans],
            dtype=np.int64,
        )
        of_unlisted = {
            "error": _UNLISTED,
            "ignore": IGNORED,
            "other": names.index(OTHER) if OTHER in names else _UNLISTED,
        }
        place = np.searchsorted(low, codes, side="right") - 1
        listed = (place >= 0) & (codes <= high[place])
        indices = np.where(listed, index[place], of_unlisted[self.unlisted])
        indices[codes == NO_CODE] = IGNORED
        return indices

    def _spans(self, side: Side) -> list[tuple[int, int, str]]:
        """First code, last code and class name (or ignore list) of every entry of a side."""
        listed = self.predicted if side == "predicted" else self.reference
        spans = [(*_span(code), name) for name, codes in listed.items() for code in codes]
        spans += [(*_span(code), "ignore") for code in self.ignore]
        if side == "reference":
            spans += [(*_span(code), "ignore_reference") for code in self.ignore_reference]
        return spans


TRAINING = "street_kitti_training"
LAST_TRAINING_ID = 19
LEAST_TRAINING_IDS = 5
"""Mapping of SemanticKITTI's training ids, the largest id, and the fewest ids of a frame."""


class UnlistedError(InputError):
    """Codes that a class mapping does not list."""

    mapping: ClassMapping
    side: Side

    @classmethod
    def of(
        cls, mapping: ClassMapping, side: Side, chunks: Iterable[NDArray[np.integer]]
    ) -> UnlistedError:
        """Name the codes that are not listed and how often they are found."""
        counts: Counter[int] = Counter()
        for codes in chunks:
            values, n = np.unique(codes, return_counts=True)
            counts.update(dict(zip(values.tolist(), n.tolist(), strict=True)))
        present = np.array(sorted(counts), np.int64)
        unlisted = {
            code: counts[code] for code in present[mapping.is_unlisted(present, side)].tolist()
        }
        more = ", ..." if len(unlisted) > _SHOWN else ""
        shown = ", ".join(f"{code} ({n:,})" for code, n in [*unlisted.items()][:_SHOWN]) + more
        problem = (
            f"found {sum(unlisted.values())} records with codes "
            f"that the class mapping does not list: {shown}"
        )
        line = ", ".join(map(str, [*unlisted][:_SHOWN])) + more
        hint = (
            f"write a line for them under [{side}], such as other = [{line}], "
            'or set unlisted = "other"'
        )
        fitting = mapping.fitting(present, side)
        if fitting:
            hint = f"a mapping that lists them: {' or '.join(fitting)} (--mapping NAME); or {hint}"
        if (
            side == "reference"
            and present.max(initial=0) <= LAST_TRAINING_ID
            and len(present) >= LEAST_TRAINING_IDS
        ):
            hint = f"if they are the training ids of SemanticKITTI: --mapping {TRAINING}; or {hint}"
        error = cls(f"{side} codes", problem, hint)
        error.mapping = mapping
        error.side = side
        return error


def scored_names(reference: tuple[str, ...], predicted: tuple[str, ...]) -> tuple[str, ...]:
    """Names on both sides, in the order of the reference, without ``other``.

    >>> scored_names(("ground", "car", "other"), ("noise", "ground", "other"))
    ('ground',)
    """
    return tuple(name for name in reference if name in predicted and name != OTHER)


def preset_names() -> tuple[str, ...]:
    """Names of the class mappings that come with the package."""
    return tuple(sorted(path.stem for path in (samples_folder() / "classes").glob("*.toml")))


def load_mapping(source: str | Path) -> ClassMapping:
    """Load a class mapping by preset name, or from a TOML file."""
    name = str(source)
    known = preset_names()
    preset = same_name(name, known)
    if preset is not None:
        return build(
            ClassMapping,
            read_toml(samples_folder() / "classes" / f"{preset}.toml"),
            f"class mapping {preset}",
        )
    if Path(name).suffix != ".toml":
        problem = f"found {name!r}, expected a .toml file or one of: {', '.join(known)}"
        where = "class mapping"
        raise ConfigError(where, problem, did_you_mean(name, known))
    return build(ClassMapping, read_toml(Path(name)), name)


def _span(code: int | str) -> tuple[int, int]:
    """First and last code of one entry: an integer, or a range "a-b" with both ends."""
    if isinstance(code, int):
        low = high = code
    else:
        first, dash, last = code.partition("-")
        if not (dash and first.strip().isdecimal() and last.strip().isdecimal()):
            problem = f"codes as integers or ranges such as '1200-1206', found {code!r}"
            raise ValueError(problem)
        low = int(first)
        high = int(last)
    if not 0 <= low <= high <= MAX_CODE:
        problem = f"codes from 0 to {MAX_CODE}, ranges from low to high, found {code!r}"
        raise ValueError(problem)
    return low, high
