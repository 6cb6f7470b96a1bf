"""Facades seen through their windows and through crowns are vertical; foliage stays."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.types import F64, U8
from prc_cli.methods.sequential_angle.coarse import without_windows
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import WindowThresholds
from tests.methods.sequential_angle.made import made

T, H, V = 1, 2, 3


def label(
    x: F64, z: F64, codes: list[int], params: WindowThresholds | None = None, noise_m: float = 0.005
) -> list[int]:
    xyz = np.stack([x, 0 * x, z], axis=-1)[None].astype(np.float32)
    beams = np.arctan2(x, -z)[None]
    lines = VerticalLines(np.linalg.norm(xyz, axis=-1), xyz, xyz[..., 0].copy(), np.array([len(x)], np.int32), beams)
    surface: U8 = np.array([codes], np.uint8)
    return without_windows(surface, lines, (params or WindowThresholds()).at_noise(noise_m))[0].tolist()


@pytest.mark.parametrize("noise_m", [0.001, 0.005])
def test_panes_and_rooms_are_vertical_and_leaves_are_not(noise_m: float) -> None:
    rng = np.random.default_rng(1)
    z = np.linspace(1.0, 2.5, 60)
    window = np.where(rng.random(60) < 0.4, 9.0, 9.5) + rng.normal(0, noise_m, 60)
    leaves = 9.0 + rng.exponential(1.4, 60)
    hedge = 9.0 + rng.exponential(0.17, 60)
    assert label(window, z, [T] * 60, noise_m=noise_m) == [V] * 60
    assert label(leaves, z, [T] * 60, noise_m=noise_m) == label(hedge, z, [T] * 60, noise_m=noise_m) == [T] * 60
    assert label(window, z, [T] * 60, made(WindowThresholds, share=1.0), noise_m) == [T] * 60
    assert label(window[:7], z[:7], [T] * 7) == [T] * 7


def test_what_is_behind_a_wall_below_it_is_a_room_and_what_is_over_it_may_be_a_tree() -> None:
    z = np.linspace(0.0, 2.0, 40)
    far = 12.4 + np.linspace(0.0, 3.0, 20)
    under = np.concatenate([far, np.full(20, 12.0)])
    over = under[::-1].copy()
    assert label(under, z, [T] * 20 + [V] * 20) == [V] * 40
    assert label(over, z, [V] * 20 + [T] * 20) == [V] * 20 + [T] * 20
