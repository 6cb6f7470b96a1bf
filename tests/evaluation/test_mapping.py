"""Mappings from codes to classes, on paper and on real labels."""

from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.evaluation.mapping import ClassMapping, load_mapping, preset_names


def made(**table: Any) -> ClassMapping:
    return ClassMapping(**{"predicted": {"ground": [2]}, "reference": {"ground": [2]}} | table)


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_takes_every_code_that_prc_predicts(name):
    labels = [Label.MISSING, Label.UNCLASSIFIED, Label.NOISE, Label.GROUND]
    labels += [Label.STEM] if name == "lehtola_forest" else [Label.BUILDING, Label.VEGETATION]
    codes = ClassCodes().lookup()[labels]
    indices = load_mapping(name).class_indices(codes, "predicted")
    assert indices[0] == -1
    assert (indices[1:] >= 0).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.int64])
def test_indices_do_not_depend_on_the_integer_type(dtype):
    mapping = made(
        unlisted="other", ignore=[0], reference={"ground": [2, "10-20"], "wire": ["30-31"]}
    )
    codes = np.array([0, 1, 2, 9, 10, 15, 20, 21, 30, 31, 32, 127], dtype=dtype)
    expected = [-1, 2, 0, 2, 0, 0, 0, 2, 1, 1, 2, 2]
    assert mapping.class_indices(codes, "reference").tolist() == expected


@pytest.mark.parametrize("unlisted", ["error", "other", "ignore"])
def test_a_record_without_a_code_is_never_scored(unlisted):
    table = {"unlisted": unlisted, "predicted": {"ground": [2]}, "reference": {"ground": [2]}}
    mapping = ClassMapping.model_validate(table)
    assert mapping.class_indices(np.array([-1, 2]), "reference").tolist() == [-1, 0]
