"""Cars in a line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from prc_cli import kernels
from prc_cli.core.types import F64, I32, Mask
from prc_cli.methods.sequential_angle.car import cars, dividers
from prc_cli.methods.sequential_angle.thresholds import CarThresholds, DividerThresholds
from tests.methods.sequential_angle.car_lines import (
    DENSE,
    NOISE_M,
    H,
    Piece,
    Seen,
    V,
    bush,
    car,
    curb,
    make_lines,
    road,
    see,
    signed_angles,
    wall,
)
from tests.methods.sequential_angle.made import made


def find(found: Seen, params: CarThresholds | None = None) -> Mask:
    signed = signed_angles(found.lines)
    return cars(
        found.lines, found.surface, found.surface, signed, found.z_g, (params or CarThresholds()).at_noise(NOISE_M)
    ).car


def test_recall_and_precision_on_lines_of_a_street() -> None:
    rng = np.random.default_rng(6)
    scenes: list[list[Piece]] = []
    for _ in range(60):
        at = float(rng.uniform(4, 12))
        kerb = at + float(rng.uniform(2.2, 3.5))
        house = kerb + float(rng.uniform(1, 6))
        vehicle = car(at, glass=bool(rng.random() < 0.7), tyre=bool(rng.random() < 0.3))
        parked = vehicle if rng.random() < 0.6 else []
        tree = bush(kerb + 0.4) if rng.random() < 0.3 else []
        scenes.append([*road(), *parked, *curb(kerb), *tree, *wall(house, 0.15, windows=bool(rng.random() < 0.5))])
    found = see(scenes, rng, scanner_m=2.2)
    marked = find(found)
    truth = np.array([[name == "car" for name in names] for names in found.names]) & (found.surface > 0)
    both = (marked & truth).sum()
    assert both / truth.sum() > 0.9
    assert both / marked.sum() > 0.9


def test_only_returns_are_marked_and_none_of_dense_vegetation() -> None:
    found = see([[*road(), *car(6), *bush(9)], [*road(), *bush(5)]], np.random.default_rng(1))
    marked = find(found)
    assert marked[0].any()
    assert not marked[np.isnan(found.lines.range_m)].any()
    assert not marked[found.surface == DENSE].any()
    assert marked.dtype == np.bool_


def test_nothing_is_marked_behind_a_high_vertical() -> None:
    """What shows through the ground floor of a wall, between its foot and a window, stands behind it."""
    open_wall = [Piece("wall", (9.0, 0.0), (9.0, 0.3)), Piece("wall", (9.0, 1.1), (9.0, 8.0))]
    inside = [*road(), *open_wall, *car(13.5)]
    found = see([inside], np.random.default_rng(3), scanner_m=2.5)
    assert len(found.where("car")) > 5
    marked = find(found)
    assert not marked[0, found.where("car")].any()


def test_without_ground_there_are_no_cars() -> None:
    found = see([[*road(), *car(6)]], np.random.default_rng(1))
    unknown = Seen(found.lines, found.surface, found.names, np.array([np.nan], np.float32))
    assert find(found).any()
    assert not find(unknown).any()


PLAIN = {
    "return_points": 0, "from_start": False, "flat_step_m": 0.0, "flat_above_m": 1000.0, "tall_m": 0.0, "glass_m": 0.0,
    "vertical_top_m": 0.0, "vertical_open": False, "straight_extent_m": 0.0, "lean_sigmas": 0.0, "relief_m": 0.0,
}  # fmt: skip
"""Without the readings that are ours, so that every rule is tested by itself."""


def plain(**values: Any) -> DividerThresholds:
    return made(DividerThresholds, **{**PLAIN, **values})


PARAMS = plain()


def find_of_dividers(
    found: Seen, params: DividerThresholds = PARAMS, *, trigger: int = 0, noise_m: float = NOISE_M
) -> I32:
    triggers = np.full(len(found.surface), trigger, np.int32)
    literal = max(params.change_chord_m, params.change_chord_sigmas * noise_m) == 0
    signed = signed_angles(found.lines) if literal else np.full_like(found.lines.range_m, np.nan)
    return dividers(found.lines, found.surface, signed, triggers, found.z_g, params.at_noise(noise_m)).pieces


def look(pieces: list[Piece], seed: int = 1, **how: Any) -> Seen:
    return see([pieces], np.random.default_rng(seed), **how)


def share_of_lines(pieces: list[Piece], params: DividerThresholds, at_m: float, **how: Any) -> float:
    """Share of 100 lines with an interval that begins within 40 cm of a distance."""
    found = see([pieces] * 100, np.random.default_rng(4), **how)
    rows = [
        row
        for row, first, _ in find_of_dividers(found, params)
        if abs(found.lines.horizontal_m[row, first] - at_m) < 0.4
    ]
    return len(set(rows)) / 100


ALL_SUDDEN = plain(sudden_from_deg=-180, sudden_to_deg=180, vertical_extent_m=100)
"""Every change is sudden, so that TestUnder alone decides."""


@pytest.mark.parametrize("distance", [4.0, 7.0, 12.0])
@pytest.mark.parametrize("step_deg", [0.06, 0.115, 0.2])
def test_something_is_under_the_side_of_a_car_but_not_under_walls_and_curbs(distance: float, step_deg: float) -> None:
    how = {"step_deg": step_deg, "high_deg": 95.0}
    assert share_of_lines([*road(), *car(distance)], ALL_SUDDEN, distance, **how) == 1
    assert share_of_lines([*road(), *wall(distance)], ALL_SUDDEN, distance, **how) == 0
    assert share_of_lines([*road(), *curb(distance)], ALL_SUDDEN, distance, **how) == 0


def test_walls_curbs_and_poles_give_no_interval() -> None:
    rng = np.random.default_rng(9)
    pole = [Piece("pole", (5.0, 0.0), (5.0, 1.1))]
    scenes = [[*road()], [*road(), *wall(9)], [*road(), *curb(9), *wall(12, 0.15, windows=True)], [*road(), *pole]]
    found = see(scenes * 25, rng)
    sudden = plain(sudden_from_deg=-60, sudden_to_deg=60)
    assert len(find_of_dividers(found, sudden)) == 0
    assert len(set(find_of_dividers(found)[:, 0].tolist())) <= 8, "some of a hundred changes look gradual"


@pytest.mark.parametrize("behind_m", [8.2, 9.5, 11.0])
def test_wall_behind_a_car_is_cut_out_although_the_search_ends_below_its_top(behind_m: float) -> None:
    found = look([*road(), *car(6, glass=False), *wall(behind_m)])
    (interval,) = find_of_dividers(found)
    assert {found.names[0][k] for k in range(interval[1], interval[2] + 1)} == {"car"}
    assert len(find_of_dividers(found, plain(vertical_extent_m=100)).ravel()) >= 3
    uncut = find_of_dividers(found, plain(vertical_extent_m=100))
    assert {found.names[0][k] for _, a, b in uncut for k in range(a, b + 1)} >= {"car", "wall"}


def profile(steps: list[tuple[str, float, float]]) -> tuple[Seen, F64]:
    """A noiseless line from (label, distance, height over the road) of every return, angles as they come."""
    h, z = np.array([step[1] for step in steps]), np.array([step[2] for step in steps]) - 1.8
    lines = make_lines(np.hypot(h, z)[None], np.pi / 2 + np.arctan2(z, h))
    codes = np.array([[{"H": H, "V": V, "T": DENSE}[step[0]] for step in steps]], np.uint8)
    return Seen(lines, codes, [["" for _ in steps]], np.array([-1.8], np.float32)), h


def ground(from_m: float, to_m: float, step_m: float = 0.25) -> list[tuple[str, float, float]]:
    return [("H", float(h), 0.0) for h in np.arange(from_m, to_m + 1e-6, step_m)]


def side(at_m: float, top_m: float = 0.95) -> list[tuple[str, float, float]]:
    return [("V", at_m, float(z)) for z in np.arange(0.2, top_m, 0.1)]


def spans(steps: list[tuple[str, float, float]], params: DividerThresholds = PARAMS) -> list[tuple[int, int]]:
    found, _ = profile(steps)
    return [(int(first), int(last)) for _, first, last in find_of_dividers(found, params)]


def columns(shapes: list[tuple[float, float, float, int]], codes: str) -> tuple[Any, Any, Any]:
    """One line through (distance, from height, to height, points) pieces, and its codes."""
    x = np.concatenate([np.full(n, d) for d, _, _, n in shapes])
    z = np.concatenate([np.linspace(a, b, n) for _, a, b, n in shapes])
    letters = np.repeat(list(codes), [n for *_, n in shapes])
    surface = np.array([[{"H": H, "V": V}[letter] for letter in letters]], np.uint8)
    return x, z, surface


def left_of(x: Any, z: Any, surface: Any, **changed: Any) -> list[tuple[int, int]]:
    """What is left of an interval over a whole line; the ground lies at -1.8 m."""
    xyz = np.stack([x, 0 * x, z], axis=-1)[None].astype(np.float32)
    whole = np.array([[0, 0, len(x) - 1]], np.int32)
    limits = made(DividerThresholds, **changed).at_noise(0.005)
    ground = np.array([-1.8], np.float32)
    n_beams = np.array([len(x)], np.int32)
    found = kernels.cut_verticals(surface, xyz, xyz[..., 0].copy(), n_beams, whole, ground, limits)
    return [(int(a), int(b)) for _, a, b in found]


def test_a_fence_is_cut_out_and_the_bowed_side_of_a_car_is_not() -> None:
    x, z, surface = columns([(6.0, -1.6, -0.7, 40)], "V")
    assert left_of(x, z, surface) == []
    assert left_of(x, z, surface, straight_extent_m=0) == [(0, 39)]
    bowed = x + 0.06 * np.sin(np.linspace(0, np.pi, 40))
    leaning = x + np.tan(np.deg2rad(4)) * (z + 1.6)
    assert left_of(bowed, z, surface) == left_of(leaning, z, surface) == [(0, 39)]


def test_only_what_is_higher_than_a_van_is_cut_out_by_its_height() -> None:
    x, z, surface = columns([(6.0, -1.6, 0.5, 60)], "V")
    leaning = x + np.tan(np.deg2rad(5)) * (z + 1.6)
    assert left_of(leaning, z, surface) == []  # it goes on to the last beam, so that nothing tells where it ends
    assert left_of(leaning, z, surface, vertical_open=False) == [(0, 59)]
    assert left_of(leaning, z, surface, vertical_top_m=0) == []
    assert left_of(leaning, z + 0.5, surface) == []
    few = slice(None, None, 6)
    assert left_of(leaning[few], z[few], surface[:, few].copy()) == []


def test_the_side_of_a_van_is_searched_to_its_top() -> None:
    def van(top: float) -> list[tuple[str, float, float]]:
        start = [*ground(2, 6.5), *side(6)]
        flank = [("V", 6.0 + 0.05 * float(z), float(z)) for z in np.arange(1.0, top, 0.1)]
        return [*start, *flank, ("V", 12.0, top + 0.5), ("V", 12.0, top + 0.6)]

    begin = len(ground(2, 6.5))
    low = len([*ground(2, 6.5), *side(6)]) + 10  # up to 2 m
    tall = plain(tall_m=2.6, vertical_extent_m=9)
    for top, expected in ((2.5, len(van(2.5)) - 3), (2.9, low)):
        ((first, last),) = spans(van(top), tall)
        assert first == begin
        assert abs(last - expected) <= 1
    assert spans(van(2.5), plain(vertical_extent_m=9))[0][1] <= low


def test_a_window_does_not_end_the_search_and_a_bush_does() -> None:
    start = [*ground(2, 6.5), *side(6)]
    begin, panes = len(ground(2, 6.5)), [("T", 6.0 + 0.4 * (i % 3), 0.9 + 0.05 * i) for i in range(8)]
    behind = [("V", 6.3, 1.35), ("H", 6.5, 1.4), ("H", 6.8, 1.4)]
    params = plain(glass_m=1.0)
    assert spans([*start, *panes, *behind], params) == [(begin, len(start) + len(panes) + 2)]
    assert spans([*start, *panes, *behind]) == [(begin, len(start) - 1)]
    far = [("V", 9.3, 1.35), ("V", 9.3, 1.4)]
    assert spans([*start, *panes, *far], params) == [(begin, len(start) - 1)], "a wall behind a bush"


def test_a_rough_wall_is_cut_out_and_a_van_is_not() -> None:
    """Slats that return from two depths, some shots through them: angles call half of them horizontal."""
    x, z, surface = columns([(6.0, -1.6, 0.2, 80)], "V")
    surface[0, ::3] = H
    rough = x + 0.03 * (np.arange(80) % 5 == 0)
    rough[[20, 41]] = 9.0
    assert left_of(rough, z, surface) == []
    assert left_of(rough, z, surface, relief_m=0) != []
    leaning = rough + np.tan(np.deg2rad(5)) * z
    assert left_of(leaning, z, surface) == left_of(leaning, z, surface, relief_m=0) != []
