"""The fused classifier on a street of planes: classes, switched-off steps, blocks, threads."""

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.pipeline import (
    FusedParams,
    FusedScanner,
)
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.range_noise import DEFAULT_NOISE_M, NoiseAlong, SensorParams
from prc_cli.methods.fused.thresholds import NEVER, NO_BINS
from tests.methods.fused.street_lines import (
    BEAM,
    BUILDING,
    CAR,
    GROUND,
    STRAY,
    VEGETATION,
    classified,
    results,
    street_lines,
)

PLANE = ScanPlane.of(BEAM)
SCANNER = FusedScanner.of(BEAM)
PARAMS = FusedParams()
EXPECTED = {
    GROUND: Label.GROUND,
    BUILDING: Label.BUILDING,
    VEGETATION: Label.VEGETATION,
    STRAY: Label.NOISE,
    CAR: Label.CAR,
}


def recalls(labels: U8, kind: U8) -> dict[int, float]:
    labels = np.where(labels == Label.CURB, np.uint8(Label.GROUND), labels)
    return {
        class_code: float((labels[kind == class_code] == label).mean())
        for class_code, label in EXPECTED.items()
    }


@pytest.fixture(scope="module")
def street():
    return street_lines(60)


def test_every_class_of_a_street_is_found(street):
    labels = classified(street[0])
    kind = street[1]
    recall_of = recalls(labels, kind)
    for class_code, least in (
        (GROUND, 0.99),
        (BUILDING, 0.97),
        (VEGETATION, 0.93),
        (STRAY, 0.85),
        (CAR, 0.85),
    ):
        assert recall_of[class_code] > least, class_code
    assert (kind[labels == Label.GROUND] == GROUND).mean() > 0.98
    assert ((labels == Label.MISSING) == np.isnan(street[0])).all()


def noise_along(ranges: F32, params: SensorParams, k: int = 128) -> list[float]:
    """Return what is known of the noise at every line, of a stream in blocks of k lines."""
    noise = NoiseAlong()
    noises_m = []
    following = np.concatenate([ranges, np.full((47, len(BEAM)), np.nan, np.float32)])
    for first in range(0, len(ranges), k):
        n_lines = min(k, len(ranges) - first)
        noise = noise.after(following[first : first + n_lines + 47], first, PLANE, params)
        noises_m += noise.of_lines(first, n_lines + 47, params)[:n_lines].tolist()
    return noises_m


def test_the_noise_of_ranges_is_measured():
    for noise_m in (0.002, 0.005, 0.01):
        ranges, _ = street_lines(40, noise_m=noise_m)
        assert noise_along(ranges, SensorParams()) == pytest.approx([noise_m] * 40, rel=0.25)
    assert noise_along(ranges, SensorParams(range_noise_m=0.004)) == [0.004] * 40
    nothing = np.full((8, len(BEAM)), np.nan, np.float32)
    assert noise_along(nothing, SensorParams()) == [DEFAULT_NOISE_M] * 8


def test_a_drive_that_begins_beneath_trees_sees_better_later():
    ranges = np.tile(street_lines(64)[0], (8, 1))
    leaves = np.random.default_rng(8).exponential(0.1, ranges.shape).astype(np.float32)
    leaves[256:384] = 0
    noises_m = noise_along(ranges + leaves, SensorParams())
    assert noises_m[-1] < 0.003
    assert min(noises_m[:288]) > 0.003


@pytest.mark.parametrize(
    "off, kind",
    [
        ({"decision": {"least_near": 0, "spike_share": NEVER}}, STRAY),
        ({"decision": {"car_bins": NO_BINS, "car_bins_rough": NO_BINS}}, CAR),
        ({"decision": {"leaf_share": 0, "leaf_share_before_wall": 0}}, VEGETATION),
        (
            {
                "walk": {"step_m": 0, "slope": 0, "gap_slope": 0},
                "decision": {"level_m": 0, "soil_m": 0},
            },
            GROUND,
        ),
    ],
)
def test_a_step_that_is_off_is_missed(street, off, kind):
    usual = recalls(classified(street[0]), street[1])[kind]
    assert recalls(classified(street[0], **off), street[1])[kind] < usual - 0.2


@pytest.mark.parametrize("name", ["labels", "confidence", "above_m"])
def test_nothing_depends_on_threads_and_cuts(name):
    ranges = street_lines(150)[0]
    whole = results("fused", name, ranges, 150)
    np.testing.assert_array_equal(results("fused", name, ranges, 17, threads=3), whole)
