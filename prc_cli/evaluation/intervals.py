"""Confidence intervals of the scores from blocks of the stream.

Neighbouring shots hit the same wall and have correlated errors, so shots are not independent trials. Therefore whole
blocks of scan lines are left out (block jackknife; Künsch 1989).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64
from prc_cli.evaluation.mapping import scored_names
from prc_cli.evaluation.result import Interval

LEVEL = 0.95
"""Confidence level."""
FEW_BLOCKS = 20
"""With fewer blocks, intervals are unreliable."""
_AT_ONCE = 1 << 22


def block_intervals(blocks: I64, names: tuple[tuple[str, ...], tuple[str, ...]]) -> dict[str, Interval]:
    """Compute intervals of every score that is defined: the spread without one block at a time, times Student's t."""
    if len(blocks) < 2:
        problem = f"intervals need at least 2 blocks with scored pairs, found {len(blocks)}"
        raise InputError("intervals", problem, "make the blocks shorter with --interval-lines, or give -M")
    total = blocks.sum(axis=0)
    centre = {name: float(values[0]) for name, values in all_scores(total[None], *names).items()}
    found = _jackknife(blocks, total, names, centre)
    return {
        name: Interval(max(low, -1.0 if name == "kappa" else 0.0), min(high, 1.0))
        for name, (low, high) in found.items()
        if not np.isnan(low + high)
    }


def _jackknife(
    blocks: I64, total: I64, names: tuple[tuple[str, ...], tuple[str, ...]], centre: dict[str, float]
) -> dict[str, tuple[float, float]]:
    from scipy.special import stdtrit

    each = max(1, _AT_ONCE // total.size)
    parts = [all_scores(total - blocks[k : k + each], *names) for k in range(0, len(blocks), each)]
    found = {}
    for name, value in centre.items():
        left_out = np.concatenate([part[name] for part in parts])
        # a score that depends on a single block is undefined without it: no interval
        n = len(left_out)
        error = float(np.sqrt((n - 1) / n * np.sum((left_out - left_out.mean()) ** 2)))
        half = float(stdtrit(n - 1, (1 + LEVEL) / 2)) * error
        found[name] = value - half, value + half
    return found


def all_scores(
    counts: NDArray[np.integer], reference_names: tuple[str, ...], predicted_names: tuple[str, ...]
) -> dict[str, F64]:
    """Compute every score of many confusion matrices at once; see :func:`prc_cli.evaluation.scores.scores`."""
    # float64: the product of two sums of 1e10 does not fit 64 bits
    rows, columns = counts.sum(axis=2, dtype=np.float64), counts.sum(axis=1, dtype=np.float64)
    total = rows.sum(axis=1)
    found: dict[str, F64] = {}
    agreed, expected = np.zeros(len(counts)), np.zeros(len(counts))
    recalls = []
    for name in scored_names(reference_names, predicted_names):
        i, j = reference_names.index(name), predicted_names.index(name)
        true, row, column = counts[:, i, j].astype(np.float64), rows[:, i], columns[:, j]
        either = row + column - true
        found[f"recall.{name}"] = _ratio(true, row)
        found[f"precision.{name}"] = _ratio(true, column)
        found[f"f1.{name}"] = _ratio(2 * true, row + column)
        found[f"iou.{name}"] = _ratio(true, either)
        found[f"accuracy.{name}"] = _ratio(total - either + true, total)
        recalls.append(found[f"recall.{name}"])
        agreed += true
        expected += row * column
    observed, chance = _ratio(agreed, total), _ratio(expected, total * total)
    known = ~np.isnan(np.stack(recalls))
    sums = np.where(known, np.stack(recalls), 0.0).sum(axis=0)
    found["accuracy"] = observed
    found["balanced_accuracy"] = _ratio(sums, known.sum(axis=0).astype(np.float64))
    found["kappa"] = _ratio(observed - chance, 1.0 - chance)
    return found


def _ratio(part: F64, whole: F64) -> F64:
    result = np.full(part.shape, np.nan)
    np.divide(part, whole, out=result, where=(whole != 0) & ~np.isnan(whole))
    return result
