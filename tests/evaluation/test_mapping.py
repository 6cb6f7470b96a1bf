"""Mappings from codes to classes, on paper and on real labels."""

from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.config import build
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.evaluation.mapping import ClassMapping, load_mapping, preset_names

STREET_SCAN = ("street_scan", "street_scan_kitti", "street_scan_oakland")
PRESETS = (
    "asprs",
    "cloudcompare_csf",
    "lastools",
    "lehtola_forest",
    "lehtola_urban",
    "lidr",
    "oakland",
    "paris_lille_3d",
    "prc",
    "semantic3d",
    "semantic_kitti",
    "semantic_kitti_low_vegetation_ground",
    "semantic_kitti_vegetation_unscored",
    "sequential_angle",
    "street",
    "street_kitti",
    "street_kitti_training",
    "street_oakland",
    *STREET_SCAN,
    "terrascan",
    "toronto3d",
)


def made(**table: Any) -> ClassMapping:
    return ClassMapping(**{"predicted": {"ground": [2]}, "reference": {"ground": [2]}} | table)


def test_presets_are_those_promised():
    assert preset_names() == PRESETS


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_takes_every_code_that_prc_predicts(name):
    labels = [Label.MISSING, Label.UNCLASSIFIED, Label.NOISE, Label.GROUND]
    labels += [Label.STEM] if name == "lehtola_forest" else [Label.BUILDING, Label.VEGETATION]
    codes = ClassCodes().lookup()[labels]
    indices = load_mapping(name).class_indices(codes, "predicted")
    assert indices[0] == -1
    assert (indices[1:] >= 0).all()


@pytest.mark.parametrize(
    "name, code, expected",
    [
        ("street_scan", 66, "vertical"),
        ("street_scan", 7, "other"),
        ("street_scan_kitti", 252, "car"),
        ("street_scan_kitti", 254, "other"),
        ("street_scan_oakland", 1501, "car"),
        ("oakland", 1301, "ground"),
        ("oakland", 1501, "other"),
        ("oakland", 0, None),
        ("semantic_kitti", 1, "noise"),
        ("semantic_kitti", 71, "vegetation"),
        ("asprs", 1, None),
        ("asprs", 65, "other"),
        ("terrascan", 1, None),
        ("lastools", 5, "vegetation"),
        ("cloudcompare_csf", 1, "rest"),
        ("lidr", 18, "noise"),
        ("semantic3d", 8, "car"),
        ("toronto3d", 6, "pole"),
        ("paris_lille_3d", 9, "vegetation"),
        ("semantic_kitti_vegetation_unscored", 70, None),
        ("semantic_kitti_low_vegetation_ground", 70, "ground"),
        ("lehtola_forest", 5, "noise"),
        ("prc", 65, "other"),
    ],
)
def test_reference_codes_of_presets(name, code, expected):
    mapping = load_mapping(name)
    index = mapping.class_indices(np.array([code]), "reference")[0]
    assert (None if index < 0 else mapping.names("reference")[index]) == expected


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.int64])
def test_indices_do_not_depend_on_the_integer_type(dtype):
    mapping = made(
        unlisted="other", ignore=[0], reference={"ground": [2, "10-20"], "wire": ["30-31"]}
    )
    codes = np.array([0, 1, 2, 9, 10, 15, 20, 21, 30, 31, 32, 127], dtype=dtype)
    expected = [-1, 2, 0, 2, 0, 0, 0, 2, 1, 1, 2, 2]
    assert mapping.class_indices(codes, "reference").tolist() == expected


def test_unlisted_codes_are_refused_with_codes_and_count():
    with pytest.raises(InputError) as caught:
        made().class_indices(np.array([2, 9, 9, 5]), "reference")
    assert str(caught.value).startswith(
        "reference codes: found 3 records with codes that the class mapping does not"
    )
    assert "5, 9" in str(caught.value)
    assert 'unlisted = "other"' in caught.value.hint


def test_training_ids_are_named_and_have_a_mapping():
    ids = np.array([0, 1, 9, 11, 13, 15, 17, 18, 19])
    with pytest.raises(InputError) as caught:
        load_mapping("street_kitti").class_indices(ids, "reference")
    assert "--mapping street_kitti_training" in caught.value.hint
    assert (load_mapping("street_kitti_training").class_indices(ids, "reference")[1:] >= 0).all()


@pytest.mark.parametrize(
    "name, codes, side, fits",
    [
        ("prc", [2, 67, 68], "predicted", "asprs or sequential_angle or street_scan"),
        ("prc", [1001, 1203], "reference", "oakland or street_oakland or street_scan_oakland"),
        ("street", [1001, 1203], "reference", "street_oakland or street_scan_oakland"),
        # asprs lists them too, all but a truck as other: it would score nothing
        (
            "street",
            [10, 18, 40, 48, 50, 70, 72, 80],
            "reference",
            "street_kitti or semantic_kitti or semantic_kitti_low_vegetation_ground",
        ),
    ],
)
def test_a_refusal_names_the_presets_that_list_the_codes(
    name,
    codes,
    side,
    fits,
):
    with pytest.raises(InputError) as caught:
        load_mapping(name).class_indices(np.array(codes), side)
    assert caught.value.hint.startswith(f"a mapping that lists them: {fits}")
    assert "or write a line for them under [" in caught.value.hint


@pytest.mark.parametrize(
    "table, expected",
    [
        ({"reference": {"ground": ["5-2"]}}, "found '5-2'"),
        ({"reference": {"ground": ["two"]}}, "found 'two'"),
        ({"reference": {"ground": [-2]}}, "found -2"),
        ({"reference": {"ground": [2**32]}}, "codes from 0 to 4294967295"),
        ({"ignore": ["1-"]}, "found '1-'"),
        (
            {"reference": {"ground": [2], "road": ["1-3"]}},
            "2 stands under 'road' and again under 'ground'",
        ),
        ({"reference": {"ground": [2, "1-3"]}}, "2 stands under 'ground' and again under 'ground'"),
        ({"ignore": [2]}, "predicted code listed once, but 2"),
        ({"ignore_reference": [2]}, "reference code listed once, but 2"),
        ({"reference": {"road": [2]}}, "at least one class name that stands under both"),
        ({"reference": {}}, "at least one class with its codes"),
        ({"unlisted": "drop"}, "'error', 'other' or 'ignore'"),
        ({"unlsted": "other"}, "did you mean 'unlisted'"),
        ({"reference": {"gro|und": [2]}}, "reference.gro|und"),
    ],
)
def test_mappings_that_make_no_sense(table, expected):
    whole = {"predicted": {"ground": [2]}, "reference": {"ground": [2]}} | table
    with pytest.raises(ConfigError) as caught:
        build(ClassMapping, whole, "classes.toml")
    assert str(caught.value).startswith("classes.toml: ")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("unlisted", ["error", "other", "ignore"])
def test_a_record_without_a_code_is_never_scored(unlisted):
    table = {"unlisted": unlisted, "predicted": {"ground": [2]}, "reference": {"ground": [2]}}
    mapping = ClassMapping.model_validate(table)
    assert mapping.class_indices(np.array([-1, 2]), "reference").tolist() == [-1, 0]


pytestmark = pytest.mark.data
