from __future__ import annotations

import pytest

from prc_cli.config import RunConfig
from prc_cli.jobs.calibrate.search import ANGLE_AXES, PRC_AXES, Axis, _neighbours, with_values


@pytest.mark.parametrize("axis", [*PRC_AXES, *ANGLE_AXES], ids=lambda axis: axis.key)
def test_every_value_of_an_axis_is_a_configuration(axis: Axis) -> None:
    assert list(axis.grid) == sorted(set(axis.grid))
    assert axis.bounds[0] <= axis.grid[0] < axis.grid[-1] <= axis.bounds[1]
    for value in (*axis.bounds, *axis.grid):
        with_values(RunConfig(), {axis.key: int(value) if axis.whole else value})


def test_refinement_goes_down_to_one_pixel_and_not_out_of_bounds() -> None:
    area = next(axis for axis in PRC_AXES if axis.key == "prc.surfaces.area")
    assert _neighbours(area, 2.0, 2.0) == (1.0, 4.0)
    assert _neighbours(area, 1.0, 2.0) == (2.0,)
    gamma = next(axis for axis in PRC_AXES if axis.whole)
    assert _neighbours(gamma, 0.0, 2.0) == (1.0,)
    assert _neighbours(gamma, 3.0, 2.0) == (2.0, 4.0)
    zeta = next(axis for axis in PRC_AXES if axis.key == "prc.support.zeta_p")
    assert _neighbours(zeta, 0.01, 1.5) == (0.015,)
    assert _neighbours(zeta, 10.0, 1.5) == (6.67,)
