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
