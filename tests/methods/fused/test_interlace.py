"""Columns that are measured half a line later are put in step."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import contest_data
from benchmarks.contest_judge import judge
from benchmarks.contest_methods import label
from prc_cli.config import load_config
from prc_cli.core.types import F32, F64
from prc_cli.methods.fused import pipeline
from prc_cli.methods.fused.interlace import put_in_step
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import STREET

BEAM = np.deg2rad(np.linspace(40, 90, 101))
NOISE_M = 0.005


def wall(late: F64, *, lines: int = 40, per_line_m: float = 0.3) -> F32:
    """A wall that recedes from line to line, its columns ``late`` lines later, with range noise."""
    at = 6.0 + per_line_m * (np.arange(lines)[:, None] + late)
    ranges = at / np.sin(BEAM) + np.random.default_rng(4).normal(0.0, NOISE_M, (lines, len(BEAM)))
    return ranges.astype(np.float32)


def in_step(range_m: F32, interlace_rad: float = STREET.interlace_rad) -> F32:
    limits = STREET._replace(interlace_rad=interlace_rad)
    return put_in_step(range_m, ScanPlane.of(BEAM), np.full(len(range_m), NOISE_M), limits)


@pytest.mark.parametrize("late", [0.5, -0.5])
def test_odd_columns_are_moved_by_half_a_line(late: float) -> None:
    odd = np.where(np.arange(len(BEAM)) % 2 == 1, late, 0.0)
    found = in_step(wall(odd))
    inner = slice(1, -1)
    assert np.abs(found - wall(0 * odd))[inner].max() < 0.03
    assert np.array_equal(found[:, ::2], wall(odd)[:, ::2])


def test_lines_may_begin_with_either_half() -> None:
    odd = np.arange(len(BEAM)) % 2 == 1
    first, second = wall(np.where(odd, 0.5, 0.0))[:30], wall(np.where(odd, -0.5, 0.0), lines=60)[30:]
    found = in_step(np.concatenate([first, second]))
    whole = wall(np.zeros(len(BEAM)), lines=60)
    off = np.abs(found - whole).max(axis=1)
    assert off[1:22].max() < 0.03
    assert off[38:-1].max() < 0.03


def test_others_stay() -> None:
    odd = np.where(np.arange(len(BEAM)) % 2 == 1, 0.5, 0.0)
    level = wall(0 * odd)
    leaves = (level + np.random.default_rng(5).uniform(-1, 1, level.shape)).astype(np.float32)
    for given in (level, leaves, wall(odd)[:2], np.full((9, len(BEAM)), np.nan, np.float32)):
        assert in_step(given) is given
    assert in_step(wall(odd), np.inf).tolist() == wall(odd).tolist()
    assert in_step(wall(odd), np.deg2rad(0.6)).tolist() == wall(odd).tolist()


def test_missing_shots_stay_missing() -> None:
    given = wall(np.where(np.arange(len(BEAM)) % 2 == 1, 0.5, 0.0))
    given[10:12, 5:9] = np.nan
    assert np.array_equal(np.isnan(in_step(given)), np.isnan(given))


@pytest.mark.usefixtures("real_data")
def test_the_real_push_broom_is_interlaced(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = contest_data.oakland(1)
    found = {}
    for name, least_rad in (("in step", STREET.interlace_rad), ("as measured", np.inf)):
        monkeypatch.setattr(pipeline, "STREET", STREET._replace(interlace_rad=least_rad))
        labels = label(scan, load_config(preset="fused"))
        found[name] = judge(scan, labels.codes, labels.extra_codes).f1()
    for one in ("building", "vegetation"):
        assert found["in step"][one] > found["as measured"][one] + 0.02
