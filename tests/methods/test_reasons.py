"""The rule behind every label: its label, its sentence, its limits."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

from prc_cli.config import RunConfig, load_config
from prc_cli.core.blocks import join
from prc_cli.core.classes import LABEL_BITS, Reason
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import Wanted
from prc_cli.methods.fused.thresholds import FOREST, STREET
from prc_cli.methods.reasons import FURTHER, RULES, VOTE, reason_table
from prc_cli.methods.rings.thresholds import MANY
from prc_cli.simulation.settings import Kind, load_settings, open_simulation

SELDOM = {Reason.FAR_BELOW, Reason.ABOVE_TOP, Reason.BEYOND_REACH, Reason.UNDECIDED, Reason.PROFILE, Reason.CURB_REGION}
"""Rules that the scans below need not have."""


def test_every_reason_has_a_sentence_and_limits_that_exist() -> None:
    assert set(RULES) == set(Reason)
    assert len({rule.sentence for rule in RULES.values()}) == len(RULES)
    config, constants = RunConfig(), (STREET, FOREST, MANY)
    for rule in (*RULES.values(), VOTE, FURTHER):
        for name in rule.limits:
            if name.startswith(("prc.", "sequential_angle.")):
                attrgetter(name)(config)
            else:
                assert any(hasattr(each, name.partition(".")[0]) for each in constants), name
                [attrgetter(name)(each) for each in constants if hasattr(each, name.partition(".")[0])]
    numbers = [number for number, *_ in reason_table()]
    assert numbers == [*sorted(RULES), 224, 240]


SCANS: list[tuple[Kind, dict[str, object], tuple[str, ...]]] = [
    ("street", {"lines": 500, "seed": 41}, ("fused", "urban", "street-scan")),
    ("forest", {"lines": 120, "sight_m": 30.0, "seed": 42}, ("fused-forest", "forest")),
]


@pytest.mark.parametrize(("kind", "options", "presets"), SCANS)
def test_reasons_are_those_of_the_labels(kind: Kind, options: dict[str, object], presets: tuple[str, ...]) -> None:
    """Over a million shots in streets; and who asks for reasons gets the same labels."""
    scan = open_simulation(kind, load_settings(kind, options=options)).scan
    block = join([item.block for item in scan.labelled_blocks()])
    assert block.angle_rad is not None
    block = replace(block, beam_rad=block.angle_rad)
    for preset in presets:
        params = load_config(preset=preset).config.classifier
        found = [list(label_blocks(iter([block]), params, wanted=Wanted(reasons=on))) for on in (True, False)]
        labels, plain = (np.concatenate([item.labels for item in items]) for items in found)
        np.testing.assert_array_equal(labels, plain)
        assert all(item.reasons is None for item in found[1]) or preset == "fused-forest"
        reasons = np.concatenate([item.reasons for item in found[0] if item.reasons is not None])
        np.testing.assert_array_equal(reasons & LABEL_BITS, labels)
        seen = set(np.unique(reasons).tolist())
        assert seen <= {*(int(one) for one in Reason), *(240 + label for label in range(16))}
        if preset.startswith("fused"):
            names = [one for one in Reason if (one in _FOREST) == (kind == "forest") and one in _FUSED]
            missing = {one for one in names if int(one) not in seen} - SELDOM
            assert not missing


_FOREST = {
    Reason.FAR_BELOW, Reason.ALONE, Reason.SOIL, Reason.FLAT, Reason.ON_STEM, Reason.BESIDE_STEM, Reason.ABOVE_TOP,
    Reason.PLANT,
}  # fmt: skip
_RINGS = {
    Reason.FLAKE, Reason.SURFACE, Reason.THIN_SMOOTH, Reason.ROUGH_PLACE, Reason.LOW_PLANT, Reason.CAR_BOX,
    Reason.LARGE_BOX, Reason.THIN_PLACE,
}  # fmt: skip
_FUSED = (
    {one for one in list(Reason)[list(Reason).index(Reason.LONELY) :] if "prc." not in str(RULES[one].limits)}
    - {one for one in Reason if "sequential_angle" in str(RULES[one].limits)}
    - _RINGS
)
