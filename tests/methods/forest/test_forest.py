"""Ground, stems, vegetation and noise of a forest.

Hand-made scenes, single steps, and a simulated walk.
"""

from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.ablation import changed
from prc_cli.core.blocks import join
from prc_cli.core.classes import LABELS_BY_REASON, Label
from prc_cli.core.types import F32, F64, U8
from prc_cli.methods.forest import classes as woods
from prc_cli.methods.forest.thresholds import FOREST, Forest
from prc_cli.methods.plane import Plane
from prc_cli.simulation.settings import load_settings, open_simulation

HEIGHT_M = 2.0
N_LINES = 12
BEAM = np.deg2rad(np.arange(-150.0, 150.0, 0.1))
PLANE = Plane.of(BEAM)
SKY = np.cos(BEAM) < -0.5


def forest(
    range_m: F32,
    plane: Plane,
    noise_m: float,
    limits: Forest,
) -> U8:
    """Labels of a block."""
    labels: U8 = LABELS_BY_REASON[woods.forest(range_m, plane, noise_m, limits).reasons]
    return labels


def ground(slope: float = 0.0) -> F64:
    """Ranges of one line on a plane, HEIGHT_M below the scanner, rising to the left by the slope.

    Inf = sky.
    """
    with np.errstate(divide="ignore"):
        down = np.cos(BEAM) + slope * np.sin(BEAM)
        return np.where(down > 0.02, HEIGHT_M / np.where(down > 0.02, down, 1.0), np.inf)


def stem(side_m: float, top_m: float = 30.0) -> F64:
    """Ranges of one line on an upright body at a place to the side; inf elsewhere."""
    with np.errstate(divide="ignore"):
        ranges = np.where(np.sin(BEAM) * side_m > 0, side_m / np.sin(BEAM), np.inf)
    return np.where(-ranges * np.cos(BEAM) + HEIGHT_M <= top_m, ranges, np.inf)


def image(*bodies: F64) -> F32:
    """The nearest of some bodies, as a block of lines."""
    nearest = np.minimum.reduce([np.broadcast_to(body, (N_LINES, len(BEAM))) for body in bodies])
    return np.where(np.isfinite(nearest), nearest, np.nan).astype(np.float32)


def labels_of(ranges: F32, **tables: dict[str, float]) -> U8:
    return forest(ranges, PLANE, 0.0, changed(FOREST, **tables))


def count(labels: U8, where: Any) -> dict[str, int]:
    counts = np.bincount(labels[np.broadcast_to(where, labels.shape)], minlength=len(Label))
    return {label.name: n for label, n in zip(Label, counts.tolist(), strict=True) if n}


def test_a_stem_stands_on_the_ground_from_foot_to_crown():
    ranges = image(ground(), stem(5.0))
    labels = labels_of(ranges)
    high = -ranges * np.cos(BEAM) + HEIGHT_M
    on_stem = np.isclose(ranges * np.sin(BEAM), 5.0, atol=0.001) & (high > 0.2)
    assert set(count(labels, on_stem)) == {"STEM"}
    assert set(count(labels, high < 0.02)) == {"GROUND"}


def test_noise_is_alone_or_below_the_ground():
    ranges = image(ground())
    sky = int(np.flatnonzero(SKY)[3])
    soil = int(np.argmin(np.abs(BEAM - 0.5)))
    ranges[4, sky] = 17.0
    ranges[4, soil] *= 1.4
    labels = labels_of(ranges)
    assert labels[4, sky] == labels[4, soil] == Label.NOISE
    assert labels_of(ranges, classes={"near_m": -1.0})[4, sky] == Label.VEGETATION
    ranges[5, sky + 1] = 17.2
    assert labels_of(ranges)[4, sky] == Label.VEGETATION


@cache
def walk() -> tuple[F32, F64, U8]:
    """A second in a simulated forest, every second column."""
    options = {"seed": 9101, "lines": 96, "sight_m": 40.0, "scanner": {"points_per_line": 2135}}
    scan = open_simulation("forest", load_settings("forest", options=options), threads=1).scan
    items = list(scan.labelled_blocks())
    block = join([item.block for item in items])
    assert block.angle_rad is not None
    return block.range_m, block.angle_rad, np.concatenate([item.labels for item in items])


@pytest.mark.slow
def test_stems_and_ground_of_a_simulated_walk():
    """Fewer lines and columns than a user has.

    The figures of whole walks are in the documentation.
    """
    ranges, angle, reference = walk()
    labels = forest(ranges, Plane.of(angle), 0.0, FOREST)
    for label, recall, precision in (
        (Label.STEM, 0.75, 0.9),
        (Label.GROUND, 0.9, 0.85),
        (Label.NOISE, 0.35, 0.6),
    ):
        both = np.count_nonzero((labels == label) & (reference == label))
        assert both > recall * np.count_nonzero(reference == label), label.name
        assert both > precision * np.count_nonzero(labels == label), label.name
    np.testing.assert_array_equal(labels == Label.MISSING, np.isnan(ranges))
