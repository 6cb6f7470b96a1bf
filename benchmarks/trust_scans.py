"""Scans of the benchmark of trust: windows all along simulated drives and walks, and real scans.

A window has what a scanner writes, and the truth: the class of every shot and the scan angle of
straight down. Scan angles count from the first column, as an encoder does. Scans whose set is
``tuning`` may be used to choose limits; those of ``held-out`` (other seeds, other scanners and
mountings, other strips) are only reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan, Simulated
from benchmarks.pages import DATA
from prc_cli.core.types import F32, F64, I64
from prc_cli.simulation.scanners import SCANNERS

Part = Literal["tuning", "held-out"]
PARTS: tuple[Part, ...] = ("tuning", "held-out")
FIRST_SEED: dict[Part, int] = {"tuning": 20_000, "held-out": 60_000}
"""Seeds of a set begin here; ``--seed N`` adds ``N * 1000``. No other benchmark uses these."""
SEEDS_APART = 1000
FEW_COLUMNS = 400
"""Scanners with fewer shots a line are push-brooms.

PRC runs with their parameters, and sequential-angle too.
"""
OAKLAND_LINES_HZ = 37.5


@dataclass(frozen=True, slots=True)
class Window:
    """Consecutive lines of a scan, and the truth about them."""

    scan: str
    first_line: int
    range_m: F32
    """(lines, M) float32 [m]; NaN = missing."""
    codes: I64
    """(lines, M) int64, reference codes of ``mapping``; 0 = not judged."""
    mapping: str
    """Mapping of the codes: a key of ``contest_judge.MAPPINGS``."""
    start_deg: float
    step_deg: float
    """Scan angle of the first column, and from column to column [deg]."""
    nadir_deg: float
    """Scan angle of straight down [deg]."""
    time_s: F64
    """(lines, M) float64 [s]."""
    world_m: F64 | None = None
    """(lines, M, 3) float64, registered [m]."""
    scanner_m: F64 | None = None
    """(lines, 3) float64, where the scanner was amid every line [m]."""

    @property
    def points_per_line(self) -> int:
        return int(self.range_m.shape[1])

    @property
    def n_lines(self) -> int:
        return int(self.range_m.shape[0])

    @property
    def is_forest(self) -> bool:
        return self.mapping == "forest"

    @property
    def is_push_broom(self) -> bool:
        return self.points_per_line < FEW_COLUMNS

    @property
    def line_hz(self) -> float:
        """Scan lines a second [Hz]."""
        return float((self.n_lines - 1) / (self.time_s[-1, 0] - self.time_s[0, 0]))

    def cells(self) -> I64:
        """Return the number of every shot, (lines, M) int64."""
        return np.arange(self.range_m.size).reshape(self.range_m.shape)

    def angle_deg(self) -> F64:
        """Return the scan angle of every column, (M,) float64 [deg]."""
        return self.start_deg + self.step_deg * np.arange(self.points_per_line, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Source:
    """A scan, cut into windows."""

    name: str
    make: Callable[[], Scan]
    n_lines: int
    """Lines of a window."""
    spec: Simulated | None = None
    """Parameters of simulated ones."""

    def windows(self, n: int) -> list[Window]:
        """Return windows that begin at even distances along the scan.

        The last one ends where the scan ends.
        """
        scan = self.make()
        lines = len(scan.range_m)
        per_window = min(self.n_lines, lines)
        n = min(n, 1 + (lines - per_window) // max(per_window // 8, 1))
        firsts = np.unique(np.linspace(0, lines - per_window, n).astype(int))
        return [cut(self.name, scan, int(first), per_window) for first in firsts]


def cut(
    name: str,
    scan: Scan,
    first: int,
    n_lines: int,
) -> Window:
    """Return some lines of a scan; its angles count from the first column."""
    lines = slice(first, first + n_lines)
    degrees = np.rad2deg(np.unwrap(scan.angle_rad))
    step = float((degrees[-1] - degrees[0]) / (len(degrees) - 1))
    time_s = _times(scan)
    return Window(
        scan=name,
        first_line=first,
        range_m=np.ascontiguousarray(scan.range_m[lines]),
        codes=np.ascontiguousarray(scan.codes[lines]),
        mapping=scan.mapping,
        start_deg=0.0,
        step_deg=step,
        nadir_deg=float(-degrees[0]),
        time_s=np.ascontiguousarray(time_s[lines]),
        world_m=None if scan.world_m is None else scan.world_m[lines],
        scanner_m=None if scan.scanner_m is None else scan.scanner_m[lines],
    )


def _times(scan: Scan) -> F64:
    """Return the times of a scan, even ones where it has none."""
    if scan.time_s is not None:
        return scan.time_s
    lines, m = scan.range_m.shape
    times: F64 = (np.arange(lines)[:, None] + 0.75 * np.arange(m) / m) / OAKLAND_LINES_HZ
    return times


_LINES = {"photon-80": 256, "focus3d-120": 144, "profiler-1mhz": 144, "sick-push-broom": 512}
"""Lines of a window by scanner."""


def source(spec: Simulated, *, is_short: bool) -> Source:
    """Return a simulated scan, whole or as short as a quick run needs it."""
    n_lines = _LINES[spec.scanner]
    if is_short:
        line_hz = spec.mount.get("line_hz", SCANNERS[spec.scanner].line_hz)
        speed_m_s = 1.1 if spec.kind == "forest" else 8.33
        spec = replace(spec, length_m=1.5 * n_lines * speed_m_s / line_hz)
    return Source(spec.name, partial(data.simulated, spec), n_lines, spec)


TOY_SEED = 59_000
_QUICK: dict[Part, tuple[int, ...]] = {"tuning": (1, 3, 5), "held-out": (0, 7, 10)}
"""Scans of a quick run."""


def sources(part: Part, seed: int = 0, *, is_quick: bool = False) -> Iterator[Source]:
    """Return the scans of a set that are made of lines; real ones if available."""
    for i, spec in enumerate(data.simulations(f"trust_{part.replace('-', '_')}")):
        if not is_quick or i in _QUICK[part]:
            seed_of_scan = FIRST_SEED[part] + SEEDS_APART * seed + i
            yield source(replace(spec, seed=seed_of_scan), is_short=is_quick)
    strips = (1,) if part == "tuning" else (2, 3)
    if (DATA / "oakland").exists() and not is_quick:
        for strip in strips:
            yield Source(f"Oakland strip {strip}", partial(data.oakland, strip), 256)


def toy(name: str) -> Source:
    """Return a small scan for tests."""
    (spec,) = (spec for spec in data.simulations("trust_toys") if spec.name == name)
    return source(replace(spec, seed=TOY_SEED), is_short=False)
