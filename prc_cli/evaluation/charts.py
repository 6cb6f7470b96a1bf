"""Line charts as inline SVG, without scripts: a score of every class over the parts of a split.

Classes have the program's colours, and each its own mark with an outline in the colour of the text, so that black
(noise) and yellow (curb) are visible on dark and on light pages.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from html import escape
from zlib import crc32

from prc_cli.core.classes import LABEL_COLOURS, LABEL_NAMES, Label
from prc_cli.evaluation.mapping import OTHER

_MORE_COLOURS = ((51, 34, 136), (136, 34, 85), (68, 170, 153), (153, 153, 51), (170, 68, 153), (221, 204, 119))
"""Colours of other classes (Paul Tol's muted scheme)."""
_OTHER_COLOUR = (108, 108, 108)

_WIDTH, _LEFT, _RIGHT, _TOP = 560, 40, 12, 12
_PLOT_HEIGHT, _BAR_HEIGHT, _GAP, _LABEL_HEIGHT = 210, 34, 10, 40
_HEIGHT = _TOP + _PLOT_HEIGHT + _GAP + _BAR_HEIGHT + _LABEL_HEIGHT
_LETTER = 6.4
"""Width of a letter of the labels [units of the drawing]."""
_MAX_MARKS = 80
"""Number of parts above which marks are omitted, because they would overlap."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A score of one class."""

    name: str
    values: tuple[float, ...]
    """One value per part, 0 to 1; NaN = undefined, the curve is interrupted."""
    place: int
    """Index of the class among those shown; selects its mark."""


def class_colour(name: str) -> str:
    """Return the colour of a class for CSS; that of an unknown class depends only on its name.

    >>> class_colour("ground")
    '#8f4512'
    """
    if name == OTHER:
        rgb = _OTHER_COLOUR
    elif name in LABEL_NAMES:
        rgb = LABEL_COLOURS[Label(LABEL_NAMES.index(name))]
    else:
        rgb = _MORE_COLOURS[crc32(name.encode()) % len(_MORE_COLOURS)]
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def mark(place: int, x: float, y: float, size: float = 4.0) -> str:
    """Return the mark of a class as an SVG shape around a point."""
    s = size
    shapes = (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{s:.1f}"/>',
        f'<rect x="{x - s:.1f}" y="{y - s:.1f}" width="{2 * s:.1f}" height="{2 * s:.1f}"/>',
        _polygon(x, y, ((0.0, -1.3 * s), (1.2 * s, s), (-1.2 * s, s))),
        _polygon(x, y, ((0.0, -1.4 * s), (1.4 * s, 0.0), (0.0, 1.4 * s), (-1.4 * s, 0.0))),
        _polygon(x, y, ((0.0, 1.3 * s), (1.2 * s, -s), (-1.2 * s, -s))),
    )
    return shapes[place % len(shapes)]


def line_chart(
    title: str,
    axis: str,
    names: Sequence[str],
    counts: Sequence[int],
    curves: Sequence[Curve],
    ticks: Sequence[str],
    breaks: Collection[int] = (),
) -> str:
    """Draw curves over the parts of a split, and bars for the number of records in each part."""
    n = len(names)
    parts = [
        f'<svg class="chart" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(title)}">',
        *_grid(),
        *_bars(names, counts),
        *_tick_labels(ticks, axis),
        *_break_lines(breaks, n),
    ]
    for curve in curves:
        colour = class_colour(curve.name)
        points = [(_x(i, n), _y(value)) for i, value in enumerate(curve.values)]
        runs = _runs(points, breaks)
        paths = [" ".join(f"{x:.1f},{y:.1f}" for x, y in run) for run in runs if len(run) > 1]
        parts.append(f'<g class="curve" style="--class:{colour}">')
        parts += [f'<polyline class="rim" points="{path}"/><polyline points="{path}"/>' for path in paths]
        alone = {run[0] for run in runs if len(run) == 1}
        for (x, y), name, value in zip(points, names, curve.values, strict=True):
            if not math.isnan(y) and (n <= _MAX_MARKS or (x, y) in alone):
                tip = escape(f"{curve.name}, {name}: {value:.3f}")
                parts.append(f"<g><title>{tip}</title>{mark(curve.place, x, y, 3.6 if n <= 30 else 2.2)}</g>")
        parts.append("</g>")
    parts.append("</svg>")
    return "".join(parts)


def _grid() -> list[str]:
    lines = []
    for tenths in range(0, 11, 2):
        y = _y(tenths / 10)
        lines.append(f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        lines.append(f'<text x="{_LEFT - 7}" y="{y + 4:.1f}" text-anchor="end">{tenths / 10:.1f}</text>')
    return lines


def _bars(names: Sequence[str], counts: Sequence[int]) -> list[str]:
    n, most = len(counts), max([*counts, 1])
    base = _TOP + _PLOT_HEIGHT + _GAP + _BAR_HEIGHT
    step = (_WIDTH - _LEFT - _RIGHT) / max(n, 1)
    width = max(step * 0.86, 0.5)
    bars = [f'<text x="{_LEFT - 7}" y="{base - 8}" text-anchor="end" class="small">n</text>']
    for i, (name, count) in enumerate(zip(names, counts, strict=True)):
        height = _BAR_HEIGHT * count / most
        shape = f'x="{_x(i, n) - width / 2:.1f}" y="{base - height:.1f}" width="{width:.1f}" height="{height:.1f}"'
        bars.append(f'<rect class="bar" {shape}><title>{escape(name)}: {count:,} records</title></rect>')
    bars.append(f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{base}" y2="{base}"/>')
    return bars


def _tick_labels(ticks: Sequence[str], axis: str) -> list[str]:
    n, y = len(ticks), _HEIGHT - _LABEL_HEIGHT + 15
    step = (_WIDTH - _LEFT - _RIGHT) / max(n, 1)
    widest = max((len(tick) for tick in ticks), default=1) * _LETTER + 8
    every = max(1, math.ceil(widest / step))
    # a round number of parts between labels reads better than 7
    every = next((number for number in (1, 2, 5, 10, 20, 50, 100, 200, 500) if number >= every), every)
    labels = [
        f'<text x="{_x(i, n):.1f}" y="{y}" text-anchor="middle">{escape(tick)}</text>'
        for i, tick in enumerate(ticks)
        if i % every == 0
    ]
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    return [
        *labels,
        f'<text class="small" x="{middle:.1f}" y="{_HEIGHT - 6}" text-anchor="middle">{escape(axis)}</text>',
    ]


def _break_lines(breaks: Collection[int], n: int) -> list[str]:
    bottom = _TOP + _PLOT_HEIGHT + _GAP + _BAR_HEIGHT
    places = [(_x(i - 1, n) + _x(i, n)) / 2 for i in sorted(breaks)]
    return [f'<line class="break" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{bottom}"/>' for x in places]


def _runs(points: Sequence[tuple[float, float]], breaks: Collection[int]) -> list[list[tuple[float, float]]]:
    """Return the points in runs to be joined by lines, split at undefined points and breaks."""
    runs: list[list[tuple[float, float]]] = [[]]
    for i, point in enumerate(points):
        if i in breaks or math.isnan(point[1]):
            runs.append([])
        if not math.isnan(point[1]):
            runs[-1].append(point)
    return [run for run in runs if run]


def _x(i: int, n: int) -> float:
    return _LEFT + (i + 0.5) * (_WIDTH - _LEFT - _RIGHT) / n


def _y(value: float) -> float:
    return _TOP + (1.0 - value) * _PLOT_HEIGHT


def _polygon(x: float, y: float, corners: Sequence[tuple[float, float]]) -> str:
    return f'<polygon points="{" ".join(f"{x + dx:.1f},{y + dy:.1f}" for dx, dy in corners)}"/>'
