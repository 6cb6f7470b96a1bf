"""The whole classifier on simulated static scans: lower bounds of scores that show a broken stage."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.types import F32, U8
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.scores import ClassScores, scores
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import Wanted
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams
from tests.simulated import HEIGHT_M, static_scan


def classified(seed: int, lines: int = 32, *, azimuth_step: float = 0.5, turn: float = 360.0) -> tuple[U8, U8, F32]:
    """Labels, reference labels and height of the ground of a simulated scan."""
    items = list(static_scan(0.2, azimuth_step, seed, turn=turn).labelled_blocks(lines))
    settings = load_config(preset="street-scan").config.classifier
    assert isinstance(settings, SequentialAngleParams)
    found = list(label_blocks((item.block for item in items), settings, wanted=Wanted(stages=True)))
    heights = [item.stages.ground_height_m for item in found if item.stages is not None]
    labels = np.concatenate([item.labels for item in found])
    return labels, np.concatenate([item.labels for item in items]), np.concatenate(heights)


def scored(labels: U8, reference: U8, name: str) -> dict[str, ClassScores]:
    mapping, codes = load_mapping(name), ClassCodes().lookup()
    matrix = accumulate(ConfusionMatrix.empty(mapping), codes[labels], codes[reference], mapping)
    return {item.name: item for item in scores(matrix).classes}


def test_classes_of_the_paper() -> None:
    scans = [classified(seed) for seed in (2, 21)]
    labels, reference = (np.concatenate([scan[i] for scan in scans]) for i in (0, 1))
    found = scored(labels, reference, "street_scan")
    # found: .89 .61, .86 .87, .36 .92, .99 .96
    floors = {"vegetation": (0.8, 0.5), "vertical": (0.78, 0.8), "car": (0.28, 0.85), "horizontal": (0.95, 0.9)}
    for name, (recall, precision) in floors.items():
        assert found[name].recall > recall, name
        assert found[name].precision > precision, name


def test_road_and_curbs() -> None:
    labels, reference, height = classified(5)
    found = scored(labels, reference, "sequential_angle")
    # found: .99 .98, .76 .93
    assert found["ground"].recall > 0.95
    assert found["ground"].precision > 0.95
    assert found["curb"].recall > 0.6
    assert found["curb"].precision > 0.8
    # the street slopes, and the tripod stands where its legs do
    assert np.nanmedian(height) == pytest.approx(-HEIGHT_M, abs=0.07)


def test_missing_shots_and_nothing_else_stay_missing() -> None:
    labels, reference, _ = classified(3, turn=90.0)
    assert np.array_equal(labels == Label.MISSING, reference == Label.MISSING)


@pytest.mark.parametrize("lines", [1, 7, 1000])
def test_blocks_change_no_label(lines: int) -> None:
    whole, cut = classified(5, azimuth_step=1.0), classified(5, lines, azimuth_step=1.0)
    assert [array.tobytes() for array in whole] == [array.tobytes() for array in cut]
