"""Pictures of range images, labels, segments and masks, and their stack in the manner of Lehtola et al. (2019), Fig. 1.

Pillow and NumPy draw everything; matplotlib stays out on purpose: these are pictures of pixels, not plots, and it
would be the largest dependency of the package.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from prc_cli.core.classes import LABEL_COLOURS, Label
from prc_cli.core.errors import InputError
from prc_cli.core.files import atomic_output
from prc_cli.core.types import F64, U8, Mask

Font: TypeAlias = ImageFont.FreeTypeFont | ImageFont.ImageFont

MISSING_COLOUR = LABEL_COLOURS[Label.MISSING]
MAX_WIDTH = 2200
"""Widest picture of a stack [pixels]."""

_MIN_WIDTH, _MIN_HEIGHT = 1000, 180
_MARGIN, _TITLE_HEIGHT, _FONT_SIZE = 12, 30, 18


def range_picture(range_m: NDArray[np.floating], limits_m: tuple[float, float] | None = None) -> U8:
    """Colour ranges from near (bright yellow) to far (dark blue), evenly in steps of the logarithm.

    Parameters
    ----------
    range_m : (lines, M) float
        Range [m]; NaN = missing, drawn white.
    limits_m : (near, far), optional
        Ranges at the ends of the colour scale [m]; default: 2nd and 98th percentile. Give them for pictures that
        are to be compared.

    Returns
    -------
    (lines, M, 3) uint8
        sRGB.

    Raises
    ------
    InputError
        When the limits are not 0 < near < far.
    """
    seen = np.isfinite(range_m) & (range_m > 0)
    if limits_m is None:
        near, far = (float(v) for v in np.percentile(range_m[seen], (2, 98))) if seen.any() else (1.0, 2.0)
        far = max(far, near * 1.01)
    else:
        near, far = limits_m
        if not 0 < near < far:
            where = "limits_m"
            raise InputError(where, f"found {limits_m}, expected 0 < near < far [m]")
    place = np.log(np.where(seen, range_m, near) / near) / np.log(far / near)
    picture: U8 = colour_map()[np.rint(255 * (1.0 - np.clip(place, 0.0, 1.0))).astype(np.intp)]
    picture[~seen] = MISSING_COLOUR
    return picture


def label_picture(labels: NDArray[np.integer]) -> U8:
    """Colour labels as in :data:`prc_cli.core.classes.LABEL_COLOURS`.

    Parameters
    ----------
    labels : (lines, M) integer
        :class:`prc_cli.core.classes.Label`.

    Returns
    -------
    (lines, M, 3) uint8
        sRGB.

    Raises
    ------
    InputError
        When a number is no label (class codes of a file are not labels).
    """
    table = np.array([LABEL_COLOURS[label] for label in Label], dtype=np.uint8)
    if labels.size and not 0 <= int(labels.min()) <= int(labels.max()) < len(table):
        problem = f"found numbers from {labels.min()} to {labels.max()}, expected labels from 0 to {len(table) - 1}"
        where = "labels"
        raise InputError(where, problem, "turn class codes into labels first")
    picture: U8 = table[labels]
    return picture


def segment_picture(segments: NDArray[np.integer]) -> U8:
    """Give every segment a colour of its own, the same in every picture; 0 = none is black.

    Parameters
    ----------
    segments : (lines, M) integer
        Segment ids.

    Returns
    -------
    (lines, M, 3) uint8
        sRGB, never darker than a third of full brightness.
    """
    # golden-ratio steps keep the hues of consecutive ids far apart; two more sequences vary the rest
    hue, saturation, value = (np.mod(segments * step, 1.0) for step in (0.6180339887, 0.7548776662, 0.5698402910))
    picture = _from_hsv(hue, 0.45 + 0.5 * saturation, 0.6 + 0.4 * value)
    picture[segments == 0] = 0
    return picture


def mask_picture(mask: Mask) -> U8:
    """Draw a binary image: true = white, false = black, (lines, M) bool to (lines, M, 3) uint8."""
    return np.repeat(np.where(mask, np.uint8(255), np.uint8(0))[..., None], 3, axis=2)


def stack_pictures(
    pictures: Sequence[tuple[str, U8]], *, legend: Iterable[Label] = (), max_width: int = MAX_WIDTH
) -> Image.Image:
    """Stack pictures of one block under each other, each with its title (Lehtola et al. 2019, Fig. 1).

    Pictures with more lines than columns are turned, so that time runs to the right. Small ones are enlarged by
    whole factors, in each direction by its own, large ones are thinned out; colours are never mixed.

    Parameters
    ----------
    pictures : sequence of (title, (lines, M, 3) uint8)
        From top to bottom.
    legend : iterable of Label
        Classes whose colours are explained at the bottom; none by default.
    max_width : int
        Widest picture [pixels].

    Returns
    -------
    PIL.Image.Image
        RGB.

    Raises
    ------
    InputError
        When there is no picture, or one is empty or not (lines, M, 3) uint8.
    """
    if not pictures:
        where = "pictures"
        raise InputError(where, "found none, expected at least one")
    panels = [(title, _panel(title, picture, max_width)) for title, picture in pictures]
    labels = list(legend)
    width = max(panel.width for _, panel in panels) + 2 * _MARGIN
    height = sum(panel.height + _TITLE_HEIGHT for _, panel in panels) + 2 * _MARGIN
    rows = _legend_rows(labels, width)
    canvas = Image.new("RGB", (width, height + _TITLE_HEIGHT * len(rows)), "white")
    draw = ImageDraw.Draw(canvas)
    top = _MARGIN
    for title, panel in panels:
        draw.text((_MARGIN, top), title, fill="black", font=_font())
        canvas.paste(panel, (_MARGIN, top + _TITLE_HEIGHT - 4))
        draw.rectangle(
            (_MARGIN - 1, top + _TITLE_HEIGHT - 5, _MARGIN + panel.width, top + _TITLE_HEIGHT - 4 + panel.height),
            outline=(150, 150, 150),
        )
        top += panel.height + _TITLE_HEIGHT
    for row in rows:
        _draw_legend(draw, row, top + _MARGIN // 2)
        top += _TITLE_HEIGHT
    return canvas


def write_png(path: Path, image: Image.Image | U8) -> None:
    """Write a picture as PNG; the file exists whole or not at all.

    Parameters
    ----------
    path : Path
        Output; replaced if it exists (callers refuse that beforehand where they must).
    image : PIL image or (height, width, 3) uint8

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    picture = image if isinstance(image, Image.Image) else Image.fromarray(image)
    with atomic_output(path) as temporary:
        picture.save(temporary, format="PNG")


@cache
def colour_map() -> U8:
    """Return 256 colours from dark blue over green to bright yellow whose lightness rises evenly.

    Equal steps of lightness in the OKLab space (Ottosson 2020), hue turning at constant speed, so that order is
    seen without a legend and by colour-blind readers.

    Returns
    -------
    (256, 3) uint8
        sRGB.
    """
    place = np.linspace(0.0, 1.0, 256)
    lightness = 0.22 + 0.74 * place
    hue = np.deg2rad(285.0 - 178.0 * place)
    chroma = 0.11 + 0.05 * place
    a, b = chroma * np.cos(hue), chroma * np.sin(hue)
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


def _panel(title: str, picture: U8, max_width: int) -> Image.Image:
    """Turn and scale one picture to a width that can be looked at."""
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or not picture.size:
        problem = f"found {picture.dtype} of shape {picture.shape}, expected uint8 (lines, points per line, 3)"
        raise InputError(title, problem)
    if picture.shape[0] > picture.shape[1]:
        picture = picture.transpose(1, 0, 2)
    height, width = picture.shape[:2]
    across, down = max(1, -(-_MIN_WIDTH // width)), max(1, -(-_MIN_HEIGHT // height))
    # a picture that is small in both directions keeps its shape
    across, down = (max(across, down),) * 2 if min(across, down) > 1 else (across, down)
    size = width * across, height * down
    if size[0] > max_width:
        size = max_width, max(1, round(size[1] * max(max_width / size[0], 0.5)))
    return Image.fromarray(np.ascontiguousarray(picture)).resize(size, Image.Resampling.NEAREST)


def _legend_rows(labels: Sequence[Label], width: int) -> list[list[Label]]:
    """Labels in rows that fit the width."""
    per_row = max(1, (width - 2 * _MARGIN) // _LEGEND_CELL)
    return [list(labels[i : i + per_row]) for i in range(0, len(labels), per_row)]


_LEGEND_CELL = 170


def _draw_legend(draw: ImageDraw.ImageDraw, labels: Sequence[Label], top: int) -> None:
    for i, label in enumerate(labels):
        left = _MARGIN + i * _LEGEND_CELL
        draw.rectangle((left, top, left + 22, top + 16), fill=LABEL_COLOURS[label], outline=(90, 90, 90))
        draw.text((left + 30, top - 3), label.name.lower(), fill="black", font=_font())


@cache
def _font() -> Font:
    try:
        return ImageFont.load_default(_FONT_SIZE)
    except (ImportError, TypeError):  # Pillow without FreeType, or older than 10.1: its small bitmap font
        return ImageFont.load_default()
