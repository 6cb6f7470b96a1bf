"""A part of a drive, in scan lines or seconds, read from the text of an option."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_LINES = re.compile(r"([0-9]*):([0-9]*)")
_MOMENT = r"(\+?)(-?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*(s|min|h)?"
_TIMES = re.compile(rf"(?:{_MOMENT})?:(?:{_MOMENT})?")
_FIRST = re.compile(r"([0-9]+\.?[0-9]*|\.[0-9]+)\s*(s|min|h|lines?)")
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True, slots=True)
class Window:
    """Lines or seconds ``first`` to ``stop`` (exclusive) of a stream, for every scanner."""

    option: str
    """As it is typed: ``--only 5:9``."""
    in_lines: bool
    """Line numbers, from 0; otherwise times [s]."""
    first: float = -math.inf
    stop: float = math.inf
    first_is_relative: bool = False
    """Counted from the first time of the stream; likewise below."""
    stop_is_relative: bool = False

    def bounds(self, origin: float) -> tuple[float, float]:
        """Return first and stop for a stream that starts at this line number or time [s]."""
        return (
            self.first + (origin if self.first_is_relative else 0.0),
            self.stop + (origin if self.stop_is_relative else 0.0),
        )


def parse_window(only_lines: str | None, only_time: str | None, first: str | None) -> Window | None:
    """Read a window; at most one text may be given."""
    texts = [text for text in (only_lines, only_time, first) if text is not None]
    if len(texts) > 1:
        message = "one of only_lines, only_time and first, not several"
        raise ValueError(message)
    if only_lines is not None:
        return _window_of_lines(only_lines)
    if only_time is not None:
        return _window_of_times(only_time)
    return None if first is None else _window_of_first(first)


def window_key(text: str) -> str:
    """Return the key of ``[input]`` that a window belongs to, by its form.

    >>> [window_key(text) for text in ("200:300", "+10s:+40s", "512.5:", "30s")]
    ['only_lines', 'only_time', 'only_time', 'first']
    """
    if ":" not in text:
        return "first"
    return "only_lines" if _LINES.fullmatch(text.strip()) else "only_time"


def window_of(text: str) -> Window:
    """Read a window of any form."""
    window = parse_window(
        **{"only_lines": None, "only_time": None, "first": None, window_key(text): text}
    )
    assert window is not None
    return window


def _window_of_lines(text: str) -> Window:
    match = _LINES.fullmatch(text.strip())
    expected = "A:B, lines A to B - 1 counted from 0, such as 200:300, 200: or :300"
    if match is None:
        raise ValueError(expected)
    low, high = match.groups()
    window = Window(f"--only {text}", True, float(low or 0), float(high or math.inf))
    if window.first >= window.stop:
        raise ValueError(expected)
    return window


def _window_of_times(text: str) -> Window:
    match = _TIMES.fullmatch(text.strip())
    expected = (
        "A:B, from A until just before B, in the stream's own seconds (prc info shows them), "
        "or with a + since its first one: 512.5:542.5, +10:+40, +1min:"
    )
    if match is None:
        raise ValueError(expected)
    plus, low, low_unit, other_plus, high, high_unit = match.groups()
    window = Window(
        f"--only {text}",
        False,
        -math.inf if low is None else float(low) * _SECONDS[low_unit or "s"],
        math.inf if high is None else float(high) * _SECONDS[high_unit or "s"],
        bool(plus),
        bool(other_plus),
    )
    if window.first_is_relative == window.stop_is_relative and window.first >= window.stop:
        raise ValueError(expected)
    return window


def _window_of_first(text: str) -> Window:
    match = _FIRST.fullmatch(text.strip())
    size = float(match.group(1)) if match is not None else 0.0
    in_lines = match is not None and match.group(2).startswith("line")
    if match is None or size <= 0 or (in_lines and size != int(size)):
        expected = "a length with its unit, such as 30s, 2min or 500lines"
        raise ValueError(expected)
    if in_lines:
        return Window(f"--only {text}", True, 0.0, size)
    return Window(f"--only {text}", False, 0.0, size * _SECONDS[match.group(2)], True, True)
