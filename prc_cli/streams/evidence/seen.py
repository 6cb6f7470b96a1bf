"""What the checks are given: everything known of one scanner of a stream."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from prc_cli.core.stream import ReadTally, StreamInfo
from prc_cli.core.types import F64
from prc_cli.streams.evidence.figures import Window


@dataclass(frozen=True, slots=True)
class Seen:
    """One scanner of a stream, as far as it was read."""

    info: StreamInfo
    scanner: int
    windows: tuple[Window, ...]
    """Lines spread over what was read, in order."""
    n_lines: int = 0
    n_shots: int = 0
    """Cells read of all scanners, missing shots included."""
    n_missing: int = 0
    """Of all scanners."""
    tally: ReadTally = field(default_factory=ReadTally)
    """Counts of the reader, of all scanners."""
    angle_rad: F64 | None = None
    """(M,) float64, scan angle of every column [rad]; None = unknown."""
    beam_rad: F64 | None = None
    """(M,) float64, angle of every column from straight down as it is used [rad]; None = unknown or not needed."""
    most_noise_m: float = math.inf
    """Most range noise that the method stands [m]."""
    is_whole: bool = True
    """Whether the stream was read to its end."""

    @property
    def points_per_line(self) -> int:
        """M, shots in a scan line."""
        return self.windows[0].range_m.shape[1] if self.windows else self.info.points_per_line
