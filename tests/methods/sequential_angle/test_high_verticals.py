"""The first vertical sequence that ends high above the ground, which hides cars behind it."""

from __future__ import annotations

import numpy as np

from prc_cli.methods.sequential_angle.car import high_verticals
from prc_cli.methods.sequential_angle.thresholds import HighVerticalThresholds
from tests.methods.sequential_angle.car_lines import H, V, car, make_lines, road, see, wall

PARAMS = HighVerticalThresholds()


def test_distance_of_a_wall_is_found_and_of_low_things_not() -> None:
    rng = np.random.default_rng(3)
    scenes = [
        [*road(), *wall(12.0)],
        [*road(), *wall(12.0, windows=True)],
        [*road(), *car(6.0), *wall(12.0)],
        [*road(), *car(6.0)],
        [*road(), *wall(5.0, top_m=2.0), *wall(15.0)],
        [*road(), *wall(5.0, top_m=2.0)],
    ]
    found = see(scenes, rng)
    distances = high_verticals(found.lines, found.surface, found.z_g, PARAMS)
    np.testing.assert_allclose(distances, [12, 12, 12, np.inf, 15, np.inf], atol=0.05)
    assert distances.dtype == np.float32


def test_last_point_of_the_sequence_decides() -> None:
    beam = np.deg2rad([60.0, 80.0, 100.0, 110.0, 120.0])
    distance = np.array([10.0, 10.0, 11.0, 12.0, 13.0])
    lines = make_lines((distance / np.sin(beam))[None], beam)
    ground = np.array([-1.8], np.float32)

    def limit(codes: list[int], z_g: np.ndarray = ground) -> float:
        return float(high_verticals(lines, np.array([codes], np.uint8), z_g, PARAMS)[0])

    np.testing.assert_allclose(limit([V, V, V, V, V]), 13, rtol=1e-6)
    np.testing.assert_allclose(limit([V, V, V, H, V]), 11, rtol=1e-6)
    np.testing.assert_allclose(limit([H, H, V, 0, V]), 11, rtol=1e-6, err_msg="a missing shot ends a sequence")
    np.testing.assert_allclose(limit([V, V, H, V, H]), 12, rtol=1e-6)
    assert limit([V, V, H, H, H]) == np.inf, "ends at the height of the scanner"
    assert limit([V, V, V, V, V], np.array([np.nan], np.float32)) == np.inf, "no ground is known"
