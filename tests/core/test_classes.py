"""The one class table."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import LABEL_COLOURS, LABEL_NAMES, ClassCodes, Label


def test_default_codes_are_those_of_the_product() -> None:
    codes = ClassCodes()
    expected = {"unclassified": 1, "ground": 2, "vegetation": 5, "building": 6, "noise": 7}
    expected |= {"stem": 64, "car": 65, "curb": 66, "vertical": 67, "horizontal": 68, "pole": 69}
    assert {label.name.lower(): codes.code(label) for label in Label if label is not Label.MISSING} == expected
    assert codes.code(Label.MISSING) == 0


def test_lookup_and_names_follow_the_table() -> None:
    codes = ClassCodes(building=5)
    table = codes.lookup()
    assert table.dtype == np.uint8
    assert [int(table[label]) for label in Label] == [codes.code(label) for label in Label]
    assert codes.names()[5] == "building/vegetation"
    assert len(LABEL_NAMES) == len(Label) == len(LABEL_COLOURS)
    assert len(set(LABEL_COLOURS.values())) == len(Label)
