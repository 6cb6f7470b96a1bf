from __future__ import annotations

import numpy as np
import pytest

from prc_cli.config import RunConfig
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.jobs.calibrate import _measure
from prc_cli.jobs.calibrate.search import ANGLE_AXES, PRC_AXES, ZETA_P, ZETA_S, Axis, Searcher, _neighbours, with_values
from tests.streams.beam_lines import stream


@pytest.mark.parametrize("axis", [*PRC_AXES, *ANGLE_AXES], ids=lambda axis: axis.key)
def test_every_value_of_an_axis_is_a_configuration(axis: Axis) -> None:
    assert list(axis.grid) == sorted(set(axis.grid))
    assert axis.bounds[0] <= axis.grid[0] < axis.grid[-1] <= axis.bounds[1]
    for value in (*axis.bounds, *axis.grid):
        with_values(RunConfig(), {axis.key: int(value) if axis.whole else value})


@pytest.mark.parametrize(
    ("searched", "key", "given", "expected"),
    [
        ({ZETA_S, ZETA_P}, ZETA_P, (1.0, 3.0), (3.0, 3.0)),
        ({ZETA_S, ZETA_P}, ZETA_S, (0.3, 1.0), (0.3, 0.3)),
        ({ZETA_S, ZETA_P}, ZETA_S, (3.0, 1.0), (3.0, 1.0)),
        ({ZETA_P}, ZETA_P, (None, 3.0), (None, 2.0)),
        ({ZETA_S}, ZETA_S, (0.3, None), (1.5, None)),
    ],
)
def test_a_threshold_takes_the_other_along(
    searched: set[str], key: str, given: tuple[float | None, float | None], expected: tuple[float | None, float | None]
) -> None:
    """zeta_s stays at least zeta_p; one that is not searched stays where it is configured, here at 2 m and 1.5 m."""
    config = with_values(RunConfig(), {ZETA_S: 2.0, ZETA_P: 1.5})
    mapping = load_mapping("oakland")
    searcher = Searcher(config, mapping, (), "mean_f1", 5, tuple(axis for axis in PRC_AXES if axis.key in searched))
    values = {name: value for name, value in zip((ZETA_S, ZETA_P), given, strict=True) if value is not None}
    found = searcher._advisable(values, key)
    assert (found.get(ZETA_S), found.get(ZETA_P)) == expected


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


@pytest.mark.parametrize(("n_lines", "is_enough"), [((2, 3), True), ((3, 2), True), ((2, 2), False), ((2, 0), False)])
def test_one_scanner_with_three_lines_is_enough(n_lines: tuple[int, int], is_enough: bool) -> None:
    parts = [ScanBlock(0, np.full((n, 50), 5.0, np.float32), scanner=scanner) for scanner, n in enumerate(n_lines) if n]
    if is_enough:
        assert _measure(stream(*parts), RunConfig(), None)[2] == dict(enumerate(n_lines))
    else:
        with pytest.raises(InputError, match=f"found {sum(n_lines)} scan lines, expected 3 or more"):
            _measure(stream(*parts), RunConfig(), None)
