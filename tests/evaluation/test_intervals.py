"""Intervals against closed forms and against scores computed one by one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from prc_cli.core.errors import InputError
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.scores import CLASS_SCORES, OVERALL_SCORES, all_scores, block_intervals, gate_value, scores

ROWS, COLUMNS = ("ground", "stem", "other"), ("noise", "ground", "stem")
NAMES = ROWS, COLUMNS


def blocks_of(n: int, seed: int = 0, size: int = 400) -> np.ndarray:
    """Blocks of equal size whose share of agreement differs."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(n):
        share = random.dirichlet([0.5, 8, 1, 0.5, 1, 6, 0.2, 0.5, 0.5])
        found.append(random.multinomial(size, share).reshape(3, 3))
    return np.array(found)


def test_all_scores_are_those_of_one_matrix_at_a_time() -> None:
    blocks = blocks_of(20)
    blocks[3, 1] = 0  # no stem in the reference
    blocks[4] = 0
    blocks[5] = np.diag([0, 0, 7])
    found = all_scores(blocks, *NAMES)
    assert set(found) == {f"{s}.{c}" for s in CLASS_SCORES for c in ("ground", "stem")} | set(OVERALL_SCORES)
    for k, counts in enumerate(blocks):
        expected = scores(ConfusionMatrix(*NAMES, counts))
        for name, values in found.items():
            np.testing.assert_allclose(values[k], gate_value(expected, name), rtol=1e-12, err_msg=f"{name} {k}")


def test_jackknife_of_a_mean_is_the_textbook_interval() -> None:
    blocks = blocks_of(25)
    per_block = all_scores(blocks, *NAMES)["accuracy"]  # of blocks of one size: their mean is the score
    half = stats.t.ppf(0.975, 24) * per_block.std(ddof=1) / np.sqrt(25)
    found = block_intervals(blocks, NAMES)["accuracy"]
    assert (found.low, found.high) == pytest.approx((per_block.mean() - half, per_block.mean() + half))


@pytest.mark.parametrize("name", ["recall.stem", "iou.ground", "kappa", "balanced_accuracy"])
def test_jackknife_by_hand(name: str) -> None:
    blocks = blocks_of(9)
    left_out = [
        gate_value(scores(ConfusionMatrix(*NAMES, np.delete(blocks, k, axis=0).sum(axis=0))), name) for k in range(9)
    ]
    error = np.sqrt(8 / 9 * np.sum((np.array(left_out) - np.mean(left_out)) ** 2))
    value = gate_value(scores(ConfusionMatrix(*NAMES, blocks.sum(axis=0))), name)
    found = block_intervals(blocks, NAMES)[name]
    half = stats.t.ppf(0.975, 8) * error
    assert (found.low, found.high) == pytest.approx((value - half, value + half))


def test_intervals_hold_the_true_score_about_as_often_as_they_say() -> None:
    true = float(all_scores(blocks_of(4000, 99).sum(axis=0)[None], *NAMES)["recall.stem"][0])
    n_held = 0
    for seed in range(60):
        found = block_intervals(blocks_of(40, seed), NAMES)["recall.stem"]
        n_held += found.low <= true <= found.high
    assert n_held >= 51  # 57 expected; fewer than 51 in one of 200 such tests


def test_bounds_and_undefined_scores() -> None:
    blocks = blocks_of(10)
    blocks[:, 1] = 0
    blocks[2, 1, 2] = 5  # stems in one block alone
    found = block_intervals(blocks, NAMES)
    assert "recall.stem" not in found
    assert all(-1 <= item.low <= item.high <= 1 for item in found.values())
    perfect = np.zeros((5, 3, 3), np.int64)
    perfect[:, 0, 1] = perfect[:, 1, 2] = 3
    assert block_intervals(perfect, NAMES)["accuracy"].low == 1.0


def test_counts_beyond_32_bits() -> None:
    blocks = blocks_of(10) * 10**9
    found, small = (block_intervals(b, NAMES)["kappa"] for b in (blocks, blocks_of(10)))
    assert (found.low, found.high) == pytest.approx((small.low, small.high))


def test_what_cannot_be_done() -> None:
    with pytest.raises(InputError, match="at least 2 blocks with scored pairs, found 1"):
        block_intervals(blocks_of(1), NAMES)
