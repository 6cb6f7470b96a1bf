"""Scores of the contest: which classes are judged, and scans without a class."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.contest_data import (
    TEST_FORESTS,
    TEST_STREETS,
    TRAIN,
    TRAIN_FOREST,
    Simulated,
    simulated,
)
from benchmarks.contest_judge import judge
from benchmarks.contest_methods import PAPERS, label_scan
from benchmarks.contest_peers import Points, step

pytestmark = pytest.mark.slow


def test_seeds_for_tuning_are_never_reported() -> None:
    tuned = {spec.seed for spec in (*TRAIN, *TRAIN_FOREST)}
    reported = {spec.seed for spec in (*TEST_STREETS, *TEST_FORESTS)}
    assert not tuned & reported
    assert len(tuned) == len(TRAIN) + len(TRAIN_FOREST)
    assert len(reported) == len(TEST_STREETS) + len(TEST_FORESTS)


def test_a_simulated_scan_is_judged() -> None:
    spec = Simulated("toy", 9050, 3.0, "residential", "sick-push-broom", noise=0.10)
    scan = simulated(spec)
    assert scan.mapping == "street"
    noise = (scan.codes[~np.isnan(scan.range_m)] == 7).mean()
    assert 0.06 < noise < 0.14
    # noise lies on its beam: where it was measured is as far from the scanner as its range says
    assert scan.world_m is not None
    assert scan.scanner_m is not None
    far = np.linalg.norm(scan.world_m - scan.scanner_m[:, None], axis=-1) - scan.range_m
    assert np.nanmax(np.abs(far)) < 0.3
    labelled = label_scan(scan, PAPERS[2])
    assert judge(scan, labelled.codes, labelled.extra_codes).f1()["ground"] > 0.5


def test_smrf_leaves_a_box_on_a_plane() -> None:
    x, y = (
        axis.ravel() for axis in np.meshgrid(np.arange(0.0, 40.0, 0.25), np.arange(0.0, 40.0, 0.25))
    )
    box = (np.abs(x - 20.0) < 3.0) & (np.abs(y - 20.0) < 3.0)
    xyz = np.stack([x, y, 0.05 * x + np.where(box, 2.5, 0.0)], axis=1)
    points = Points(xyz, np.zeros(len(xyz), np.int32), np.zeros((1, 3)), 2.0)
    smrf = {
        "filter": "smrf",
        "cell_m": 1.0,
        "slope": 0.15,
        "window_m": 5.0,
        "threshold_m": 0.5,
        "scaler": 1.25,
    }
    codes, _ = step(points, smrf, points.no_codes())
    np.testing.assert_array_equal(codes == 2, ~box)
