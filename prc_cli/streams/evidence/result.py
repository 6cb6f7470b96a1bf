"""Checks of the result: labels that no scan gets if its description is right.

A wrong direction of down, a wrong M or damaged ranges show in the labels: the ground is not below
the scanner or leans, things lie below it, most of the scan is noise. The shares that are usual
differ between methods (:class:`prc_cli.methods.base.UsualLabels`).

Lines are kept while they pass: every n-th, in up to 128 of their columns; n doubles whenever there
are too many. All figures are computed from these on demand. The choice depends on the
line numbers alone, so the findings depend neither on threads nor on the reader's chunks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.facts import SourceFacts
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.hints import fitting_finding
from prc_cli.core.stream import LabelledBlock
from prc_cli.core.types import F32, F64, I64, U8, Mask
from prc_cli.methods.base import UsualLabels
from prc_cli.streams.evidence.table import verdict_of, worst_of

MAX_SCANNERS = 4
"""Most scanners whose labels are looked at."""
MAX_LINES = 512
MAX_COLUMNS = 128
"""Most lines and columns kept of a scanner: 0.3 MB."""
LEAST_LINES = 32
LEAST_RETURNS = 1000
"""Fewer kept lines, or fewer returns in them, are too few to tell."""
LEAST_SHARE = 0.5
"""Least share of returns in kept columns: fewer if columns are empty at regular steps."""
DOWN_RAD = math.radians(60.0)
"""Shots this near to straight down are on the ground, or on objects that stand on it."""
NEAR_M = 20.0
BELOW_M = 1.0
"""Returns this near should not lie this far below the ground."""
FAR_SHARE = 0.01
"""Least share of returns that are farther than a room is wide."""
LEAST_GROUND = 3
"""Ground returns on a side of a line for its height there."""
LEAST_LEVEL = 8
LEAST_SPREAD_M = 0.3
"""Ground returns of a line for its lean, and their standard deviation to the side."""
STRETCH_LINES = 16
"""Kept lines of a stretch: 16 to 32 stretches in all but short streams."""
LEAST_STRETCHES = 8
"""Fewer are too few to tell what is usual along the stream."""
WHOLE = 0.8
"""With this share of the usual returns left, noise fills empty shots, as from the sun."""
LONG_STRETCHES = 3
"""Stretches in a row that make a long one: a tenth to a fifth of a long stream."""

_NOTHING_BELOW = (
    "nothing is below the scanner: classify a tile beside the road with the other tiles of the "
    "drive; else check where down is: prc info"
)
_LOOK_FOR_DOWN = "check where down is: prc info; or give it: --set input.nadir=DEG"
_UP_KEY = "rings.up"
_NO_STREET = "fused is for scans outdoors; remove stretches indoors"
_LOOK_AT_INPUT = "check the order of the shots, M and the unit of the ranges: prc info"


class _Kept:
    """Lines of one scanner, evenly over all that have passed."""

    def __init__(self, item: LabelledBlock) -> None:
        # evenly spread columns; if these miss most returns, only columns with returns
        block = item.block
        step = -(-block.range_m.shape[1] // MAX_COLUMNS)
        self.columns = np.arange((step - 1) // 2, block.range_m.shape[1], step)
        n_returns = np.count_nonzero(np.isfinite(block.range_m), axis=0)
        if n_returns[self.columns].mean() < LEAST_SHARE * n_returns.mean():
            with_returns = np.flatnonzero(n_returns)
            step = -(-len(with_returns) // MAX_COLUMNS)
            self.columns = with_returns[(step - 1) // 2 :: step]
        n_columns = len(self.columns)
        self.beam_rad = None if block.beam_rad is None else block.beam_rad[self.columns].copy()
        self.angle_rad = None if block.angle_rad is None else block.angle_rad[self.columns].copy()
        self.line = np.empty(MAX_LINES, np.int64)
        self.range_m = np.empty((MAX_LINES, n_columns), np.float32)
        self.labels = np.empty((MAX_LINES, n_columns), np.uint8)
        self.n = 0
        self.stride = 1
        """Lines from one that is kept to the next."""
        self.is_up_assumed = False

    def add(self, item: LabelledBlock) -> None:
        self.is_up_assumed |= item.is_up_assumed
        first = item.block.first_line
        stop = first + item.block.n_lines
        line = first
        while True:
            line = -(-line // self.stride) * self.stride
            if line >= stop:
                return
            if self.n == MAX_LINES:
                self._drop_every_other()
                continue
            lines = np.arange(line, stop, self.stride)[: MAX_LINES - self.n]
            last = int(lines[-1])
            rows = slice(line - first, last - first + 1, self.stride)
            kept = slice(self.n, self.n + len(lines))
            self.line[kept] = lines
            self.range_m[kept] = item.block.range_m[rows][:, self.columns]
            self.labels[kept] = item.labels[rows][:, self.columns]
            self.n = kept.stop
            line = last + 1

    def _drop_every_other(self) -> None:
        self.stride *= 2
        kept = np.flatnonzero(self.line[: self.n] % self.stride == 0)
        self.n = len(kept)
        for column in (self.line, self.range_m, self.labels):
            column[: self.n] = column[kept]

    def sample(self) -> _Sample:
        return _Sample(
            self.line[: self.n],
            self.range_m[: self.n],
            self.labels[: self.n],
            self.beam_rad,
            self.angle_rad,
            self.is_up_assumed,
        )


@dataclass(frozen=True, slots=True)
class _Sample:
    """Kept lines of one scanner."""

    line: I64
    """(n,) int64, their numbers."""
    range_m: F32
    """(n, columns) float32 [m]."""
    labels: U8
    """(n, columns) uint8."""
    beam_rad: F64 | None
    """(columns,) float64, from straight down [rad]; None = unknown or not needed."""
    angle_rad: F64 | None
    """(columns,) float64, scan angle [rad]; None = unknown."""
    is_up_assumed: bool = False
    """Whether a plane below and one above fit, and z is assumed to point up."""


@dataclass(slots=True)
class ResultWatch:
    """Watches the labels while they are written, and checks them."""

    usual: UsualLabels
    facts: SourceFacts = field(default_factory=SourceFacts)
    _scanners: dict[int, _Kept] = field(default_factory=dict, init=False)

    def see(self, item: LabelledBlock) -> None:
        """Keep a bounded part of the next lines of a scanner; call it in the order of its lines."""
        kept = self._scanners.get(item.block.scanner)
        if kept is None:
            if len(self._scanners) == MAX_SCANNERS:
                return
            kept = self._scanners[item.block.scanner] = _Kept(item)
        kept.add(item)

    def findings(self) -> tuple[Finding, ...]:
        """Return the answers of all checks to what has passed so far.

        Too few labels give no finding.
        """
        scanners = sorted(self._scanners.items())
        by_scanner: dict[int, list[Finding]] = {}
        for scanner, kept in scanners:
            sample = kept.sample()
            without_angles = frozenset() if sample.angle_rad is not None else frozenset(("nadir",))
            refuses = self.facts.refuses | without_angles
            by_scanner[scanner] = [
                fitting_finding(finding, refuses, self.facts.remedy)
                for finding in check_labels(sample, self.usual)
            ]
        return tuple(worst_of(by_scanner))


def check_labels(sample: _Sample, usual: UsualLabels) -> Iterator[Finding]:
    """Run all checks of the labels of one scanner."""
    there = sample.labels != Label.MISSING
    if np.count_nonzero(there) < LEAST_RETURNS:
        return
    noise = sample.labels == Label.NOISE
    yield _noise(there, noise, sample.labels == Label.UNCLASSIFIED, usual)
    if sample.is_up_assumed:
        yield _both_level()
    if len(sample.line) < LEAST_LINES:
        return
    solid = there & ~noise
    level = np.isin(sample.labels, usual.level)
    yield from _indoors(solid, sample.range_m, usual)
    below = solid
    if sample.beam_rad is not None:
        is_down = np.abs(sample.beam_rad) < DOWN_RAD
        below = solid & is_down
        scene = _Scene.of(sample, solid, is_down)
        yield from _ground_below(solid, below, level, np.cos(sample.beam_rad) > 0, usual)
        yield from _ground_lean(scene, sample, usual)
        yield from _below_ground(scene, usual)
    yield from _along(sample, there, noise, below, level, usual)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.0995 else f"{100 * share:.0f} %"


def _noise(
    there: Mask,
    noise: Mask,
    unclassified: Mask,
    usual: UsualLabels,
) -> Finding:
    n = int(np.count_nonzero(there))
    noisy = int(np.count_nonzero(noise)) / n
    without = int(np.count_nonzero(unclassified)) / n
    if without > usual.unclassified_share and noisy <= usual.noise_share:
        measured = f"{_percent(without)} of the returns have no class"
        most = usual.unclassified_share
        return Finding(
            "noise-share", Verdict.DOUBTFUL, measured, f"at most {_percent(most)}", _LOOK_AT_INPUT
        )
    verdict = verdict_of(doubtful=noisy > usual.noise_share, against=noisy > usual.garbage_share)
    measured = f"{_percent(noisy)} of the returns are noise"
    return Finding(
        "noise-share", verdict, measured, f"at most {_percent(usual.noise_share)}", _LOOK_AT_INPUT
    )


def _both_level() -> Finding:
    """Return the warning that the floor and the ceiling could be exchanged."""
    measured = "a larger level surface is above the scanner than below it, if z points up"
    option = f"--set {_UP_KEY}=z"
    hint = f"if z points up: {option}; if it points down: --set {_UP_KEY}=-z"
    return Finding(
        "down", Verdict.DOUBTFUL, measured, "one level surface, the ground", hint, option
    )


def _indoors(solid: Mask, range_m: F32, usual: UsualLabels) -> Iterator[Finding]:
    n = int(np.count_nonzero(solid))
    if n < LEAST_RETURNS or usual.reach_m <= 0:
        return
    share = int(np.count_nonzero(solid & (range_m > usual.reach_m))) / n
    measured = f"{_percent(share)} of the returns are farther than {usual.reach_m:g} m"
    yield Finding(
        "indoors",
        verdict_of(doubtful=share < FAR_SHARE),
        measured,
        f"at least {_percent(FAR_SHARE)}",
        _NO_STREET,
    )


@dataclass(frozen=True, slots=True)
class _Scene:
    """Kept returns in the scan plane."""

    aside_m: F32
    """(n, columns) float32, to the side [m]."""
    up_m: F32
    """(n, columns) float32, above the scanner [m]."""
    near: Mask
    """(n, columns) bool, not noise, and within 20 m."""
    ground: Mask
    """(n, columns) bool, near, and ground."""
    is_down: Mask
    """(columns,) bool, within 60 deg of straight down."""
    is_left: Mask
    """(columns,) bool, side of the scan plane."""

    @classmethod
    def of(cls, sample: _Sample, solid: Mask, is_down: Mask) -> _Scene:
        assert sample.beam_rad is not None
        beam = sample.beam_rad.astype(np.float32)
        near = solid & (sample.range_m < NEAR_M)
        ground = near & np.isin(sample.labels, (Label.GROUND, Label.CURB))
        return cls(
            sample.range_m * np.sin(beam),
            sample.range_m * -np.cos(beam),
            near,
            ground,
            is_down,
            beam < 0,
        )


def _ground_below(
    solid: Mask,
    below: Mask,
    level: Mask,
    is_lower: Mask,
    usual: UsualLabels,
) -> Iterator[Finding]:
    where = " within 60 deg of down"
    hint = _LOOK_FOR_DOWN
    seen = below
    least = usual.level_share
    if np.count_nonzero(below) < LEAST_RETURNS:
        # ground that is above the scanner does not count
        where = ""
        hint = _NOTHING_BELOW
        seen = solid
        least = usual.ground_share
        level = level & is_lower
    n = int(np.count_nonzero(seen))
    if n < LEAST_RETURNS or least <= 0:
        return
    share = int(np.count_nonzero(seen & level)) / n
    measured = f"{_percent(share)} of the returns{where} are ground"
    yield Finding(
        "ground-below",
        verdict_of(doubtful=share < least),
        measured,
        f"at least {_percent(least)}",
        hint,
    )


def _ground_lean(scene: _Scene, sample: _Sample, usual: UsualLabels) -> Iterator[Finding]:
    # the slope of a straight line through the ground of every line
    ground = scene.ground[:, scene.is_down]
    n = np.count_nonzero(ground, axis=1)
    rows = n >= LEAST_LEVEL
    ground = ground[rows]
    n = n[rows]
    aside = np.where(ground, scene.aside_m[rows][:, scene.is_down], 0)
    up = np.where(ground, scene.up_m[rows][:, scene.is_down], 0)
    middle = aside.sum(axis=1) / n
    height = up.sum(axis=1) / n
    variance = (aside * aside).sum(axis=1) / n - middle * middle
    covariance = (aside * up).sum(axis=1) / n - middle * height
    is_wide = variance > LEAST_SPREAD_M**2
    if np.count_nonzero(is_wide) < LEAST_LINES:
        return
    lean_rad = math.atan(float(np.median(covariance[is_wide] / variance[is_wide])))
    lean_deg = math.degrees(lean_rad)
    hint = _LOOK_FOR_DOWN
    if sample.angle_rad is not None and sample.beam_rad is not None:
        nearest = int(np.argmin(np.abs(sample.beam_rad - lean_rad)))
        nadir_deg = math.degrees(sample.angle_rad[nearest])
        hint = f"to make it level: --set input.nadir={nadir_deg:.1f}; check where down is: prc info"
    yield Finding(
        "ground-lean",
        verdict_of(doubtful=abs(lean_deg) > usual.lean_deg),
        f"the ground leans by {abs(lean_deg):.2f} deg across the lines",
        f"at most {usual.lean_deg:g} deg",
        hint,
    )


def _below_ground(scene: _Scene, usual: UsualLabels) -> Iterator[Finding]:
    n_near = 0
    n_below = 0
    for is_side in (scene.is_left, ~scene.is_left):
        side = is_side & scene.is_down
        ground = scene.ground[:, side]
        n_ground = np.count_nonzero(ground, axis=1)
        rows = n_ground >= LEAST_GROUND
        if not rows.any():
            continue
        up = scene.up_m[rows][:, side]
        ground = ground[rows]
        n_ground = n_ground[rows]
        # all else sorts behind the ground
        heights = np.sort(np.where(ground, up, np.float32(np.inf)), axis=1)
        middle_m = np.take_along_axis(heights, (n_ground // 2)[:, None], axis=1)
        near = scene.near[rows][:, side]
        n_near += int(np.count_nonzero(near))
        n_below += int(np.count_nonzero(near & ~ground & (up < middle_m - BELOW_M)))
    if n_near < LEAST_RETURNS:
        return
    share = n_below / n_near
    measured = (
        f"{_percent(share)} of the returns within 20 m and 60 deg of down are more than 1 m "
        "below the ground"
    )
    verdict = verdict_of(doubtful=share > usual.below_share)
    yield Finding(
        "below-ground", verdict, measured, f"at most {_percent(usual.below_share)}", _LOOK_FOR_DOWN
    )


def _along(
    sample: _Sample,
    there: Mask,
    noise: Mask,
    below: Mask,
    level: Mask,
    usual: UsualLabels,
) -> Iterator[Finding]:
    n = len(sample.line) // STRETCH_LINES
    if n < LEAST_STRETCHES:
        return

    def per_stretch(mask: Mask) -> F64:
        rows: I64 = np.count_nonzero(mask[: n * STRETCH_LINES], axis=1)
        counts: F64 = rows.reshape(n, STRETCH_LINES).sum(axis=1).astype(np.float64)
        return counts

    expected = "ground and little noise along the whole stream"
    ground = _share(per_stretch(below & level), per_stretch(below))
    noisy = _share(per_stretch(noise), per_stretch(there))
    known = ground[np.isfinite(ground)]
    usually = float(np.quantile(known, 0.75)) if len(known) else 0.0
    solid = np.convolve(per_stretch(there & ~noise), np.ones(LONG_STRETCHES), "valid")
    is_noisy = noisy > usual.noise_share
    is_whole = solid >= WHOLE * (np.median(solid[~is_noisy]) if not is_noisy.all() else np.inf)
    for bad, said, verdict in (
        (ground < usual.vanished_share * usually, "hardly any ground", Verdict.DOUBTFUL),
        (is_noisy & ~is_whole, "much noise", Verdict.DOUBTFUL),
        (is_noisy, "much noise between complete surfaces", Verdict.FINE),
    ):
        first, length = longest_run(bad)
        # where all is noise, it is not a stretch that is odd
        if not 0 < length < len(bad):
            continue
        start = int(sample.line[first * STRETCH_LINES])
        stop = int(sample.line[(first + length + LONG_STRETCHES - 1) * STRETCH_LINES - 1]) + 1
        shown = f"{start}:{min(start + 500, stop)}"
        hint = f"to see these lines: prc render IN OUT.png --only {shown}"
        yield Finding(
            "classes-along", verdict, f"{said} in lines {start} to {stop}", expected, hint
        )
        return
    yield Finding(
        "classes-along", Verdict.FINE, "ground and noise are even along the stream", expected
    )


def _share(part: F64, whole: F64) -> F64:
    """Return shares pooled over as many stretches as make a long one.

    NaN if there are too few returns.
    """
    kernel = np.ones(LONG_STRETCHES)
    parts = np.convolve(part, kernel, "valid")
    wholes = np.convolve(whole, kernel, "valid")
    unknown = np.full(len(parts), np.nan)
    shares: F64 = np.divide(
        parts, wholes, out=unknown, where=wholes >= LEAST_RETURNS * LONG_STRETCHES / LEAST_STRETCHES
    )
    return shares


def longest_run(mask: Mask) -> tuple[int, int]:
    """Return the start and the length of the longest run of true values.

    >>> longest_run(np.array([True, False, True, True, False]))
    (2, 2)
    >>> longest_run(np.array([False]))
    (0, 0)
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    starts = edges[::2]
    ends = edges[1::2]
    if not len(starts):
        return 0, 0
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest] - starts[longest])
