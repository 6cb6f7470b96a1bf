"""Pieces of jobs at their limits."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.jobs.batch.report import drift
from prc_cli.jobs.thin import _check_lines


def files(*ground: int) -> list[dict[str, int]]:
    return [{"GROUND": n, "OBJECT": 1000 - n} for n in ground]


def test_alarms_at_their_limits() -> None:
    usual = files(600, 610, 591, 605, 595, 600, 600, 600)
    far = {"GROUND": 100, "OBJECT": 900}
    assert drift(far, usual) == "GROUND is 10.0 % of the records, in 8 earlier files 60.0 % (59.4 to 60.6 % in most)"
    # a file of a single record counts, an empty one does not
    assert drift(far, usual[:7]) is None
    assert drift(far, [*usual[:7], {"GROUND": 1}]) is not None
    assert drift(far, [*usual[:7], {"GROUND": 0}]) is None
    assert drift({}, usual) == "there are no records, while 8 earlier files have some"
    assert drift({"GROUND": 1}, usual) is not None
    # the change of a twentieth, or six standard deviations above the median distance
    equal = files(*[600] * 8)
    assert drift({"GROUND": 5500, "OBJECT": 4500}, equal) is None
    assert drift({"GROUND": 5499, "OBJECT": 4501}, equal) is not None
    wide = files(500, 520, 540, 560, 640, 660, 680, 700)
    # distances 100, 80, 60, 40, 40, 60, 80, 100: median 70, median deviation 20
    limit = 600 - 70 - 6 * 1.4826 * 20
    assert drift({"GROUND": math.ceil(limit), "OBJECT": 1000 - math.ceil(limit)}, wide) is None
    assert drift({"GROUND": math.floor(limit) - 1, "OBJECT": 1001 - math.floor(limit)}, wide) is not None


@pytest.mark.parametrize(
    ("n_alike", "n_usual", "is_odd"), [(2, 20, True), (3, 20, False), (4, 90, True), (5, 90, False)]
)
def test_a_kind_of_drive_that_was_there_is_not_odd(n_alike: int, n_usual: int, is_odd: bool) -> None:
    for alike, expected in ((149, is_odd), (151, True)):
        earlier = files(*[600] * n_usual, *[alike] * n_alike)
        assert (drift({"GROUND": 100, "OBJECT": 900}, earlier) is not None) is expected


def rules(**given: Any) -> Any:
    config = {key: given.pop(key, None) for key in ("time_origin", "angle_start", "angle_step")}
    usual = {"lines": "angle-wrap", "columns": "angle", "line_hz": None, "config": SimpleNamespace(**config)}
    grid = SimpleNamespace(grid=SimpleNamespace(start_rad=math.radians(5.0), step_rad=math.radians(0.25)))
    times = iter([SimpleNamespace(values={"time": np.array([7.25, 8.0])})])
    return SimpleNamespace(
        rules=SimpleNamespace(**{**usual, **given}),
        setups=dict(enumerate([SimpleNamespace(columns=one) for one in (grid, SimpleNamespace(grid=None), grid)])),
        source=SimpleNamespace(chunks=lambda _: times),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"lines": "fixed"}, "their order"), ({"columns": "order"}, "their order"),
        ({"columns": "time"}, "the first return of their line"), (None, "the records around them"),
        ({}, None), ({"columns": "time", "line_hz": 50.0}, None),
    ],
)  # fmt: skip
def test_cells_that_would_move(given: dict[str, Any] | None, said: str | None) -> None:
    opened: Any = SimpleNamespace(grid=None if given is None else rules(**given))
    if said is None:
        _check_lines(Path("a.las"), opened)
    else:
        with pytest.raises(ConfigError, match=f"the cells of shots follow from {said}, so that leaving"):
            _check_lines(Path("a.las"), opened)
