"""Confidence of the fused method.

What it means, where it is written, and what it does not depend on.
"""

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import ExtraReturns, ScanBlock
from prc_cli.core.types import F32, U8
from prc_cli.jobs.classify import classify, label_blocks
from prc_cli.methods.base import Wanted
from prc_cli.methods.fused.confidence import MEASURES, N_QUESTIONS, QUESTIONS, load_table
from tests.methods.fused.street_lines import BEAM, results, street_lines

ON = {"output": {"confidence": True}, "input": {"nadir": 0.0}}


def confidence(ranges: F32, preset: str = "fused") -> U8:
    return results(preset, "confidence", ranges)


@pytest.mark.parametrize("preset", ["fused", "fused-forest"])
def test_it_is_a_percentage_of_every_return(preset):
    ranges = street_lines(140)[0]
    percentages = confidence(ranges, preset)
    assert (percentages.dtype, percentages.shape) == (np.uint8, ranges.shape)
    assert (percentages[np.isnan(ranges)] == 0).all()
    there = percentages[~np.isnan(ranges)]
    assert there.min() > 0
    assert 90 < there.max() <= 100


def test_labels_are_the_same_without_it():
    block = ScanBlock(0, street_lines(140)[0], beam_rad=BEAM, is_last=True)
    params = load_config(preset="fused").config.classifier
    on, off = (
        list(label_blocks(iter([block]), params, wanted=Wanted(confidence=wanted)))
        for wanted in (True, False)
    )
    for with_it, without_it in zip(on, off, strict=True):
        np.testing.assert_array_equal(with_it.labels, without_it.labels)
        assert without_it.confidence is None
        assert without_it.extra_confidence is None


def test_stray_points_take_confidence_from_a_road():
    ranges = street_lines(140)[0]
    road = np.abs(np.rad2deg(BEAM)) < 20
    plain = confidence(ranges)[40:60, road]
    rng = np.random.default_rng(1)
    noisy = ranges.copy()
    noisy[40:60, road] += rng.normal(0, 0.1, (20, int(road.sum()))).astype(np.float32)
    rough = confidence(noisy)[40:60, road]
    assert np.median(plain) >= 99
    assert rough.mean() < plain.mean() - 5


def test_further_returns_have_that_of_the_shot_whose_label_they_take():
    ranges = street_lines(140)[0]
    line = np.array([10, 10], np.int32)
    column = np.array([200, 200], np.int32)
    far = np.array([ranges[10, 200] + 0.01, 90.0], np.float32)
    block = ScanBlock(
        0,
        ranges,
        beam_rad=BEAM,
        is_last=True,
        extra=ExtraReturns(line, column, far, np.arange(2) + ranges.size),
    )
    params = load_config(preset="fused").config.classifier
    first = next(iter(label_blocks(iter([block]), params, wanted=Wanted(confidence=True))))
    assert first.confidence is not None
    assert first.extra_confidence is not None
    assert first.extra_confidence[0] in first.confidence[9:12, 196:205]
    assert first.extra_confidence[1] == 0  # agrees with no shot


@pytest.mark.parametrize("preset", ["prc-2019-urban", "street-scan", None])
def test_other_methods_refuse_it(tmp_path, preset):
    angles = {} if preset is None else {"angle_deg": np.rad2deg(BEAM)}
    few = 12 if preset is None else 1  # columns, too few to measure their angles
    np.savez(tmp_path / "s.npz", range_m=street_lines(140)[0][:, ::few], **angles)
    config = load_config(preset=preset, options=ON)
    with pytest.raises(
        ConfigError,
        match=r"output\.confidence: this method has no confidence, expected fused; give --preset",
    ):
        classify(tmp_path / "s.npz", tmp_path / "o.csv", config)
    assert not (tmp_path / "o.csv").exists()


@pytest.mark.parametrize("environment", ["urban", "forest"])
def test_every_label_has_its_questions_and_its_row(environment):
    place = "forest" if environment == "forest" else "urban"
    method = load_config(
        preset="fused" if place == "urban" else "fused-forest"
    ).config.classifier.method()
    labels = method.gives - {Label.MISSING, Label.UNCLASSIFIED}
    assert set(QUESTIONS[place]) == labels
    for label, questions in QUESTIONS[place].items():
        assert len(questions) == len(set(questions)) == N_QUESTIONS
        assert set(questions) <= set(MEASURES)
        row = load_table(place)[label]
        assert 0 < row.min() <= row.max() <= 100
        assert np.unique(row).size > 20
