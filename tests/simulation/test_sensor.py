"""The sensor against its documented model: statistics of many shots, seeded."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest

from prc_cli import kernels
from prc_cli.core.classes import Label
from prc_cli.core.types import F64, I32
from prc_cli.simulation.scanners import SCANNERS, Scanner
from prc_cli.simulation.sensor import Measured, goes_behind, scan
from prc_cli.simulation.world import Bodies, Material, Shape

SEED = 20
LINES = 400

CW = SCANNERS["photon-80"].changed(
    points_per_line=100, field_deg=14.86, lost_share=0.0, background_share=0.0, sky_share=0.0, bright_sky_share=0.0,
    cluster_share=0.0, half_range_m=2000.0, max_range_m=150.0,
)  # fmt: skip
"""A continuous wave without anything stray, with the steps of the Photon."""
PULSED = CW.changed(principle="pulsed", ambiguity_m=0.0, pulse_m=0.45, max_returns=4, min_range_m=0.3)


class Hits(NamedTuple):
    t: F64
    body: I32
    facing: F64

    def lines(self, first: int, stop: int) -> Hits:
        return Hits(self.t[first:stop], self.body[first:stop], self.facing[first:stop])


def world(*materials: Material, shape: Shape = Shape.TRIANGLE) -> Bodies:
    n = len(materials)
    leaved = np.array([material is Material.LEAVES for material in materials])
    return Bodies(
        np.where(leaved, Shape.ELLIPSOID, shape).astype(np.uint8),
        np.zeros((n, 9)),
        np.array(materials, dtype=np.uint8),
        np.where(leaved, 1.0, 0.0),
        np.zeros((n, 2)),
        32.0 * np.arange(n, dtype=np.float64),
    )


def hits(t: Any, body: Any = 0, facing: Any = 1.0, lines: int = LINES, columns: int = 100) -> Hits:
    """Hits of which each number may be given for all, or by column."""
    shape = (lines, columns)
    number = np.broadcast_to(np.asarray(body, dtype=np.int32), shape).copy()
    t = np.where(number < 0, np.inf, np.broadcast_to(np.asarray(t, dtype=np.float64), shape))
    return Hits(t, number, np.broadcast_to(np.asarray(facing, dtype=np.float64), shape).copy())


def step(scanner: Scanner, far: float = 30.0) -> Measured:
    """Between a post at 20 m in columns 40 to 59, and a wall."""
    column = np.arange(100)
    post = (column >= 40) & (column < 60)
    found = hits(np.where(post, 20.0, far), np.where(post, 1, 0), lines=20_000)
    return scan(found, world(Material.WALL, Material.POLE, shape=Shape.CONE), scanner, 0, SEED)


def test_a_pulse_gives_two_returns_of_a_wide_step_and_a_mixture_of_a_narrow_one() -> None:
    wide = step(PULSED)
    width, apart = 0.0033 + 0.00016 * 20.0, PULSED.step_rad * 20.0
    assert set(wide.extra_column) == {39, 40, 59, 60}
    assert len(wide.extra_line) == pytest.approx(4 * 20_000 * 0.5 * width / apart, rel=0.05)
    np.testing.assert_allclose(wide.extra_range_m, 30.0, atol=0.2)  # some of these echoes are weak
    np.testing.assert_allclose(wide.range_m[wide.extra_line, wide.extra_column], 20.0, atol=0.2)
    assert (wide.extra_label == Label.BUILDING).all()
    assert (wide.label[wide.extra_line, wide.extra_column] == Label.POLE).all()
    assert not (wide.label == Label.NOISE).any()
    order = wide.extra_line.astype(np.int64) * 100 + wide.extra_column
    assert (np.diff(order) > 0).all()
    narrow = step(PULSED, far=20.4)
    assert len(narrow.extra_line) == 0
    mixed = narrow.label == Label.NOISE
    assert mixed.any()
    assert ((narrow.range_m[mixed] > 20.04) & (narrow.range_m[mixed] < 20.36)).all()


def street(rng: np.random.Generator, lines: int, columns: int) -> tuple[Hits, Bodies]:
    """Runs of all materials and sky."""
    bodies = world(Material.WALL, Material.GLASS, Material.LEAVES, Material.POLE, Material.TYRE)
    run = np.maximum.accumulate(np.where(rng.random((lines, columns)) < 0.2, np.arange(columns), 0), axis=1)
    body = np.take_along_axis(rng.integers(-1, 5, (lines, columns)), run, axis=1).astype(np.int32)
    t = np.take_along_axis(rng.uniform(2.0, 40.0, (lines, columns)), run, axis=1)
    t = np.where(body >= 0, t + np.where(body == 2, rng.exponential(0.5, (lines, columns)), 0.0), np.inf)
    return Hits(t, body, rng.random((lines, columns))), bodies


@pytest.mark.parametrize("name", sorted(SCANNERS))
def test_result_depends_on_line_and_seed_alone(name: str) -> None:
    scanner = SCANNERS[name]
    rng = np.random.default_rng(3)
    seen, bodies = street(rng, 12, scanner.points_per_line)
    asked = goes_behind(seen, bodies, scanner, 5, SEED)
    behind = Hits(np.where(asked, seen.t + 2.0, np.inf), np.where(asked, 0, -1).astype(np.int32), seen.facing)
    whole = scan(seen, bodies, scanner, 5, SEED, behind)
    for first, stop in pairwise((0, 1, 7, 12)):
        part = scan(seen.lines(first, stop), bodies, scanner, 5 + first, SEED, behind.lines(first, stop))
        np.testing.assert_array_equal(part.range_m, whole.range_m[first:stop])
        np.testing.assert_array_equal(part.label, whole.label[first:stop])
        np.testing.assert_array_equal(part.intensity, whole.intensity[first:stop])
        mine = (whole.extra_line >= first) & (whole.extra_line < stop)
        np.testing.assert_array_equal(part.extra_line + first, whole.extra_line[mine])
        np.testing.assert_array_equal(part.extra_column, whole.extra_column[mine])
        np.testing.assert_array_equal(part.extra_range_m, whole.extra_range_m[mine])
        np.testing.assert_array_equal(part.extra_label, whole.extra_label[mine])
        np.testing.assert_array_equal(part.extra_intensity, whole.extra_intensity[mine])
    other = scan(seen, bodies, scanner, 5, SEED + 1, behind)
    assert (other.range_m != whole.range_m).mean() > 0.5


@pytest.mark.parametrize("name", sorted(SCANNERS))
def test_ranges_labels_and_intensities_go_together(name: str) -> None:
    scanner = SCANNERS[name]
    seen, bodies = street(np.random.default_rng(4), 12, scanner.points_per_line)
    found = scan(seen, bodies, scanner, 0, SEED)
    given = np.isfinite(found.range_m)
    np.testing.assert_array_equal(given, found.label != Label.MISSING)
    np.testing.assert_array_equal(given, found.intensity > 0)
    assert (found.range_m[given] > 0).all()
    assert 0.4 < given.mean() < 0.95
    assert np.isfinite(found.extra_range_m).all()
    if scanner.max_returns == 1:
        assert len(found.extra_line) == 0


def test_kernel_reads_the_labels_that_are_meant() -> None:
    from prc_cli.simulation import sensor_loops as loops

    assert (loops.LABEL_MISSING, loops.LABEL_NOISE) == (Label.MISSING, Label.NOISE)
    assert callable(kernels.sense)
