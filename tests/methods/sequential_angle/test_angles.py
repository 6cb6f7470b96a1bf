"""Angles of chords, windows of walls, and the table of keys."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.random import Generator

from prc_cli.core.config import flatten
from prc_cli.core.types import F64
from prc_cli.methods.sequential_angle import angles_loops as kernel_module
from prc_cli.methods.sequential_angle.angles import signed_angles
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams
from prc_cli.methods.sequential_angle.thresholds import ChordThresholds
from prc_cli.reference.sequential_angle import angles as oracle_angles
from tests.methods.sequential_angle.scenes import lines_through, made

HELPERS: Any = kernel_module
"""Their plain functions are called: compiled, helpers have no way in from outside."""


def plain(**values: float) -> ChordThresholds:
    """Without the readings that are ours, so that every rule is tested by itself."""
    return made(ChordThresholds, **values).at_noise()


STEP = np.deg2rad(0.1)


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(2012)


def test_chords_bridge_missing_shots_and_short_steps() -> None:
    gap = (np.nan, np.nan)
    points = [(4, -2), gap, gap, (4.5, -2), (4.51, -2), (4.519, -2), gap, (4.52, -2), (4.6, -1.9)]
    angles = signed_angles(lines_through(points), plain())
    assert angles.ahead[0].tolist() == [3, -1, -1, 8, 8, 8, -1, 8, -1]
    assert np.isnan(angles.signed_deg[0]).tolist() == [
        False,
        True,
        True,
        False,
        False,
        False,
        True,
        False,
        True,
    ]
    # a chord is as long as the shortest allowed or longer
    whole = plain(range_noise_m=0.0625)
    angles = signed_angles(lines_through([(4, -2), (4.25, -2), (4.5, -2)]), whole)
    assert angles.ahead[0].tolist() == [1, 2, -1]


def straight_line(rng: Generator) -> tuple[F64, F64, float]:
    """Beams and ranges of shots on a straight line with gaps, and the line's angle from down."""
    while True:
        beam = np.arange(300) * STEP + rng.uniform(0, np.pi - 300 * STEP)
        point = rng.uniform(-20, 20, 2)
        direction = rng.uniform(0, np.pi)
        normal = np.array([-np.sin(direction), np.cos(direction)])
        across = np.stack([np.cos(beam), np.sin(beam)], axis=-1) @ normal
        ranges = (point @ normal) / across
        if (ranges > 0.3).all() and (ranges < 300).all():
            there = np.sort(rng.choice(300, 40, replace=False))
            return beam[there], ranges[there], direction


def test_line_angle_is_the_angle_of_chord_and_beam(rng: Generator) -> None:
    """Geometry, across gaps and beyond 90 deg.

    Constant along a line; the bare arc tangent has no quadrant.
    """
    n_blunt = 0
    for _ in range(200):
        beam, ranges, direction = straight_line(rng)
        pairs = list(zip(beam, beam[1:], ranges, ranges[1:], strict=False))
        phi = np.sin(np.diff(beam))
        along_beam = np.cos(np.diff(beam)) - ranges[:-1] / ranges[1:]
        HELPERS._directions.py_func(phi, along_beam, len(phi))
        geometric = [oracle_angles.angle_at_first(*pair) for pair in pairs]
        np.testing.assert_allclose(phi, geometric, rtol=0, atol=4e-13)
        along = phi + beam[:-1]
        np.testing.assert_allclose(along, along[0], rtol=0, atol=1e-9)
        assert min(abs(along[0] - direction), abs(abs(along[0] - direction) - np.pi)) < 1e-9
        n_blunt += bool((phi > np.pi / 2).any())
        blunt = phi > np.pi / 2
        step = np.diff(beam)
        ratio = ranges[:-1] / ranges[1:]
        bare = np.arctan(np.sin(step) / (np.cos(step) - ratio))
        assert (np.abs(bare - phi)[blunt] > 1).all()
        np.testing.assert_allclose(bare[~blunt], phi[~blunt], atol=1e-9)
    assert 50 < n_blunt < 150


PAGE = (Path(__file__).resolve().parents[3] / "design" / "sequential_angle.md").read_text(
    encoding="utf-8"
)
VALUES = dict(flatten(SequentialAngleParams().model_dump()))


def documented() -> dict[str, str]:
    """Keys and defaults of the table of constants.

    a row a table, cells of "`key` default (note)".
    """
    section = PAGE[PAGE.index("## Constants") : PAGE.index("## Beside Table 1")]
    published = {}
    for table, cells in re.findall(r"^\| (?:`([a-z_.]+)`)? ?\|(.*)\|$", section, re.MULTILINE):
        for key, default in re.findall(r"`([a-z0-9_]+)`,? ([^;|(`]*)", cells):
            published[f"{table}.{key}".lstrip(".")] = default.strip().replace("−", "-")
    return published


def test_the_table_names_every_default_and_no_other_key() -> None:
    table = documented()
    assert table.keys() <= VALUES.keys()
    for key, value in VALUES.items():
        if isinstance(value, tuple) and isinstance(value[0], float):
            assert table[key] == ", ".join(f"{number:g}" for number in value), key
        elif isinstance(value, bool):
            assert table[key] == str(value).lower(), key
        elif isinstance(value, int | float):
            assert float(table[key]) == value, key
