"""Sheets of pictures with titles, axes, colour bars and a key.

Colours are never interpolated: pictures are enlarged by integer factors, and thinned before they
come here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple, TypeAlias

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
        half_cell = 0.5 if self.cells else 0.0
        first_multiple = math.ceil(low / step - 1e-9)
        last_multiple = math.floor(high / step + 1e-9)
        marks = []
        for multiple in range(first_multiple, last_multiple + 1):
            value = step * multiple
            if self.first > self.stop:
                place = (self.first - value - half_cell) / (self.first - self.stop)
            else:
                place = (value + half_cell - self.first) / (self.stop - self.first)
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
    zoom: tuple[int, int] = (1, 1)
    """Integer enlargement factors, across and down."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the enlarged picture [pixels]."""
        height, width, _ = self.picture.shape
        across, down = self.zoom
        return width * across, height * down


class KeyEntry(NamedTuple):
    """A colour and its text in a row of the key."""

    left: int
    """Distance from the beginning of the row [pixels]."""
    text: str
    colour: Colour


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
    decimals = 0
    if step < 1:
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    text = f"{value:,.{decimals}f}"
    is_zero = float(text.replace(",", "")) == 0
    return text.replace("-0", "0") if is_zero else text


def zoom_for(
    width: int,
    height: int,
    *,
    least_width: int = 1000,
    least_height: int = 180,
    most: int = 2200,
) -> tuple[int, int]:
    """Return integer factors, across and down, that enlarge a small picture to a readable size."""
    most_across = max(1, most // max(width, 1))
    most_down = max(1, most // max(height, 1))
    across = min(max(1, -(-least_width // max(width, 1))), most_across)
    down = min(max(1, -(-least_height // max(height, 1))), most_down)
    if across > 1 and down > 1:
        both = min(max(across, down), most_across, most_down)
        return both, both
    return across, down


def draw_panel(panel: Panel) -> Image.Image:
    """Draw one picture with its axes and its colour bar."""
    picture = panel.picture
    is_rgb = picture.ndim == 3 and picture.shape[2] == 3 and picture.dtype == np.uint8
    if not is_rgb or not picture.size:
        problem = (
            f"found {picture.dtype} of shape {picture.shape}, "
            "expected uint8 (lines, points per line, 3)"
        )
        raise InputError(panel.title, problem)

    # the title above, the note beside it or, if there is no room, below the picture with the key
    width, height = panel.size
    top = TITLE_HEIGHT
    title_width = font(_TITLE).getlength(panel.title) + 16
    head_width = title_width + font(_SMALL).getlength(panel.note)
    is_note_below = bool(panel.note) and head_width > width + RIGHT
    note_height = 30 if is_note_below else 0
    rows = key_rows(panel.key, width + RIGHT - MARGIN)
    foot = note_height + KEY_HEIGHT * len(rows) + (MARGIN if rows else 0)
    bottom = top + height + AXIS_HEIGHT

    canvas = Image.new("RGB", (LEFT + width + RIGHT, bottom + foot), "white")
    draw = ImageDraw.Draw(canvas)
    across, down = panel.zoom
    enlarged = picture.repeat(down, axis=0).repeat(across, axis=1)
    canvas.paste(Image.fromarray(np.ascontiguousarray(enlarged)), (LEFT, top))
    draw.rectangle((LEFT - 1, top - 1, LEFT + width, top + height), outline=(150, 150, 150))
    draw.text((LEFT, top - 8), panel.title, fill=INK, font=font(_TITLE), anchor="ls")
    note_place = (LEFT + draw.textlength(panel.title, font=font(_TITLE)) + 16, top - 8)
    anchor = "ls"
    if is_note_below:
        note_place = (LEFT, bottom + 4)
        anchor = "la"
    draw.text(note_place, panel.note, fill=PALE_INK, font=font(_SMALL), anchor=anchor)
    _draw_axes(draw, panel, top, width, height)
    if panel.bar is not None:
        _draw_bar(canvas, draw, panel.bar, LEFT + width + 18, top, height)
    _draw_key(draw, rows, bottom + note_height)
    return canvas


def _draw_key(draw: ImageDraw.ImageDraw, rows: list[list[KeyEntry]], top: int) -> None:
    for row in rows:
        for entry in row:
            left = LEFT + entry.left
            box = (left, top + 4, left + 30, top + 25)
            draw.rectangle(box, fill=entry.colour, outline=(90, 90, 90))
            draw.text((left + 40, top + 15), entry.text, fill=INK, font=font(_KEY), anchor="lm")
        top += KEY_HEIGHT


def _draw_axes(
    draw: ImageDraw.ImageDraw,
    panel: Panel,
    top: int,
    width: int,
    height: int,
) -> None:
    bottom = top + height
    below = bottom + _TICK + 3
    beside = LEFT - _TICK - 5
    small = font(_SMALL)
    write = partial(draw.text, fill=PALE_INK, font=small)

    # the numbers below the picture leave its right end to the name of the axis
    name_width = math.ceil(draw.textlength(panel.x.name, font=small))
    for place, text in panel.x.ticks(width, 120):
        column = LEFT + place
        draw.line((column, bottom + 1, column, bottom + _TICK), fill=PALE_INK)
        if place < width - name_width - 60:
            write((column, below), text, anchor="ma")
    write((LEFT + width, below), panel.x.name, anchor="ra")

    # the name of the axis on the left is turned, unless long numbers leave no space beside them
    widest = 0.0
    for place, text in panel.y.ticks(height, max(48, height // 24)):
        row = top + place
        draw.line((LEFT - _TICK - 1, row, LEFT - 2, row), fill=PALE_INK)
        write((beside, row), text, anchor="rm")
        widest = max(widest, draw.textlength(text, font=small))
    if widest > LEFT - _TICK - 32:
        write((beside, top - 14), panel.y.name, anchor="rs")
        return
    name_width = math.ceil(draw.textlength(panel.y.name, font=small))
    name = Image.new("L", (max(1, name_width + 2), 24), 0)
    ImageDraw.Draw(name).text((1, 1), panel.y.name, fill=255, font=small)
    turned = name.rotate(90, expand=True)
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
    length = max(40, min(height - 26, 520))
    right = left + 18
    rows = np.rint(np.linspace(len(bar.colours) - 1, 0, length)).astype(np.intp)
    strip = np.repeat(bar.colours[rows][:, None], right - left, axis=1)
    canvas.paste(Image.fromarray(np.ascontiguousarray(strip)), (left, top))
    draw.rectangle((left - 1, top - 1, right, top + length), outline=(150, 150, 150))
    last_row = math.inf
    for place, text in bar.ticks:
        row = top + length - 1 - round(place * (length - 1))
        if last_row - row < 22:  # numbers would touch
            continue
        last_row = row
        draw.line((right + 1, row, right + 5, row), fill=PALE_INK)
        draw.text((right + 9, row), text, fill=PALE_INK, font=small, anchor="lm")
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
    images = [draw_panel(panel) for panel in panels]
    grid = [images[first : first + columns] for first in range(0, len(images), columns)]
    width = max(sum(image.width for image in row) for row in grid) + MARGIN
    row_heights = [max(image.height for image in row) for row in grid]
    head_lines = wrap(head, font(_KEY), width - 2 * MARGIN) if head else []
    head_height = MARGIN
    if head_lines:
        head_height = HEAD_HEIGHT + 30 * (len(head_lines) - 1)
    keys = key_rows(key, width - LEFT - MARGIN)
    height = head_height + sum(row_heights) + KEY_HEIGHT * len(keys) + MARGIN

    canvas = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(canvas)
    for number, line in enumerate(head_lines):
        draw.text((MARGIN, MARGIN + 30 * number), line, fill=INK, font=font(_KEY))
    top = head_height
    for row, row_height in zip(grid, row_heights, strict=True):
        left = 0
        for image in row:
            canvas.paste(image, (left, top))
            left += image.width
        top += row_height
    _draw_key(draw, keys, top)
    return canvas


def choose_columns(panels: Sequence[Panel], max_height: int) -> int:
    """Return the number of pictures per row that makes a sheet about as wide as high."""
    panel_width = max(panel.size[0] for panel in panels) + LEFT + RIGHT
    panel_height = max(panel.size[1] for panel in panels) + FRAME_HEIGHT

    def badness(columns: int) -> tuple[bool, float]:
        rows = -(-len(panels) // columns)
        width = columns * panel_width
        height = rows * panel_height
        n_free = -len(panels) % columns
        return height > max_height, abs(math.log(width / height / 1.2)) + 0.6 * n_free

    return min(range(1, min(len(panels), 4) + 1), key=badness)


def key_rows(key: Key, width: int) -> list[list[KeyEntry]]:
    """Return the entries of a key in rows that fit the width [pixels]."""
    rows: list[list[KeyEntry]] = []
    left = width
    for text, colour in key:
        needed = 40 + round(font(_KEY).getlength(text)) + 32
        if not rows or left + needed > width:
            rows.append([])
            left = 0
        rows[-1].append(KeyEntry(left, text, colour))
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
