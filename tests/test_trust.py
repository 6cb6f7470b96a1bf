"""What is told wrong is not silently labelled: a small part of ``python -m benchmarks.trust``."""

from functools import cache
from pathlib import Path

import pytest

from benchmarks.trust import Case, Trial, random_of, try_row
from benchmarks.trust_cases import (
    METHODS,
    QUICK_CASES,
    ROWS,
    Context,
    plain,
    right_forms,
)
from benchmarks.trust_scans import FIRST_SEED, SEEDS_APART, Window, sources, toy

pytestmark = pytest.mark.slow

MACRO = 0.4
"""Macro F1 that every method reaches on the small scans."""
FORMS = [
    (name, i) for name, n in (("street", 5), ("push-broom", 2), ("forest", 2)) for i in range(n)
]


@cache
def window_of(name: str) -> Window:
    return toy(name).windows(1)[0]


@cache
def right_f1(name: str, method: str, folder: Path) -> float:
    window = window_of(name)
    stated = plain(window, Context(folder, method, random_of(name)))
    return Trial(folder).judge(case_of(window, method), stated, 0.0).f1


def case_of(window: Window, method: str) -> Case:
    return Case("right", window.scan, 0, method, window.mapping, METHODS[method])


@pytest.mark.parametrize(
    "case", QUICK_CASES, ids=lambda case: f"{case.row}, {case.toy}, {case.method}"
)
def test_what_is_wrong_is_not_silent_and_what_is_right_passes(case, tmp_path):
    row = next(row for row in ROWS if row.name == case.row)
    expected = right_f1(case.toy, case.method, tmp_path)
    assert expected > MACRO
    result = try_row(
        Trial(tmp_path),
        row,
        window_of(case.toy),
        Context(tmp_path, case.method, random_of()),
        expected,
        seed=0,
    )
    assert result is not None
    assert result.outcome != "silent", result
    assert not result.is_alarm, result


@pytest.mark.parametrize("name, form", FORMS)
def test_a_scan_rightly_told_is_neither_refused_nor_doubted(name, form, tmp_path):
    window = window_of(name)
    method = "fused-forest" if window.is_forest else "fused"
    stated = right_forms(window)[form](window, Context(tmp_path, method, random_of()))
    result = Trial(tmp_path).judge(case_of(window, method), stated, MACRO, is_right=True)
    assert result.outcome == "harmless", result
    assert result.f1 > MACRO


@pytest.mark.parametrize(
    "name, method, seed, words",
    [
        (
            "trajectory a second late",
            "prc",
            0,
            "input.trajectory_time_offset",
        ),  # it was another unit of the ranges
        ("radians named degrees", "fused", 0, "name them angle_rad"),
        ("radians named degrees", "fused", 1, "name them angle_rad"),
    ],
)
def test_what_is_wrong_is_named(
    name,
    method,
    seed,
    words,
    tmp_path,
):
    row = next(row for row in ROWS if row.name == name)
    result = try_row(
        Trial(tmp_path),
        row,
        window_of("street"),
        Context(tmp_path, method, random_of()),
        0.9,
        seed=seed,
    )
    assert result is not None
    assert words in result.said
    # another unit is named behind it, if at all
    assert "range_scale" not in result.said.partition(words)[0]


def test_limits_are_never_chosen_on_scans_that_are_reported():
    specs = {
        part: [source.spec for source in sources(part) if source.spec is not None]
        for part in FIRST_SEED
    }
    for part, first in FIRST_SEED.items():
        assert all(first <= spec.seed < first + SEEDS_APART for spec in specs[part])
    mounts = {
        part: {(spec.scanner, repr(spec.mount)) for spec in part_specs}
        for part, part_specs in specs.items()
    }
    shared = mounts["tuning"] & mounts["held-out"]
    assert {scanner for scanner, _ in shared} <= {"focus3d-120"}
