"""Options of ``prc transfer``."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from prc_cli.core.errors import ConfigError
from prc_cli.formats.las.rewrite import CARRIED
from prc_cli.matching.sides import MAX_SAME


@dataclass(frozen=True, slots=True)
class TransferOptions:
    """How the records of the two sides are matched."""

    match: str = "time"
    """``time``; ``order`` (equal on both sides; also ``record``); ``record:NAME`` (a dimension of
    the registered file with the index of the raw record, from 0); ``dimension:NAME`` (an integer
    dimension of both sides); ``nearest`` (the label with the nearest coordinates)."""
    tolerance_s: float = 0.0
    """Largest difference of times [s].

    Float64 rounding at these times is always allowed in addition. With ``nearest`` it is the
    largest distance [m]. 0 = chosen from both clouds, as ``prc evaluate`` does."""
    time_offset_s: float = 0.0
    """Added to the times of the labels [s]."""
    ignore_return: bool = False
    """Match by the key only, even if both sides have return numbers."""
    same: tuple[str, ...] = ()
    """Further integer dimensions that must be equal, such as ``scanner_channel``; at most two."""
    dimension: str | None = None
    """Column or dimension with the class codes.

    Default as :func:`~prc_cli.formats.labels.open_codes`.
    """
    carry: tuple[str, ...] = ()
    """Dimensions of classified LAS labels to copy as well: ``segment_id``, ``range``, ``surface``,
    ``dense_vegetation``, ``ground_height``, ``height_above_ground``, ``confidence``."""
    min_confidence: int | None = None
    """Labels with less confidence are not transferred [per cent].

    The labels are classified LAS with ``confidence``.
    """
    trajectory: Path | None = None
    """``nearest``: poses from which the shots of the labels' input get their coordinates."""
    mount: tuple[float, ...] = ()
    """Scanner on the vehicle: roll, pitch, yaw [deg]; x, y, z from the trajectory's point [m]."""
    min_matched: float = 0.5
    """Least share of the smaller side that must be matched.

    Also the least share of the matched points whose match must be unambiguous.
    """

    def __post_init__(self) -> None:
        typed = self.match
        if typed == "order":  # as for prc evaluate
            object.__setattr__(self, "match", "record")
        kind, _, name = self.match.partition(":")
        if self.match not in ("time", "record", "nearest") and not (
            kind in ("record", "dimension") and name
        ):
            problem = (
                f"found {self.match!r}, "
                "expected time, order, record:NAME, dimension:NAME or nearest"
            )
            raise ConfigError("--match", problem)
        if not (math.isfinite(self.tolerance_s) and self.tolerance_s >= 0):
            raise ConfigError(
                "--tolerance", f"found {self.tolerance_s}, expected seconds, 0 or more"
            )
        if not math.isfinite(self.time_offset_s):
            raise ConfigError("--time-offset", f"found {self.time_offset_s}, expected seconds")
        if self.match != "time" and (
            (self.tolerance_s and self.match != "nearest") or self.time_offset_s
        ):
            problem = f"--tolerance and --time-offset are for times, found --match {typed}"
            raise ConfigError("--match", problem, "leave them out")
        if not 0 <= self.min_matched <= 1:
            raise ConfigError(
                "--min-matched", f"found {self.min_matched}, expected a share from 0 to 1"
            )
        if self.min_confidence is not None and not 0 <= self.min_confidence <= 100:
            raise ConfigError(
                "--min-confidence", f"found {self.min_confidence}, expected per cent, 0 to 100"
            )
        if len(self.same) >= MAX_SAME:
            raise ConfigError(
                "--match",
                f"found {len(self.same)} more dimensions, expected at most {MAX_SAME - 1}",
            )
        for name in self.carry:
            if name not in CARRIED:
                raise ConfigError(
                    "--carry", f"found {name!r}, expected one of {', '.join(CARRIED)}"
                )

    def as_dict(self) -> dict[str, Any]:
        """Return the options for a run record, with the trajectory only if there is one."""
        options = asdict(self)
        trajectory = options.pop("trajectory")
        mount = options.pop("mount")
        if trajectory is not None:
            options |= {"trajectory": trajectory.name, "mount": mount}
        return options
