"""Scans of the contest: those that tune a method are none that it is scored on."""

from benchmarks.contest_data import (
    TEST_FORESTS,
    TEST_STREETS,
    TRAIN,
    TRAIN_FOREST,
)


def test_seeds_for_tuning_are_never_reported():
    tuned = {spec.seed for spec in (*TRAIN, *TRAIN_FOREST)}
    reported = {spec.seed for spec in (*TEST_STREETS, *TEST_FORESTS)}
    assert not tuned & reported
    assert len(tuned) == len(TRAIN) + len(TRAIN_FOREST)
    assert len(reported) == len(TEST_STREETS) + len(TEST_FORESTS)
