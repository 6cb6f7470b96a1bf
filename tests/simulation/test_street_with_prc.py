"""The street is of use only if PRC meets in it what the paper describes."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.classifiers.prc.pipeline import PrcParams, classify_block, initial_state
from prc_cli.core.classes import ClassCodes
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.scores import Scores, gate_value, scores
from prc_cli.simulation.params import StreetParams
from prc_cli.simulation.street import simulate_street


def evaluated(zeta_p: float) -> Scores:
    params = PrcParams.model_validate({"support": {"zeta_p": zeta_p}})
    k = params.lines_per_block
    blocks = list(simulate_street(StreetParams(n_lines=3 * k)).labelled_blocks(lines=k))
    mapping, lookup = load_mapping("prc"), ClassCodes().lookup()
    matrix, state = ConfusionMatrix.empty(mapping), initial_state(2154)
    for i, item in enumerate(blocks):
        following = blocks[i + 1].block.range_m[:1] if i + 1 < len(blocks) else np.empty((0, 2154), np.float32)
        result = classify_block(item.block.range_m, following, state, params)
        state = result.state
        matrix = accumulate(matrix, lookup[result.labels], lookup[item.labels], mapping)
    return scores(matrix)


@pytest.fixture(scope="module")
def published() -> Scores:
    return evaluated(1.0)


@pytest.mark.parametrize(
    ("gate", "at_least"), [("recall.ground", 0.95), ("recall.noise", 0.9), ("recall.vegetation", 0.7)]
)
def test_published_parameters_find_ground_noise_and_vegetation(
    published: Scores, gate: str, at_least: float
) -> None:  # fmt: skip
    assert gate_value(published, gate) > at_least


def test_a_smaller_threshold_trades_as_in_table_i(published: Scores) -> None:
    tight = evaluated(0.1)
    assert gate_value(tight, "recall.ground") < gate_value(published, "recall.ground")
    assert gate_value(tight, "recall.vegetation") < gate_value(published, "recall.vegetation")
    assert gate_value(tight, "recall.building") > gate_value(published, "recall.building")
