"""Pictures of the search for cars: names and colours of what ``output.stages`` numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import LABEL_COLOURS, CarTest, Label
from prc_cli.core.stream import StageLabels
from prc_cli.core.types import U8, Mask
from prc_cli.jobs.render.classes import ClassTable

_PALE = (226, 226, 226)

INTERVALS = ClassTable(
    ("no return", "in no interval", "odd interval", "even interval"),
    np.array([(255, 255, 255), _PALE, (213, 94, 0), (0, 114, 178)], np.uint8),
)
"""Intervals between dividers in turn, as in the paper's Fig. 4; 0 = missing."""

TESTS = ClassTable(
    (
        "no return",
        "in no interval",
        "tall vertical, cut out",
        "vegetation by its spectrum",
        "behind a high vertical",
        "next to the ground",
        "behind a curb",
        "car",
    ),
    np.array(
        [
            (255, 255, 255),
            _PALE,
            LABEL_COLOURS[Label.VERTICAL],
            LABEL_COLOURS[Label.VEGETATION],
            (106, 61, 154),
            LABEL_COLOURS[Label.HORIZONTAL],
            LABEL_COLOURS[Label.CURB],
            LABEL_COLOURS[Label.CAR],
        ],
        np.uint8,
    ),
)
"""What became of the shots of intervals: :class:`~prc_cli.core.classes.CarTest` plus 1; 0 = missing."""


def interval_codes(stages: StageLabels, seen: Mask) -> U8:
    """Return indices of :data:`INTERVALS`, (lines, M) uint8."""
    turn = np.where(stages.car_interval == 0, 1, 3 - stages.car_interval % 2)
    return _of_returns(turn, seen)


def test_codes(stages: StageLabels, seen: Mask) -> U8:
    """Return indices of :data:`TESTS`, (lines, M) uint8."""
    assert len(TESTS.names) == len(CarTest) + 1
    return _of_returns(stages.car_test + np.uint8(1), seen)


def _of_returns(codes: NDArray[np.integer], seen: Mask) -> U8:
    return np.where(seen, codes, 0).astype(np.uint8)
