"""Converts range images, labels, segments and masks to colours.

Drawn with Pillow and NumPy only: these are pixel images, not plots, and matplotlib would be the
largest dependency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import LABEL_COLOURS, Label, TriggerSide
from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, U8, Mask

MISSING_COLOUR = LABEL_COLOURS[Label.MISSING]


@dataclass(frozen=True, slots=True)
class Bar:
    """A colour bar: its colours from the bottom up, and the numbers beside it."""

    colours: U8
    """(n, 3) uint8."""
    ticks: tuple[tuple[float, str], ...]
    """Place from 0 (bottom) to 1 (top), and text."""
    unit: str = "m"


def range_limits(range_m: NDArray[np.floating]) -> tuple[float, float]:
    """Return the ranges at the ends of the colour scale [m].

    2nd and 98th percentile of the returns.
    """
    seen = range_m[np.isfinite(range_m) & (range_m > 0)]
    near, far = (float(v) for v in np.percentile(seen, (2, 98))) if seen.size else (1.0, 2.0)
    return near, max(far, near * 1.01)


def range_picture(range_m: NDArray[np.floating], limits_m: tuple[float, float] | None = None) -> U8:
    """Colour ranges (lines, M) from near, bright yellow, to far, dark blue, by logarithm.

    (lines, M, 3) uint8.
    """
    seen = np.isfinite(range_m) & (range_m > 0)
    near, far = range_limits(range_m) if limits_m is None else limits_m
    if not 0 < near < far:
        where = "limits_m"
        raise InputError(where, f"found {limits_m}, expected 0 < near < far [m]")
    with np.errstate(over="ignore"):  # infinitely far is far
        place = np.log(np.where(seen, range_m, near) / near) / np.log(far / near)
    picture: U8 = colour_map()[np.rint(255 * (1.0 - np.clip(place, 0.0, 1.0))).astype(np.intp)]
    picture[~seen] = MISSING_COLOUR
    return picture


def range_bar(limits_m: tuple[float, float], *, rises: bool = False) -> Bar:
    """Return the colour bar of :func:`range_picture`, near at the bottom.

    ``rises``: of :func:`critical_picture`.

    >>> [text for _, text in range_bar((2.0, 60.0)).ticks]
    ['2', '5', '10', '20', '50']
    """
    near, far = limits_m
    powers = range(math.floor(math.log10(near)), math.ceil(math.log10(far)) + 1)
    values = [factor * 10.0**power for power in powers for factor in (1, 2, 5)]
    if sum(near <= value <= far for value in values) < 3:  # too few of these on a narrow scale
        values = _even_values(near, far)
    inside = [value for value in values if near <= value * (1 + 1e-9) and value <= far * (1 + 1e-9)]
    ticks = tuple(
        (math.log(value / near) / math.log(far / near), f"{value:.3g}") for value in inside
    )
    return Bar(colour_map() if rises else colour_map()[::-1], ticks)


def value_limits(values: NDArray[np.floating]) -> tuple[float, float]:
    """Return the ends of a linear colour scale: 1st and 99th percentile of the finite values."""
    seen = values[np.isfinite(values)]
    low, high = (float(v) for v in np.percentile(seen, (1, 99))) if seen.size else (0.0, 1.0)
    return low, high if high > low else low + 1.0


def value_picture(values: NDArray[np.floating], limits: tuple[float, float]) -> U8:
    """Colour a quantity from low, dark blue, to high, bright yellow.

    NaN = white; (..., 3) uint8.
    """
    seen = np.isfinite(values)
    low, high = limits
    place = (np.where(seen, values, low) - low) / (high - low)
    picture: U8 = colour_map()[np.rint(255 * np.clip(place, 0.0, 1.0)).astype(np.intp)]
    picture[~seen] = MISSING_COLOUR
    return picture


def value_bar(limits: tuple[float, float], unit: str) -> Bar:
    """Return the colour bar of :func:`value_picture`.

    >>> [text for _, text in value_bar((-2.0, 3.0), "m").ticks]
    ['-2', '-1', '0', '1', '2', '3']
    """
    low, high = limits
    values = _even_values(low, high)
    return Bar(
        colour_map(),
        tuple(((value - low) / (high - low), f"{value:.6g}") for value in values),
        unit,
    )


def _even_values(low: float, high: float) -> list[float]:
    """Return three to seven multiples of 1, 2 or 5 times a power of ten."""
    step = 10.0 ** math.floor(math.log10((high - low) / 3))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (factor * step) <= 6)
    return [
        step * i for i in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    ]


AGREE_COLOUR = (222, 222, 222)
"""Colour where predicted and reference class are equal."""
NOT_SCORED_COLOUR = (196, 180, 224)
"""Colour of returns whose class is not compared."""


def difference_picture(
    predicted: U8,
    reference: U8,
    colours: U8,
    unscored: int | None = None,
) -> U8:
    """Show where two labellings (lines, M) uint8 differ, in colours (n, 3); (lines, M, 3) uint8."""
    picture = colours[predicted]
    picture[predicted == reference] = AGREE_COLOUR
    if unscored is not None:
        picture[(predicted == unscored) | (reference == unscored)] = NOT_SCORED_COLOUR
    picture[(predicted == 0) | (reference == 0)] = MISSING_COLOUR
    return np.asarray(picture, np.uint8)


def segment_picture(segments: NDArray[np.integer]) -> U8:
    """Colour ids (lines, M) alike in every picture, 0 = none is black; (lines, M, 3) uint8."""
    # golden-ratio steps separate the hues of consecutive ids; two more sequences vary saturation
    # and value
    hue, saturation, value = (
        np.mod(segments * step, 1.0) for step in (0.6180339887, 0.7548776662, 0.5698402910)
    )
    picture = _from_hsv(hue, 0.45 + 0.5 * saturation, 0.6 + 0.4 * value)
    picture[segments == 0] = 0
    return picture


def mask_picture(mask: Mask) -> U8:
    """Draw a binary image: true = white, false = black, (lines, M) bool to (lines, M, 3) uint8."""
    return np.repeat(np.where(mask, np.uint8(255), np.uint8(0))[..., None], 3, axis=2)


@cache
def colour_map() -> U8:
    """Return 256 colours, (256, 3) uint8, dark blue to bright yellow.

    Their lightness grows evenly in OKLab (Ottosson 2020).
    """
    place = np.linspace(0.0, 1.0, 256)
    lightness = 0.22 + 0.74 * place
    hue = np.deg2rad(285.0 - 178.0 * place)
    chroma = 0.11 + 0.05 * place
    a = chroma * np.cos(hue)
    b = chroma * np.sin(hue)
    cones = np.stack(
        [
            lightness + 0.3963377774 * a + 0.2158037573 * b,
            lightness - 0.1055613458 * a - 0.0638541728 * b,
            lightness - 0.0894841775 * a - 1.2914855480 * b,
        ],
        axis=1,
    )
    to_linear = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip((cones**3) @ to_linear.T, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return _bytes(encoded)


def _from_hsv(hue: F64, saturation: F64, value: F64) -> U8:
    """Hue, saturation and value in 0..1, (...) each, to sRGB (..., 3)."""
    position = (hue[..., None] * 6.0 + np.array([5.0, 3.0, 1.0])) % 6.0
    drop = np.clip(np.minimum(position, 4.0 - position), 0.0, 1.0)
    rgb = value[..., None] * (1.0 - saturation[..., None] * drop)
    return _bytes(rgb)


def _bytes(rgb: F64) -> U8:
    """Colours in 0..1 as bytes."""
    colours: U8 = np.rint(255 * rgb).astype(np.uint8)
    return colours


NEVER_COLOUR = LABEL_COLOURS[Label.NOISE]
"""Colour of shots that no threshold supports."""
TRIGGER_COLOUR = (30, 20, 10)
PALE = 0.6
"""Share of white mixed into the classes behind triggers."""
TRIGGER_CELLS = 2
"""Cells by which the mark of a trigger reaches beyond it along the line, so that it is seen."""


def critical_picture(zeta_m: NDArray[np.floating], limits_m: tuple[float, float]) -> U8:
    """Colour thresholds [m] from low, dark blue, to high, bright yellow, by logarithm.

    (lines, M, 3) uint8.
    """
    low, high = limits_m
    never = np.isposinf(zeta_m)
    shown = np.where(never, np.nan, zeta_m)
    picture = value_picture(
        np.log(np.clip(shown, low, high)), (float(np.log(low)), float(np.log(high)))
    )
    picture[never] = NEVER_COLOUR
    return picture


def trigger_codes(labels: U8, trigger: U8) -> U8:
    """Pack classes and sides of the trigger, (lines, M) uint8, for :func:`trigger_picture`."""
    packed: U8 = (labels + np.uint8(len(Label)) * trigger).astype(np.uint8)
    return packed


def trigger_key() -> tuple[tuple[str, tuple[int, int, int]], ...]:
    """Return the key of :func:`trigger_picture`.

    >>> trigger_key()[0]
    ('trigger', (30, 20, 10))
    """
    classes = (
        ("dense vegetation T'", Label.VEGETATION),
        ("H", Label.HORIZONTAL),
        ("V", Label.VERTICAL),
    )
    pale = trigger_picture(np.array([[label for _, label in classes]], np.uint8))[0].tolist()
    keys = tuple(
        (name, (red, green, blue))
        for (name, _), (red, green, blue) in zip(classes, pale, strict=True)
    )
    return (("trigger", TRIGGER_COLOUR), *keys)


def trigger_picture(packed: U8) -> U8:
    """Mark the triggers over pale classes; thinned images still show them.

    ``packed`` (lines, M) uint8; returns (lines, M, 3) uint8.

    A line that triggers at its third shot, although that shot is not among those drawn:

    >>> sides = np.array([[1, 1, 1, 1, 1, 3, 3, 3, 3]], np.uint8)
    >>> packed = trigger_codes(np.full((1, 9), 3, np.uint8), sides)
    >>> (trigger_picture(packed)[0, :, 0] == TRIGGER_COLOUR[0]).astype(int)
    array([0, 0, 0, 1, 1, 1, 1, 1, 0])
    """
    classes = packed % len(Label)
    side = packed // len(Label)
    colours = np.array([LABEL_COLOURS[label] for label in Label], np.uint8)
    picture: U8 = np.rint(colours[classes] * (1.0 - PALE) + 255 * PALE).astype(np.uint8)
    begun = side >= TriggerSide.AT
    mark = side == TriggerSide.AT
    # thinning may have taken the shot itself: the trigger lies where a line goes from before it to
    # after it
    mark[:, 1:] |= begun[:, 1:] & (side[:, :-1] == TriggerSide.BEFORE)
    mark[:, :-1] |= begun[:, :-1] & (side[:, 1:] == TriggerSide.BEFORE)
    wide = mark.copy()
    for reach in range(1, TRIGGER_CELLS + 1):
        wide[:, reach:] |= mark[:, :-reach]
        wide[:, :-reach] |= mark[:, reach:]
    picture[wide] = TRIGGER_COLOUR
    return picture
