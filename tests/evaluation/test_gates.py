from __future__ import annotations

import pytest

from prc_cli.core.errors import ConfigError, GateError
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.scores import Gate, check_gates, parse_gate, refuse_failed, scores
from tests.evaluation.samples import MATRIX


def test_passed_and_failed() -> None:
    results = check_gates(scores(MATRIX), [Gate("recall.ground", 0.9), Gate("accuracy", 1.0), Gate("recall.stem", 0.0)])
    assert [item.passed for item in results] == [True, False, False]  # undefined has reached nothing
    refuse_failed(results[:1])
    with pytest.raises(GateError) as caught:
        refuse_failed(results)
    assert str(caught.value) == (
        "accuracy: found 0.9869, demanded at least 1.0000; "
        "recall.stem: found undefined (no such records), demanded at least 0.0000"
    )
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("text", ["recall.ground", "recall.ground=", "recall.ground=x", "accuracy=1.1", "kappa=nan"])
def test_limits_that_make_no_sense(text: str) -> None:
    with pytest.raises(ConfigError, match="--fail-under: found"):
        parse_gate(text, load_mapping("prc"))


@pytest.mark.parametrize("text", ["recal.ground=0.5", "recall.road=0.5", "=0.5"])
def test_scores_and_classes_that_are_not_there(text: str) -> None:
    with pytest.raises(ConfigError, match="score: found"):
        parse_gate(text, load_mapping("prc"))


@pytest.mark.parametrize("score", ["recall", "precision", "f1", "iou", "accuracy"])
def test_classes_of_one_side_have_no_gate_and_are_not_offered(score: str) -> None:
    mapping = ClassMapping(
        unlisted="other", predicted={"ground": (2,), "noise": (7,)}, reference={"ground": (2,), "car": (65,)}
    )
    for name in ("other", "noise", "car"):
        with pytest.raises(ConfigError) as caught:
            parse_gate(f"{score}.{name}=0.5", mapping)
        told = str(caught.value)
        assert f"found class {name!r}, which the mapping does not have on both sides" in told
        assert told.endswith("expected one of: ground")
    assert parse_gate(f"{score}.ground=0.5", mapping).limit == 0.5
