"""Labels, class codes and their colours."""

import re
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest

from prc_cli.core.classes import (
    FURTHER_RETURN,
    LABEL_COLOURS,
    LABELS_BY_REASON,
    REASONS_OF_LABELS,
    VOTED,
    ClassCodes,
    Label,
    Reason,
)
from prc_cli.core.config import samples_folder
from prc_cli.core.types import F64


def test_default_codes_are_those_of_the_product():
    codes = ClassCodes()
    expected = {"unclassified": 1, "ground": 2, "vegetation": 5, "building": 6, "noise": 7}
    expected |= {"stem": 64, "car": 65, "curb": 66, "vertical": 67, "horizontal": 68, "pole": 69}
    assert {
        label.name.lower(): codes.code(label) for label in Label if label is not Label.MISSING
    } == expected
    assert codes.code(Label.MISSING) == 0


EVERYWHERE = (Label.MISSING, Label.UNCLASSIFIED, Label.NOISE, Label.GROUND, Label.VEGETATION)
TOGETHER = {
    "street": (*EVERYWHERE, Label.BUILDING, Label.CAR, Label.CURB, Label.POLE),
    "forest": (*EVERYWHERE, Label.STEM),
    "sequential-angle": (*EVERYWHERE, Label.CAR, Label.CURB, Label.VERTICAL, Label.HORIZONTAL),
}
SEEN_BY = {
    "most": np.eye(3),
    "protanopes": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopes": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopes": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
"""Linear sRGB as seen with a missing kind of cone (Machado et al. 2009, severity 1)."""
LEAST = 0.10
"""Distance in OKLab; the palette before this one came down to 0.059."""


def oklab(rgb: tuple[int, int, int], seen: F64) -> F64:
    """Return lightness, green-red and blue-yellow of a colour (Ottosson 2020)."""
    share = np.array(rgb) / 255
    linear = np.clip(
        seen @ np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4), 0, 1
    )
    cones = (
        np.array(
            [
                [0.4122214708, 0.5363325363, 0.0514459929],
                [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005],
            ]
        )
        @ linear
    )
    axes = np.array(
        [
            [0.2104542553, 0.7936177850, -0.0040720468],
            [1.9779984951, -2.4285922050, 0.4505937099],
            [0.0259040371, 0.7827717662, -0.8086757660],
        ]
    )
    lab: F64 = axes @ np.cbrt(cones)
    return lab


@pytest.mark.parametrize("reader", SEEN_BY)
@pytest.mark.parametrize("method", TOGETHER)
def test_classes_of_a_method_differ_for_every_reader(method, reader):
    places = {label: oklab(LABEL_COLOURS[label], SEEN_BY[reader]) for label in TOGETHER[method]}
    near = {
        (a.name, b.name): round(float(np.linalg.norm(places[a] - places[b])), 3)
        for a, b in combinations(places, 2)
    }
    assert {pair: apart for pair, apart in near.items() if apart < LEAST} == {}


def test_ground_is_brown_and_vegetation_green():
    red, green, blue = LABEL_COLOURS[Label.GROUND]
    assert red > green > blue
    red, green, blue = LABEL_COLOURS[Label.VEGETATION]
    assert green > blue > red


def test_every_reason_has_one_label_and_a_number_of_its_own():
    listed = [reason for reasons in REASONS_OF_LABELS.values() for reason in reasons]
    assert sorted(listed) == sorted(Reason)
    assert max(Reason) < FURTHER_RETURN < VOTED
    for label, reasons in REASONS_OF_LABELS.items():
        numbers = [*reasons, VOTED + label, FURTHER_RETURN + label]
        assert LABELS_BY_REASON[numbers].tolist() == [label] * len(numbers)


def test_styles_of_viewers_hold_every_code():
    codes = {ClassCodes().code(label) for label in Label} | {0, 18}
    style = ElementTree.parse(samples_folder() / "viewers/prc_classes.qml").getroot()
    assert {int(category.get("value", "-1")) for category in style.iter("category")} == codes
    script = (samples_folder() / "viewers/prc_classes_potree.js").read_text(encoding="utf-8")
    assert {int(code) for code in re.findall(r"^ +(\d+):", script, re.MULTILINE)} == codes
