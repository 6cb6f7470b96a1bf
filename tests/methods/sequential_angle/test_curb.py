"""Possible curb points and regions of vertical points across lines."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.random import Generator

from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.sequential_angle.curb import CurbState, _tail, curbs, possible_curbs
from prc_cli.methods.sequential_angle.ground import ground, initial_ground, potential_ground
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import CurbThresholds, GroundThresholds
from tests.methods.sequential_angle.made import made
from tests.methods.sequential_angle.profiles import NOISE_M, Scene, Segment, V, scan, street

PLAIN = CurbThresholds(min_height_m=0.0)
"""Without the readings that are ours, so that every rule is tested by itself."""


def plain(**values: Any) -> CurbThresholds:
    return made(CurbThresholds, **{"min_height_m": 0.0, **values}).at_noise(NOISE_M)


PARAMS = plain()


def possible(scene: Scene, params: CurbThresholds = PARAMS) -> I32:
    potential = potential_ground(
        scene.lines, scene.surface, scene.phihat, scene.ahead, GroundThresholds().at_noise(NOISE_M)
    )
    state = initial_ground(potential.height_m, GroundThresholds())
    found, z_g, _ = ground(
        scene.lines, scene.surface, scene.phihat, scene.ahead, potential, state,
        GroundThresholds().at_noise(NOISE_M),
    )  # fmt: skip
    return possible_curbs(scene.lines, scene.surface, found, z_g, params)


def find(scene: Scene, params: CurbThresholds = PARAMS) -> Mask:
    start = CurbState.start(scene.lines.n_sides, scene.surface.shape[1], params)
    curb, _ = curbs(scene.lines, scene.surface, scene.signed, possible(scene), start, params, last=True)
    return curb


def riser(scene: Scene) -> Mask:
    mask: Mask = (scene.surface == V) & (np.abs(scene.lines.horizontal_m - 6.0) < 0.05)
    return mask


@pytest.mark.parametrize("n_sides", [1, 2])
def test_curbs_are_found_and_walls_are_not(n_sides: int) -> None:
    scene = scan([street()] * 12, n=800, n_sides=n_sides)
    np.testing.assert_array_equal(find(scene), riser(scene))


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


@pytest.mark.parametrize(("deeper_m", "noise_m", "under"), [(0.02, 0.005, False), (0.035, 0.005, True), (0.035, 0.006, False), (0.02, 0.001, True)])  # fmt: skip  # noqa: E501
def test_something_under_is_farther_by_the_larger_of_both_limits(deeper_m: float, noise_m: float, under: bool) -> None:
    """1 cm, or six times the range noise: 3 cm for 5 mm, 3.6 cm for 6 mm."""
    ranges = np.array([[3.0, 3.0 + deeper_m, 3.0]], np.float32)
    xyz = np.stack([ranges, 0 * ranges, 0 * ranges], axis=-1)
    lines = VerticalLines(ranges, xyz, ranges, np.array([3], np.int32), np.linspace(1.4, 1.5, 3)[None])
    surface, on_ground = np.array([[2, 2, 3]], np.uint8), np.array([[True, True, False]])
    found = possible_curbs(lines, surface, on_ground, np.zeros(1, np.float32), PLAIN.at_noise(noise_m))
    assert found.tolist() == [-1 if under else 2]


def test_search_ends_two_metres_above_the_ground() -> None:
    floating: list[Segment] = [(0.0, -1.8, 6.0, -1.8, 2), (6.0, 0.5, 6.0, 1.5, V)]
    scene = scan([floating] * 4, n=600)
    assert (possible(scene) == -1).all()
    assert (possible(scene, plain(search_height_m=5.0)) >= 0).all()


def drawn(picture: Sequence[str], step: float = 0.1) -> tuple[VerticalLines, U8, F32]:
    """Lines of one side drawn with ``#`` for vertical points at one height, a grid of ``step`` metres."""
    surface = np.array([[3 if c == "#" else 2 for c in row] for row in picture], np.uint8)
    rows, n = surface.shape
    x, y = np.arange(n) * step + 5, np.arange(rows)[:, None] * step
    xyz = np.stack(np.broadcast_arrays(x, y, np.float64(-1.7)), axis=-1).astype(np.float32)
    horizontal = np.hypot(xyz[..., 0], xyz[..., 1])
    lines = VerticalLines(
        np.linalg.norm(xyz, axis=-1), xyz, horizontal, np.full(rows, n, np.int32), np.linspace(0.2, 2, n)[None]
    )
    return lines, surface, np.zeros((rows, n), np.float32)


def label(
    lines: VerticalLines, surface: U8, signed: F32, possible: Sequence[int], params: CurbThresholds = PARAMS
) -> Mask:
    start = CurbState.start(1, surface.shape[1], params)
    return curbs(lines, surface, signed, np.array(possible, np.int32), start, params, last=True)[0]


def test_regions_merge_fork_and_touch_the_ends_of_rows() -> None:
    merge = drawn(["#...#", ".#.#.", "..#..", ".#.#.", "#...#"])
    np.testing.assert_array_equal(label(*merge, [-1, -1, -1, -1, 4]), merge[1] == V)
    apart = drawn(["#...#", "#...#", "#...#"])
    np.testing.assert_array_equal(label(*apart, [4, -1, -1])[0], [False, False, False, False, True])
    assert not label(*drawn(["#.#", "...", "#.#"]), [0, -1, 0]).any()  # complete after one line each
    # too far apart in space, though neighbours on the grid
    assert not label(*drawn(["##", "##", "##"], step=0.4), [0, -1, -1], plain(min_lines=2)).any()


def test_sides_never_connect() -> None:
    lines, surface, signed = drawn(["#", "#", "#", "#"])
    two = VerticalLines(lines.range_m, lines.xyz_m, lines.horizontal_m, lines.n_beams, np.tile(lines.beam_rad, (2, 1)))
    at = np.array([0, -1, -1, -1], np.int32)
    params = plain(min_lines=3)
    curb, _ = curbs(two, surface, signed, at, CurbState.start(2, 1, params), params, last=True)
    assert not curb.any()  # two lines a side, one of them without a possible point
    assert label(lines, surface, signed, [0, -1, -1, -1]).all()
    curb, _ = curbs(two, surface, signed, at, CurbState.start(2, 1, plain(min_lines=2)), plain(min_lines=2), last=True)  # fmt: skip  # noqa: E501
    assert curb[:, 0].tolist() == [True, False, True, False]


def test_a_region_of_very_many_lines_is_decided_and_what_follows_is_a_new_one() -> None:
    lines, surface, signed = drawn(["#"] * 25)
    params = plain(max_lines=10)
    at = np.full(25, -1, np.int32)
    at[12] = 0
    state = CurbState.start(1, 1, params)
    curb, state = curbs(lines, surface, signed, at, state, params, last=False)
    assert curb[:, 0].tolist() == [False] * 10 + [True] * 10
    assert state.n_waiting == 5


def random_scene(rng: Generator, n_lines: int, n_sides: int, n: int) -> Scene:
    shape = (n_lines * n_sides, n)
    surface = np.where(rng.random(shape) < 0.55, 3, rng.choice([0, 2], shape)).astype(np.uint8)
    z = -1.75 + rng.choice([0.0, 0.06, 0.15, 0.21], shape, p=[0.6, 0.3, 0.09, 0.01])
    xyz = np.stack([5 + np.arange(n) * 0.1 + 0 * z, 0 * z, z], axis=-1).astype(np.float32)
    horizontal = np.hypot(xyz[..., 0], xyz[..., 1])
    lines = VerticalLines(
        np.linalg.norm(xyz, axis=-1), xyz, horizontal, np.full(len(z), n, np.int32), np.zeros((n_sides, n))
    )
    signed = rng.choice([0.0, 15.0, 30.0], shape).astype(np.float32)
    return Scene(lines, surface, signed, signed, surface.astype(np.int32))


@pytest.mark.parametrize("n_sides", [1, 2])
@pytest.mark.parametrize("max_lines", [3, 200])
def test_cuts_change_nothing_and_memory_is_bounded(n_sides: int, max_lines: int) -> None:
    rng = np.random.default_rng(8)
    params = plain(max_lines=max_lines, max_height_m=0.18)
    shown = 0
    for _ in range(10):
        scene = random_scene(rng, 40, n_sides, 12)
        at = rng.integers(-12, 12, len(scene.surface)).clip(-1).astype(np.int32)
        start = CurbState.start(n_sides, 12, params)
        whole, _ = curbs(scene.lines, scene.surface, scene.signed, at, start, params, last=True)
        assert len(whole) == len(scene.surface)
        shown += int(whole.sum())
        for cuts in (range(1, 40), np.sort(rng.integers(0, 41, 6)).tolist()):
            edges = [0, *(cut * n_sides for cut in cuts), len(scene.surface)]
            state, parts = start, []
            for first, end in pairwise(edges):
                part = scene.rows(first, end)
                found, state = curbs(part.lines, part.surface, part.signed, at[first:end], state, params, last=False)
                assert len(found) % n_sides == 0
                assert state.n_waiting < max_lines
                assert len(state.regions.labels) <= max(max_lines, 1) * n_sides
                parts.append(found)
            rest = scene.rows(0, 0)
            found, state = curbs(rest.lines, rest.surface, rest.signed, at[:0], state, params, last=True)
            np.testing.assert_array_equal(np.concatenate([*parts, found]), whole)
            assert state.n_waiting == 0
    assert shown > 0


def test_a_wall_holds_no_line_back_and_costs_little() -> None:
    lines, surface, signed = drawn(["#" * 1000] * 10, step=0.01)
    lines.xyz_m[..., 2] = np.linspace(-1.8, 8.0, 1000)
    tall = VerticalLines(*(np.tile(a, (100,) + (1,) * (a.ndim - 1)) for a in (lines.range_m, lines.xyz_m, lines.horizontal_m, lines.n_beams)), lines.beam_rad)  # fmt: skip  # noqa: E501
    none = np.full(1000, -1, np.int32)

    def seconds(rows: int) -> float:
        part = VerticalLines(tall.range_m[:rows], tall.xyz_m[:rows], tall.horizontal_m[:rows], tall.n_beams[:rows], tall.beam_rad)  # fmt: skip  # noqa: E501
        wall, angle = np.tile(surface, (rows // 10, 1)), np.tile(signed, (rows // 10, 1))
        best = np.inf
        for _ in range(3):
            begin = time.process_time()
            curb, state = curbs(part, wall, angle, none[:rows], CurbState.start(1, 1000, PARAMS), PARAMS, last=False)
            best = min(best, time.process_time() - begin)
            assert curb.shape == (rows, 1000)
            assert state.n_waiting == 0
        return best

    # four times as much to do takes sixteen times as long if it grows with the square, and that every time
    assert any(seconds(1000) < 10 * seconds(250) + 0.005 for _ in range(5))


@pytest.mark.parametrize("n", [0, 1, 3])
@pytest.mark.parametrize("n_new", [0, 1, 2, 3, 4, 9])
def test_the_last_rows_stay(n: int, n_new: int) -> None:
    before, new = np.arange(n, dtype=np.float32), 10 + np.arange(n_new, dtype=np.float32)
    assert _tail(before, new).tolist() == np.concatenate([before, new])[len(before) + n_new - n :].tolist()
