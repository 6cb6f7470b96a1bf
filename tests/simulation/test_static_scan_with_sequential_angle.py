"""The whole classifier on simulated static scans: floors well below what it reaches, so that a broken stage is seen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from prc_cli.classifiers.sequential_angle.pipeline import SequentialAngleParams
from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.types import F32, U8
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.scores import ClassScores, scores
from prc_cli.pipeline import label_blocks
from prc_cli.simulation.static_scan import StaticScanParams, simulate_static_scan


def classified(lines: int = 32, **options: Any) -> tuple[U8, U8, F32]:
    """Labels, reference labels and height of the ground of a simulated scan."""
    params = {"azimuth_step_deg": 0.5, "elevation_step_deg": 0.2} | options
    items = list(simulate_static_scan(StaticScanParams(**params)).labelled_blocks(lines))
    settings = load_config(preset="street-scan").config.classifier
    assert isinstance(settings, SequentialAngleParams)
    found = list(label_blocks((item.block for item in items), settings))
    heights = [item.stages.ground_height_m for item in found if item.stages is not None]
    labels = np.concatenate([item.labels for item in found])
    return labels, np.concatenate([item.labels for item in items]), np.concatenate(heights)


def scored(labels: U8, reference: U8, name: str) -> dict[str, ClassScores]:
    mapping, codes = load_mapping(name), ClassCodes().lookup()
    matrix = accumulate(ConfusionMatrix.empty(mapping), codes[labels], codes[reference], mapping)
    return {item.name: item for item in scores(matrix).classes}


@pytest.mark.parametrize("seed", [2, 21])
def test_classes_of_the_paper(seed: int) -> None:
    labels, reference, _ = classified(seed=seed)
    found = scored(labels, reference, "street_scan")
    floors = {"vegetation": (0.8, 0.7), "vertical": (0.85, 0.85), "car": (0.65, 0.8), "horizontal": (0.95, 0.9)}
    for name, (recall, precision) in floors.items():
        assert found[name].recall > recall, name
        assert found[name].precision > precision, name


def test_road_and_curbs() -> None:
    labels, reference, height = classified(seed=8)
    found = scored(labels, reference, "sequential_angle")
    assert found["ground"].recall > 0.95
    assert found["ground"].precision > 0.95
    assert found["curb"].recall > 0.5
    assert found["curb"].precision > 0.6
    # 1.75 m above the road where it stands; the road falls to the gutters
    assert np.nanmedian(height) == pytest.approx(-1.8, abs=0.07)


def test_missing_shots_and_nothing_else_stay_missing() -> None:
    labels, reference, _ = classified(seed=3, azimuth_deg=90.0)
    assert np.array_equal(labels == Label.MISSING, reference == Label.MISSING)


@pytest.mark.parametrize("lines", [1, 7, 1000])
def test_blocks_change_no_label(lines: int) -> None:
    options: dict[str, Any] = {"seed": 5, "azimuth_step_deg": 1.0}
    whole, cut = classified(**options), classified(lines, **options)
    assert [array.tobytes() for array in whole] == [array.tobytes() for array in cut]
