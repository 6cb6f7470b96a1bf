"""Joins label files into one confusion matrix: who is compared with whom, how, and in which parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError
from prc_cli.core.types import I64
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate, refuse_poor_match
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.result import Evaluation, MatchReport
from prc_cli.readers.labels import open_codes


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """How two sides are compared."""

    match: str = "order"
    """``order``, ``time``, ``dimension:NAME`` or ``nearest``."""
    tolerance: float | None = None
    """Largest difference of a pair: seconds for ``time``, metres for ``nearest``; None = the default of either."""
    min_matched: float = 0.5
    """Least share of the smaller side that must find a partner."""
    predicted_dimension: str | None = None
    """Column or dimension with the predicted codes; None = found by name."""
    reference_dimension: str | None = None
    """Column or dimension with the reference codes; None = found by name."""
    predicted_points: Path | None = None
    """The points that predicted labels alone belong to, record by record: the input of the run."""
    reference_points: Path | None = None
    """The points that reference labels alone belong to."""
    split_range_m: tuple[float, ...] = ()
    """Edges of range bins [m]; empty = not split."""
    split_lines: int | None = None
    """Scan lines of a part; None = not split."""
    split_scanner: bool = False
    """Whether scanners are told apart."""
    points_per_line: int | None = None
    """M, where records are shots of a dense stream: the line of record i is i // M."""
    intervals: str | None = None
    """``jackknife`` or ``bootstrap``; None = no intervals."""
    interval_lines: int = 99
    """Scan lines of a block that is left out or drawn as a whole."""
    seed: int = 1
    """Of the bootstrap."""


def evaluate_all(
    predicted: Sequence[Path],
    reference: Sequence[Path],
    mapping: ClassMapping | str | Path = "prc",
    *,
    options: EvaluateOptions | None = None,
) -> Evaluation:
    """Compare files and pool them into one matrix."""
    options = options or EvaluateOptions()
    if options.match != "order":
        raise ConfigError("match", f"found {options.match!r}, expected order")
    found = mapping if isinstance(mapping, ClassMapping) else load_mapping(mapping)
    matrix, n = ConfusionMatrix.empty(found), 0
    for one, other in zip(predicted, reference, strict=True):
        left = open_codes(Path(one), options.predicted_dimension)
        right = open_codes(Path(other), options.reference_dimension)
        for codes, wanted in pair_chunks(left.chunks(), right.chunks(), (str(one), str(other))):
            matrix, n = accumulate(matrix, codes, wanted, found), n + len(codes)
    name = "" if isinstance(mapping, ClassMapping) else str(mapping)
    files = tuple(map(str, predicted)), tuple(map(str, reference))
    return Evaluation(*files, name, MatchReport(options.match, n, n, n), matrix, {}, {})


def evaluate(
    predicted: Path | str,
    reference: Path | str,
    mapping: ClassMapping | str | Path = "prc",
    *,
    predicted_dimension: str | None = None,
    reference_dimension: str | None = None,
) -> ConfusionMatrix:
    """Compare two label files record by record.

    Parameters
    ----------
    predicted, reference : path
        Label files (``.npy``, ``.csv``, ``.parquet``), or any record file that carries codes.
    mapping : ClassMapping, name or path
        Which codes mean which class on either side: a preset name, a TOML file or a mapping.
    predicted_dimension, reference_dimension : str, optional
        Column or dimension that holds the codes; default ``class``, ``label`` or ``classification``.

    Raises
    ------
    InputError
        When the files hold different numbers of records: matched by order needs equal counts.
    """
    options = EvaluateOptions(predicted_dimension=predicted_dimension, reference_dimension=reference_dimension)
    return evaluate_all([Path(predicted)], [Path(reference)], mapping, options=options).matrix


def pair_chunks(left: Iterator[I64], right: Iterator[I64], names: tuple[str, str]) -> Iterator[tuple[I64, I64]]:
    """Walk two code streams in equal steps; different lengths are refused with both counts."""
    rest: list[I64] = [np.empty(0, np.int64), np.empty(0, np.int64)]
    seen = [0, 0]
    streams = (left, right)
    while True:
        for side in (0, 1):
            while not rest[side].size:
                chunk = next(streams[side], None)
                if chunk is None:
                    break
                rest[side] = chunk
                seen[side] += chunk.size
        n = min(rest[0].size, rest[1].size)
        if not n:
            break
        yield rest[0][:n], rest[1][:n]
        rest = [rest[0][n:], rest[1][n:]]
    for side in (0, 1):
        seen[side] += sum(chunk.size for chunk in streams[side])
    refuse_poor_match(seen[0], seen[1], *names)
