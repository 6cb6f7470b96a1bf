"""Scores only the records of some lines or times."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.window import Window
from prc_cli.jobs.evaluate.counts import Counts
from prc_cli.matching.join import Columns
from prc_cli.matching.sides import LINE, SECONDS


class ScoredWindow:
    """Leaves out pairs of records outside a window, and counts what is left."""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._origin_s: float | None = None
        self._n = self._n_inside = 0
        self._low, self._high = math.inf, -math.inf

    def inside(self, beside: Columns, one: Columns, other: Columns) -> tuple[tuple[Columns, Columns], Columns]:
        """Return both sides of the pairs within the window, and the columns beside them."""
        place = np.asarray(beside[LINE if self._window.in_lines else SECONDS], np.float64)
        known = np.isfinite(place) & ~(self._window.in_lines & (place < 0))
        if known.any():
            if self._origin_s is None:
                self._origin_s = float(place[known][0])
            self._low = min(self._low, float(place[known].min()))
            self._high = max(self._high, float(place[known].max()))
        low, high = self._window.bounds(self._origin_s or 0.0)
        keep = known & (place >= low) & (place < high)
        self._n += len(keep)
        self._n_inside += int(np.count_nonzero(keep))
        left, right, more = ({name: values[keep] for name, values in each.items()} for each in (one, other, beside))
        return (left, right), more

    def report(self, path: str, counts: Counts) -> None:
        """Note how many pairs were scored."""
        if not self._n_inside:
            what = "lines" if self._window.in_lines else "times"
            problem = f"found {what} from {self._low:.9g} to {self._high:.9g}, expected some in {self._window.option}"
            raise InputError(path, problem, f"choose {what} that it has")
        counts.note(f"{self._window.option}: {{n}} records outside are not scored", self._n - self._n_inside)
