"""Joins two label files into one confusion matrix, matched by the order of their records."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from prc_cli.core.types import I64
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate, refuse_poor_match
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.readers.labels import open_codes


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
    found = mapping if isinstance(mapping, ClassMapping) else load_mapping(mapping)
    left = open_codes(Path(predicted), predicted_dimension)
    right = open_codes(Path(reference), reference_dimension)
    matrix = ConfusionMatrix.empty(found)
    pairs = pair_chunks(left.chunks(), right.chunks(), (str(predicted), str(reference)))
    for predicted_codes, reference_codes in pairs:
        matrix = accumulate(matrix, predicted_codes, reference_codes, found)
    return matrix


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
