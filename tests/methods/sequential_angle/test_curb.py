"""Possible curb points and regions of vertical points across lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.sequential_angle.curb import CurbState, _tail, curbs, possible_curbs
from prc_cli.methods.sequential_angle.ground import ground, initial_ground, potential_ground
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import CurbThresholds, GroundThresholds
from tests.methods.sequential_angle.scenes import NOISE_M, Scene, V, made, scan, street


def plain(**values: Any) -> CurbThresholds:
    return made(CurbThresholds, **{"min_height_m": 0.0, "grouping_m": 0.3, **values})


PARAMS = plain()


def possible(scene: Scene, params: CurbThresholds = PARAMS) -> I32:
    limits = GroundThresholds(range_noise_m=NOISE_M)
    rows = (scene.lines, scene.surface, scene.phihat, scene.ahead)
    potential = potential_ground(*rows, limits)
    state = initial_ground(potential.height_m, limits)
    mask, z_g, _ = ground(*rows, potential, state, limits)
    return possible_curbs(scene.lines, scene.surface, mask, z_g, params)


def find(scene: Scene, params: CurbThresholds = PARAMS) -> Mask:
    start = CurbState.start(scene.lines.n_sides, scene.surface.shape[1], params)
    curb, _ = curbs(
        scene.lines, scene.surface, scene.signed, possible(scene), start, params, last=True
    )
    return curb


def test_sides_of_cars_have_something_under_them() -> None:
    scene = scan([street(car=True)] * 12, n=800)
    side = (scene.surface == V) & (np.abs(scene.lines.horizontal_m - 3.0) < 0.05)
    assert side.any(axis=1).all()
    beams = possible(scene)
    assert not side[np.flatnonzero(beams >= 0), beams[beams >= 0]].any()
    # with nothing looked for under it the side itself would be the first
    blind = possible(scene, plain(under_m=100.0))
    assert side[np.arange(12), blind].all()
    assert not find(scene).any()  # the wind screen is a possible curb, and too high for one


def drawn(picture: Sequence[str], step: float = 0.1) -> tuple[VerticalLines, U8, F32]:
    """Lines of one side drawn with ``#`` for vertical points at one height, a grid of ``step``
    metres."""
    surface = np.array([[3 if c == "#" else 2 for c in row] for row in picture], np.uint8)
    rows, n = surface.shape
    x = np.arange(n) * step + 5
    y = np.arange(rows)[:, None] * step
    xyz = np.stack(np.broadcast_arrays(x, y, np.float64(-1.7)), axis=-1).astype(np.float32)
    horizontal = np.hypot(xyz[..., 0], xyz[..., 1])
    lines = VerticalLines(
        np.linalg.norm(xyz, axis=-1),
        xyz,
        horizontal,
        np.full(rows, n, np.int32),
        np.linspace(0.2, 2, n)[None],
    )
    return lines, surface, np.zeros((rows, n), np.float32)


def label(
    lines: VerticalLines,
    surface: U8,
    signed: F32,
    possible: Sequence[int],
    params: CurbThresholds = PARAMS,
) -> Mask:
    start = CurbState.start(1, surface.shape[1], params)
    return curbs(lines, surface, signed, np.array(possible, np.int32), start, params, last=True)[0]


def test_sides_never_connect() -> None:
    lines, surface, signed = drawn(["#", "#", "#", "#"])
    two = VerticalLines(
        lines.range_m,
        lines.xyz_m,
        lines.horizontal_m,
        lines.n_beams,
        np.tile(lines.beam_rad, (2, 1)),
    )
    beams = np.array([0, -1, -1, -1], np.int32)
    params = plain(min_lines=3)
    curb, _ = curbs(two, surface, signed, beams, CurbState.start(2, 1, params), params, last=True)
    assert not curb.any()  # two lines a side, one of them without a possible point
    assert label(lines, surface, signed, [0, -1, -1, -1]).all()
    curb, _ = curbs(
        two,
        surface,
        signed,
        beams,
        CurbState.start(2, 1, plain(min_lines=2)),
        plain(min_lines=2),
        last=True,
    )
    assert curb[:, 0].tolist() == [True, False, True, False]


def test_a_region_of_very_many_lines_is_decided_and_what_follows_is_a_new_one() -> None:
    lines, surface, signed = drawn(["#"] * 25)
    params = plain(max_lines=10)
    beams = np.full(25, -1, np.int32)
    beams[12] = 0
    state = CurbState.start(1, 1, params)
    curb, state = curbs(lines, surface, signed, beams, state, params, last=False)
    assert curb[:, 0].tolist() == [False] * 10 + [True] * 10
    assert state.n_waiting == 5


@pytest.mark.parametrize("n", [0, 1, 3])
@pytest.mark.parametrize("n_new", [0, 1, 2, 3, 4, 9])
def test_the_last_rows_stay(n: int, n_new: int) -> None:
    before = np.arange(n, dtype=np.float32)
    new = 10 + np.arange(n_new, dtype=np.float32)
    assert (
        _tail(before, new).tolist()
        == np.concatenate([before, new])[len(before) + n_new - n :].tolist()
    )
