"""Converts range images, labels, segments and masks to colours.

Drawn with Pillow and NumPy only: these are pixel images, not plots, and matplotlib would be the
largest dependency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import LABEL_COLOURS, Label
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


class Limits(NamedTuple):
    """Values at the two ends of a colour scale."""

    low: float
    high: float


def range_limits(range_m: NDArray[np.floating]) -> Limits:
    """Return the ranges at the ends of the colour scale [m].

    2nd and 98th percentile of the returns.
    """
    returned = np.isfinite(range_m) & (range_m > 0)
    if not returned.any():
        return Limits(1.0, 2.0)
    near, far = np.percentile(range_m[returned], (2, 98))
    return Limits(float(near), max(float(far), float(near) * 1.01))


def range_picture(range_m: NDArray[np.floating], limits_m: Limits | None = None) -> U8:
    """Colour ranges from near, bright yellow, to far, dark blue, by logarithm.

    Parameters
    ----------
    range_m : (lines, M) floating, metres
        Not finite or 0 where there is no return.
    limits_m : Limits, optional
        Ranges at the ends of the colours; by default :func:`range_limits`.

    Returns
    -------
    (lines, M, 3) uint8
    """
    returned = np.isfinite(range_m) & (range_m > 0)
    near, far = range_limits(range_m) if limits_m is None else limits_m
    if not 0 < near < far:
        where = "limits_m"
        raise InputError(where, f"found {(near, far)}, expected 0 < near < far [m]")
    with np.errstate(over="ignore"):  # infinitely far is far
        ratio = np.where(returned, range_m, near) / near
        farness = np.log(ratio) / np.log(far / near)
    nearness = 1.0 - np.clip(farness, 0.0, 1.0)
    picture = _mapped(nearness)
    picture[~returned] = MISSING_COLOUR
    return picture


def range_bar(limits_m: Limits, *, rises: bool = False) -> Bar:
    """Return the colour bar of :func:`range_picture`, near at the bottom.

    ``rises``: the bar of :func:`critical_picture`, whose colours run the other way.

    >>> [text for _, text in range_bar(Limits(2.0, 60.0)).ticks]
    ['2', '5', '10', '20', '50']
    """
    near, far = limits_m
    lowest_power = math.floor(math.log10(near))
    highest_power = math.ceil(math.log10(far))
    values = []
    for power in range(lowest_power, highest_power + 1):
        values += [factor * 10.0**power for factor in (1, 2, 5)]
    if sum(near <= value <= far for value in values) < 3:  # too few of these on a narrow scale
        values = _even_values(near, far)
    ticks = []
    for value in values:
        if near <= value * (1 + 1e-9) and value <= far * (1 + 1e-9):
            place = math.log(value / near) / math.log(far / near)
            ticks.append((place, f"{value:.3g}"))
    colours = colour_map() if rises else colour_map()[::-1]
    return Bar(colours, tuple(ticks))


def value_limits(values: NDArray[np.floating]) -> Limits:
    """Return the ends of a linear colour scale: 1st and 99th percentile of the finite values."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Limits(0.0, 1.0)
    low, high = (float(value) for value in np.percentile(finite, (1, 99)))
    return Limits(low, high if high > low else low + 1.0)


def value_picture(values: NDArray[np.floating], limits: Limits) -> U8:
    """Colour a quantity from low, dark blue, to high, bright yellow.

    NaN = white; (..., 3) uint8.
    """
    known = np.isfinite(values)
    low, high = limits
    place = (np.where(known, values, low) - low) / (high - low)
    picture = _mapped(np.clip(place, 0.0, 1.0))
    picture[~known] = MISSING_COLOUR
    return picture


def _mapped(places: NDArray[np.floating]) -> U8:
    """Return colours (..., 3) of places from 0 to 1 in the colour map, (...)."""
    colours: U8 = colour_map()[np.rint(255 * places).astype(np.intp)]
    return colours


def value_bar(limits: Limits, unit: str) -> Bar:
    """Return the colour bar of :func:`value_picture`.

    >>> [text for _, text in value_bar(Limits(-2.0, 3.0), "m").ticks]
    ['-2', '-1', '0', '1', '2', '3']
    """
    low, high = limits
    ticks = []
    for value in _even_values(low, high):
        place = (value - low) / (high - low)
        ticks.append((place, f"{value:.6g}"))
    return Bar(colour_map(), tuple(ticks), unit)


def _even_values(low: float, high: float) -> list[float]:
    """Return three to seven multiples of 1, 2 or 5 times a power of ten."""
    step = 10.0 ** math.floor(math.log10((high - low) / 3))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (factor * step) <= 6)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [step * multiple for multiple in range(first, last + 1)]


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
    # steps by the golden ratio separate the hues of consecutive ids, two more sequences vary
    # saturation and value
    hue = np.mod(segments * 0.6180339887, 1.0)
    saturation = 0.45 + 0.5 * np.mod(segments * 0.7548776662, 1.0)
    value = 0.6 + 0.4 * np.mod(segments * 0.5698402910, 1.0)
    # from hue, saturation and value to red, green and blue
    position = (hue[..., None] * 6.0 + np.array([5.0, 3.0, 1.0])) % 6.0
    drop = np.clip(np.minimum(position, 4.0 - position), 0.0, 1.0)
    picture = _bytes(value[..., None] * (1.0 - saturation[..., None] * drop))
    picture[segments == 0] = 0
    return picture


def mask_picture(mask: Mask) -> U8:
    """Draw a binary image: true = white, false = black, (lines, M) bool to (lines, M, 3) uint8."""
    grey = np.where(mask, np.uint8(255), np.uint8(0))
    return np.repeat(grey[..., None], 3, axis=2)


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


def _bytes(rgb: F64) -> U8:
    """Return colours in 0..1 as bytes."""
    return np.rint(255 * rgb).astype(np.uint8)


NEVER_COLOUR = LABEL_COLOURS[Label.NOISE]
"""Colour of shots that no threshold supports."""


def critical_picture(zeta_m: NDArray[np.floating], limits_m: Limits) -> U8:
    """Colour thresholds [m] from low, dark blue, to high, bright yellow, by logarithm.

    (lines, M, 3) uint8.
    """
    low, high = limits_m
    log_limits = Limits(float(np.log(low)), float(np.log(high)))
    never = np.isposinf(zeta_m)
    thresholds = np.clip(np.where(never, np.nan, zeta_m), low, high)
    picture = value_picture(np.log(thresholds), log_limits)
    picture[never] = NEVER_COLOUR
    return picture
