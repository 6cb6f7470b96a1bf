"""Colours of intermediate results: critical thresholds, triggers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import LABEL_COLOURS, Label, TriggerSide
from prc_cli.core.types import U8
from prc_cli.imaging.pictures import Bar, colour_map, label_picture, range_bar, range_limits, value_picture

NEVER_COLOUR = LABEL_COLOURS[Label.NOISE]
"""Colour of shots that no threshold supports."""
TRIGGER_COLOUR = (30, 20, 10)
PALE = 0.6
"""Share of white mixed into the classes behind triggers."""
TRIGGER_CELLS = 2
"""Cells by which the mark of a trigger reaches beyond it along the line, so that it is seen."""


def critical_limits(zeta_m: NDArray[np.floating]) -> tuple[float, float]:
    """Return the ends of the colour scale [m]: 2nd and 98th percentile of the finite values above 0."""
    return range_limits(zeta_m)


def critical_picture(zeta_m: NDArray[np.floating], limits_m: tuple[float, float]) -> U8:
    """Colour critical thresholds from low (dark blue) to high (bright yellow) on a logarithmic scale.

    ``zeta_m`` (lines, M) float; returns (lines, M, 3) uint8.
    """
    low, high = limits_m
    never = np.isposinf(zeta_m)
    shown = np.where(never, np.nan, zeta_m)
    picture = value_picture(np.log(np.clip(shown, low, high)), (float(np.log(low)), float(np.log(high))))
    picture[never] = NEVER_COLOUR
    return picture


def critical_bar(limits_m: tuple[float, float]) -> Bar:
    """Return the colour bar of :func:`critical_picture`.

    >>> critical_bar((0.01, 1.0)).ticks[0]
    (0.0, '0.01')
    """
    return replace(range_bar(limits_m), colours=colour_map())


def trigger_codes(labels: U8, trigger: U8) -> U8:
    """Pack classes and sides of the trigger into one image, (lines, M) uint8, for :func:`trigger_picture`."""
    packed: U8 = (labels + np.uint8(len(Label)) * trigger).astype(np.uint8)
    return packed


def trigger_key() -> tuple[tuple[str, tuple[int, int, int]], ...]:
    """Return the key of :func:`trigger_picture`.

    >>> trigger_key()[0]
    ('trigger', (30, 20, 10))
    """
    classes = (("dense vegetation T'", Label.VEGETATION), ("H", Label.HORIZONTAL), ("V", Label.VERTICAL))
    pale = trigger_picture(np.array([[label for _, label in classes]], np.uint8))[0].tolist()
    keys = tuple((name, (red, green, blue)) for (name, _), (red, green, blue) in zip(classes, pale, strict=True))
    return (("trigger", TRIGGER_COLOUR), *keys)


def trigger_picture(packed: U8) -> U8:
    """Mark the triggers over pale classes; thinned images still show them.

    ``packed`` (lines, M) uint8; returns (lines, M, 3) uint8.

    A line that triggers at its third shot, although that shot is not among those drawn:

    >>> packed = trigger_codes(np.full((1, 9), 3, np.uint8), np.array([[1, 1, 1, 1, 1, 3, 3, 3, 3]], np.uint8))
    >>> (trigger_picture(packed)[0, :, 0] == TRIGGER_COLOUR[0]).astype(int)
    array([0, 0, 0, 1, 1, 1, 1, 1, 0])
    """
    classes, side = packed % len(Label), packed // len(Label)
    picture: U8 = np.rint(label_picture(classes) * (1.0 - PALE) + 255 * PALE).astype(np.uint8)
    begun = side >= TriggerSide.AT
    mark = side == TriggerSide.AT
    # thinning may have taken the shot itself: the trigger lies where a line goes from before it to after it
    mark[:, 1:] |= begun[:, 1:] & (side[:, :-1] == TriggerSide.BEFORE)
    mark[:, :-1] |= begun[:, :-1] & (side[:, 1:] == TriggerSide.BEFORE)
    wide = mark.copy()
    for reach in range(1, TRIGGER_CELLS + 1):
        wide[:, reach:] |= mark[:, :-reach]
        wide[:, :-reach] |= mark[:, reach:]
    picture[wide] = TRIGGER_COLOUR
    return picture
