"""Streets and slopes: every surface has the class that a person sees."""

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F32
from prc_cli.methods.base import Wanted
from prc_cli.methods.run import run_blocks
from prc_cli.methods.sequential_angle.pipeline import SequentialAngle
from prc_cli.methods.sequential_angle.thresholds import SequentialAngleThresholds
from tests.methods.sequential_angle.scenes import ROAD_Z, scan, street


def labelled(block: ScanBlock) -> LabelledBlock:
    method = SequentialAngle(SequentialAngleThresholds().at_noise())
    (item,) = run_blocks(iter([block]), method, wanted=Wanted(stages=True))
    return item


def places(block: ScanBlock) -> tuple[F32, F32]:
    """Return the distance to the side and the height of every shot."""
    assert block.xyz_m is not None
    return block.xyz_m[..., 0], block.xyz_m[..., 2]


@pytest.mark.parametrize("curb_m", [0.0, 0.15])
def test_a_street_without_a_car(curb_m):
    block = scan([street(curb_m)] * 40)
    labels = labelled(block).labels
    x, _ = places(block)
    assert (labels == Label.CAR).mean() < 0.005
    assert (labels[x < 2.9] == Label.GROUND).mean() > 0.6
    assert (labels[x > 9.9] == Label.VERTICAL).mean() > 0.98
    is_curb = labels == Label.CURB
    assert is_curb[np.abs(x - 6) < 0.02].mean() > 0.8 if curb_m else not is_curb.any()


def test_the_side_of_a_car_is_no_curb():
    """Something is under it, and the wind screen is too high for a curb."""
    block = scan([street(car=True)] * 40)
    labels = labelled(block).labels
    x, z = places(block)
    body = (x > 2.9) & (x < 4.95) & (z > -1.6)
    assert (labels[body] == Label.CAR).mean() > 0.5
    assert (labels[~body] == Label.CAR).mean() < 0.005
    assert not (labels == Label.CURB).any()


@pytest.mark.parametrize("n", [800, 3200])
def test_a_wall_hit_head_on_is_not_vegetation(n):
    """Beams are as close to each other as the noise, or farther apart."""
    block = scan([[(10.0, -3.0, 10.0, 6.0)]] * 20, n)
    labels = labelled(block).labels
    assert (labels[~np.isnan(block.range_m)] == Label.VERTICAL).mean() > 0.95


@pytest.mark.parametrize("slope_deg", [0.5, 3.0])
@pytest.mark.parametrize("turned_deg", [0.0, 90.0, 200.0])
def test_a_slope_is_ground_all_around_whatever_the_first_line(slope_deg, turned_deg):
    rise = np.tan(np.deg2rad(slope_deg)) * np.cos(np.deg2rad(np.arange(0, 360, 4) + turned_deg))
    block = scan([[(0.6, ROAD_Z + 0.6 * t, 15.0, ROAD_Z + 15 * t)] for t in rise.tolist()], n=300)
    item = labelled(block)
    assert item.stages is not None
    is_ground = (item.labels == Label.GROUND)[~np.isnan(block.range_m)]
    assert is_ground.mean() > 0.97
    assert np.all(np.abs(item.stages.ground_height_m - ROAD_Z) < 0.02)
