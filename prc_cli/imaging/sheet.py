"""Sheets of pictures with titles, axes, colour bars and a key.

Colours are never interpolated: pictures are enlarged by integer factors, and thinned before they
come here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from prc_cli.core.errors import InputError
from prc_cli.core.types import U8
from prc_cli.imaging.pictures import Bar

Font: TypeAlias = ImageFont.FreeTypeFont | ImageFont.ImageFont
Colour: TypeAlias = tuple[int, int, int]
Key: TypeAlias = tuple[tuple[str, Colour], ...]
"""Texts and colours of a key."""

MARGIN = 18
LEFT = 96
RIGHT = 126
"""Margins of a picture [pixels].

On all sides, left for the axis numbers, right for the colour bar.
"""
TITLE_HEIGHT = 40
AXIS_HEIGHT = 34
KEY_HEIGHT = 36
HEAD_HEIGHT = 52
FRAME_HEIGHT = TITLE_HEIGHT + AXIS_HEIGHT
"""Height of a panel in addition to its picture [pixels]."""
INK = (20, 20, 20)
PALE_INK = (110, 110, 110)
_TICK = 6
_TITLE = 24
_SMALL = 18
_KEY = 21
"""Sizes of letters [pixels]."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Scale along one side of a picture."""

    name: str
    first: float
    """Value at the left or upper edge."""
    stop: float
    """Value at the right or lower edge; smaller than ``first`` where the axis runs backwards."""
    cells: bool = True
    """Whether integers denote cells, marked at their middle, rather than positions."""

    def ticks(self, length: int, apart: int) -> list[tuple[int, str]]:
        """Return pixel and text of round numbers, at least ``apart`` pixels from each other."""
        low, high = sorted((self.first, self.stop))
        if not high > low:
            return []
        step = round_step((high - low) * apart / max(length, 1), integer=self.cells)
        half = 0.5 if self.cells else 0.0
        values = [
            step * i
            for i in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
        ]
        marks = []
        for value in values:
            place = (value + half - self.first) / (self.stop - self.first)
            if self.first > self.stop:
                place = (self.first - value - half) / (self.first - self.stop)
            if 0 <= place < 1:
                marks.append((int(place * length), number_text(value, step)))
        return marks


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture with its title, axes, colour bar and key."""

    title: str
    picture: U8
    """(height, width, 3) uint8, the first row at the top."""
    x: Axis
    y: Axis
    note: str = ""
    """Shown in grey behind the title."""
    bar: Bar | None = None
    key: Key = ()
    """Colours of this picture, explained below it."""
    caption: str = ""
    """A sentence or two for pages with text."""
    zoom: tuple[int, int] = (1, 1)
    """Integer enlargement factors, across and down."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the enlarged picture [pixels]."""
        return self.picture.shape[1] * self.zoom[0], self.picture.shape[0] * self.zoom[1]


def round_step(least: float, *, integer: bool = False) -> float:
    """Return the smallest of 1, 2, 5, 10, 20, ... (or 0.1, 0.2, ...) that is not below ``least``.

    >>> round_step(37), round_step(0.03), round_step(0.03, integer=True)
    (50.0, 0.05, 1.0)
    """
    if integer:
        least = max(least, 1.0)
    power = 10.0 ** math.floor(math.log10(max(least, 1e-12)))
    for factor in (1.0, 2.0, 5.0, 10.0):
        if factor * power >= least * (1 - 1e-9):
            return round(factor * power, 12)
    return 10.0 * power


def number_text(value: float, step: float = 1.0) -> str:
    """Format a number with the decimals of its step and thousands separators.

    >>> number_text(12000.0, 500), number_text(0.25, 0.05)
    ('12,000', '0.25')
    """
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step < 1 else 0
    text = f"{value:,.{decimals}f}"
    return text.replace("-0", "0") if float(text.replace(",", "")) == 0 else text


def zoom_for(
    width: int,
    height: int,
    least: tuple[int, int] = (1000, 180),
    most: int = 2200,
) -> tuple[int, int]:
    """Return integer factors that enlarge a small picture to a readable size."""
    across, down = (
        max(1, -(-limit // max(size, 1)))
        for limit, size in zip(least, (width, height), strict=True)
    )
    across = min(across, max(1, most // max(width, 1)))
    down = min(down, max(1, most // max(height, 1)))
    if across > 1 and down > 1:
        both = min(max(across, down), max(1, most // max(width, height, 1)))
        return both, both
    return across, down


def draw_panel(panel: Panel, *, with_title: bool = True) -> Image.Image:
    """Draw one picture with its axes and its colour bar."""
    picture = panel.picture
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or not picture.size:
        problem = (
            f"found {picture.dtype} of shape {picture.shape}, "
            "expected uint8 (lines, points per line, 3)"
        )
        raise InputError(panel.title, problem)
    width, height = panel.size
    top = TITLE_HEIGHT if with_title else MARGIN // 2
    # HTML pages write the key below the picture themselves
    rows = key_rows(panel.key, width + RIGHT - MARGIN) if with_title else []
    needed = font(_TITLE).getlength(panel.title) + 16 + font(_SMALL).getlength(panel.note)
    wrapped = with_title and bool(panel.note) and needed > width + RIGHT  # no room beside the title
    note_height = 30 if wrapped else 0
    foot = note_height + KEY_HEIGHT * len(rows) + (MARGIN if rows else 0)
    canvas = Image.new("RGB", (LEFT + width + RIGHT, top + height + AXIS_HEIGHT + foot), "white")
    draw = ImageDraw.Draw(canvas)
    enlarged = picture.repeat(panel.zoom[1], axis=0).repeat(panel.zoom[0], axis=1)
    canvas.paste(Image.fromarray(np.ascontiguousarray(enlarged)), (LEFT, top))
    draw.rectangle((LEFT - 1, top - 1, LEFT + width, top + height), outline=(150, 150, 150))
    if with_title:
        draw.text((LEFT, top - 8), panel.title, fill=INK, font=font(_TITLE), anchor="ls")
        begin = LEFT + draw.textlength(panel.title, font=font(_TITLE)) + 16
        if wrapped:
            draw.text(
                (LEFT, top + height + AXIS_HEIGHT + 4),
                panel.note,
                fill=PALE_INK,
                font=font(_SMALL),
                anchor="la",
            )
        else:
            draw.text((begin, top - 8), panel.note, fill=PALE_INK, font=font(_SMALL), anchor="ls")
    _draw_axes(draw, panel, top, width, height)
    if panel.bar is not None:
        _draw_bar(canvas, draw, panel.bar, LEFT + width + 18, top, height)
    _draw_key(draw, rows, top + height + AXIS_HEIGHT + note_height)
    return canvas


def _draw_key(
    draw: ImageDraw.ImageDraw, rows: list[list[tuple[int, str, Colour]]], top: int
) -> None:
    for row in rows:
        for left, text, colour in row:
            x = LEFT + left
            draw.rectangle((x, top + 4, x + 30, top + 25), fill=colour, outline=(90, 90, 90))
            draw.text((x + 40, top + 15), text, fill=INK, font=font(_KEY), anchor="lm")
        top += KEY_HEIGHT


def _draw_axes(
    draw: ImageDraw.ImageDraw,
    panel: Panel,
    top: int,
    width: int,
    height: int,
) -> None:
    bottom = top + height
    small = font(_SMALL)
    room = width - math.ceil(draw.textlength(panel.x.name, font=small)) - 60
    for place, text in panel.x.ticks(width, 120):
        draw.line((LEFT + place, bottom + 1, LEFT + place, bottom + _TICK), fill=PALE_INK)
        if place < room:  # keep the end free for the axis name
            draw.text(
                (LEFT + place, bottom + _TICK + 3), text, fill=PALE_INK, font=small, anchor="ma"
            )
    draw.text(
        (LEFT + width, bottom + _TICK + 3), panel.x.name, fill=PALE_INK, font=small, anchor="ra"
    )
    marks = panel.y.ticks(height, max(48, height // 24))
    for place, text in marks:
        draw.line((LEFT - _TICK - 1, top + place, LEFT - 2, top + place), fill=PALE_INK)
        draw.text((LEFT - _TICK - 5, top + place), text, fill=PALE_INK, font=small, anchor="rm")
    if max((draw.textlength(text, font=small) for _, text in marks), default=0) > LEFT - _TICK - 32:
        # long numbers leave no space beside them
        draw.text(
            (LEFT - _TICK - 5, top - 14), panel.y.name, fill=PALE_INK, font=small, anchor="rs"
        )
        return
    side = Image.new("L", (max(1, math.ceil(draw.textlength(panel.y.name, font=small)) + 2), 24), 0)
    ImageDraw.Draw(side).text((1, 1), panel.y.name, fill=255, font=small)
    turned = side.rotate(90, expand=True)
    if turned.height <= height:
        draw.bitmap((2, top + (height - turned.height) // 2), turned, fill=PALE_INK)


def _draw_bar(
    canvas: Image.Image,
    draw: ImageDraw.ImageDraw,
    bar: Bar,
    left: int,
    top: int,
    height: int,
) -> None:
    """Draw a colour bar with its numbers, the first colour at the bottom."""
    small = font(_SMALL)
    wide = 18
    foot = 26
    length = max(40, min(height - foot, 520))
    rows = np.rint(np.linspace(len(bar.colours) - 1, 0, length)).astype(np.intp)
    strip = np.ascontiguousarray(np.repeat(bar.colours[rows][:, None], wide, axis=1))
    canvas.paste(Image.fromarray(strip), (left, top))
    draw.rectangle((left - 1, top - 1, left + wide, top + length), outline=(150, 150, 150))
    last = math.inf
    for place, text in bar.ticks:
        row = top + length - 1 - round(place * (length - 1))
        if last - row < 22:
            continue
        last = row
        draw.line((left + wide + 1, row, left + wide + 5, row), fill=PALE_INK)
        draw.text((left + wide + 9, row), text, fill=PALE_INK, font=small, anchor="lm")
    draw.text((left - 2, top + length + 5), bar.unit, fill=PALE_INK, font=small, anchor="la")


def draw_sheet(
    head: str,
    panels: Sequence[Panel],
    key: Key = (),
    *,
    columns: int = 1,
) -> Image.Image:
    """Stack pictures under each other below a headline, a key at the bottom."""
    if not panels:
        where = "pictures"
        raise InputError(where, "found none, expected at least one")
    drawn = [draw_panel(panel) for panel in panels]
    grid = [drawn[first : first + columns] for first in range(0, len(drawn), columns)]
    width = max(sum(image.width for image in row) for row in grid) + MARGIN
    lines = wrap(head, font(_KEY), width - 2 * MARGIN)
    head_height = HEAD_HEIGHT + 30 * (len(lines) - 1) if head else MARGIN
    rows = key_rows(key, width - LEFT - MARGIN)
    heights = [max(image.height for image in row) for row in grid]
    height = head_height + sum(heights) + KEY_HEIGHT * len(rows) + MARGIN
    canvas = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(canvas)
    for number, line in enumerate(lines if head else ()):
        draw.text((MARGIN, MARGIN + 30 * number), line, fill=INK, font=font(_KEY))
    top = head_height
    for images, row_height in zip(grid, heights, strict=True):
        left_edge = 0
        for image in images:
            canvas.paste(image, (left_edge, top))
            left_edge += image.width
        top += row_height
    _draw_key(draw, rows, top)
    return canvas


def choose_columns(panels: Sequence[Panel], max_height: int) -> int:
    """Return the number of pictures per row that makes a sheet about as wide as high."""

    def size(columns: int) -> tuple[int, int]:
        rows = -(-len(panels) // columns)
        wide, high = (max(panel.size[axis] for panel in panels) for axis in (0, 1))
        return columns * (wide + LEFT + RIGHT), rows * (high + FRAME_HEIGHT)

    def badness(columns: int) -> tuple[bool, float]:
        width, height = size(columns)
        free = -len(panels) % columns
        return height > max_height, abs(math.log(width / height / 1.2)) + 0.6 * free

    return min(range(1, min(len(panels), 4) + 1), key=badness)


def key_rows(key: Key, width: int) -> list[list[tuple[int, str, Colour]]]:
    """Return the entries of a key in rows that fit the width, each with its left edge [pixels]."""
    rows: list[list[tuple[int, str, Colour]]] = []
    left = width
    for text, colour in key:
        needed = 40 + round(font(_KEY).getlength(text)) + 32
        if not rows or left + needed > width:
            rows.append([])
            left = 0
        rows[-1].append((left, text, colour))
        left += needed
    return rows


def wrap(text: str, used: Font, width: int) -> list[str]:
    """Cut a line at blanks so that every part is no wider than ``width`` pixels, if it can be."""
    lines: list[str] = []
    for word in text.split(" "):
        if lines and used.getlength(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


@cache
def font(size: int) -> Font:
    """Return the font that comes with Pillow."""
    try:
        return ImageFont.load_default(size)
    except (ImportError, TypeError):  # Pillow without FreeType: its small bitmap font
        return ImageFont.load_default()
