"""The answers of a check by hand: what a person said about a random sample of shots.

``prc check`` draws the shots, its page writes this file, and ``prc evaluate`` reads it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field, ValidationError

from prc_cli.core.brief import Brief
from prc_cli.core.config import Params
from prc_cli.core.errors import InputError
from prc_cli.core.types import I64
from prc_cli.evaluation.mapping import OTHER
from prc_cli.evaluation.stratified import StratifiedSample

SUFFIX = ".json"
KIND = "answers of prc check"
CANNOT_TELL = "cannot tell"
LARGEST_FILE = 64 << 20
"""Larger files are refused [bytes]."""
_HINT = "save the answers again on the page of prc check"


class ClassifiedFile(Params):
    """The file whose classes were checked."""

    name: str
    size: int
    """[bytes]."""
    sha256: str


class SampleStratum(Params):
    """Shots of one predicted class, and of one span of confidence, of which some were drawn."""

    predicted: str
    low: int | None = None
    high: int | None = None
    """Least and greatest confidence [%]; None = not divided by confidence."""
    n_shots: int = Field(gt=0)
    """All shots of the stratum, drawn or not."""
    n_drawn: int = Field(ge=0)


class PlaceAnswer(Params):
    """A shot that was drawn, and its answer."""

    scanner: int
    line: int
    column: int
    record: int
    """Record of the input, -1 = none."""
    stratum: int = Field(ge=0)
    answer: str | None = None
    """True class, ``other``, ``cannot tell``; None = not answered yet."""
    time: str | None = None
    """When it was answered (ISO 8601)."""

    @property
    def cell(self) -> tuple[int, int, int]:
        """Scanner, line and column."""
        return self.scanner, self.line, self.column


class Answers(Params):
    """An answers file."""

    kind: Literal["answers of prc check"]
    format: Literal[1]
    version: str
    """Version of prc that drew the shots."""
    classified: ClassifiedFile
    classes: tuple[str, ...]
    """Classes that could be answered."""
    seed: int
    strata: tuple[SampleStratum, ...]
    person: str = ""
    places: tuple[PlaceAnswer, ...]


def is_answers(path: Path) -> bool:
    """Return whether a file is meant to contain answers, by its name."""
    return path.suffix.lower() == SUFFIX


def load_answers(path: Path) -> Answers:
    """Read an answers file.

    Raises
    ------
    InputError
        If it is no answers file, or damaged.
    """
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(str(path), f"larger than {LARGEST_FILE:,} bytes", _HINT)
        table = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check the name") from error
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), f"is not JSON ({str(error)[:80]})", _HINT) from error
    if not isinstance(table, dict) or table.get("kind") != KIND:
        problem = "contains no answers, expected the file that the page of prc check saves"
        raise InputError(str(path), problem, "give that file, or a reference with class codes")
    try:
        answers = Answers.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InputError(str(path), f"{where}: {first['msg']}", _HINT) from error
    allowed = {*answers.classes, OTHER, CANNOT_TELL, None}
    for number, place in enumerate(answers.places):
        if place.stratum >= len(answers.strata):
            raise InputError(str(path), f"place {number} has no stratum {place.stratum}", _HINT)
        if place.answer not in allowed:
            problem = f"place {number} has the answer {place.answer!r}, which is no class of it"
            raise InputError(str(path), problem, _HINT)
    return answers


class Difference(NamedTuple):
    """A shot that was answered otherwise than it was predicted."""

    scanner: int
    line: int
    column: int
    record: int
    predicted: str
    answer: str


@dataclass(frozen=True, slots=True, repr=False)
class Pooled(Brief):
    """Answers of one or more files about the same classified file."""

    sample: StratifiedSample
    """Answers by stratum; a shot that two persons answered counts once, as the first said."""
    n_places: int
    """Different shots that were drawn."""
    n_open: int
    """Shots without an answer so far."""
    n_other: int
    """Shots that are none of the classes."""
    differences: tuple[Difference, ...]
    """In the order of the file."""
    persons: tuple[str, ...]
    agreement: I64 | None
    """Shots with two answers by class of the first and of the second, (classes + 1, the same).

    The last class is ``other``. None = no shot has two answers.
    """


def pool(paths: Sequence[Path], files: Sequence[Answers]) -> Pooled:
    """Put answers together.

    Raises
    ------
    InputError
        If the files are about different classified files, or divide one differently.
    """
    first = files[0]
    for path, answers in zip(paths, files, strict=True):
        if answers.classified.sha256 != first.classified.sha256:
            problem = f"is about {answers.classified.name}, but {paths[0].name} about another file"
            raise InputError(str(path), problem, "evaluate them one by one")
        if _division(answers) != _division(first) or answers.classes != first.classes:
            problem = f"has other strata or classes than {paths[0].name}"
            raise InputError(str(path), problem, "evaluate them one by one")
    columns = (*first.classes, OTHER)
    strata = first.strata
    counts = np.zeros((len(strata), len(columns)), np.int64)
    n_unsure = np.zeros(len(strata), np.int64)
    agreement = np.zeros((len(columns), len(columns)), np.int64)
    answered: dict[tuple[int, int, int], PlaceAnswer] = {}
    drawn: set[tuple[int, int, int]] = set()
    for answers in files:
        for place in answers.places:
            drawn.add(place.cell)
            if place.answer is None:
                continue
            earlier = answered.setdefault(place.cell, place)
            pair = (earlier.answer, place.answer)
            if earlier is not place and CANNOT_TELL not in pair:
                agreement[columns.index(pair[0] or ""), columns.index(pair[1] or "")] += 1
    differences = []
    for place in answered.values():
        answer = place.answer or ""
        if answer == CANNOT_TELL:
            n_unsure[place.stratum] += 1
            continue
        counts[place.stratum, columns.index(answer)] += 1
        predicted = strata[place.stratum].predicted
        if answer != predicted:
            differences.append(Difference(*place.cell, place.record, predicted, answer))
    sample = StratifiedSample(
        tuple(stratum.predicted for stratum in strata),
        np.array([stratum.n_shots for stratum in strata], np.int64),
        columns,
        counts,
        n_unsure,
    )
    return Pooled(
        sample,
        len(drawn),
        len(drawn) - len(answered),
        int(counts[:, -1].sum()),
        tuple(sorted(differences)),
        tuple(answers.person or path.stem for path, answers in zip(paths, files, strict=True)),
        agreement if agreement.any() else None,
    )


def _division(answers: Answers) -> list[tuple[str, int | None, int | None, int]]:
    return [
        (stratum.predicted, stratum.low, stratum.high, stratum.n_shots)
        for stratum in answers.strata
    ]
