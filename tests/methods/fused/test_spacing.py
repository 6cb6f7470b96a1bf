"""Distances of lines, and noise that a wider window tells."""

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, I64, U8
from prc_cli.methods.base import OneByOne
from prc_cli.methods.fused.neighbours import smooth_pairs
from prc_cli.methods.fused.pipeline import (
    FusedParams,
    FusedScanner,
    classify_block,
    initial_state,
)
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.spacing import IN_LINE_PAIRS, SPACED_LINES, STANDS, spaced_pairs
from prc_cli.methods.fused.thresholds import Smoothness
from tests.methods.fused.street_lines import (
    BEAM,
    BUILDING,
    VEGETATION,
    street_lines,
    with_limits,
)

SCANNER = FusedScanner.of(BEAM)
PLANE = ScanPlane.of(BEAM)
NOISE_M = 0.002
ALONE = with_limits(SCANNER, spaced=None)
"""Neighbours are those of the next line, however close it is."""


def drive(places: I64, n_lines: int = 48) -> tuple[F32, U8]:
    """Return a street seen from given places along it, with fresh range noise."""
    ranges, kind = street_lines(n_lines, noise_m=0.0)
    noise = np.random.default_rng(2).normal(0, NOISE_M, (len(places), len(BEAM)))
    return ranges[places] + noise.astype(np.float32), kind[places]


def labelled(ranges: F32, k: int = 64, scanner: FusedScanner = SCANNER) -> tuple[U8, I64]:
    """Return the labels of a drive in blocks of k lines, and the distances of lines after every
    block."""
    params = FusedParams.model_validate(
        {"lines_per_block": k, "sensor": {"range_noise_m": NOISE_M}}
    )
    turn = OneByOne(initial_state(scanner))
    parts = []
    strides = []
    for first in range(0, len(ranges), k):
        following = ranges[first + k : first + k + SPACED_LINES]
        parts.append(classify_block(ranges[first : first + k], following, scanner, turn, params))
        strides.append(turn.state.spacing.stride)
    return np.concatenate(parts), np.array(strides)


def share(
    labels: U8,
    kind: U8,
    class_code: int,
    label: Label,
) -> float:
    return float((labels[kind == class_code] == label).mean())


def test_a_slow_drive_is_labelled_as_a_normal_one():
    normal, kind = drive(np.arange(48))
    usual = share(labelled(normal)[0], kind, VEGETATION, Label.VEGETATION)
    slow, kind = drive(np.arange(48 * 12) // 12)
    aware = labelled(slow)[0]
    not_aware = labelled(slow, scanner=ALONE)[0]
    assert share(aware, kind, VEGETATION, Label.VEGETATION) > usual - 0.02
    assert share(aware, kind, BUILDING, Label.BUILDING) > 0.97
    assert share(not_aware, kind, VEGETATION, Label.VEGETATION) < usual - 0.02


def test_a_drive_that_stops_keeps_its_labels():
    places = np.concatenate([np.arange(40), np.full(150, 40), np.arange(40, 48)])
    ranges, kind = drive(places)
    labels, strides = labelled(ranges)
    stop = slice(100, 185)
    assert STANDS in strides
    normal = labelled(drive(np.arange(48))[0])[0][40]
    surface = np.isin(kind[40], (BUILDING, VEGETATION))
    assert (labels[stop] == normal)[:, surface].mean() > 0.96
    for class_code, label in ((BUILDING, Label.BUILDING), (VEGETATION, Label.VEGETATION)):
        assert (
            share(labels[stop], kind[stop], class_code, label)
            > share(normal, kind[40], class_code, label) - 0.03
        )


def test_lines_of_all_distances_equal_streams_of_these_lines():
    ranges, _ = street_lines(80)
    margin = SPACED_LINES - 3
    strides = np.array([1, 1, 4, 4, 4, 4, 4, 2, 2, 0, 0, 16, 16, 16, 1, 8], np.int64)
    noise_m = np.where(np.arange(len(strides)) < 6, 2 * NOISE_M, NOISE_M)
    spaced = spaced_pairs(ranges, strides, PLANE, noise_m, Smoothness())
    for i, stride in enumerate(strides.tolist()):
        rows = np.full((5, len(BEAM)), np.nan, np.float32)
        rows[2] = ranges[margin + i]
        if stride != STANDS:
            rows = ranges[margin + i - 2 * stride : margin + i + 2 * stride + 1 : stride]
        pairs = smooth_pairs(np.ascontiguousarray(rows), PLANE, float(noise_m[i]), Smoothness())[0]
        np.testing.assert_array_equal(
            spaced[i], pairs if stride != STANDS else IN_LINE_PAIRS[pairs]
        )
